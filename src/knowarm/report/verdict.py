"""The claims of one task go in; what they say about the knowledge comes out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from knowarm.report.blocks import Tone, Verdict
from knowarm.report.claims import FEWEST_SEEDS, OUTCOMES, Claim, Outcome, count, subject
from knowarm.report.study import Task

NO_KNOWLEDGE = ("wide", "zeros")
"""Controls of the network's size: nothing is told, the parameters are the same."""

NO_MEANING = ("random", "shuffled", "onehot")
"""Controls of the content: something is told, it is not what the graph says."""

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
    """What one task's comparisons say about one outcome.

    Attributes:
        kind: the finding, for programs.
        sentence: the finding, for people.
        reasons: the comparisons it follows from.
    """

    kind: Kind
    sentence: str
    reasons: tuple[str, ...] = ()

    def verdict(self, shown_reasons: int = 99) -> Verdict:
        """The finding as a block of a page."""
        return Verdict(
            sentence=self.sentence,
            reasons=self.reasons,
            shown_reasons=shown_reasons,
            tone=TONES.get(self.kind, "open"),
        )


def finding(task: Task, decided: Sequence[Claim], outcome: Outcome = "success") -> Finding:
    """Whether the knowledge matters on one task.

    The chain of questions, each needing a real difference as `Claim.verdict` defines it:

    1. Is the agent better than the baseline? If not, no advantage is shown.
    2. Better than every network of its size that is told nothing (wide, zeros)? If not, the size
       may explain it.
    3. Better than every vector without meaning (random, shuffled, onehot)? If not, an input
       helps, and its meaning is not shown to.

    The later questions are not asked before the earlier ones are answered.

    Args:
        task: the task.
        decided: every claim of the report; those of other tasks and outcomes are passed over.
        outcome: what is asked for.
    """
    asked = subject(task)
    mine = [c for c in decided if c.task is task and c.outcome == outcome and c.first is asked]
    if asked is None or not mine:
        what = "no agent with knowledge" if asked is None else "only one agent"
        return Finding("nothing to compare", f"{task.title}: {what} among these runs.")
    reasons = tuple(claim.sentence() for claim in mine)
    against = {claim.second.agent: claim for claim in mine}
    if all(claim.verdict == "too few seeds" for claim in against.values()):
        fewest = min(claim.seeds for claim in against.values())
        seeds = f"from {count(fewest, 'training seed')} an agent" if fewest else "without results"
        return Finding(
            "too few seeds",
            f"{task.title}, {OUTCOMES[outcome]}: whether knowledge helps cannot be said {seeds}.",
            (
                f"At least {FEWEST_SEEDS} seeds of each agent are needed: two networks of one "
                "method that differ in their training seed alone can differ as much as two "
                "methods.",
                *reasons,
            ),
        )
    kind, words = _judge(asked.name, against)
    return Finding(kind, f"{task.title}, {OUTCOMES[outcome]}: {words}", reasons)


def _judge(name: str, against: dict[str, Claim]) -> tuple[Kind, str]:
    if "bm" not in against:
        return "no baseline", f"there is no baseline to judge {name} by."
    if against["bm"].verdict == "worse":
        return "worse", f"{name} did worse than the baseline."
    if against["bm"].verdict != "better":
        return "no advantage", f"no advantage of {name} over the baseline is shown."
    if not any(agent in against for agent in NO_KNOWLEDGE):
        return "size not excluded", (
            f"{name} did better than the baseline, but its network is larger too: without a "
            "control of equal size (wide, zeros) this is no evidence for knowledge."
        )
    if open_ones := _not_beaten(NO_KNOWLEDGE, against):
        return "size may explain it", (
            f"{name} did better than the baseline, but not clearly better than "
            f"{' and '.join(open_ones)}, which {'are' if len(open_ones) > 1 else 'is'} told "
            "nothing: the size of the network may explain the advantage."
        )
    if not any(agent in against for agent in NO_MEANING):
        return "meaning not tested", (
            f"{name} did better than networks of equal size without knowledge; whether its meaning "
            "matters takes random, shuffled or onehot beside it."
        )
    if open_ones := _not_beaten(NO_MEANING, against):
        return "input without meaning", (
            f"an input vector helps, but its meaning is not shown to matter: {name} was not "
            f"clearly better than {' and '.join(open_ones)}."
        )
    return "knowledge matters", (
        f"the knowledge matters: {name} did better than the baseline, than networks of equal size, "
        "and than vectors without meaning."
    )


def _not_beaten(agents: Sequence[str], against: dict[str, Claim]) -> list[str]:
    return [a for a in agents if a in against and against[a].verdict != "better"]
