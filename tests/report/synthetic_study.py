"""Synthetic studies: run folders as trainings with a known truth could have left them."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from knowarm.config import to_dict
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.evaluation import EvaluationConfig, SplitTest
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.summary import (
    EPISODE_COLUMNS,
    Summary,
    step_columns,
    summarize,
    write_film,
    write_table,
)
from knowarm.knowledge import query_embedding, scene_embedding
from knowarm.knowledge.queries.queries import parse_query
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.reading import read_json, write_json
from knowarm.report.model import Group, StudyData
from knowarm.statistics import Interval
from knowarm.world.agents import BLIND_AGENTS
from knowarm.world.robots import ROBOTS

FACETS = {
    "fixed": [("mug", "red"), ("bottle", "yellow"), ("cereal_box", "brown")],
    "randomized": [
        ("mug", "red"),
        ("mug", "blue"),
        ("bottle", "yellow"),
        ("bottle", "purple"),
        ("cereal_box", "brown"),
        ("cereal_box", "light_blue"),
    ],
}
ASKED = [
    parse_query(text)
    for text in ("usedFor drinking", "hasPart handle", "hasColor brown")
]
"""Queries of the choose task."""
JOINTS = {"irb120": 6, "tiago": 7}
LABEL = "post-training-greedy"


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What is true of every agent of a study."""

    success: dict[str, float]
    """Mean success of each agent's trainings."""
    spread: float = 0.05
    """Standard deviation of success from training seed to training seed."""
    roles: dict[str, str] = field(default_factory=dict)
    """Roles stored in the configs; other agents have that of the registry, or none."""
    sizes: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Stored sizes of single agents that differ from the true ones: "knowledge" and
    "parameter_counts" as in provenance.json."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """How much each run folder holds."""

    points: int = 40
    episodes: int = 200
    films: int = 0
    steps: bool = False
    blind: bool = False
    tables: bool = True
    """Whether the Parquet files and the vectors are written, or only what verdicts need."""
    total_steps: int = 4_000_000
    evaluation: dict[str, Any] = field(default_factory=dict)
    """Fields of the evaluation's config that differ from the usual ones."""


def robot_title(name: str) -> str:
    """Title of a robot, as a report shows it."""
    return ROBOTS[name].title


def env_of(robot: str = "irb120", colours: str = "fixed") -> dict[str, Any]:
    """The task, as ``config.json`` has it."""
    return {
        "robot": robot,
        "targets": ["mug", "bottle", "cereal_box"],
        "colours": colours,
    }


def choice_env(*, marked: bool = False) -> dict[str, Any]:
    """The choose task, as ``config.json`` has it."""
    queries = {"kind": "graph", "graph": "objects", "split": "train"}
    asked = {"kind": "choose", "objects": 4, "queries": queries, "marked": marked}
    task = {"asked": asked, "skill": {"kind": "reach"}}
    return env_of() | {"task": task, "targets": ["mug", "bottle", "cereal_box", "bowl"]}


def write_study(
    folder: Path,
    truth: Truth,
    *,
    seeds: int,
    robot: str = "irb120",
    colours: str = "fixed",
    seed: int = 0,
    size: Size = Size(),
) -> list[Path]:
    """Write one run folder for each agent and training seed; returns their paths."""
    generator = np.random.default_rng(seed)
    paths = []
    for agent, mean in truth.success.items():
        for number in range(seeds):
            path = folder / f"{robot}-{colours}-{agent}-ppo" / str(number)
            level = _level(mean, truth, generator)
            env = env_of(robot, colours)
            write_run(
                path,
                agent,
                number,
                level,
                env=env,
                generator=generator,
                size=size,
                role=truth.roles.get(agent),
                sizes=truth.sizes.get(agent),
            )
            paths.append(path)
    return paths


