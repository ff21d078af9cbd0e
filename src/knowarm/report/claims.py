"""Claims: the differences between agents that a report decides on, with their p-values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from knowarm.report import format
from knowarm.report.format import counted
from knowarm.report.study import CONTROLS, Group, Study, Task
from knowarm.statistics import Comparison, area_under_curve, holm, welch

FEWEST_SEEDS = 3
"""Training seeds of each agent below which no difference is called significant."""

ALPHA = 0.05
"""Fraction of studies without any effect in which the report may claim one."""

TOLERANCE = 0.01
"""Largest relative difference in size between a control and its subject."""

SIZES = {
    "knowledge width": ("knowledge", "dim"),
    "parameters": ("parameter_counts", "total"),
    "parameters of the image encoder": ("parameter_counts", "image"),
    "norm": ("knowledge", "norm"),
}
"""Sizes in which controls must equal their subject: where ``provenance.json`` has them."""

Outcome = Literal["success", "speed"]

OUTCOMES: dict[Outcome, str] = {
    "success": "success after training",
    "speed": "mean success during training",
}
"""What is tested. Everything else in a report is descriptive."""

Stage = Literal["gate", "after gate", "described"]
"""Against the baseline; tested only once the gate is passed; never tested."""

Decision = Literal["better", "worse", "undecided", "too few seeds", "not tested", "described"]

ENDINGS: dict[Decision, str] = {
    "better": "significantly better",
    "worse": "significantly worse",
    "undecided": "no significant difference",
    "too few seeds": f"not tested below {FEWEST_SEEDS} seeds",
    "not tested": "not tested, because no advantage over the baseline is shown",
    "described": "descriptive only",
}


@dataclass(frozen=True)
class Claim:
    """One difference between two agents on one task, and the decision on it.

    Attributes:
        task: the task.
        first: agent whose advantage is tested.
        second: agent it is compared with.
        outcome: what is compared.
        stage: how the difference enters the verdict.
        comparison: Welch's comparison over training seeds; None below two seeds per agent.
        adjusted_p: see `claims`; None where nothing is tested.
    """

    task: Task
    first: Group
    second: Group
    outcome: Outcome
    stage: Stage
    comparison: Comparison | None = None
    adjusted_p: float | None = None

    @property
    def seeds(self) -> int:
        """Training seeds of the agent that has fewer."""
        groups = (self.first, self.second)
        return min(len(scores(self.task, group, self.outcome)) for group in groups)

    @property
    def testable(self) -> bool:
        """Whether there are enough seeds for a test."""
        return self.comparison is not None and self.seeds >= FEWEST_SEEDS

    @property
    def verdict(self) -> Decision:
        """The decision on the first agent.

        A difference is significant if its adjusted p is at most `ALPHA`. The adjusted p is never
        below the unadjusted one, so the 95 % interval then excludes zero as well.
        """
        if self.stage == "described":
            return "described"
        if self.comparison is None or not self.testable:
            return "too few seeds"
        if self.adjusted_p is None:
            return "not tested"
        if self.adjusted_p > ALPHA:
            return "undecided"
        return "better" if self.comparison.difference.estimate > 0 else "worse"

    def sentence(self) -> str:
        """Return the difference in words, with its interval and the decision."""
        who = f"{self.first.name} against {self.second.name}"
        if self.comparison is None:
            seeds = counted(self.seeds, "training seed")
            return f"{who}: {seeds}, too few for a comparison of the methods."
        ending = ENDINGS[self.verdict]
        if reason := mismatch(self.second, self.first) if self.verdict == "described" else None:
            ending = f"{ending}, because they differ in more than content ({reason})"
        interval = self.comparison.difference
        seeds = f"{self.comparison.first_count} and {self.comparison.second_count} seeds"
        p = f", adjusted p {format.p_value(self.adjusted_p)}" if self.adjusted_p is not None else ""
        return (
            f"{who}: {format.points(interval.estimate)} points "
            f"(95 % interval {format.points(interval.low)} to {format.points(interval.high)}; "
            f"{seeds}{p}): {ending}."
        )


def claims(study: Study) -> list[Claim]:
    """Decide on every difference of a report so that at most 5 % of studies claim falsely.

    The gates are the comparisons of each subject (`Task.subjects`) with the baseline, one per
    task and outcome; Holm's correction runs over all gates of the report. Behind a passed gate
    the subject is compared with the other agents of its task, each at the gate's part of the 5 %
    (p multiplied by the number of gates). These comparisons are not corrected for their own
    number, because `verdict.finding` requires that every control of a kind is beaten (an
    intersection-union test). Without any effect, a false claim therefore requires a falsely
    passed gate.

    Without a baseline every comparison of a subject is a gate.
    """
    found = [
        Claim(task, first, second, outcome, stage, _compare(task, first, second, outcome))
        for task in study.tasks
        for first, second, stage in pairs(task)
        for outcome in OUTCOMES
    ]
    gates = [c for c in found if c.stage == "gate" and c.testable]
    adjusted = holm([c.comparison.p_value for c in gates if c.comparison])
    passed = {id(gate): float(p) for gate, p in zip(gates, adjusted, strict=True)}
    return [_decide(claim, gates, passed) for claim in found]


def _decide(claim: Claim, gates: Sequence[Claim], passed: dict[int, float]) -> Claim:
    if id(claim) in passed:
        return replace(claim, adjusted_p=passed[id(claim)])
    if claim.stage != "after gate" or not claim.testable or claim.comparison is None:
        return claim
    key = (claim.task, claim.first, claim.outcome)
    own = min((passed[id(g)] for g in gates if (g.task, g.first, g.outcome) == key), default=1.0)
    if own > ALPHA:
        return claim
    return replace(claim, adjusted_p=max(own, min(1.0, claim.comparison.p_value * len(passed))))


def pairs(task: Task) -> list[tuple[Group, Group, Stage]]:
    """Return the pairs of agents that are compared on a task, and the stage of each.

    A subject is tested against the baseline, then against the agents that bear on it: other
    agents with knowledge of its scope and the controls that match it in size (`mismatch`). The
    rest is described.
    """
    baseline, found = task.baseline, list[tuple[Group, Group, Stage]]()
    for subject in task.subjects:
        for group in task.groups:
            if group is subject or (subject, group) in ((b, a) for a, b, _ in found):
                continue
            if not bears_on(group, subject):
                stage: Stage = "described"
            else:
                stage = "gate" if group is baseline or baseline is None else "after gate"
            found.append((subject, group, stage))
    first = baseline or task.groups[0]
    if baseline or not task.subjects:
        others = [group for group in task.groups if group not in (*task.subjects, first)]
        found += [(group, first, "described") for group in others]
    return sorted(found, key=lambda pair: ("gate", "after gate", "described").index(pair[2]))


def bears_on(group: Group, subject: Group) -> bool:
    """Return whether a comparison with a group says something about a subject's knowledge."""
    return mismatch(group, subject) is None


