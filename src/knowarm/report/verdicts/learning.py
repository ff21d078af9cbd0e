"""Findings on training: whether agents learned, and how much of their success depends on vision."""

from knowarm.report import format
from knowarm.report.blocks import Tone, Verdict
from knowarm.report.format import listed
from knowarm.report.model import Evaluated, Group, TaskData
from knowarm.statistics import Interval, share_difference

CLEAR = 0.05  # smallest difference in success that is called learning


def learned(task: TaskData, group: Group) -> bool | None:
    """Return whether an agent succeeds clearly more often than without training and vision.

    That is, than every untrained policy and than never, both by at least `CLEAR` and with an
    interval that excludes equality, and than the blind agents. None if it was not evaluated.
    """
    own = _success(group)
    if own is None:
        return None
    floors = [level for each in task.references if (level := _success(each))]
    for floor in floors or [Interval(0.0, 0.0, 0.0)]:
        difference = share_difference(own, floor)
        if difference.low <= 0 or difference.estimate < CLEAR:
            return False
    vision = group.level("vision_gain")
    return vision is None or vision.low > 0


def learning_verdict(task: TaskData) -> Verdict | None:
    """State which agents learned; None without an untrained policy to compare them with."""
    untrained = [each for each in task.references if each.level("success")]
    outcomes = {
        group: found for group in task.groups if (found := learned(task, group)) is not None
    }
    if not untrained or not outcomes:
        return None
    better = [group.name for group, found in outcomes.items() if found]
    others = [group.name for group, found in outcomes.items() if not found]
    blind = any(group.level("vision_gain") for group in outcomes)
    more = "succeeded clearly more often than an untrained policy"
    more += " and policies without vision" if blind else ""
    if better:
        rest = f"; {listed(others)} did not" if others else ""
        sentence = f"training succeeded: {listed(better)} {more}{rest}."
    else:
        sentence = f"training did not succeed: none of {listed(others)} {more}."
    tone: Tone = "good" if not others else "open" if better else "bad"
    shown = "; ".join(f"{each.name} {_shown(each)}" for each in (*outcomes, *untrained))
    reason = f"Success on the same episodes: {shown}."
    return Verdict(sentence=f"{task.title}: {sentence}", reasons=[reason], tone=tone)


def vision_verdict(task: TaskData) -> Verdict | None:
    """State how much of each agent's success depends on vision."""
    measured = [
        (group.name, vision, success)
        for group in task.groups
        if (vision := group.level("vision_gain")) and (success := group.level("success"))
    ]
    if not measured:
        return None
    seeing = [name for name, vision, _ in measured if vision.low > 0]
    others = [name for name, vision, _ in measured if vision.low <= 0]
    sentence = f"the success of {listed(seeing or others)} "
    sentence += "depends on vision" if seeing else "is not shown to depend on vision"
    sentence += f"; for {listed(others)} this is not shown." if seeing and others else "."
    reasons = []
    for name, vision, success in measured:
        total, blind = (
            format.percent(each) for each in (success.estimate, success.estimate - vision.estimate)
        )
        ends = format.ends(vision, format.points)
        reasons.append(
            f"{name}: success {total}; the better of a fixed list of actions and black images "
            f"reaches {blind} (difference {format.points(vision.estimate)} points, {ends})."
        )
    tone: Tone = "open" if others else "good"
    return Verdict(sentence=f"{task.title}: {sentence}", reasons=reasons, tone=tone)


def _success(each: Evaluated) -> Interval | None:
    """Return the success with its interval; that over episodes where all seeds are equal."""
    level = each.level("success")
    if level is None or level.low < level.high:
        return level
    return each.evaluations[0].summary.interval("success")


def _shown(each: Evaluated) -> str:
    level = each.level("success")
    form = format.percent
    return f"{form(level.estimate)} ({format.ends(level, form)})" if level else ""