def redraw(study: StudyData, truth: Truth, *, seed: int, size: Size) -> StudyData:
    """Return a study of one task with other successes, as ``write_study`` draws them.

    It takes no files, of which many studies would leave too many.
    """
    generator = np.random.default_rng(seed)
    (task,) = study.tasks
    groups = {group.agent: group for group in task.groups}
    for agent, mean in truth.success.items():
        runs = []
        for run in groups[agent].runs:
            level = _level(mean, truth, generator)
            interim = run.interim | {
                "success": _interim_success(level, generator, size)
            }
            share = generator.binomial(size.episodes, level) / size.episodes
            (evaluation,) = run.evaluations.values()
            numbers = {**evaluation.summary.numbers, "success": share}
            evaluation = replace(
                evaluation, summary=replace(evaluation.summary, numbers=numbers)
            )
            runs.append(replace(run, interim=interim, evaluations={LABEL: evaluation}))
        before = groups[agent]
        groups[agent] = Group.of(before.name, before.colour, runs, LABEL)
    return replace(study, tasks=(replace(task, groups=tuple(groups.values())),))


def _level(mean: float, truth: Truth, generator: np.random.Generator) -> float:
    """Draw the success of one training."""
    return float(np.clip(generator.normal(mean, truth.spread), 0.01, 0.99))


def write_run(
    path: Path,
    agent: str,
    seed: int,
    success: float,
    *,
    env: dict[str, Any] | None = None,
    generator: np.random.Generator | None = None,
    size: Size = Size(),
    algorithm: str = "ppo",
    role: str | None = None,
    sizes: dict[str, Any] | None = None,
) -> Path:
    """Write one whole run folder."""
    env = env or env_of()
    generator = generator or np.random.default_rng(seed)
    folder = RunFolder.create(path)
    facets = FACETS[env["colours"]]
    entry = AGENTS.get(agent, AGENTS["full"])
    role = role or (entry.role if agent in AGENTS else None)
    config = {
        **{
            "format": 1,
            "name": path.parent.name,
            "agent": agent,
            "seed": seed,
            "env": env,
        },
        "algorithm_name": algorithm,
        "algorithm": to_dict(ALGORITHMS[algorithm].config),
        "knows": to_dict(entry.knows),
        "policy": {"fusion": "before_lstm", "wide": entry.policy.wide},
        "total_steps": size.total_steps,
    }
    write_json(folder.config_path, config | ({"role": role} if role else {}))
    log = _curve(success, generator, size)
    folder.evaluations_path.write_text(log)
    folder.metrics_path.write_text(log)
    embedding, counts = _parts(agent, env["robot"], env["colours"])
    provenance: dict[str, Any] = {
        "versions": {"knowarm": "0.1.0", "torch": "2.13.0", "mujoco": "4.0.0"},
        "commit": "0123456789abcdef",
        "machine": {"processor": "a processor", "cores": 2},
        "parameter_counts": counts,
        "facets": facets,
        "knowledge": embedding and to_dict(embedding.describe()),
    }
    for part, values in (sizes or {}).items():
        provenance[part] = provenance[part] | values
    write_json(folder.path / "provenance.json", provenance)
    if size.tables:
        table = np.zeros((len(facets), 0), np.float32)
        if embedding is not None and not entry.policy.wide:
            table = embedding.table(ASKED if entry.knows.scope == "query" else facets)
        folder.write_knowledge(table)
    write_evaluation(path / "evaluation" / LABEL, agent, success, env, generator, size)
    return path


@lru_cache
def _parts(agent: str, robot: str, colours: str) -> tuple[Any, dict[str, int]]:
    """Return the knowledge of an agent and the parameter counts of its policy."""
    entry = AGENTS.get(agent, AGENTS["full"])
    knows: Any = entry.knows
    embedding: Any = None
    if knows.scope == "query":
        embedding = query_embedding(knows, ASKED)
    elif knows.scope != "nothing":
        embedding = scene_embedding(knows, FACETS[colours])
    dim, slots = (embedding.dim, embedding.slots_per_row) if embedding else (0, 1)
    shape = PolicyShape(joints=JOINTS[robot], knowledge_dim=dim, knowledge_slots=slots)
    with torch.device("meta"):
        policy = Policy(entry.policy if dim else PolicyConfig(fusion="none"), shape)
    return embedding, policy.parameter_counts()


