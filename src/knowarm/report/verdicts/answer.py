"""Answer of a report: one sentence from all findings on knowledge and queries."""

from collections import defaultdict
from collections.abc import Sequence

from knowarm.report.blocks import Verdict
from knowarm.report.format import listed
from knowarm.report.verdicts.claims import TONES, Finding, Kind, QueryKind

WORDS: dict[Kind | QueryKind, str] = {
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
    places: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for each in findings:
        place = [each.outcome] * (each.outcome != "success") + [each.task.title] * (tasks > 1)
        name = each.subject.name if each.subject else "agents with knowledge"
        places[name][WORDS[each.kind]].append(", ".join(place))
    parts = []
    for name, said in places.items():
        clauses = [f"{words}{_where(found, tasks)}" for words, found in said.items()]
        parts.append(f"{name}: {'; '.join(clauses)}.")
    tones = {TONES.get(each.kind, "open") for each in findings}
    sentence = f"Does the knowledge help? {' '.join(parts) or 'There is nothing to compare.'}"
    return Verdict(sentence=sentence, tone=tones.pop() if len(tones) == 1 else "open")


def _where(places: Sequence[str], tasks: int) -> str:
    """Return where a finding holds: on some splits or tasks, or nothing for a single task."""
    if not any(places):
        return ""
    if len(places) == tasks > 1:
        return f" on all {tasks} tasks"
    return f" on {listed(places)}"
