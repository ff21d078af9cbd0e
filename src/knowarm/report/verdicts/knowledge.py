"""Findings on knowledge vectors, and the answer of a report from these and those on queries."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from knowarm.report.blocks import Verdict
from knowarm.report.format import listed
from knowarm.report.model import CONTROLS, Group, TaskData
from knowarm.report.verdicts.claims import (
    FEW_SEEDS,
    OUTCOMES,
    TONES,
    Claim,
    Finding,
    Kind,
    few_seeds,
    hint,
    mismatch,
)


def findings(task: TaskData, decided: Sequence[Claim], outcome: str = "success") -> list[Finding]:
    """Return the finding on every subject of a task; one finding if there is no subject."""
    return [finding(task, decided, outcome, each) for each in task.subjects or (None,)]


def tested_findings(task: TaskData, decided: Sequence[Claim]) -> list[Finding]:
    """Return the findings on all outcomes; of others than success only those with a test."""
    return findings(task, decided) + [
        each
        for outcome in OUTCOMES
        if outcome != "success"
        for each in findings(task, decided, outcome)
        if each.kind not in ("nothing to compare", "too few seeds")
    ]


def finding(
    task: TaskData, decided: Sequence[Claim], outcome: str = "success", subject: Group | None = None
) -> Finding:
    """Decide whether the knowledge of a subject matters on one task.

    It must be better than the baseline, else no advantage is shown; then than every capacity
    control that ran, else the size of the network may explain the advantage; then than every
    content control that ran, else an input vector helps, but its meaning is not shown to matter.
    Controls of another size (`claims.mismatch`) do not count; the sentence names them.
    """
    subject = subject or next(iter(task.subjects), None)
    mine = [c for c in decided if c.task is task and c.outcome == outcome and c.first is subject]
    tested = [claim for claim in mine if claim.stage != "described"]
    kind: Kind
    if subject is None or not tested:
        kind = "nothing to compare"
        of = f"nothing to compare {subject.name} with" if subject else "no agent with knowledge"
        sentence = f"{task.title}: {of} among these runs."
        return Finding(task, subject, outcome, kind, sentence)
    notes: tuple[str, ...] = ()
    if all(claim.verdict == "too few seeds" for claim in tested):
        kind, notes = "too few seeds", (FEW_SEEDS,)
        words = f"whether the knowledge of {subject.name} helps "
        words += few_seeds(min(claim.seeds for claim in tested))
    else:
        kind, words = _judge(subject, tested)
        words += _not_counted(task, subject)
    sentence = f"{task.title}, {OUTCOMES[outcome]}: {words}"
    return Finding(task, subject, outcome, kind, sentence, mine, notes)


def _judge(subject: Group, tested: Sequence[Claim]) -> tuple[Kind, str]:
    """Return the finding on a subject and its sentence; both name only agents that ran."""
    name = subject.name
    by_role = {
        role: [claim for claim in tested if claim.second and claim.second.role == role]
        for role in ("baseline", *CONTROLS)
    }
    gate = next(iter(by_role["baseline"]), None)
    if gate is None:
        return "no baseline", f"there is no baseline to compare {name} with."
    baseline = gate.against
    if gate.verdict == "worse":
        return "worse", f"{name} was worse than the baseline {baseline}."
    if gate.verdict != "better":
        return "no advantage", f"no advantage of {name} over the baseline {baseline} is shown."
    better = f"{name} was better than the baseline {baseline}"
    capacity, content = (by_role[role] for role in CONTROLS)
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
    return listed([claim.against for claim in claims])


def _not_beaten(claims: Sequence[Claim]) -> str:
    return listed([c.against for c in claims if c.verdict != "better"], "or")


def _not_counted(task: TaskData, subject: Group) -> str:
    """Return a sentence that names the controls of the subject's scope that do not match it."""
    controls = [g for g in task.groups if g.role in CONTROLS and g.scope == subject.scope]
    reasons = [f"{g.name} ({reason})" for g in controls if (reason := mismatch(g, subject))]
    return f" Not counted as controls: {listed(reasons)}." if reasons else ""


WORDS: dict[Kind, str] = {
    "no advantage": "no advantage over the baseline is shown",
    "worse": "worse than the baseline",
    "knowledge matters": "better than the baseline and than every control of size and content",
    "size not excluded": "better than the baseline, but its network is larger, too",
    "size may explain it": "better than the baseline, but not than a network as large",
    "input without meaning": "better than the baseline, but not than vectors of other content",
    "meaning not tested": "better than controls of size; the content was not tested",
    "no baseline": "there is no baseline to compare it with",
    "nothing to compare": "there is nothing to compare it with",
    "too few seeds": "undecided, because there are too few training seeds",
    "no control": "the choice has no control",
    "not above chance": "choices are not above chance",
    "not above the best control": "choices are not above the best control",
    "understood": "the query is understood",
}
"""What a finding says about its agent, in a few words."""


def answer(findings: Sequence[Finding], tasks: int) -> Verdict:
    """Return the answer of a report of some tasks, agent by agent."""
    said: dict[str, dict[str, dict[str, dict[str, list[str]]]]] = defaultdict(
        lambda: defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
    )
    for finding in findings:
        is_split = finding.outcome not in OUTCOMES
        name = finding.subject.name if finding.subject else "agents with knowledge"
        by_task = said[name]["" if is_split else finding.outcome][WORDS[finding.kind]]
        by_task[finding.task.title] += [finding.outcome] * is_split
    parts = []
    for name, outcomes in said.items():
        if outcomes.get("success") == outcomes.get("speed"):
            outcomes.pop("speed", None)
        clauses = [
            (f"{OUTCOMES[outcome]}: " if "speed" in outcomes and outcome else "")
            + "; ".join(f"{_where(splits, tasks)}{words}" for words, splits in each.items())
            for outcome, each in outcomes.items()
        ]
        parts.append(f"{name}: {'; '.join(clauses)}.")
    tones = {TONES.get(each.kind, "open") for each in findings}
    sentence = f"Does the knowledge help? {' '.join(parts) or 'There is nothing to compare.'}"
    return Verdict(sentence=sentence, tone=tones.pop() if len(tones) == 1 else "open")


def _where(splits: Mapping[str, Sequence[str]], tasks: int) -> str:
    """Return where a finding holds, given splits by task; nothing for all of a single task."""
    titles: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for title, each in splits.items():
        titles[tuple(each)].append(title)
    places = []
    for each, found in titles.items():
        every = "both tasks" if tasks == 2 else f"all {tasks} tasks"
        named = every if len(found) == tasks else listed(found)
        places.append(" of ".join([listed(each)] * bool(each) + [named] * (tasks > 1)))
    return f"on {listed(places)} " if any(places) else ""
