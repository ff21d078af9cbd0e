"""Settings of tiny trainings, and the facets of the reach task, shared by all tests."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.names import experiment_config

ALGORITHM = {"num_envs": 4, "rollout_steps": 5, "minibatches": 2, "processes": 1}

NETWORK = {"features": 16, "hidden": 16}
"""A small network: optimizers, checkpoints and packs take long for a large one."""

EPISODE = {"max_episode_steps": 25}

TINY = {
    "total_steps": 40,
    "interim": {"every_steps": 40, "episodes": 2},
    "env": EPISODE,
    "policy": NETWORK,
    "algorithm": ALGORITHM,
}
"""Two updates, without a checkpoint between them."""

SHORT = {
    "total_steps": 160,
    "checkpoint_every_steps": 40,
    "interim": {"every_steps": 80, "episodes": 2},
    "env": EPISODE,
    "policy": NETWORK,
    "algorithm": ALGORITHM,
}
"""Eight updates, with checkpoints and evaluations between them; the settings of `short`."""

STUDY = {
    "total_steps": 40,
    "checkpoint_every_steps": 20,
    "interim": {"every_steps": 20, "episodes": 2},
    "env": EPISODE,
    "policy": NETWORK,
    "algorithm": ALGORITHM,
}
"""Two updates, with a checkpoint and an evaluation after each; the runs of a tiny study."""

CHOOSE_ENV = {
    "dynamics": "kinematic",
    "task": {"asked": {"queries": {"pairs": "none"}}},
}

CHOOSE_NAME = "irb120-choose-subgraph-fast"

CHOOSE = {
    "total_steps": 200,
    "knows": {"grounding": {"images": 64, "rounds": 2, "batch": 32}},
    "env": {**CHOOSE_ENV, **EPISODE},
    "policy": NETWORK,
    "algorithm": {"num_envs": 4, "rollout_steps": 25, "minibatches": 2, "processes": 1},
    "interim": {"every_steps": 100, "episodes": 4},
}
"""Two updates of an agent with knowledge of a query, which it grounds."""

FACETS = [
    ("mug", "red"),
    ("mug", "blue"),
    ("bottle", "yellow"),
    ("bottle", "purple"),
    ("cereal_box", "brown"),
    ("cereal_box", "light_blue"),
]
"""The six facets of the reach task with randomized colours; every second one is a fixed colour."""


def short(name: str = "irb120-full-ppo", **changes: Any) -> ExperimentConfig:
    """Return the config of a training that is stopped, resumed or compared."""
    return dataclasses.replace(experiment_config(name, **SHORT), **changes)


def flags(settings: Mapping[str, Any], prefix: str = "--") -> Iterator[str]:
    """Return settings as arguments of the command line."""
    for name, value in settings.items():
        flag = prefix + name.replace("_", "-")
        if isinstance(value, Mapping):
            yield from flags(value, f"{flag}.")
        elif value is False:
            yield f"{prefix}no-{flag.removeprefix(prefix)}"
        else:
            yield from (flag, str(value))
