"""Claims, the differences between agents that a report decides on; findings they add up to."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from knowarm.experiment.agents import Role, controls_of
from knowarm.experiment.provenance import Provenance
from knowarm.report import format
from knowarm.report.blocks import Tone, Verdict
from knowarm.report.format import counted, listed
from knowarm.report.model import CONTROLS, Group, StudyData, TaskData
from knowarm.statistics import Comparison, area_under_curve, holm, welch

FEWEST_SEEDS = 3  # of each agent, below which no difference is called significant
ALPHA = 0.05  # fraction of studies without any effect in which the report may claim one
TOLERANCE = 0.01  # largest relative difference in size between a control and its subject

# Sizes in which controls must equal their subject: where ``provenance.json`` has them.
SIZES: dict[str, Callable[[Provenance], float | None]] = {
    "knowledge width": lambda known: known.knowledge.dim if known.knowledge else None,
    "parameters": lambda known: known.parameter_counts.get("total"),
    "parameters of the image encoder": lambda known: known.parameter_counts.get("image"),
    "norm": lambda known: known.knowledge.norm if known.knowledge else None,
}

# What is tested, beside right choices on a split. Everything else in a report is descriptive.
OUTCOMES = {"success": "success after training", "speed": "mean success during training"}
CHANCE = "chance"  # name of the choice at random among the objects of an episode

# Against the baseline; tested only once the gate is passed; never tested; one of the comparisons
# that together decide whether a query was understood (`verdicts.query`).
Stage = Literal["gate", "after gate", "described", "query"]
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
    """One difference between two agents on one task, and the decision on it."""

    task: TaskData
    first: Group  # agent whose advantage is tested
    second: Group | None  # agent it is compared with; None for a choice at random
    outcome: str  # key of `OUTCOMES`, or the name of a split
    stage: Stage  # how the difference enters the verdict
    seeds: int  # training seeds of the agent that has fewer
    comparison: Comparison | None = None  # over training seeds; None below two seeds per agent
    adjusted_p: float | None = None  # see `claims`, `verdicts.query`; None: nothing is tested

    @property
    def against(self) -> str:
        """Name of what the first agent is compared with."""
        return self.second.name if self.second else CHANCE

    @property
    def is_above(self) -> bool:
        """Whether the first agent's interval is above the second's, before any correction."""
        return self.comparison is not None and self.comparison.difference.low > 0

    @property
    def testable(self) -> bool:
        """Whether there are enough seeds for a test."""
        return self.comparison is not None and self.seeds >= FEWEST_SEEDS

    @property
    def verdict(self) -> Decision:
        """The decision on the first agent: significant if the adjusted p is at most `ALPHA`."""
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
        who = f"{self.first.name} against {self.against}"
        if self.comparison is None:
            seeds = counted(self.seeds, "training seed")
            return f"{who}: {seeds}, too few for a comparison of the methods."
        ending = "" if self.stage == "query" else f": {ENDINGS[self.verdict]}"
        if self.stage == "described" and self.second:
            reason = mismatch(self.second, self.first)
            ending += f", because they differ in more than content ({reason})" if reason else ""
        compared, difference = self.comparison, self.comparison.difference
        shown = f"{format.points(difference.estimate)} points"
        seeds = f"; {compared.first_count} and {compared.second_count} seeds" if self.second else ""
        p = f", adjusted p {format.p_value(self.adjusted_p)}" if self.adjusted_p is not None else ""
        return f"{who}: {shown} ({format.ends(difference, format.points)}{seeds}{p}){ending}."


def claims(study: StudyData) -> list[Claim]:
    """Decide on every difference of a report so that at most 5 % of studies claim falsely.

    The gates are the comparisons of each subject with the baseline (without a baseline, with
    every agent), one per task and outcome, with Holm's correction over all gates of the report.
    Behind a passed gate the subject is compared with the other agents of its task, each at the
    gate's part of the 5 % (p multiplied by the number of gates). These are not corrected for their
    own number, because `verdicts.knowledge` requires that every control of a kind is beaten (an
    intersection-union test): without any effect, a false claim requires a falsely passed gate.
    """
    undecided = [
        _claim(task, first, second, outcome, stage)
        for task in study.tasks
        for first, second, stage in pairs(task)
        for outcome in OUTCOMES
    ]
    gates = [c for c in undecided if c.stage == "gate" and c.testable]
    adjusted = holm([c.comparison.p_value for c in gates if c.comparison])
    passed = {id(gate): float(p) for gate, p in zip(gates, adjusted, strict=True)}
    return [_decide(claim, gates, passed) for claim in undecided]


def _decide(claim: Claim, gates: Sequence[Claim], passed: dict[int, float]) -> Claim:
    if id(claim) in passed:
        return replace(claim, adjusted_p=passed[id(claim)])
    if claim.stage != "after gate" or not claim.testable or claim.comparison is None:
        return claim
    key = (claim.task, claim.first, claim.outcome)
    own = min((passed[id(g)] for g in gates if (g.task, g.first, g.outcome) == key), default=1.0)
    adjusted = max(own, min(1.0, claim.comparison.p_value * len(passed)))
    return claim if own > ALPHA else replace(claim, adjusted_p=adjusted)


def pairs(task: TaskData) -> list[tuple[Group, Group, Stage]]:
    """Return the pairs of agents that are compared on a task, and the stage of each.

    A subject is tested against the baseline, then against the agents that match it (`mismatch`).
    """
    baseline, compared = task.baseline, list[tuple[Group, Group, Stage]]()
    for subject in task.subjects:
        for group in task.groups:
            if group is subject or (subject, group) in ((b, a) for a, b, _ in compared):
                continue
            if mismatch(group, subject) is not None:
                stage: Stage = "described"
            else:
                stage = "gate" if group is baseline or baseline is None else "after gate"
            compared.append((subject, group, stage))
    first = baseline or task.groups[0]
    if baseline or not task.subjects:
        others = [group for group in task.groups if group not in (*task.subjects, first)]
        compared += [(group, first, "described") for group in others]
    return sorted(compared, key=lambda pair: ("gate", "after gate", "described").index(pair[2]))


def mismatch(group: Group, subject: Group) -> str | None:
    """Return why a comparison with a group says nothing about a subject's knowledge.

    Vectors of another scope do not. A control, moreover, must equal the subject in `SIZES` (only a
    content control in the norm) within `TOLERANCE`; sizes that are not stored cannot be compared.
    A baseline differs by definition. None if there is no such difference.
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
        own, other = size_of(group, name), size_of(subject, name)
        if own is None or other is None:
            return f"{name} unknown"
        if abs(own - other) > TOLERANCE * abs(other):
            return f"{name} {own:,.6g} instead of {other:,.6g}"
    return None


