"""Choice of the wanted object: its numbers per split, and whether the query was understood."""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.knowledge.queries import AND, Query
from knowarm.knowledge.query_splits import SPLITS
from knowarm.report import format
from knowarm.report.blocks import Tone, Verdict
from knowarm.report.claims import ALPHA, FEWEST_SEEDS, mismatch
from knowarm.report.collect import LATEST, UNTRAINED, rules
from knowarm.report.format import counted, listed
from knowarm.report.study import CONTROLS, Evaluated, Evaluation, Group, Study, Task
from knowarm.report.verdict import hint
from knowarm.statistics import Comparison, Interval, holm, paired, welch

Kind = Literal[
    "no control",
    "too few seeds",
    "not above chance",
    "not above the best control",
    "meaning not tested",
    "understood",
]

TONES: dict[Kind, Tone] = {"understood": "good", "no control": "note", "too few seeds": "note"}
"""Colours of the verdicts; the others are undecided."""

CHANCE = "chance"
"""Name of the choice at random among the objects of an episode."""


@dataclass(frozen=True, eq=False)
class Asked(Evaluated):
    """One agent on the questions of one split.

    Attributes:
        group: the agent.
        split: name of the split.
        evaluations: one per training seed, with the numbers of `choice_numbers`.
    """

    group: Group
    split: str
    evaluations: Sequence[Evaluation]

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the agent."""
        return self.group.name

    @property
    def chance(self) -> float:
        """Share of right choices of an agent that chooses at random."""
        return float(self.evaluations[0].summary["choice_chance"])


def asked_splits(task: Task) -> dict[str, list[Asked]]:
    """Return the agents of a task that chose between objects, by split.

    An evaluation without a split asks the questions of training, as S1 does. Of evaluations of
    one split with other episodes or thresholds the most common ones count.
    """
    found: dict[str, dict[str, list[tuple[Group, Evaluation]]]] = defaultdict(dict)
    for group in task.groups:
        for run in group.runs:
            for label, evaluation in sorted(run.evaluations.items()):
                summary = evaluation.summary
                if label.endswith((UNTRAINED, LATEST)) or "choice_chance" not in summary:
                    continue
                chosen = evaluation.config.get("split")
                split = chosen if chosen in SPLITS else next(iter(SPLITS))
                key = json.dumps([label, rules(evaluation)])
                found[split].setdefault(key, []).append((group, evaluation))
    splits = {}
    for split in filter(found.__contains__, SPLITS):
        members = max(found[split].values(), key=len)
        by_group: dict[str, list[Evaluation]] = defaultdict(list)
        for group, evaluation in members:
            by_group[group.name].append(replace(evaluation, summary=choice_numbers(evaluation)))
        groups = {group.name: group for group, _ in members}
        splits[split] = [Asked(groups[name], split, each) for name, each in by_group.items()]
    return splits


def choice_numbers(evaluation: Evaluation) -> dict[str, Any]:
    """Return the summary of an evaluation with its numbers corrected for chance.

    ``choice_corrected`` is 0 for a choice at random and 1 if every choice is right.
    ``success_corrected`` does the same for success: 0 for an agent that reaches the objects it
    chooses equally often, but chooses at random. ``switched`` (split S5) is the share of the new
    answer among episodes that ended at the new or the old one. ``per_type`` holds choice and
    success by the relations that a query names, each over all episodes of the type.
    """
    summary = evaluation.summary
    groups: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for query, numbers in summary.get("per_query", {}).items():
        groups[query_type(query)].append(numbers)
    per_type = {}
    for kind in sorted(groups):
        weights = [float(each["episodes"]) for each in groups[kind]]
        per_type[kind] = {"episodes": sum(weights)} | {
            key: float(np.average([each[key] for each in groups[kind]], weights=weights))
            for key in ("choice", "success")
        }
    return {**summary, **_corrected(summary), "per_type": per_type}


def _corrected(summary: Mapping[str, Any]) -> dict[str, float | None]:
    """The flat numbers of `choice_numbers`."""
    chance, choice = float(summary["choice_chance"]), float(summary["choice"])
    values: dict[str, float | None] = {
        f"choice_corrected{end}": (float(summary[f"choice{end}"]) - chance) / (1 - chance)
        for end in ("", "_low", "_high")
        if f"choice{end}" in summary
    }
    guessed = chance * float(summary["success_if_chosen"])
    values["success_corrected"] = (float(summary["success"]) - guessed) / (1 - chance)
    if "chose_old_answer" in summary:
        either = choice + float(summary["chose_old_answer"])
        values["switched"] = choice / either if either else None
    return values


def query_type(text: str) -> str:
    """Return the relations of a query: "usedFor and hasColor"; a text that is none as it is."""
    try:
        return AND.join(condition.relation for condition in Query.parse(text).conditions)
    except UserError:
        return text


@dataclass(frozen=True, eq=False)
class Finding:
    """Whether one agent understood the questions of one split.

    Attributes:
        task: the task.
        subject: an agent that is told what the graph knows about the query.
        controls: the agents it is compared with, the best one first.
        against: Welch's comparisons of the right choices with each control, in their order, over
            training seeds; empty below two seeds of an agent.
        above_chance: comparison with choosing at random; None below two seeds.
        adjusted_p: of the least significant of these, by Holm over all findings of the report;
            None where nothing is tested.
    """

    task: Task
    subject: Asked
    controls: tuple[Asked, ...]
    against: tuple[Comparison, ...] = ()
    above_chance: Comparison | None = None
    adjusted_p: float | None = None

    @property
    def seeds(self) -> int:
        """Training seeds of the agent that has fewest."""
        return min(len(each.evaluations) for each in (self.subject, *self.controls))

    @property
    def testable(self) -> bool:
        """Whether there is a control, and every agent has enough seeds."""
        return bool(self.controls) and self.seeds >= FEWEST_SEEDS

    @property
    def p_value(self) -> float:
        """The largest p of all comparisons; 1 if one of them is not in the agent's favour."""
        found = [*self.against, *filter(None, [self.above_chance])]
        if not found or min(each.difference.estimate for each in found) <= 0:
            return 1.0
        return max(each.p_value for each in found)

    @property
    def kind(self) -> Kind:
        """The finding: an agent understood if it chose better than chance and every control."""
        if not self.controls:
            return "no control"
        if not self.testable or self.above_chance is None or self.adjusted_p is None:
            return "too few seeds"
        if not _is_above(self.above_chance):
            return "not above chance"
        if self.adjusted_p > ALPHA:
            return "not above the best control"
        if not any(each.group.role == "content_control" for each in self.controls):
            return "meaning not tested"
        return "understood"

    def verdict(self) -> Verdict:
        """Return the finding in words, with the intervals that it follows from."""
        name, split = self.subject.name, self.subject.split
        reasons = tuple(self._reasons())
        words = f"{split} ({SPLITS[split]}): {self._words(name)}"
        return Verdict(
            sentence=words, reasons=reasons, tone=TONES.get(self.kind, "open"), kind=self.kind
        )

    def _words(self, name: str) -> str:
        """Return the sentence; it names only agents that ran, except registered ones to run."""
        if self.kind == "no control":
            offered = hint("content_control", self.subject.group)
            return f"nothing to compare the choice of {name} with.{offered}"
        if self.kind == "too few seeds":
            return (
                f"whether {name} understood the query cannot be decided from "
                f"{counted(self.seeds, 'training seed')} per agent."
            )
        choice = self.subject.level("choice")
        assert choice is not None
        share = f"in {format.percent(choice.estimate)} of the episodes"
        chance = format.percent(self.subject.chance)
        if self.kind == "not above chance":
            return (
                f"{name} is not shown to understand the query: it chose the wanted object {share}, "
                f"not significantly more often than at random ({chance})."
            )
        best = f"{self.controls[0].name} ({_points(self.against[0].difference)})"
        names = [each.name for each in self.controls]
        if self.kind == "not above the best control":
            missed = [
                control.name
                for control, comparison in zip(self.controls, self.against, strict=True)
                if not _is_above(comparison)
            ]
            rest = [each for each in names if each not in missed]
            beaten = f" It was better than {listed(rest)}." if rest and missed else ""
            return (
                f"{name} is not shown to understand the query: it chose the wanted object {share}, "
                f"not significantly more often than {listed(missed, 'or') or names[0]}; the best "
                f"control is {best}.{beaten}"
            )
        better = (
            f"it chose the wanted object {share} (at random: {chance}), more often than the best "
            f"control {best}"
        )
        better += f" and than {listed(names[1:])}" if names[1:] else ""
        if self.kind == "meaning not tested":
            offered = hint("content_control", self.subject.group)
            return (
                f"{name} uses the query: {better}; whether by its meaning was not tested.{offered}"
            )
        return f"{name} understood the query: {better}."

    def _reasons(self) -> list[str]:
        if not self.against:
            return []
        p = "" if self.adjusted_p is None else f" Adjusted p {format.p_value(self.adjusted_p)}."
        return [
            f"{self.subject.name} against {control.name}: {_points(comparison.difference)}; "
            f"{comparison.first_count} and {comparison.second_count} seeds."
            for control, comparison in zip(self.controls, self.against, strict=True)
        ] + [
            f"{self.subject.name} against {CHANCE}: {_points(each.difference)}.{p}"
            for each in [self.above_chance]
            if each is not None
        ]