def _interim_steps(size: Size) -> np.ndarray:
    return np.linspace(
        size.total_steps / size.points, size.total_steps, size.points
    ).round()


def _interim_success(
    success: float, generator: np.random.Generator, size: Size
) -> np.ndarray:
    share = success / (1 + np.exp(-8 * (_interim_steps(size) / size.total_steps - 0.4)))
    return np.clip(share + generator.normal(0, 0.03, size.points), 0, 1)


def _curve(success: float, generator: np.random.Generator, size: Size) -> str:
    """Return a log with the columns of ``metrics.csv`` and of ``evaluations.csv``."""
    share = _interim_success(success, generator, size)
    columns = {
        "step": _interim_steps(size).astype(int),
        "wall_time_s": _interim_steps(size) / 2500,
        "return_mean": (gain := (140 * share - 40).round(3)),
        "steps_per_s": np.full(size.points, 2500),
        "success": share.round(4),
        "accuracy": share.round(4),
        "best": (gain >= np.maximum.accumulate(gain)).astype(int),
    }
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "".join(",".join(map(str, row)) + "\n" for row in (columns, *rows))


def write_summary(
    folder: Path, agent: str, env: dict[str, Any], size: Size, **found: Any
) -> None:
    """Write a summary with the numbers, groups and joints that were found."""
    config = EvaluationConfig(episodes=size.episodes, **size.evaluation)
    parts = {"groups": {}} | found
    summary = Summary(agent=agent, label=folder.name, config=config, env=env, **parts)
    write_json(folder / "summary.json", to_dict(summary))


def edit_summary(
    folder: Path, *, config: dict[str, Any] | None = None, **numbers: Any
) -> None:
    """Change numbers, and fields of the config, of a stored summary."""
    values = read_json(folder / "summary.json")
    values["config"] |= config or {}
    values["numbers"] |= numbers
    write_json(folder / "summary.json", values)


def write_evaluation(
    folder: Path,
    agent: str,
    success: float,
    env: dict[str, Any],
    generator: np.random.Generator,
    size: Size = Size(),
) -> None:
    """Write one evaluation folder in which about a share ``success`` of episodes succeeded."""
    folder.mkdir(parents=True)
    if not size.tables:
        share = generator.binomial(size.episodes, success) / size.episodes
        flat = {"success": share, "accuracy": share, "return_mean": 140 * share - 40}
        write_summary(
            folder, agent, env, size, numbers=flat | {"episodes": float(size.episodes)}
        )
        return
    columns = _episodes(success, env, generator, size, size.evaluation.get("seeds", 1))
    write_table(folder / "episodes.parquet", columns, EPISODE_COLUMNS)
    joints = (
        tuple(f"hinge_{i}" for i in range(JOINTS[env["robot"]])) if size.steps else ()
    )
    if size.steps:
        _write_steps(folder, columns, len(joints), generator, 0.2 * (agent == "full"))
    for number in range(size.films):
        write_film(
            folder / "films" / f"{number}.webp", _images(int(columns["length"][number]))
        )
    numbers, groups = summarize(columns)
    if size.blind:
        groups["blind"] = blind = _blind(numbers["success"].estimate)
        numbers["vision_gain"] = blind["open-loop"]["difference"]
    write_summary(
        folder, agent, env, size, joints=joints, numbers=numbers, groups=groups
    )