def size_of(group: Group, name: str) -> float | None:
    """Return a stored size of an agent's network or input; None if it is not stored."""
    return SIZES[name](group.runs[0].provenance)


def scores(task: TaskData, group: Group, outcome: str) -> np.ndarray:
    """Return one score in 0..1 per training run, (n,) float64.

    A curve extends to the same step for all agents of a task; runs that were stopped before it are
    left out, and of those that ``stop_when`` ended the last value is extended.
    """
    if outcome == "success":
        return group.scores("success")
    until = task.horizon
    curves = [run.interim for run in group.runs if run.lasts(until)]
    return np.array([area_under_curve(each["step"], each["success"], until) for each in curves])


def compare(first: np.ndarray, second: np.ndarray) -> Comparison | None:
    """Compare two agents over training seeds; None below two seeds of one of them."""
    return welch(first, second) if min(first.size, second.size) >= 2 else None


def _claim(task: TaskData, first: Group, second: Group, outcome: str, stage: Stage) -> Claim:
    one, other = scores(task, first, outcome), scores(task, second, outcome)
    seeds = min(one.size, other.size)
    return Claim(task, first, second, outcome, stage, seeds, compare(one, other))


# Findings on a knowledge vector, then those on a query; some are common.
KnowledgeKind = Literal["no baseline", "no advantage", "worse", "knowledge matters"]
SizeKind = Literal["size not excluded", "size may explain it", "input without meaning"]
QueryKind = Literal["no control", "not above chance", "not above the best control", "understood"]
CommonKind = Literal["nothing to compare", "too few seeds", "meaning not tested"]
Kind = KnowledgeKind | SizeKind | QueryKind | CommonKind

TONES: dict[Kind, Tone] = {  # the others are undecided
    **{"worse": "bad", "knowledge matters": "good", "understood": "good"},
    **{"nothing to compare": "note", "no baseline": "note", "no control": "note"},
}

FEW_SEEDS = (
    f"At least {FEWEST_SEEDS} seeds of each agent are required: two networks of one method that "
    "differ only in the training seed can differ as much as two methods."
)


@dataclass(frozen=True, eq=False)
class Finding:
    """What a report says about one agent."""

    task: TaskData
    subject: Group | None  # the agent; None if the task has none whose knowledge can be tested
    outcome: str  # outcome or split that the finding is about
    kind: Kind  # the finding
    sentence: str  # the finding in words
    claims: Sequence[Claim] = ()  # the comparisons that it follows from
    notes: Sequence[str] = ()  # reasons before those of the claims

    def verdict(self, *, shown_reasons: int = 99) -> Verdict:
        """Return the finding as a block of a page."""
        reasons = [*self.notes, *(claim.sentence() for claim in self.claims)]
        block = Verdict(sentence=self.sentence, reasons=reasons, shown_reasons=shown_reasons)
        return replace(block, tone=TONES.get(self.kind, "open"), kind=self.kind)


def few_seeds(count: int) -> str:
    """Return why nothing can be decided."""
    seeds = f"from {counted(count, 'training seed')} per agent" if count else "without results"
    return f"cannot be decided {seeds}."


def hint(role: Role, subject: Group) -> str:
    """Return a sentence that names the registered agents that would answer the question."""
    names = controls_of(subject.agent, role)
    return f" Registered for this: {listed(names, 'or')}." if names else ""