def choice_findings(study: Study) -> list[Finding]:
    """Decide for every split and every agent that is told the query whether it understood.

    Compared is the share of right choices, over training seeds. An agent understood the questions
    of a split if it is better than chance and than every control that ran. Each finding requires
    all its comparisons (an intersection-union test), so only the findings are corrected for their
    number, by Holm over all tasks, agents and splits.
    """
    found = [
        _compared(task, subject, asked)
        for task in study.tasks
        for asked in asked_splits(task).values()
        for subject in asked
        if subject.group.role == "knowledge" and subject.group.scope != "scene"
    ]
    tested = [finding for finding in found if finding.testable]
    adjusted = holm([finding.p_value for finding in tested])
    values = {id(each): float(p) for each, p in zip(tested, adjusted, strict=True)}
    return [replace(each, adjusted_p=values.get(id(each))) for each in found]


def _compared(task: Task, subject: Asked, asked: Sequence[Asked]) -> Finding:
    controls = [each for each in asked if _is_control(each.group, subject.group)]
    controls.sort(key=lambda each: (-float(each.scores("choice").mean()), each.name))
    finding = Finding(task, subject, tuple(controls))
    if not controls or finding.seeds < 2:
        return finding
    own = subject.scores("choice")
    return replace(
        finding,
        against=tuple(welch(own, each.scores("choice")) for each in controls),
        above_chance=paired(own, np.full(len(own), subject.chance)),
    )


