"""Findings on knowledge vectors, and the answer of a report from these and those on queries."""

from collections.abc import Mapping, Sequence

from knowarm.report.blocks import Verdict
from knowarm.report.format import listed
from knowarm.report.model import CONTROLS, ROLES, Group, TaskData
from knowarm.report.verdicts.claims import (
    FEW_SEEDS,
    KINDS,
    OUTCOMES,
    Claim,
    Claims,
    Finding,
    claims_on,
    few_seeds,
    hint,
    mismatch,
    tone_of,
)

UNTESTED = ("nothing to compare", "too few seeds")


def findings(
    task: TaskData,
    decided: Claims,
    outcome: str = "success",
) -> list[Finding]:
    """Return the finding on every subject of a task; one finding if there is no subject."""
    subjects = task.subjects or (None,)
    return [finding(task, decided, outcome, subject) for subject in subjects]


def tested_findings(task: TaskData, decided: Claims) -> list[Finding]:
    """Return the findings on all outcomes; of others than success only those with a test."""
    tested = []
    for outcome in OUTCOMES:
        of_outcome = findings(task, decided, outcome)
        if outcome != "success":
            of_outcome = [
                finding for finding in of_outcome if finding.kind not in UNTESTED
            ]
        tested += of_outcome
    return tested


def finding(
    task: TaskData,
    decided: Claims,
    outcome: str = "success",
    subject: Group | None = None,
) -> Finding:
    """Decide whether the knowledge of a subject matters on one task.

    It must be better than the baseline, else no advantage is shown; then than every capacity
    control that ran, else the size of the network may explain the advantage; then than every
    content control that ran, else an input vector helps, but its meaning is not shown to matter.
    Controls of another size (`claims.mismatch`) do not count; the sentence names them.
    """
    subject = subject or next(iter(task.subjects), None)
    if subject is None:
        sentence = f"{task.title}: no agent with knowledge among these runs."
        return Finding(
            task=task,
            subject=None,
            outcome=outcome,
            kind="nothing to compare",
            sentence=sentence,
        )
    compared = claims_on(decided, task, subject, outcome)
    tested = [claim for claim in compared if claim.stage != "described"]
    by_role: dict[str, list[Claim]] = {role: [] for role in ROLES}
    for claim in tested:
        if claim.second:
            by_role[claim.second.role].append(claim)
    baseline = by_role["baseline"][:1]
    capacity = by_role["capacity_control"]
    content = by_role["content_control"]
    kind = _judge(baseline, capacity, content)
    if not tested:
        kind = "nothing to compare"
    elif all(claim.verdict == "too few seeds" for claim in tested):
        kind = "too few seeds"
    words = KINDS[kind]["vector"].format(
        name=subject.name,
        baseline=_names(baseline),
        capacity=_names(capacity),
        content=_names(content),
        not_beaten=_not_beaten(capacity) or _not_beaten(content),
        capacity_hint=hint("capacity_control", subject),
        content_hint=hint("content_control", subject),
        few_seeds=few_seeds(min((claim.seeds for claim in tested), default=0)),
    )
    sentence = (
        f"{task.title}, {OUTCOMES[outcome]}: {words}{_not_counted(task, subject)}"
    )
    notes = [FEW_SEEDS] if kind == "too few seeds" else []
    return Finding(
        task=task,
        subject=subject,
        outcome=outcome,
        kind=kind,
        sentence=sentence,
        claims=compared,
        notes=notes,
    )


def _judge(baseline: Claims, capacity: Claims, content: Claims) -> str:
    """Return the finding on a subject, from the comparisons with agents of each role."""
    if not baseline:
        return "no baseline"
    if baseline[0].verdict == "worse":
        return "worse"
    if baseline[0].verdict != "better":
        return "no advantage"
    if not capacity:
        return "size not excluded"
    if _not_beaten(capacity):
        return "size may explain it"
    if not content:
        return "meaning not tested"
    return "input without meaning" if _not_beaten(content) else "knowledge matters"


def _names(claims: Claims) -> str:
    return listed([claim.against for claim in claims])


def _not_beaten(claims: Claims) -> str:
    missed = [claim.against for claim in claims if claim.verdict != "better"]
    return listed(missed, "or")


def _not_counted(task: TaskData, subject: Group) -> str:
    """Return a sentence that names the controls of the subject's scope that do not match it."""
    reasons = []
    for group in task.groups:
        if group.role in CONTROLS and group.scope == subject.scope:
            reason = mismatch(group, subject)
            if reason:
                reasons.append(f"{group.name} ({reason})")
    if not reasons:
        return ""
    return f" Not counted as controls: {listed(reasons)}."


Places = dict[str, list[str]]
"""Splits on which a finding holds, by the title of the task; none for other outcomes."""


def answer(findings: Sequence[Finding], tasks: int) -> Verdict:
    """Return the answer of a report of some tasks, agent by agent."""
    said: dict[str, dict[str, dict[str, Places]]] = {}
    for finding in findings:
        name = finding.subject.name if finding.subject else "agents with knowledge"
        outcome = finding.outcome if finding.outcome in OUTCOMES else ""
        clauses = said.setdefault(name, {}).setdefault(outcome, {})
        places = clauses.setdefault(KINDS[finding.kind]["words"], {})
        splits = places.setdefault(finding.task.title, [])
        if not outcome:
            splits.append(finding.outcome)
    sentences = []
    for name, outcomes in said.items():
        if outcomes.get("success") == outcomes.get("speed"):
            outcomes.pop("speed", None)
        statements = []
        for outcome, clauses in outcomes.items():
            phrases = [_where(where, tasks) + what for what, where in clauses.items()]
            statement = "; ".join(phrases)
            if outcome and "speed" in outcomes:
                statement = f"{OUTCOMES[outcome]}: {statement}"
            statements.append(statement)
        sentences.append(f"{name}: {'; '.join(statements)}.")
    answer = " ".join(sentences) or "There is nothing to compare."
    tone = tone_of(finding.kind for finding in findings)
    return Verdict(f"Does the knowledge help? {answer}", tone=tone)


def _where(places: Mapping[str, Sequence[str]], tasks: int) -> str:
    """Return where a finding holds; nothing for all of a single task."""
    titles: dict[str, list[str]] = {}
    for title, splits in places.items():
        titles.setdefault(listed(splits), []).append(title)
    phrases = []
    for phrase, same_splits in titles.items():
        if tasks > 1:
            which = _tasks(same_splits, tasks)
            phrase = f"{phrase} of {which}" if phrase else which
        phrases.append(phrase)
    return f"on {listed(phrases)} " if any(phrases) else ""


def _tasks(titles: Sequence[str], tasks: int) -> str:
    """Name tasks of a report that has some number of tasks."""
    if len(titles) < tasks:
        return listed(titles)
    return "both tasks" if tasks == 2 else f"all {tasks} tasks"
