"""A study goes in; every comparison the report decides on, corrected as one family, comes out."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from knowarm.experiment.report import format
from knowarm.experiment.report.study import Group, Run, Study, Task
from knowarm.experiment.statistics import (
    Comparison,
    area_under_curve,
    holm,
    seeds_needed,
    welch,
)

FEWEST_SEEDS = 3
"""Training seeds of each agent below which no difference is called real."""

ALPHA = 0.05
"""Share of studies without any effect in which at least one claim may be wrong."""

Outcome = Literal["success", "speed"]

OUTCOMES: dict[Outcome, str] = {
    "success": "success after training",
    "speed": "mean success during training",
}
"""What is decided on. Everything else a report shows is described, not tested."""


@dataclass(frozen=True)
class Claim:
    """One difference between two agents on one task, and whether it may be called real.

    Attributes:
        task: the task.
        first: agent whose advantage is asked for.
        second: agent it is compared with.
        outcome: what is compared.
        comparison: Welch's comparison over training seeds; None below two seeds a side.
        adjusted_p: Holm's, over every comparison of the report; None without a comparison.
    """

    task: Task
    first: Group
    second: Group
    outcome: Outcome
    comparison: Comparison | None
    adjusted_p: float | None

    @property
    def seeds(self) -> int:
        """Training seeds of the agent that has fewer."""
        return min(len(scores(self.first, self.outcome)), len(scores(self.second, self.outcome)))

    @property
    def verdict(self) -> Literal["better", "worse", "undecided", "too few seeds"]:
        """What the numbers allow to say about the first agent.

        A difference is real when Holm's adjusted p is at most .05. The adjusted p is never below
        the plain one, so the 95 % interval then leaves out zero as well.
        """
        if self.comparison is None or self.adjusted_p is None or self.seeds < FEWEST_SEEDS:
            return "too few seeds"
        if self.adjusted_p > ALPHA:
            return "undecided"
        return "better" if self.comparison.difference.estimate > 0 else "worse"

    @property
    def needed(self) -> int | None:
        """Seeds of each agent that would show a difference as large as the one seen."""
        size = self.comparison.effect_size if self.comparison else None
        return seeds_needed(size) if size else None

    def sentence(self) -> str:
        """The verdict in words, with the interval it follows from."""
        names = f"{self.first.name} against {self.second.name}, {OUTCOMES[self.outcome]}"
        if self.comparison is None:
            return (
                f"{names}: {count(self.seeds, 'training seed')}, so no difference between the "
                "methods can be called real."
            )
        interval = self.comparison.difference
        shown = (
            f"{format.points(interval.estimate)} points "
            f"(95 % interval {format.points(interval.low)} to {format.points(interval.high)}; "
            f"{self.comparison.first_count} and {self.comparison.second_count} seeds; "
            f"adjusted p {format.p_value(self.adjusted_p)})"
        )
        ends = {
            "better": "a real advantage",
            "worse": "a real disadvantage",
            "undecided": "not told apart from chance",
            "too few seeds": f"fewer than {FEWEST_SEEDS} seeds: no claim",
        }
        return f"{names}: {shown}, {ends[self.verdict]}."


def claims(study: Study) -> list[Claim]:
    """Compare, on every task, the agent with the most knowledge with all others, and all with BM.

    One family: Holm's correction runs over every comparison of the report, both outcomes.
    """
    open_claims: list[Claim] = []
    for task in study.tasks:
        for first, second in pairs(task):
            for outcome in OUTCOMES:
                compared = _compare(scores(first, outcome), scores(second, outcome))
                open_claims.append(Claim(task, first, second, outcome, compared, None))
    tested = [claim for claim in open_claims if claim.comparison]
    adjusted = iter(holm([claim.comparison.p_value for claim in tested if claim.comparison]))
    return [
        Claim(c.task, c.first, c.second, c.outcome, c.comparison, float(next(adjusted)))
        if c.comparison
        else c
        for c in open_claims
    ]


def subject(task: Task) -> Group | None:
    """The agent whose knowledge is in question: full, else another real one, as the task has it."""
    for agent in ("full", "full+", "partial", "target"):
        for group in task.groups:
            if group.agent == agent:
                return group
    return None


def pairs(task: Task) -> list[tuple[Group, Group]]:
    """Pairs that the report decides on."""
    asked = subject(task)
    baseline = next((group for group in task.groups if group.agent == "bm"), None)
    found: list[tuple[Group, Group]] = []
    for group in task.groups:
        if asked and group is not asked:
            found.append((asked, group))
        if baseline and group is not baseline and group is not asked:
            found.append((group, baseline))
    if not asked and not baseline and len(task.groups) > 1:
        found = [(group, task.groups[0]) for group in task.groups[1:]]
    return found


def scores(group: Group, outcome: Outcome) -> np.ndarray:
    """(n,) float64: one score in 0..1 a training run."""
    if outcome == "success":
        return group.scores("success")
    curves = [run for run in group.runs if has_curve(run)]
    if not curves:
        return np.empty(0)
    until = max(run.steps_done for run in group.runs)
    return np.array(
        [area_under_curve(run.interim["step"], run.interim["success"], until) for run in curves]
    )


def has_curve(run: Run) -> bool:
    """Whether the run has a whole curve of interim success."""
    return "success" in run.interim and bool(np.isfinite(run.interim["success"]).all())


def count(number: int, what: str) -> str:
    """A number with its noun."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def _compare(first: np.ndarray, second: np.ndarray) -> Comparison | None:
    return welch(first, second) if min(first.size, second.size) >= 2 else None