def mismatch(group: Group, subject: Group) -> str | None:
    """Return why a comparison with a group says nothing about a subject's knowledge.

    Vectors of another scope do not: one vector per scene carries no information about the
    episode, one per target does. A control, moreover, must equal the subject in the width of the
    knowledge vector, in the parameters of the image encoder and in total, and a content control
    in the norm of the vector; numbers are compared within `TOLERANCE`. Sizes that are not stored
    cannot be compared. A baseline differs by definition.

    Returns:
        The difference in words, or None if there is none.
    """
    if group.role == "baseline":
        return None
    if group.scope != subject.scope:
        return f"knowledge of scope {group.scope} instead of {subject.scope}"
    if group.role not in CONTROLS:
        return None
    for name in SIZES:
        if name == "norm" and group.role != "content_control":
            continue
        own, other = _size(group, name), _size(subject, name)
        if own is None or other is None:
            return f"{name} unknown"
        if abs(own - other) > TOLERANCE * abs(other):
            return f"{name} {own:,.6g} instead of {other:,.6g}"
    return None


def _size(group: Group, name: str) -> float | None:
    """Return a stored size of an agent's network or input; None if it is not stored."""
    part, key = SIZES[name]
    value = (group.runs[0].provenance.get(part) or {}).get(key)
    return float(value) if isinstance(value, int | float) else None


def scores(task: Task, group: Group, outcome: Outcome) -> np.ndarray:
    """Return one score in 0..1 per training run, (n,) float64.

    The mean success during training extends to the same step for all agents of a task; a run
    that stopped before keeps its last value.
    """
    if outcome == "success":
        return group.scores("success")
    until = task.horizon
    return np.array(
        [
            area_under_curve(run.interim["step"], run.interim["success"], until)
            for run in group.runs
            if run.has_success_curve
        ]
    )


def _compare(task: Task, first: Group, second: Group, outcome: Outcome) -> Comparison | None:
    one, other = scores(task, first, outcome), scores(task, second, outcome)
    return welch(one, other) if min(one.size, other.size) >= 2 else None
