"""What the paper leaves open about its A3C: training with one other choice each, seed 0.

    python -m benchmarks.a3c_open --steps 15000000 --choices epsilon radians
    python -m benchmarks.a3c_open --pack docs/results/a3c-open

Runs that exist are resumed, those that are done are kept. The outcome, fixed before these runs, is
the accuracy (the paper's measure, distance alone) of the interim evaluations in the last fifth of
the training; success and errors beside it. Returns of two rewards cannot be compared. One seed
screens choices; it decides nothing.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from benchmarks.a3c_changes import trained
from knowarm.arrays import Floats
from knowarm.cli.tables import print_table
from knowarm.experiment.csv_log import read_csv
from knowarm.study.config import StudyConfig, read_study, write_study
from knowarm.study.pack import SUFFIX, pack_study
from knowarm.world.tasks import register_task
from knowarm.world.tasks.reward import paper_reward
from knowarm.world.tasks.skills.skill import Skill
from knowarm.world.tasks.state import EpisodeState

EXPERIMENT = "irb120-bm-a3c"
RADIANS = "benchmarks.a3c_open:RadiansReach"

CHOICES: dict[str, tuple[str, Mapping[str, Any]]] = {
    "published": ("the published numbers", {}),
    "rollouts": (
        "rollouts of 20 steps, the LSTM's state kept",
        {"algorithm.rollout_steps": 20, "algorithm.rollout_ends_with_episode": False},
    ),
    "bootstrap": ("the time limit continues", {"algorithm.bootstrap_at_time_limit": True}),
    "epsilon": ("epsilon .1 of RMSprop", {"algorithm.rmsprop_eps": 0.1}),
    "value": ("half the value loss", {"algorithm.vf_coef": 0.5}),
    "kinematic": ("joints move exactly: ideal compensation", {"env.dynamics": "kinematic"}),
    "radians": ("the reward's angle in radians", {"env.task.skill.kind": "radians-reach"}),
    "rewards": ("rewards of a hundredth", {"algorithm.reward_scale": 0.01}),
}
"""Words and overrides of each choice."""


MEASURES = ("accuracy", "success", "distance_mean", "angle_mean")
"""Columns of the interim evaluations that are reported."""


@dataclass(frozen=True, kw_only=True)
class RadiansReach(Skill):
    """Reaching from the paper's near start, with the angle of the reward in radians."""

    area: ClassVar[str] = "near"
    kind: Literal["radians-reach"] = "radians-reach"

    def reward(self, state: EpisodeState) -> Floats:
        """Compute the paper's reward with the angle in radians."""
        return paper_reward(state.distance, np.radians(state.angle), state.success)


def study_of(choice: str, steps: int) -> StudyConfig:
    """Return the study of one choice."""
    study, overrides = read_study("paper-a3c"), dict[str, Any]()
    for path, value in CHOICES[choice][1].items():
        inner = overrides
        *parts, name = path.split(".")
        for part in parts:
            inner = inner.setdefault(part, {})
        inner[name] = value
    return replace(
        study,
        name=f"a3c-open-{choice}",
        about=f"the paper's A3C, {CHOICES[choice][0]}",
        experiments=(EXPERIMENT,),
        overrides={"total_steps": steps, **overrides},
        evaluations=(),
    )


def outcome(choice: str, folder: Path) -> list[Any]:
    """Return the means of the last fifth of the interim evaluations."""
    rows = read_csv(folder / "evaluations.csv")
    last = rows[-len(rows) // 5 :]
    return [choice, *(float(np.mean([float(row[name]) for row in last])) for name in MEASURES)]


def main() -> None:
    """Train, or pack."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=15_000_000)
    parser.add_argument("--choices", nargs="+", choices=CHOICES, default=[*CHOICES])
    parser.add_argument("--runs", type=Path, default=Path("runs/a3c-open"))
    parser.add_argument("--pack", type=Path)
    given = parser.parse_args()
    register_task(RADIANS)
    rows = []
    for choice in given.choices:
        study = study_of(choice, given.steps)
        if given.pack is None:
            (config,) = study.runs()
            rows.append(outcome(choice, trained(config, given.runs / choice).path))
        else:
            write_study(study, given.runs / choice)
            pack_study(given.runs / choice, given.pack / f"{choice}{SUFFIX}")
    if rows:
        print_table("A3C, last fifth", ["choice", *MEASURES], rows)


if __name__ == "__main__":
    main()
