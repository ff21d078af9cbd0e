"""An evaluation's statistics, and the files that store it: summary, episodes and steps."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image, ImageSequence

from knowarm.experiment.config import EvaluationConfig
from knowarm.experiment.graph_at_test import answers_before_edit
from knowarm.reading import reading, replacing, writing
from knowarm.statistics import bootstrap, wilson
from knowarm.world.agents.play import EpisodeResults
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.lifting.lift import OUTCOMES, lift
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.episodes import Episodes

EPISODE_COLUMNS = {
    "episode": ("int32", "index of the episode in the fixed list, from 0"),
    "evaluation_seed": ("int64", "seed from which the episode was drawn"),
    "target": ("string", "target object"),
    "facet": ("string", "object and colour, as object/colour"),
    "return": ("float64", "sum of the rewards, not discounted"),
    "length": ("int32", "steps until success or the time limit"),
    "distance_m": ("float64", "distance of gripper and grasp point at the end [m]"),
    "angle_deg": ("float64", "geodesic angle between gripper and grasp frame at the end [deg]"),
    "success": ("bool", "distance and angle within the thresholds at the same step"),
    "accurate": ("bool", "distance within the threshold at the end: the paper's accuracy"),
    "success_wide": ("bool", "distance and the wider angle threshold met at some step"),
}
"""Columns of ``episodes.parquet``: type and meaning; one row per episode."""

TASK_COLUMNS = {
    "query": ("string", "query of the episode"),
    "chosen": ("string", "object whose grasp point was nearest to the gripper at the end"),
    "choice_correct": ("bool", "whether that object answers the query"),
    "object_correct": ("bool", "whether the part reached belongs to the object that answers"),
    "chose_old_answer": ("bool", "whether it answered the query before the graph was edited"),
    "visible_answers": ("int64", "objects in the first image that answer, as the agent sees it"),
    "lift": ("string", "how the lift of the object ended: see lifting.OUTCOMES"),
    "lift_rise_m": ("float64", "rise of the object's centre of mass in the lift [m]"),
}
"""Further columns of tasks with several objects and of the lift test; a task of your own adds
others."""

STEP_COLUMNS = {
    "episode": ("int32", "index of the episode in the fixed list, from 0"),
    "step": ("int32", "step of the episode, from 1; the row holds the values after the step"),
    "distance_m": ("float32", "distance of gripper and grasp point [m]"),
    "angle_deg": ("float32", "geodesic angle between gripper and grasp frame [deg]"),
    "reward": ("float32", "reward of the step"),
}
"""Columns of ``steps.parquet``, followed by ``joint_<i>_rad`` and ``action_<i>`` per joint."""

NOT_REACHED = "not reached"
"""Outcome of episodes without success, in which nothing is lifted."""
EXCLUDED = "excluded"
"""Outcome of episodes whose object the robot's ``not_liftable`` names."""
FRAME_MS, LAST_MS = 120, 1_200
"""Display time of each image, and of the last before the animation repeats [ms]."""
MAX_FRAMES = 10_000
"""Most images of a film that is read; an episode has at most a few hundred steps."""
AGAIN = "Evaluate the run again."
"""Remedy for a damaged file of an evaluation."""


def episode_types(episodes: Mapping[str, np.ndarray]) -> dict[str, tuple[str, str]]:
    """Return type and meaning of the columns of ``episodes.parquet``, those of the task last."""
    known = EPISODE_COLUMNS | {n: each for n, each in TASK_COLUMNS.items() if n in episodes}
    types = {"b": "bool", "i": "int64", "u": "int64", "f": "float64"}
    return known | {
        name: (types.get(values.dtype.kind, "string"), "of the task")
        for name, values in episodes.items()
        if name not in known
    }


def step_columns(joints: int) -> dict[str, tuple[str, str]]:
    """Return the columns of ``steps.parquet`` for a robot with ``joints`` joints."""
    columns = dict(STEP_COLUMNS)
    for i in range(1, joints + 1):
        increment = f"chosen increment of joint {i}: 0..6, see ACTION_LEVELS"
        columns[f"joint_{i}_rad"] = ("float32", f"angle of joint {i} [rad]")
        columns[f"action_{i}"] = ("int8", increment)
    return columns


