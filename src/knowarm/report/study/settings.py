"""Configs go in; which of them are the same, and in what the others differ, come out."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from knowarm.report.study.model import Run

NOT_THE_TASK = {"renderer", "image_size", "name"}
"""Fields of ``env`` that do not make another task."""

OF_THE_RUN = {"agent", "name", "seed", "env", "format", "checkpoint_every_steps"}
"""Top-level fields that are no setting of the agent."""

DRAWS = {"knowledge.seed"}
"""Settings that only draw anew: runs that differ in them are seeds of one agent."""


def task_key(run: Run) -> str:
    """Equal for runs that were trained on the same task by the same algorithm."""
    env = {k: v for k, v in run.config["env"].items() if k not in NOT_THE_TASK}
    return json.dumps([env, algorithm(run)], sort_keys=True)


def agent_settings(run: Run) -> dict[str, Any]:
    """Everything but task and seed, flattened to dotted names."""
    kept = {name: value for name, value in run.config.items() if name not in OF_THE_RUN}
    return {name: value for name, value in flatten(kept).items() if name not in DRAWS}


def algorithm(run: Run) -> str:
    """Name of the algorithm."""
    chosen = run.config["algorithm"]
    return str(chosen.get("name", "?")) if isinstance(chosen, Mapping) else str(chosen)


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one mapping of dotted names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names whose values are not the same everywhere."""
    names = sorted({name for each in settings for name in each})
    return [
        name
        for name in names
        if len({json.dumps(each.get(name), sort_keys=True) for each in settings}) > 1
    ]