def _is_control(group: Group, subject: Group) -> bool:
    """Return whether a group is the baseline or a control of a subject, of its size.

    Of registered agents, the registry says which controls belong to a subject.
    """
    if group.role == "baseline":
        return True
    if group.role not in CONTROLS or mismatch(group, subject) is not None:
        return False
    registered = subject.agent in AGENTS and group.agent in AGENTS
    return not registered or group.agent in controls_of(subject.agent, AGENTS[group.agent].role)


def _is_above(comparison: Comparison) -> bool:
    return comparison.difference.low > 0


def _points(difference: Interval) -> str:
    return (
        f"{format.points(difference.estimate)} points, 95 % interval "
        f"{format.points(difference.low)} to {format.points(difference.high)}"
    )


def choice_summary(findings: Sequence[Finding]) -> list[Verdict]:
    """Return one sentence per task and agent: on which splits it understood the query."""
    by_agent: dict[tuple[str, str], dict[Kind, list[str]]] = defaultdict(lambda: defaultdict(list))
    for each in findings:
        by_agent[each.task.title, each.subject.name][each.kind].append(each.subject.split)
    verdicts = []
    for (title, name), kinds in by_agent.items():
        parts = [f"{kind} on {listed(splits)}" for kind, splits in kinds.items()]
        tone = TONES.get(next(iter(kinds)), "open") if len(kinds) == 1 else "open"
        verdicts.append(
            Verdict(
                sentence=f"{title}, the query as told to {name}: {'; '.join(parts)}.", tone=tone
            )
        )
    return verdicts
