"""Success of agents with and without vision, at both thresholds.

python -m benchmarks.blind [RUN ...] [--start near] [--episodes 1000] [--json FILE]

Without runs: the agents that need no training, on the main robots, also by object. With runs: the
trained agent of each run folder, on black images and with the first image only, on its robot.
`knowarm evaluate RUN` prints the same numbers for one threshold.
"""

import argparse
import json
from functools import partial
from pathlib import Path

from knowarm.config import override
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.load import load_agent
from knowarm.experiment.probes import BlindProbe
from knowarm.statistics import Interval
from knowarm.world.agents import BLIND_AGENTS, SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS

THRESHOLDS = ((0.10, 17.0), (0.05, 15.0))
"""Post-training evaluation and training: distance [m] and angle [deg]."""

UNTRAINED = ("zero", "random", "open-loop", "oracle")


def evaluation(episodes: int, thresholds: tuple[float, float]) -> EvaluationConfig:
    distance_m, angle_deg = thresholds
    return EvaluationConfig(
        episodes=episodes,
        probes=(BlindProbe(episodes=episodes),),
        distance_m=distance_m,
        angle_deg=angle_deg,
    )


def _make(name: str, env: ArmVectorEnv) -> AgentProtocol:
    return SCRIPTED_AGENTS[name].make(env, EvaluationConfig().seed)


def rows_of_robot(robot: str, start: str, episodes: int) -> list[dict]:
    """Evaluate the agents that need no training, on all episodes and on those of each object."""
    rows = []
    task = override(EnvConfig().task, {"start": start})
    env = EnvConfig(robot=robot, task=task, image_size=8)  # they look at no image
    groups = {"": (), **{f": {target}": ("target", target) for target in env.targets}}
    for name in UNTRAINED:
        make = partial(_make, name)
        parts = [{"robot": robot, "agent": f"{name}{part}"} for part in groups]
        for thresholds in THRESHOLDS:
            found = evaluate(make, env, evaluation(episodes, thresholds)).summary
            for row, group in zip(parts, groups.values(), strict=True):
                row |= cells(found.interval("success", *group), thresholds)
        rows += parts
        print("\n".join(map(line, parts)), flush=True)
    return rows


def rows_of_run(path: Path, episodes: int) -> list[dict]:
    """Evaluate a trained agent and the blind agents that are made from it."""
    trained = load_agent(path, seed=EvaluationConfig().seed)
    names = ["trained", *(name for name in BLIND_AGENTS if name not in SCRIPTED_AGENTS)]
    label = f"{trained.config.agent}, seed {trained.config.seed}"
    rows = [
        {"robot": trained.config.env.robot, "agent": f"{label}: {name}"}
        for name in names
    ]
    for thresholds in THRESHOLDS:
        found = evaluate(
            trained, config=evaluation(episodes, thresholds), write=False
        ).summary
        for row, name in zip(rows, names, strict=True):
            row |= cells(
                found.interval(
                    "success", *(() if name == "trained" else ("blind", name))
                ),
                thresholds,
            )
    for row in rows:
        print(line(row), flush=True)
    return rows


def cells(success: Interval, thresholds: tuple[float, float]) -> dict:
    """Return the success with its interval, named by the thresholds."""
    return success.named(f"success_{thresholds[0] * 100:g}cm_{thresholds[1]:g}deg")


def line(row: dict) -> str:
    """Format a row in Markdown, in percent with the 95 % interval."""
    values = list(row.values())
    shares = [values[i : i + 3] for i in range(2, len(values), 3)]
    texts = [
        f"{100 * s:.1f} [{100 * low:.1f}, {100 * high:.1f}]" for s, low, high in shares
    ]
    return f"| {' | '.join([row['robot'], row['agent'], *texts])} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--start", choices=("far", "near"), default="far")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rows = []
    print(
        "| robot | agent | success %, 10 cm and 17 deg | success %, 5 cm and 15 deg |"
    )
    print("|---" * 4 + "|")
    for path in arguments.runs:
        rows += rows_of_run(path, arguments.episodes)
    for robot in () if arguments.runs else ROBOTS:
        rows += rows_of_robot(robot, arguments.start, arguments.episodes)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
