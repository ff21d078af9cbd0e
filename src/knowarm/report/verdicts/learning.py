"""Findings on training: whether agents learned, and how much of their success depends on vision."""

from collections.abc import Mapping, Sequence

from knowarm.report.blocks import Tone, Verdict
from knowarm.report.format import ends, listed, percent, points
from knowarm.report.model import Evaluated, Group, TaskData
from knowarm.statistics import Interval, share_difference

CLEAR = 0.05  # smallest difference in success that is called learning


def learned(task: TaskData, group: Group) -> bool | None:
    """Return whether an agent succeeds clearly more often than without training and vision.

    That is, than every untrained policy and than never, both by at least `CLEAR` and with an
    interval that excludes equality, and than the blind agents. None if it was not evaluated.
    """
    success = _success(group)
    if success is None:
        return None
    floors = filter(None, map(_success, task.references))
    for floor in list(floors) or [Interval(0.0, 0.0, 0.0)]:
        difference = share_difference(success, floor)
        if difference.low <= 0 or difference.estimate < CLEAR:
            return False
    vision = group.level("vision_gain")
    return vision is None or vision.low > 0


def learning_verdict(task: TaskData) -> Verdict | None:
    """State which agents learned; None without an untrained policy to compare them with."""
    untrained = [policy for policy in task.references if policy.level("success")]
    evaluated = {}
    for group in task.groups:
        has_learned = learned(task, group)
        if has_learned is not None:
            evaluated[group] = has_learned
    if not untrained or not evaluated:
        return None
    more = "succeeded clearly more often than an untrained policy"
    if any(group.level("vision_gain") for group in evaluated):
        more += " and policies without vision"
    successes = "; ".join(map(_named_success, (*evaluated, *untrained)))
    return _verdict(
        task,
        evaluated,
        f"training succeeded: {{}} {more}",
        "; {} did not",
        f"training did not succeed: none of {{}} {more}",
        [f"Success on the same episodes: {successes}."],
        none_tone="bad",
    )


def vision_verdict(task: TaskData) -> Verdict | None:
    """State how much of each agent's success depends on vision."""
    depends = {}
    reasons = []
    for group in task.groups:
        vision = group.level("vision_gain")
        success = group.level("success")
        if not vision or not success:
            continue
        depends[group] = vision.low > 0
        blind = percent(success.estimate - vision.estimate)
        gain = f"difference {points(vision.estimate)} points, {ends(vision, points)}"
        reasons.append(
            f"{group.name}: success {percent(success.estimate)}; the better of a fixed list of "
            f"actions and black images reaches {blind} ({gain})."
        )
    if not reasons:
        return None
    return _verdict(
        task,
        depends,
        "the success of {} depends on vision",
        "; for {} this is not shown",
        "the success of {} is not shown to depend on vision",
        reasons,
        none_tone="open",
    )


def _verdict(
    task: TaskData,
    held: Mapping[Group, bool],
    some: str,
    others: str,
    none: str,
    reasons: Sequence[str],
    none_tone: Tone,
) -> Verdict:
    """State for which agents something holds: some, which the ``others`` follow, or none."""
    positive = listed([group.name for group in held if held[group]])
    negative = listed([group.name for group in held if not held[group]])
    tone: Tone = "open"
    sentence = some.format(positive)
    if not positive:
        tone = none_tone
        sentence = none.format(negative)
    elif negative:
        sentence += others.format(negative)
    else:
        tone = "good"
    return Verdict(f"{task.title}: {sentence}.", reasons, tone=tone)


def _success(agent: Evaluated) -> Interval | None:
    """Return the success with its interval; that over episodes where all seeds are equal."""
    level = agent.level("success")
    if level is None or level.low < level.high:
        return level
    return agent.evaluations[0].summary.interval("success")


def _named_success(agent: Evaluated) -> str:
    level = agent.level("success")
    if not level:
        return f"{agent.name} "
    return f"{agent.name} {percent(level.estimate)} ({ends(level, percent)})"
