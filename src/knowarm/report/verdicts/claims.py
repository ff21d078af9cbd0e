"""Claims, the differences between agents that a report decides on; findings they add up to."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from knowarm.arrays import Floats
from knowarm.experiment.agents import Role, controls_of
from knowarm.reading import read_toml
from knowarm.report.blocks import Tone, Verdict
from knowarm.report.format import counted, ends, listed, p_value, points
from knowarm.report.model import CONTROLS, Group, StudyData, TaskData
from knowarm.statistics import Comparison, area_under_curve, holm, welch

FEWEST_SEEDS = 3  # of each agent, below which no difference is called significant
ALPHA = 0.05  # fraction of studies without any effect in which the report may claim one
# Largest relative difference in size between a control and its subject.
TOLERANCE = 0.01

# Sizes in which controls must equal their subject: where ``provenance.json`` has them.
SIZES = (
    "knowledge width",
    "parameters",
    "parameters of the image encoder",
    "norm",
)

# What is tested, beside right choices on a split. Everything else in a report is descriptive.
OUTCOMES = {
    "success": "success after training",
    "speed": "mean success during training",
}
CHANCE = "chance"  # name of the choice at random among the objects of an episode

# Against the baseline; tested only once the gate is passed; never tested; one of the comparisons
# that together decide whether a query was understood (`verdicts.query`).
Stage = Literal["gate", "after gate", "described", "query"]
STAGES: tuple[Stage, ...] = get_args(Stage)
Decision = Literal[
    "better", "worse", "undecided", "too few seeds", "not tested", "described"
]

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
    # Over training seeds; None below two seeds per agent.
    comparison: Comparison | None = None
    # See `claims`, `verdicts.query`; None: nothing is tested.
    adjusted_p: float | None = None

    @property
    def topic(self) -> tuple[TaskData, Group, str]:
        """Task, first agent and outcome, which the claims of one finding share."""
        return self.task, self.first, self.outcome

    @property
    def against(self) -> str:
        """Name of what the first agent is compared with."""
        return self.second.name if self.second else CHANCE

    @property
    def is_above(self) -> bool:
        """Whether the first agent's interval is above the second's, before any correction."""
        return self.comparison is not None and self.comparison.difference.low > 0

    @property
    def tested(self) -> Comparison | None:
        """The comparison, if there are enough seeds for a test."""
        return self.comparison if self.seeds >= FEWEST_SEEDS else None

    @property
    def verdict(self) -> Decision:
        """The decision on the first agent: significant if the adjusted p is at most `ALPHA`."""
        if self.stage == "described":
            return "described"
        if self.tested is None:
            return "too few seeds"
        if self.adjusted_p is None:
            return "not tested"
        if self.adjusted_p > ALPHA:
            return "undecided"
        return "better" if self.tested.difference.estimate > 0 else "worse"

    def sentence(self) -> str:
        """Return the difference in words, with its interval and the decision."""
        pair = f"{self.first.name} against {self.against}"
        compared = self.comparison
        if compared is None:
            seeds = counted(self.seeds, "training seed")
            return f"{pair}: {seeds}, too few for a comparison of the methods."
        details = ends(compared.difference, points)
        if self.second:
            details += f"; {compared.first_count} and {compared.second_count} seeds"
        if self.adjusted_p is not None:
            details += f", adjusted p {p_value(self.adjusted_p)}"
        sentence = f"{pair}: {points(compared.difference.estimate)} points ({details})"
        if self.stage != "query":
            sentence += f": {ENDINGS[self.verdict]}"
        if self.stage == "described" and self.second:
            reason = mismatch(self.second, self.first)
            if reason:
                sentence += f", because they differ in more than content ({reason})"
        return f"{sentence}."


Claims = Sequence[Claim]


def claims(study: StudyData) -> list[Claim]:
    """Decide on every difference of a report so that at most 5 % of studies claim falsely.

    The gates are the comparisons of each subject with the baseline (without a baseline, with
    every agent), one per task and outcome, with Holm's correction over all gates of the report.
    Behind a passed gate the subject is compared with the other agents of its task, each at the
    gate's part of the 5 % (p multiplied by the number of gates). These are not corrected for their
    own number, because `verdicts.knowledge` requires that every control of a kind is beaten (an
    intersection-union test): without any effect, a false claim requires a falsely passed gate.
    """
    undecided = []
    for task in study.tasks:
        for first, second, stage in pairs(task):
            for outcome in OUTCOMES:
                claim = claim_of(
                    task=task,
                    first=first,
                    second=second,
                    outcome=outcome,
                    stage=stage,
                    values=scores(task, first, outcome),
                    others=scores(task, second, outcome),
                )
                undecided.append(claim)
    gates = []
    p_values = []
    for claim in undecided:
        if claim.stage == "gate" and claim.tested:
            gates.append(claim)
            p_values.append(claim.tested.p_value)
    gate_values = dict(zip(gates, holm(p_values).tolist(), strict=True))
    return [_decide(claim, gate_values) for claim in undecided]


def claims_on(
    decided: Claims,
    task: TaskData,
    subject: Group | None,
    outcome: str,
) -> list[Claim]:
    """Return the claims on one subject of a task."""
    topic = (task, subject, outcome)
    return [claim for claim in decided if claim.topic == topic]


def _decide(claim: Claim, gate_values: Mapping[Claim, float]) -> Claim:
    """Return a claim with its adjusted p, given those of the gates."""
    if claim in gate_values:
        return replace(claim, adjusted_p=gate_values[claim])
    if claim.stage != "after gate" or not claim.tested:
        return claim
    own_gates = [p for gate, p in gate_values.items() if gate.topic == claim.topic]
    gate_p = min(own_gates, default=1.0)
    if gate_p > ALPHA:
        return claim
    adjusted = min(1.0, claim.tested.p_value * len(gate_values))
    return replace(claim, adjusted_p=max(gate_p, adjusted))


def claim_of(
    task: TaskData,
    first: Group,
    second: Group | None,
    outcome: str,
    stage: Stage,
    values: Floats,
    others: Floats,
    test: Callable[[Floats, Floats], Comparison] = welch,
) -> Claim:
    """Compare two agents by one score per training seed; nothing is tested below two seeds."""
    seeds = min(values.size, others.size)
    comparison = test(values, others) if seeds >= 2 else None
    return Claim(
        task=task,
        first=first,
        second=second,
        outcome=outcome,
        stage=stage,
        seeds=seeds,
        comparison=comparison,
    )


def pairs(task: TaskData) -> list[tuple[Group, Group, Stage]]:
    """Return the pairs of agents that are compared on a task, and the stage of each.

    A subject is tested against the baseline, then against the agents that match it (`mismatch`).
    """
    compared: list[tuple[Group, Group, Stage]] = []
    others = list(task.groups)
    for subject in task.subjects:
        others.remove(subject)
        for group in others:
            stage = _stage(task, subject, group)
            compared.append((subject, group, stage))
    first = task.baseline or task.groups[0]
    if task.baseline or not task.subjects:
        others = [group for group in others if group is not first]
        compared += [(group, first, "described") for group in others]
    return sorted(compared, key=lambda pair: STAGES.index(pair[2]))


def _stage(task: TaskData, subject: Group, group: Group) -> Stage:
    """Return how the comparison of a subject with another agent enters the verdict."""
    if mismatch(group, subject) is not None:
        return "described"
    return "gate" if task.baseline in (group, None) else "after gate"


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
        size = size_of(group, name)
        wanted = size_of(subject, name)
        if size is None or wanted is None:
            return f"{name} unknown"
        if abs(size - wanted) > TOLERANCE * abs(wanted):
            return f"{name} {size:,.6g} instead of {wanted:,.6g}"
    return None


def size_of(group: Group, name: str) -> float | None:
    """Return a stored size of an agent's network or input; None if it is not stored."""
    provenance = group.runs[0].provenance
    counts = provenance.parameter_counts
    sizes: dict[str, float | None] = {
        "parameters": counts.get("total"),
        "parameters of the image encoder": counts.get("image"),
    }
    if provenance.knowledge:
        sizes["knowledge width"] = provenance.knowledge.dim
        sizes["norm"] = provenance.knowledge.norm
    return sizes.get(name)


