"""A study goes in; every difference the report decides on, and the verdict on each, comes out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from knowarm.report import format
from knowarm.report.study import Group, Run, Study, Task
from knowarm.statistics import (
    Comparison,
    area_under_curve,
    holm,
    seeds_needed,
    welch,
)

FEWEST_SEEDS = 3
"""Training seeds of each agent below which no difference is called real."""

ALPHA = 0.05
"""Share of studies without any effect in which the report may claim one."""

Outcome = Literal["success", "speed"]

OUTCOMES: dict[Outcome, str] = {
    "success": "success after training",
    "speed": "mean success during training",
}
"""What is decided on. Everything else a report shows is described, not tested."""

Role = Literal["gate", "control", "described"]
"""Against the baseline; against a control, asked once the gate is passed; only described."""

Decision = Literal["better", "worse", "undecided", "too few seeds", "not asked", "described"]


@dataclass(frozen=True)
class Claim:
    """One difference between two agents on one task, and whether it may be called real.

    Attributes:
        task: the task.
        first: agent whose advantage is asked for.
        second: agent it is compared with.
        outcome: what is compared.
        role: how the difference enters the verdict.
        comparison: Welch's comparison over training seeds; None below two seeds a side.
        adjusted_p: see `claims`; None where nothing is decided.
    """

    task: Task
    first: Group
    second: Group
    outcome: Outcome
    role: Role
    comparison: Comparison | None = None
    adjusted_p: float | None = None

    @property
    def seeds(self) -> int:
        """Training seeds of the agent that has fewer."""
        groups = (self.first, self.second)
        return min(len(scores(self.task, group, self.outcome)) for group in groups)

    @property
    def verdict(self) -> Decision:
        """What the numbers allow to say about the first agent.

        A difference is real when its adjusted p is at most .05. That p is never below the plain
        one, so the plain 95 % interval then leaves out zero as well.
        """
        if self.role == "described":
            return "described"
        if self.comparison is None or self.seeds < FEWEST_SEEDS:
            return "too few seeds"
        if self.adjusted_p is None:
            return "not asked"
        if self.adjusted_p > ALPHA:
            return "undecided"
        return "better" if self.comparison.difference.estimate > 0 else "worse"

    @property
    def needed(self) -> int | None:
        """Seeds of each agent that would show a difference as large as the one seen."""
        size = self.comparison.effect_size if self.comparison else None
        return seeds_needed(size) if size else None

    def sentence(self) -> str:
        """The difference in words, with its interval and what follows from it."""
        if self.comparison is None:
            return (
                f"Against {self.second.name}: {count(self.seeds, 'training seed')}, so no "
                "difference between the methods can be called real."
            )
        interval = self.comparison.difference
        seeds = f"{self.comparison.first_count} and {self.comparison.second_count} seeds"
        ends: dict[Decision, str] = {
            "better": "a real advantage",
            "worse": "a real disadvantage",
            "undecided": "not told apart from chance",
            "too few seeds": f"no claim below {FEWEST_SEEDS} seeds",
            "not asked": "not asked, since no advantage over the baseline is shown",
            "described": "described only",
        }
        p = f", adjusted p {format.p_value(self.adjusted_p)}" if self.adjusted_p is not None else ""
        return (
            f"Against {self.second.name}: {format.points(interval.estimate)} points "
            f"(95 % interval {format.points(interval.low)} to {format.points(interval.high)}; "
            f"{seeds}{p}): {ends[self.verdict]}."
        )


def claims(study: Study) -> list[Claim]:
    """Every difference of a report, decided in an order that keeps false claims at 5 %.

    The gates are the comparisons of the knowledge agent with the baseline, one a task and
    outcome; Holm's correction runs over all of the report's gates. Behind a gate that is passed,
    the controls of its task and outcome are asked, each at the gate's share of the 5 %
    (multiplied by the number of gates). They are not corrected for their own number, since
    `verdict.finding` calls a question settled only when every control of its kind is beaten (an
    intersection-union test). Without any effect a claim therefore takes a falsely passed gate.

    Without a baseline every comparison with the knowledge agent is a gate.
    """
    found = [
        Claim(task, first, second, outcome, role, _compare(task, first, second, outcome))
        for task in study.tasks
        for first, second, role in pairs(task)
        for outcome in OUTCOMES
    ]
    gates = [c for c in found if c.role == "gate" and _decidable(c)]
    adjusted = holm([c.comparison.p_value for c in gates if c.comparison])
    passed = {id(gate): float(p) for gate, p in zip(gates, adjusted, strict=True)}
    return [_decide(claim, found, passed) for claim in found]


def _decide(claim: Claim, found: Sequence[Claim], passed: dict[int, float]) -> Claim:
    if claim.role == "gate" and id(claim) in passed:
        return replace(claim, adjusted_p=passed[id(claim)])
    if claim.role != "control" or not _decidable(claim) or claim.comparison is None:
        return claim
    own = [
        passed[id(gate)]
        for gate in found
        if id(gate) in passed and gate.task is claim.task and gate.outcome == claim.outcome
    ]
    if not own or min(own) > ALPHA:
        return claim
    return replace(
        claim, adjusted_p=max(min(own), min(1.0, claim.comparison.p_value * len(passed)))
    )


def _decidable(claim: Claim) -> bool:
    return claim.comparison is not None and claim.seeds >= FEWEST_SEEDS


def subject(task: Task) -> Group | None:
    """The agent whose knowledge is in question: full, else another real one, as the task has it."""
    for agent in ("full", "full+", "partial", "target"):
        for group in task.groups:
            if group.agent == agent:
                return group
    return None


def pairs(task: Task) -> list[tuple[Group, Group, Role]]:
    """Pairs that are compared on a task, and what each is for."""
    asked = subject(task)
    baseline = next((group for group in task.groups if group.agent == "bm"), None)
    found: list[tuple[Group, Group, Role]] = []
    if asked is None:
        first = baseline or task.groups[0]
        return [(group, first, "described") for group in task.groups if group is not first]
    for group in task.groups:
        if group is not asked:
            gate = group is baseline or baseline is None
            found.append((asked, group, "gate" if gate else "control"))
    if baseline:
        others = [group for group in task.groups if group not in (asked, baseline)]
        found += [(group, baseline, "described") for group in others]
    return sorted(found, key=lambda pair: ("gate", "control", "described").index(pair[2]))


def scores(task: Task, group: Group, outcome: Outcome) -> np.ndarray:
    """(n,) float64: one score in 0..1 a training run.

    The mean success during training runs to the same step for all agents of a task; a run that
    stopped before keeps its last value.
    """
    if outcome == "success":
        return group.scores("success")
    until = horizon(task)
    return np.array(
        [
            area_under_curve(run.interim["step"], run.interim["success"], until)
            for run in group.runs
            if has_curve(run)
        ]
    )


def horizon(task: Task) -> float:
    """Steps to which every agent of a task has at least one run; 0 without curves."""
    longest = [
        max(run.interim["step"][-1] for run in group.runs if has_curve(run))
        for group in task.groups
        if any(has_curve(run) for run in group.runs)
    ]
    return float(min(longest, default=0.0))


def has_curve(run: Run) -> bool:
    """Whether the run has a whole curve of interim success."""
    return "success" in run.interim and bool(np.isfinite(run.interim["success"]).all())


def count(number: int, what: str) -> str:
    """A number with its noun."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def _compare(task: Task, first: Group, second: Group, outcome: Outcome) -> Comparison | None:
    one, other = scores(task, first, outcome), scores(task, second, outcome)
    return welch(one, other) if min(one.size, other.size) >= 2 else None