def write_choice(
    folder: Path,
    agent: str,
    split: str,
    choice: float,
    generator: np.random.Generator,
    *,
    reach: float = 0.8,
    old: float = 0.5,
    size: Size = Size(),
) -> None:
    """Write the summary of an evaluation of the choose task.

    Args:
        folder: its folder.
        agent: name of the agent.
        split: name of the split.
        choice: probability of a right choice.
        generator: of the draws.
        reach: probability of success after a right choice.
        old: probability that a wrong choice on S5 is the answer before the edit.
        size: number of episodes.
    """
    folder.mkdir(parents=True)
    rules = {"test": (SplitTest(split=split),), "distance_m": 0.05, "angle_deg": 15.0}
    env, share = choice_env(), generator.binomial(size.episodes, choice) / size.episodes
    chance = 1 / env["task"]["asked"]["objects"]
    beyond = (share - chance) / (1 - chance)
    numbers = {
        "success": share * reach,
        "accuracy": share * reach,
        "return_mean": 140 * share,
    }
    numbers |= {
        "episodes": float(size.episodes),
        "choice": share,
        "success_if_chosen": reach,
    }
    numbers |= {"choice_chance": chance, "choice_corrected": beyond}
    numbers["success_corrected"] = beyond * reach
    numbers["binding"] = share - (1 - share) / 3
    if split == "S5":
        before = (1 - share) * old
        numbers |= {"chose_old_answer": before, "switched": share / (share + before)}
    write_summary(folder, agent, env, replace(size, evaluation=rules), numbers=numbers)


def _blind(success: float) -> dict[str, Any]:
    """Blind agents that solve .2, .1 and .3 of the episodes, as an evaluation stores them."""
    numbers: dict[str, Any] = {}
    for name, share in zip(BLIND_AGENTS, (0.2, 0.1, 0.3), strict=True):
        numbers[name] = {"episodes": 200.0}
        for key, value in (("success", share), ("difference", success - share)):
            numbers[name][key] = Interval(value, value - 0.05, value + 0.05)
    return numbers


def _episodes(
    success: float,
    env: dict[str, Any],
    generator: np.random.Generator,
    size: Size,
    seeds: int,
) -> dict[str, np.ndarray]:
    count, facets = size.episodes, FACETS[env["colours"]]
    which = np.random.default_rng(7).integers(0, len(facets), count)
    reached = generator.random(count) < success
    near, far = (
        generator.uniform(0.02, 0.1, count),
        generator.uniform(0.08, 0.45, count),
    )
    length = np.where(reached, generator.integers(6, 40, count), 50)
    distance = np.where(reached, near, far)
    return {
        "episode": np.arange(count),
        "evaluation_seed": 1_000_003 + np.repeat(np.arange(seeds), count // seeds),
        "target": np.array([facets[i][0] for i in which]),
        "facet": np.array(["/".join(facets[i]) for i in which]),
        "return": np.where(reached, 100.0, 0.0) - 0.5 * length,
        "length": length,
        "distance_m": distance,
        "angle_deg": np.where(reached, 8.0, generator.uniform(5, 70, count)),
        "success": reached,
        "accurate": distance <= 0.1,
        "success_wide": reached,
    }


def _write_steps(
    folder: Path,
    episodes: dict[str, np.ndarray],
    joints: int,
    generator: np.random.Generator,
    shift: float,
) -> None:
    lengths = episodes["length"]
    total = int(lengths.sum())
    columns = {
        "episode": np.repeat(episodes["episode"], lengths),
        "step": np.concatenate([np.arange(1, n + 1) for n in lengths]),
        "distance_m": generator.uniform(0, 0.4, total),
        "angle_deg": generator.uniform(0, 90, total),
        "reward": generator.uniform(-1, 0, total),
    }
    for i in range(1, joints + 1):
        columns[f"joint_{i}_rad"] = generator.normal(shift * i / 2, 0.5 - shift, total)
        columns[f"action_{i}"] = generator.integers(0, 7, total)
    write_table(folder / "steps.parquet", columns, step_columns(joints))


def _images(length: int) -> np.ndarray:
    frames = np.full((length + 1, 64, 64, 3), (150, 152, 158), np.uint8)
    for t, frame in enumerate(frames):
        at = 4 + int(40 * t / (length + 1))
        frame[at : at + 14, 20:32] = (255, 115, 13)
        frame[46:58, 30:40] = (255, 0, 0)
    return frames
