"""Findings on queries: whether an agent of the choose task understood what the query means."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.knowledge.queries.splits import SPLITS
from knowarm.report import format
from knowarm.report.blocks import Verdict
from knowarm.report.collect import split_groups
from knowarm.report.format import listed
from knowarm.report.model import CONTROLS, Group, SplitGroup, StudyData, TaskData
from knowarm.report.verdicts.claims import (
    ALPHA,
    TONES,
    Claim,
    Finding,
    Kind,
    compare,
    few_seeds,
    hint,
    mismatch,
)
from knowarm.statistics import holm, paired


def query_findings(study: StudyData) -> list[Finding]:
    """Decide for every split whether the agents that receive the query understood it.

    They did if their share of right choices, over training seeds, is above chance and every
    control that ran. Each finding requires all its comparisons (an intersection-union test), so
    only the findings are corrected for their number, by Holm over all tasks, agents and splits.
    """
    subjects = [
        (subject, _claims(task, subject, groups))
        for task in study.tasks
        for groups in split_groups(task).values()
        for subject in groups
        if subject.group.role == "knowledge" and subject.group.scope != "scene"
    ]
    tested = [claims for _, claims in subjects if all(c.testable for c in claims) and claims[1:]]
    adjusted = holm([_p_value(claims) for claims in tested])
    values = {id(claims): float(p) for claims, p in zip(tested, adjusted, strict=True)}
    return [_finding(subject, claims, values.get(id(claims))) for subject, claims in subjects]


def _claims(task: TaskData, subject: SplitGroup, groups: Sequence[SplitGroup]) -> list[Claim]:
    """Compare an agent with chance, then with its controls, the best one first."""
    controls = [each for each in groups if _is_control(each.group, subject.group)]
    controls.sort(key=lambda each: (-float(each.scores("choice").mean()), each.name))
    own = subject.scores("choice")
    chance = paired(own, np.full(len(own), subject.chance)) if len(own) > 1 else None
    claims = [Claim(task, subject.group, None, subject.split, "query", len(own), chance)]
    for control in controls:
        other = control.scores("choice")
        seeds, comparison = min(len(own), len(other)), compare(own, other)
        claims.append(
            Claim(task, subject.group, control.group, subject.split, "query", seeds, comparison)
        )
    return claims


def _is_control(group: Group, subject: Group) -> bool:
    """Return whether a group is the baseline or a control of a subject, of its size."""
    if group.role == "baseline":
        return True
    if group.role not in CONTROLS or mismatch(group, subject) is not None:
        return False
    registered = subject.agent in AGENTS and group.agent in AGENTS
    return not registered or group.agent in controls_of(subject.agent, AGENTS[group.agent].role)


def _p_value(claims: Sequence[Claim]) -> float:
    """Return the largest p of all comparisons; 1 if one of them is not in the agent's favour."""
    compared = [claim.comparison for claim in claims if claim.comparison]
    if min(each.difference.estimate for each in compared) <= 0:
        return 1.0
    return max(each.p_value for each in compared)


def _finding(subject: SplitGroup, claims: list[Claim], adjusted_p: float | None) -> Finding:
    kind, words = _judge(subject, claims, adjusted_p)
    sentence = f"{subject.split} ({SPLITS[subject.split]}): {words}"
    chance, *controls = claims
    shown = [*controls, chance] if controls and chance.comparison else []
    note = f"Adjusted p of all comparisons: {format.p_value(adjusted_p)}."
    notes = [] if adjusted_p is None else [note]
    return Finding(chance.task, subject.group, subject.split, kind, sentence, shown, notes)


def _judge(subject: SplitGroup, claims: list[Claim], adjusted_p: float | None) -> tuple[Kind, str]:
    """Return the finding on an agent and its sentence."""
    name, (above_chance, *controls) = subject.name, claims
    missing = hint("content_control", subject.group)
    if not controls:
        return "no control", f"nothing to compare the choice of {name} with.{missing}"
    if adjusted_p is None:
        seeds = few_seeds(min(claim.seeds for claim in claims))
        return "too few seeds", f"whether {name} understood the query {seeds}"
    share = float(subject.scores("choice").mean())
    chose = f"it chose the wanted object in {format.percent(share)} of the episodes"
    chance = format.percent(subject.chance)
    not_shown = f"{name} is not shown to understand the query: {chose}"
    if not above_chance.is_above:
        return "not above chance", (
            f"{not_shown}, not significantly more often than at random ({chance})."
        )
    names = [claim.against for claim in controls]
    best = names[0]
    if compared := controls[0].comparison:
        gap, form = compared.difference, format.points
        best += f" ({form(gap.estimate)} points, {format.ends(gap, form)})"
    if adjusted_p > ALPHA:
        missed = [claim.against for claim in controls if not claim.is_above]
        rest = [each for each in names if each not in missed]
        beaten = f" It was better than {listed(rest)}." if rest and missed else ""
        return "not above the best control", (
            f"{not_shown}, not significantly more often than "
            f"{listed(missed, 'or') or 'every control after the correction'}; "
            f"the best control is {best}.{beaten}"
        )
    better = f"{chose} (at random: {chance}), more often than the best control {best}"
    better += f" and than {listed(names[1:])}" if names[1:] else ""
    if not any(claim.second and claim.second.role == "content_control" for claim in controls):
        return "meaning not tested", (
            f"{name} uses the query: {better}; whether by its meaning was not tested.{missing}"
        )
    return "understood", f"{name} understood the query: {better}."


def query_summary(findings: Sequence[Finding]) -> list[Verdict]:
    """Return one sentence per task and agent: on which splits it understood the query."""
    by_agent: dict[tuple[str, str], dict[Kind, list[str]]] = defaultdict(lambda: defaultdict(list))
    for each in findings:
        name = each.subject.name if each.subject else ""
        by_agent[each.task.title, name][each.kind].append(each.outcome)
    verdicts = []
    for (title, name), kinds in by_agent.items():
        parts = [f"{kind} on {listed(splits)}" for kind, splits in kinds.items()]
        tone = TONES.get(next(iter(kinds)), "open") if len(kinds) == 1 else "open"
        sentence = f"{title}, the query received by {name}: {'; '.join(parts)}."
        verdicts.append(Verdict(sentence=sentence, tone=tone))
    return verdicts