def scores(task: TaskData, group: Group, outcome: str) -> Floats:
    """Return one score in 0..1 per training run, (n,).

    A curve extends to the same step for all agents of a task; runs that were stopped before it are
    left out, and of those that ``stop_when`` ended the last value is extended.
    """
    if outcome == "success":
        return group.scores("success")
    until = task.horizon
    areas = []
    for run in group.runs:
        if run.lasts(until):
            curve = run.interim
            areas.append(area_under_curve(curve["step"], curve["success"], until))
    return np.array(areas)


KINDS: dict[str, dict[str, str]] = read_toml(Path(__file__).with_name("kinds.toml"))
"""What findings say, by kind."""


def tone_of(kinds: Iterable[str]) -> Tone:
    """Return the tone that findings share; without one they are undecided."""
    tones: set[Any] = {KINDS[kind].get("tone", "open") for kind in kinds}
    return tones.pop() if len(tones) == 1 else "open"


FEW_SEEDS = (
    f"At least {FEWEST_SEEDS} seeds of each agent are required: two networks of one method that "
    "differ only in the training seed can differ as much as two methods."
)


@dataclass(frozen=True, eq=False)
class Finding:
    """What a report says about one agent."""

    task: TaskData
    # The agent; None if the task has none whose knowledge can be tested.
    subject: Group | None
    outcome: str  # outcome or split that the finding is about
    kind: str  # the finding, one of `KINDS`
    sentence: str  # the finding in words
    claims: Claims = ()  # the comparisons that it follows from
    notes: Sequence[str] = ()  # reasons before those of the claims

    def verdict(self, *, shown_reasons: int = 99) -> Verdict:
        """Return the finding as a block of a page."""
        reasons = [*self.notes, *(claim.sentence() for claim in self.claims)]
        return Verdict(
            sentence=self.sentence,
            reasons=reasons,
            shown_reasons=shown_reasons,
            tone=tone_of([self.kind]),
            kind=self.kind,
        )


def few_seeds(count: int) -> str:
    """Return why nothing can be decided."""
    if not count:
        return "cannot be decided without results."
    return f"cannot be decided from {counted(count, 'training seed')} per agent."


def hint(role: Role, subject: Group) -> str:
    """Return a sentence that names the registered agents that would answer the question."""
    names = controls_of(subject.agent, role)
    if not names:
        return ""
    return f" Registered for this: {listed(names, 'or')}."
