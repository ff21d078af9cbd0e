"""Verdicts: what the claims of one task say about the knowledge of a subject."""

from collections.abc import Sequence
from typing import Literal

from knowarm.experiment.agents import Role, controls_of
from knowarm.report.blocks import Tone, Verdict
from knowarm.report.claims import FEWEST_SEEDS, OUTCOMES, Claim, Outcome, mismatch
from knowarm.report.format import counted, listed
from knowarm.report.study import CONTROLS, Group, Task

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


def findings(task: Task, decided: Sequence[Claim], outcome: Outcome = "success") -> list[Verdict]:
    """Return the finding on every subject of a task; one finding if there is no subject."""
    return [finding(task, decided, outcome, each) for each in task.subjects or (None,)]


def finding(
    task: Task, decided: Sequence[Claim], outcome: Outcome = "success", subject: Group | None = None
) -> Verdict:
    """Decide whether the knowledge of a subject matters on one task.

    Three questions, each answered by significant differences (`Claim.verdict`); a later one is
    asked only after a positive answer to the one before:

    1. Is the subject better than the baseline? If not, no advantage is shown.
    2. Is it better than every capacity control that ran? If not, the size of the network may
       explain the advantage.
    3. Is it better than every content control that ran? If not, an input vector helps, but its
       meaning is not shown to matter.

    Controls of another size than the subject's (`claims.mismatch`) do not count; the sentence
    names those of its scope.

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
        return _verdict("nothing to compare", f"{task.title}: {what} among these runs.")
    reasons = tuple(claim.sentence() for claim in mine)
    if all(claim.verdict == "too few seeds" for claim in tested):
        fewest = min(claim.seeds for claim in tested)
        seeds = (
            f"from {counted(fewest, 'training seed')} per agent" if fewest else "without results"
        )
        return _verdict(
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
    words += _not_counted(task, subject)
    return _verdict(kind, f"{task.title}, {OUTCOMES[outcome]}: {words}", reasons)


def _verdict(kind: Kind, sentence: str, reasons: tuple[str, ...] = ()) -> Verdict:
    tone = TONES.get(kind, "open")
    return Verdict(kind=kind, sentence=sentence, reasons=reasons, tone=tone)


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
            f"evidence for knowledge.{hint('capacity_control', subject)}"
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
            f"{hint('content_control', subject)}"
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


def _not_counted(task: Task, subject: Group) -> str:
    """Return a sentence that names the controls of the subject's scope that do not match it."""
    reasons = [
        f"{group.name} ({reason})"
        for group in task.groups
        if group.role in CONTROLS
        and group.scope == subject.scope
        and (reason := mismatch(group, subject))
    ]
    return f" Not counted as controls: {listed(reasons)}." if reasons else ""


def hint(role: Role, subject: Group) -> str:
    """Return a sentence that names the registered agents that would answer the question."""
    names = controls_of(subject.agent, role)
    return f" Registered for this: {listed(names, 'or')}." if names else ""
