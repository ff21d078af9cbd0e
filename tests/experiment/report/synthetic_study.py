"""A truth goes in; run folders that trainings with this truth could have left come out."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from knowarm.config import to_dict
from knowarm.experiment.evaluation_files import EPISODE_COLUMNS, step_columns, write_table
from knowarm.experiment.evaluation_summary import summarize
from knowarm.experiment.film import write_film
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge import KNOWLEDGE, scene_embedding

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
JOINTS = {"irb120": 6, "tiago": 7}
LABEL = "post-training-greedy"


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What is true of every agent of a study."""

    success: dict[str, float]
    spread: float = 0.06
    speed: dict[str, float] | None = None


def write_study(
    folder: Path,
    truth: Truth,
    *,
    seeds: int,
    robot: str = "irb120",
    colours: str = "fixed",
    generator: np.random.Generator | None = None,
    **options: int,
) -> list[Path]:
    """Write one run folder for each agent and seed; returns their paths."""
    generator = generator or np.random.default_rng(0)
    paths = []
    for agent, mean in truth.success.items():
        speed = (truth.speed or {}).get(agent, 1.0)
        for seed in range(seeds):
            path = folder / f"{robot}-{colours}-{agent}-ppo" / str(seed)
            level = float(np.clip(generator.normal(mean, truth.spread), 0.01, 0.99))
            write_run(path, agent, seed, level, robot, colours, speed, generator, **options)
            paths.append(path)
    return paths


def write_run(
    path: Path,
    agent: str,
    seed: int,
    success: float,
    robot: str,
    colours: str,
    speed: float,
    generator: np.random.Generator,
    *,
    points: int = 40,
    episodes: int = 200,
    films: int = 0,
    steps: bool = False,
    total_steps: int = 4_000_000,
) -> None:
    """Write a whole run folder."""
    folder = RunFolder.create(path)
    facets = FACETS[colours]
    known = KNOWLEDGE.get(agent, KNOWLEDGE["full"])
    env = {"robot": robot, "targets": ["mug", "bottle", "cereal_box"], "colours": colours}
    config = {
        "format": 1,
        "name": path.parent.name,
        "agent": agent,
        "seed": seed,
        "env": env,
        "knowledge": to_dict(known),
        "network": {"fusion": "before_lstm", "wide": agent == "wide"},
        "algorithm": {"name": "ppo", "learning_rate": 1e-3},
        "total_steps": total_steps,
    }
    folder.write_json("config.json", config)
    embedding = scene_embedding(known, facets)
    width = embedding.dim
    folder.write_json(
        "provenance.json",
        {
            "versions": {"knowarm": "0.1.0", "torch": "2.13.0", "mujoco": "4.0.0"},
            "commit": "0123456789abcdef",
            "machine": {"processor": "a processor", "cores": 2},
            "parameter_counts": {
                "encoder": 161_168,
                "memory": 4 * (128 + width) * (128 + 128 + 2 * width + 2),
                "heads": 43 * (129 + width),
                "total": 161_168 + 4 * (128 + width) * (258 + 2 * width) + 43 * (129 + width),
            },
            "facets": facets,
            "knowledge": embedding.describe(),
        },
    )
    table = embedding.table(facets)
    folder.write_knowledge(table[:, :0] if agent == "wide" else table)
    _write_curves(folder, success, speed, generator, points, total_steps)
    write_evaluation(
        path / "evaluation" / LABEL, agent, success, env, generator, episodes, films, steps
    )


def _write_curves(
    folder: RunFolder,
    success: float,
    speed: float,
    generator: np.random.Generator,
    points: int,
    total_steps: int,
) -> None:
    ends = np.linspace(total_steps / points, total_steps, points).round()
    share = success / (1 + np.exp(-8 * (ends / total_steps * speed - 0.4)))
    share = np.clip(share + generator.normal(0, 0.03, points), 0, 1)
    lines = ["step,wall_time_s,return_mean,return_std,length_mean,success,accuracy,best"]
    metrics = ["step,wall_time_s,steps_per_s,episodes,return_mean,policy_loss,entropy"]
    best = -np.inf
    for end, value in zip(ends, share, strict=True):
        gain = -40 + 140 * value
        lines.append(
            f"{end:.0f},{end / 2500:.1f},{gain:.3f},40,30,{value:.4f},{value:.4f},"
            f"{int(gain > best)}"
        )
        best = max(best, gain)
        metrics.append(f"{end:.0f},{end / 2500:.1f},2500,40,{gain:.3f},.1,{11 - 5 * value:.3f}")
    folder.evaluations_path.write_text("\n".join(lines) + "\n")
    folder.metrics_path.write_text("\n".join(metrics) + "\n")


def write_evaluation(
    folder: Path,
    agent: str,
    success: float,
    env: dict,
    generator: np.random.Generator,
    episodes: int = 200,
    films: int = 0,
    steps: bool = False,
) -> None:
    """Write one evaluation folder in which a share ``success`` of episodes succeeded."""
    folder.mkdir(parents=True)
    facets = FACETS[env["colours"]]
    which = np.random.default_rng(7).integers(0, len(facets), episodes)
    reached = generator.random(episodes) < success
    length = np.where(reached, generator.integers(6, 40, episodes), 50)
    distance = np.where(reached, generator.uniform(0.02, 0.1, episodes), 0.25)
    distance[~reached] += generator.uniform(-0.17, 0.2, np.count_nonzero(~reached))
    angle = np.where(
        reached, generator.uniform(2, 17, episodes), generator.uniform(5, 70, episodes)
    )
    columns = {
        "episode": np.arange(episodes),
        "evaluation_seed": np.full(episodes, 1_000_003),
        "target": np.array([facets[i][0] for i in which]),
        "facet": np.array(["/".join(facets[i]) for i in which]),
        "return": np.where(reached, 100.0, 0.0) - 0.5 * length,
        "length": length,
        "distance_m": distance,
        "angle_deg": angle,
        "success": reached,
        "accurate": distance <= 0.1,
        "success_wide": reached,
    }
    write_table(folder / "episodes.parquet", columns, EPISODE_COLUMNS)
    if steps:
        _write_steps(
            folder, columns, JOINTS[env["robot"]], generator, shift=0.2 * (agent == "full")
        )
    for number in range(films):
        write_film(folder / "films" / f"{number}.webp", _pictures(int(length[number]), number))
    summary = {
        "format": 1,
        "agent": agent,
        "label": LABEL,
        "config": {
            "episodes": episodes,
            "seed": 1_000_003,
            "seeds": 1,
            "distance_m": 0.1,
            "angle_deg": 17.0,
            "wide_angle_deg": 20.0,
            "actions": "greedy",
        },
        "env": env,
        **summarize(columns),
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=2))


def _write_steps(
    folder: Path, episodes: dict, joints: int, generator: np.random.Generator, shift: float
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


def _pictures(length: int, number: int) -> np.ndarray:
    frames = np.full((length + 1, 64, 64, 3), (150, 152, 158), np.uint8)
    for t, frame in enumerate(frames):
        at = 4 + int(40 * t / (length + 1))
        frame[at : at + 14, 20 + number : 32 + number] = (255, 115, 13)
        frame[46:58, 30:40] = (255, 0, 0)
    return frames
