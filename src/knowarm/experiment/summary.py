"""Statistics of an evaluation: columns of its episodes and steps, and their summary."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from knowarm.experiment.config import EvaluationConfig
from knowarm.experiment.edited_graph import answers_before_edit
from knowarm.experiment.evaluation_files import STEP_COLUMNS
from knowarm.statistics import Interval, bootstrap, wilson
from knowarm.world.agents.play import EpisodeResults
from knowarm.world.envs.vector_env import ReachVectorEnv

Columns = Mapping[str, np.ndarray]
"""One (n,) array per column, as `evaluation_files.EPISODE_COLUMNS` describes them."""


def episode_columns(
    result: EpisodeResults, env: ReachVectorEnv, config: EvaluationConfig
) -> dict[str, np.ndarray]:
    """Return the columns of ``episodes.parquet``, (n,) each."""
    count = len(result.length)
    names = np.array(["/".join(facet) for facet in env.facets])
    seeds = config.seed + np.arange(config.seeds)
    targets = np.array([target.name for target in env.scene.targets])
    columns = {
        "episode": np.arange(count),
        "evaluation_seed": np.repeat(seeds, count // config.seeds),
        "target": targets[result.infos["target"]],
        "facet": names[result.infos["facet"]],
        "return": result.episode_return,
        "length": result.length,
        "distance_m": result.distance,
        "angle_deg": result.angle,
        "success": result.success,
        "accurate": result.distance <= config.distance_m,
        "success_wide": _ever_within(result, config),
    }
    columns |= env.config.task.columns(env.running.setting, result.infos)
    if config.split == "S5":
        before = answers_before_edit(env.config)
        asked = zip(columns["query"], columns["chosen"], strict=True)
        columns["chose_old_answer"] = np.array([name in before.get(q, ()) for q, name in asked])
    return columns


def _ever_within(result: EpisodeResults, config: EvaluationConfig) -> np.ndarray:
    """Return (N,) bool: success with the wider angle.

    Until an episode meets the wider threshold, both thresholds give the same steps.
    """
    assert result.steps is not None
    steps = result.steps
    near = (steps.distance <= config.distance_m) & (steps.angle <= config.wide_angle_deg)
    within = result.success.copy()
    within[steps.episode[near]] = True
    return within


def step_values(result: EpisodeResults) -> dict[str, np.ndarray]:
    """Return the columns of ``steps.parquet``, (steps,) each."""
    assert result.steps is not None
    steps = result.steps
    values = (steps.episode, steps.step, steps.distance, steps.angle, steps.reward)
    columns = dict(zip(STEP_COLUMNS, values, strict=True))
    for i in range(steps.joint_positions.shape[1]):
        columns[f"joint_{i + 1}_rad"] = steps.joint_positions[:, i]
        columns[f"action_{i + 1}"] = steps.actions[:, i]
    return columns


def summarize(episodes: Columns) -> dict[str, Any]:
    """Compute the numbers of the paper's post-training evaluation, with 95 % intervals.

    Of all episodes, and the same under ``per_target`` and ``per_facet``: ``return_*``, ``length_*``
    and ``failure_distance_*`` (mean, sample std, max), ``accuracy`` (the paper's: final distance
    only), ``success`` (distance and angle at the same step), ``success_wide`` (the wider angle).
    In tasks with queries also ``choice``, the share of episodes that ended nearest to the wanted
    object, ``success_if_chosen``, groups ``per_query``, and on S5 ``chose_old_answer``.
    """
    summary = _numbers(episodes)
    groups = {"per_target": "target", "per_facet": "facet"}
    if "query" in episodes:
        groups["per_query"] = "query"
    for group, column in groups.items():
        keys = episodes[column]
        summary[group] = {
            str(name): _numbers({key: values[keys == name] for key, values in episodes.items()})
            for name in sorted(set(keys))
        }
    return summary


def _numbers(episodes: Columns) -> dict[str, Any]:
    """The numbers of `summarize` for one group of episodes."""
    count = len(episodes["return"])
    failures = episodes["distance_m"][~episodes["success"]]
    values: dict[str, Any] = {"episodes": count}
    for name in ("return", "length"):
        values[f"{name}_mean"] = float(np.mean(episodes[name]))
        values[f"{name}_std"] = _std(episodes[name])
        values |= _bounds(f"{name}_mean", bootstrap([episodes[name]], repetitions=2_000))
    for name in ("accuracy", "success", "success_wide"):
        column = "accurate" if name == "accuracy" else name
        share = wilson(int(np.count_nonzero(episodes[column])), count)
        values |= {name: share.estimate, **_bounds(name, share)}
    if "choice_correct" in episodes:
        correct = episodes["choice_correct"]
        share = wilson(int(np.count_nonzero(correct)), count)
        values |= {"choice": share.estimate, **_bounds("choice", share)}
        reached = episodes["success"][correct]
        values["success_if_chosen"] = float(reached.mean()) if len(reached) else 0.0
    if "chose_old_answer" in episodes:
        values["chose_old_answer"] = float(episodes["chose_old_answer"].mean())
    values["failures"] = len(failures)
    for name, function in (("mean", np.mean), ("std", _std), ("max", np.max)):
        values[f"failure_distance_{name}"] = float(function(failures)) if len(failures) else None
    values["distance_mean"] = float(np.mean(episodes["distance_m"]))
    values["angle_mean"] = float(np.mean(episodes["angle_deg"]))
    return values


def _std(values: np.ndarray) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _bounds(name: str, interval: Interval) -> dict[str, float]:
    return {f"{name}_low": interval.low, f"{name}_high": interval.high}
