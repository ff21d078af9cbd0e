"""Findings on queries: whether an agent of the choose task understood what the query means."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.knowledge.queries.splits import SPLITS, TOPICS, topic_of
from knowarm.report.format import ends, listed, p_value, percent, points
from knowarm.report.model import CONTROLS, Group, StudyData, TaskData
from knowarm.report.verdicts.claims import (
    ALPHA,
    KINDS,
    Claim,
    Claims,
    Finding,
    claim_of,
    few_seeds,
    hint,
    mismatch,
)
from knowarm.statistics import (
    CrossedScores,
    Interval,
    crossed_difference,
    holm,
    paired,
)


def query_findings(study: StudyData) -> list[Finding]:
    """Decide for every split whether the agents that receive the query understood it.

    They did if their share of right choices, over training seeds, is above chance and every
    control that ran; of other questions than those drawn only if it is so over these, too. Each
    finding requires all its comparisons (an intersection-union test), so only the findings are
    corrected for their number, by Holm over all tasks, agents and splits.
    """
    subjects = []
    for task in study.tasks:
        for agents in task.splits.values():
            for agent in agents:
                if agent.role == "knowledge" and agent.scope != "scene":
                    compared = _claims(task, agent, agents)
                    subjects.append((agent, compared, _p_value(compared)))
    adjusted = holm([p for *_, p in subjects if p is not None]).tolist()
    findings = []
    for agent, compared, p in subjects:
        adjusted_p = None if p is None else adjusted.pop(0)
        findings.append(_finding(agent, compared, adjusted_p))
    return findings


def _claims(task: TaskData, subject: Group, agents: Sequence[Group]) -> list[Claim]:
    """Compare an agent with chance, then with its controls, the best one first."""
    split = subject.split
    right = subject.scores("choice")
    chance = np.full(len(right), subject.chance)
    above_chance = claim_of(
        task=task,
        first=subject,
        second=None,
        outcome=split,
        stage="query",
        values=right,
        others=chance,
        test=paired,
    )
    claims = [above_chance]
    controls = [agent for agent in agents if _is_control(agent, subject)]
    controls.sort(key=lambda control: (-control.scores("choice").mean(), control.name))
    for control in controls:
        claim = claim_of(
            task=task,
            first=subject,
            second=control,
            outcome=split,
            stage="query",
            values=right,
            others=control.scores("choice"),
        )
        claims.append(claim)
    return claims


def _is_control(group: Group, subject: Group) -> bool:
    """Return whether a group is the baseline or a control of a subject, of its size."""
    if group.role == "baseline":
        return True
    if group.role not in CONTROLS or mismatch(group, subject) is not None:
        return False
    if subject.agent not in AGENTS or group.agent not in AGENTS:
        return True
    return group.agent in controls_of(subject.agent, AGENTS[group.agent].role)


def _p_value(claims: Claims) -> float | None:
    """Return the largest p of all comparisons; 1 if one of them is not in the agent's favour.

    None if there is no control, or too few seeds for one of the comparisons.
    """
    compared = [claim.tested for claim in claims if claim.tested]
    if len(claims) == 1 or len(compared) < len(claims):
        return None
    if min(comparison.difference.estimate for comparison in compared) <= 0:
        return 1.0
    return max(comparison.p_value for comparison in compared)


def _finding(subject: Group, claims: list[Claim], adjusted_p: float | None) -> Finding:
    chance, *controls = claims
    kind = _judge(chance, controls, adjusted_p)
    notes = []
    if adjusted_p is not None:
        notes.append(f"Adjusted p of all comparisons: {p_value(adjusted_p)}.")
    topics = TOPICS.get(subject.split, "")
    if kind == "understood" and topics:
        beyond = _least_beyond(subject, controls)
        if beyond is None:
            notes.append(f"Of other {topics} nothing is known: episodes are missing.")
        else:
            notes.append(beyond.sentence(topics))
            kind = "understood" if beyond.is_shown else "understood of these"
    beaten = [control.against for control in controls if control.is_above]
    missed = [control.against for control in controls if not control.is_above]
    best, *others = [control.against for control in controls] or [""]
    if controls and controls[0].comparison:
        gap = controls[0].comparison.difference
        best += f" ({points(gap.estimate)} points, {ends(gap, points)})"
    share = percent(float(subject.scores("choice").mean()))
    words = KINDS[kind]["query"].format(
        name=subject.name,
        content_hint=hint("content_control", subject),
        few_seeds=few_seeds(min(claim.seeds for claim in claims)),
        chose=f"it chose the wanted object in {share} of the episodes",
        at_random=percent(subject.chance),
        best=best,
        controls=f"{best} and than {listed(others)}" if others else best,
        not_beaten=listed(missed, "or") or "every control after the correction",
        also=f" It was better than {listed(beaten)}." if beaten and missed else "",
        topics=topics,
    )
    sentence = f"{subject.split} ({SPLITS[subject.split]}): {words}"
    reasons = [*controls, chance] if controls and chance.comparison else []
    return Finding(
        task=chance.task,
        subject=subject,
        outcome=subject.split,
        kind=kind,
        sentence=sentence,
        claims=reasons,
        notes=notes,
    )


class Beyond(NamedTuple):
    """By how much an agent is above a control, over training seeds and topics of the episodes."""

    difference: Interval
    control: str
    topics: int

    @property
    def is_shown(self) -> bool:
        """Whether it is above the control of other topics than those that were drawn, too."""
        return self.topics > 1 and self.difference.low > 0

    def sentence(self, topics: str) -> str:
        """Return it in words."""
        gap = self.difference
        return (
            f"Over training seeds and the {topics} that were drawn ({self.topics}): "
            f"{points(gap.estimate)} points above {self.control} ({ends(gap, points)}), the "
            "control that is least surely beaten."
        )


def _least_beyond(subject: Group, controls: Claims) -> Beyond | None:
    """Return by how much an agent is above the control that it beats least surely.

    None where an evaluation lacks its episodes, or they are damaged.
    """
    found = []
    try:
        right = _right_choices(subject)
        for control in controls:
            assert control.second
            gap = crossed_difference(right, _right_choices(control.second))
            found.append(Beyond(gap, control.against, np.unique(right.topics).size))
    except (ValueError, KeyError):  # missing or damaged
        return None
    return min(found, key=lambda beyond: beyond.difference.low)


def _right_choices(group: Group) -> CrossedScores:
    """Return whether each episode's choice is right, by training run and topic."""
    right: list[float] = []
    runs: list[int] = []
    topics: list[str] = []
    for run, evaluation in enumerate(group.evaluations):
        episodes = evaluation.episodes()
        right += episodes["choice_correct"].astype(float).tolist()
        for query, target in zip(episodes["query"], episodes["target"], strict=True):
            topics.append(topic_of(group.split, query, target))
            runs.append(run)
    return CrossedScores(np.array(right), runs, topics)


def _judge(chance: Claim, controls: Claims, adjusted_p: float | None) -> str:
    """Return the finding on an agent."""
    roles = {control.second.role for control in controls if control.second}
    if not roles:
        return "no control"
    if adjusted_p is None:
        return "too few seeds"
    if not chance.is_above:
        return "not above chance"
    if adjusted_p > ALPHA:
        return "not above the best control"
    return "understood" if "content_control" in roles else "meaning not tested"
