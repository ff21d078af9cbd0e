"""Verdicts: what the claims of one task say about the knowledge of a subject."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from knowarm.experiment.agents import AGENTS
from knowarm.report.blocks import Tone, Verdict
from knowarm.report.claims import FEWEST_SEEDS, OUTCOMES, Claim, Outcome
from knowarm.report.format import counted, listed
from knowarm.report.study import Group, Task

Kind = Literal[
    "nothing to compare",
    "too few seeds",
    "no baseline",
    "no advantage",
    "worse",
    "size not excluded",
    "size may explain it",
    "meaning not tested",
    "input without meaning",
    "knowledge matters",
]

TONES: dict[Kind, Tone] = {
    "worse": "bad",
    "knowledge matters": "good",
    "nothing to compare": "note",
    "no baseline": "note",
}


@dataclass(frozen=True)
class Finding:
    """What the comparisons of one task say about one subject and outcome.

    Attributes:
        kind: the finding, for programs.
        sentence: the finding, for people.
        reasons: the comparisons it follows from.
    """

    kind: Kind
    sentence: str
    reasons: tuple[str, ...] = ()

    def verdict(self, shown_reasons: int = 99) -> Verdict:
        """Return the finding as a block of a page."""
        return Verdict(
            sentence=self.sentence,
            reasons=self.reasons,
            shown_reasons=shown_reasons,
            tone=TONES.get(self.kind, "open"),
        )


def findings(task: Task, decided: Sequence[Claim], outcome: Outcome = "success") -> list[Finding]:
    """Return the finding on every subject of a task; one finding if there is no subject."""
    return [finding(task, decided, outcome, each) for each in task.subjects or (None,)]


def finding(
    task: Task, decided: Sequence[Claim], outcome: Outcome = "success", subject: Group | None = None
) -> Finding:
    """Decide whether the knowledge of a subject matters on one task.

    Three questions, each answered by significant differences (`Claim.verdict`); a later one is
    asked only after a positive answer to the one before:

    1. Is the subject better than the baseline? If not, no advantage is shown.
    2. Is it better than every capacity control that ran? If not, the size of the network may
       explain the advantage.
    3. Is it better than every content control of its scope that ran? If not, an input vector
       helps, but its meaning is not shown to matter.

    Args:
        task: the task.
        decided: all claims of the report; those of other tasks and outcomes are ignored.
        outcome: the outcome.
        subject: one of ``task.subjects``; None takes the first.
    """
    subject = subject or next(iter(task.subjects), None)
    mine = [c for c in decided if c.task is task and c.outcome == outcome and c.first is subject]
    tested = [claim for claim in mine if claim.stage != "described"]
    if subject is None or not tested:
        what = (
            "no agent with knowledge"
            if subject is None
            else f"nothing to compare {subject.name} with"
        )
        return Finding("nothing to compare", f"{task.title}: {what} among these runs.")
    reasons = tuple(claim.sentence() for claim in mine)
    if all(claim.verdict == "too few seeds" for claim in tested):
        fewest = min(claim.seeds for claim in tested)
        seeds = (
            f"from {counted(fewest, 'training seed')} per agent" if fewest else "without results"
        )
        return Finding(
            "too few seeds",
            f"{task.title}, {OUTCOMES[outcome]}: whether the knowledge of {subject.name} helps "
            f"cannot be decided {seeds}.",
            (
                f"At least {FEWEST_SEEDS} seeds of each agent are required: two networks of one "
                "method that differ only in the training seed can differ as much as two methods.",
                *reasons,
            ),
        )
    kind, words = _judge(subject, tested)
    return Finding(kind, f"{task.title}, {OUTCOMES[outcome]}: {words}", reasons)


def _judge(subject: Group, tested: Sequence[Claim]) -> tuple[Kind, str]:
    """Return the finding on a subject and its sentence; both name only agents that ran."""
    name = subject.name
    gate = next((claim for claim in tested if claim.second.role == "baseline"), None)
    if gate is None:
        return "no baseline", f"there is no baseline to compare {name} with."
    baseline = gate.second.name
    if gate.verdict == "worse":
        return "worse", f"{name} was worse than the baseline {baseline}."
    if gate.verdict != "better":
        return "no advantage", f"no advantage of {name} over the baseline {baseline} is shown."
    better = f"{name} was better than the baseline {baseline}"
    capacity = [claim for claim in tested if claim.second.role == "capacity_control"]
    content = [claim for claim in tested if claim.second.role == "content_control"]
    if not capacity:
        return "size not excluded", (
            f"{better}, but its network is larger, too: without a capacity control this is no "
            f"evidence for knowledge.{_hint('capacity_control', subject)}"
        )
    if missed := _not_beaten(capacity):
        return "size may explain it", (
            f"{better}, but not significantly better than {missed} without knowledge: the size of "
            "the network may explain the advantage."
        )
    better = f"{better}, than {_names(capacity)} (as large, without knowledge)"
    if not content:
        return "meaning not tested", (
            f"{better}; whether the content of the vector matters was not tested."
            f"{_hint('content_control', subject)}"
        )
    if missed := _not_beaten(content):
        return "input without meaning", (
            f"an input vector helps, but its meaning is not shown to matter: {name} was not "
            f"significantly better than {missed}."
        )
    return "knowledge matters", (
        f"the knowledge matters: {better} and than {_names(content)} (same shape, other content)."
    )


def _names(claims: Sequence[Claim]) -> str:
    return listed([claim.second.name for claim in claims])


def _not_beaten(claims: Sequence[Claim]) -> str:
    return listed([c.second.name for c in claims if c.verdict != "better"], "or")


def _hint(role: str, subject: Group) -> str:
    """Return a sentence that names the registered agents that would answer the question."""
    scopes = {subject.scope, "scene"} if role == "capacity_control" else {subject.scope}
    names = [
        name
        for name, agent in AGENTS.items()
        if agent.role == role and agent.knowledge.scope in scopes
    ]
    return f" Registered for this: {listed(names, 'or')}." if names else ""