def write_table(
    path: Path, columns: Mapping[str, np.ndarray], described: Mapping[str, tuple[str, str]]
) -> None:
    """Write columns, (n,) each, to a Parquet file, with the meaning of each as metadata."""
    types = {"string": pa.dictionary(pa.int32(), pa.string())}
    fields = [
        pa.field(name, types.get(kind) or pa.type_for_alias(kind), metadata={"meaning": meaning})
        for name, (kind, meaning) in described.items()
    ]
    arrays = [pa.array(columns[f.name]).cast(f.type) for f in fields]
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields))
    with replacing(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a Parquet file as (n,) arrays."""
    with reading(path, AGAIN):
        table = pq.read_table(pa.BufferReader(path.read_bytes()))
        return {name: np.asarray(table[name].to_numpy()) for name in table.column_names}


def write_film(path: Path, frames: np.ndarray) -> None:
    """Write images (T, H, W, 3) as a lossless animated WebP, which `read_film` reads."""
    images = [Image.fromarray(frame) for frame in frames]
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_MS]
    options: dict[str, Any] = {"duration": durations, "loop": 0, "lossless": True, "method": 4}
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        images[0].save(path, save_all=True, append_images=images[1:], **options)


def read_film(path: Path) -> np.ndarray:
    """Read the images of a film written by `write_film`: (T, H, W, 3) uint8."""
    frames: list[np.ndarray] = []
    with reading(path, AGAIN):
        with Image.open(path) as film:
            for number, frame in enumerate(ImageSequence.Iterator(film)):
                image = np.asarray(frame.convert("RGB"))
                # The encoder stores equal neighbours once, with the sum of their times.
                shown = int(frame.info.get("duration", 0))  # a single image has none
                is_last = number == getattr(film, "n_frames", 1) - 1
                extra = shown - (LAST_MS if is_last else FRAME_MS)
                frames += [image] * (1 + max(0, extra) // FRAME_MS)
                if len(frames) > MAX_FRAMES:
                    raise ValueError(f"it shows more than {MAX_FRAMES:,} images")
        return np.stack(frames)


Columns = Mapping[str, np.ndarray]
"""One (n,) array per column, as `EPISODE_COLUMNS` describes them."""


def episode_columns(
    result: EpisodeResults, env: ArmVectorEnv, config: EvaluationConfig
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


def lift_columns(result: EpisodeResults, scene: Scene, episodes: Episodes) -> dict[str, np.ndarray]:
    """Lift the object of every successful episode; return ``lift`` and ``lift_rise_m``, (n,).

    Every episode ends at its first state within the thresholds, so each is lifted at most once.
    """
    count = len(episodes)
    names = np.array([target.name for target in scene.targets])[episodes.target]
    excluded = np.isin(names, list(scene.robot.not_liftable))
    chosen = np.flatnonzero(result.success & ~excluded)
    outcome = np.where(excluded, EXCLUDED, NOT_REACHED).astype("U16")
    rise = np.zeros(count)
    if len(chosen):
        steps = result.steps
        first = np.searchsorted(steps.episode, np.arange(count + 1))
        paths = [steps.joint_positions[first[i] : first[i + 1]] for i in chosen]
        lifts = lift(scene, paths, episodes.objects[chosen], episodes.positions[chosen])
        outcome[chosen], rise[chosen] = lifts.outcome, lifts.rise
    return {"lift": outcome, "lift_rise_m": rise}


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
    object or part, ``right_object`` of tasks with parts, ``success_if_chosen``, groups
    ``per_query``, and on S5 ``chose_old_answer``; of agents that answer by a graph
    ``saw_no_answer`` and ``saw_several_answers``; of a lift test the numbers of `lift_numbers`.
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
        values |= bootstrap(episodes[name], repetitions=2_000).named(f"{name}_mean")
    shares = {"accuracy": "accurate", "success": "success", "success_wide": "success_wide"}
    shares |= {"choice": "choice_correct", "right_object": "object_correct"}
    for name, column in shares.items():
        if column in episodes:
            values |= wilson(int(np.count_nonzero(episodes[column])), count).named(name)
    if "choice_correct" in episodes:
        reached = episodes["success"][episodes["choice_correct"]]
        values["success_if_chosen"] = float(reached.mean()) if len(reached) else 0.0
    if "visible_answers" in episodes:
        values["saw_no_answer"] = float(np.mean(episodes["visible_answers"] == 0))
        values["saw_several_answers"] = float(np.mean(episodes["visible_answers"] > 1))
    if "chose_old_answer" in episodes:
        values["chose_old_answer"] = float(episodes["chose_old_answer"].mean())
    if "lift" in episodes:
        values |= lift_numbers(episodes)
    values["failures"] = len(failures)
    for name, function in (("mean", np.mean), ("std", _std), ("max", np.max)):
        values[f"failure_distance_{name}"] = float(function(failures)) if len(failures) else None
    values["distance_mean"] = float(np.mean(episodes["distance_m"]))
    values["angle_mean"] = float(np.mean(episodes["angle_deg"]))
    return values


def lift_numbers(episodes: Columns) -> dict[str, Any]:
    """Compute the numbers of a group of episodes, without those that are excluded.

    ``lifted`` is the share of all episodes in which the object was lifted, ``grasps`` that of the
    successful ones, with 95 % Wilson intervals; ``lift_outcomes`` counts how lifts ended.
    """
    outcomes = episodes["lift"][episodes["lift"] != EXCLUDED]
    successes = np.count_nonzero(outcomes != NOT_REACHED)
    lifted = np.count_nonzero(outcomes == "lifted")
    values: dict[str, Any] = {"lift_episodes": len(outcomes)}
    for name, of in (("lifted", len(outcomes)), ("grasps", int(successes))):
        if of:
            values |= wilson(int(lifted), of).named(name)
    counted = {name: int(np.count_nonzero(outcomes == name)) for name in (*OUTCOMES, NOT_REACHED)}
    return values | {"lift_outcomes": counted}


def _std(values: np.ndarray) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
