"""Page "Summary": verdicts in sentences, and success and return of every agent."""

from collections.abc import Sequence
from dataclasses import replace

from knowarm.report import format
from knowarm.report.blocks import (
    Block,
    Figure,
    Panel,
    Row,
    Table,
    Tile,
    Tiles,
    Tone,
    Verdict,
    cells,
    shared,
)
from knowarm.report.charts import RETURN_AXIS, SUCCESS_AXIS
from knowarm.report.choice import Finding, choice_summary
from knowarm.report.claims import Claim
from knowarm.report.diagrams import dot_chart, group_dot
from knowarm.report.format import counted, listed
from knowarm.report.study import Study, Task
from knowarm.report.verdict import findings
from knowarm.statistics import Interval

KEYS = ("success", "accuracy", "return_mean")
"""Numbers of the table."""

NAMES = 124
"""Space for the agents' names [px]."""


def summary_blocks(
    study: Study, decided: list[Claim], understood: Sequence[Finding]
) -> list[Block]:
    """State what the runs show, in sentences generated from their numbers, then the numbers."""
    blocks: list[Block] = []
    for task in study.tasks:
        blocks += [replace(each, shown_reasons=1) for each in findings(task, decided)]
        blocks += choice_summary([each for each in understood if each.task is task])
        learned = learning_verdict(task)
        if learned:
            blocks.append(learned)
        if eyes := eyes_verdict(task):
            blocks.append(eyes)
    if len(study.tasks) == 1:
        blocks.append(_tiles(study.tasks[0]))
    if any(task.label for task in study.tasks):
        blocks.append(_results(study))
    if study.problems:
        blocks.append(
            Verdict(
                tone="bad",
                sentence=f"The run folders have {counted(len(study.problems), 'defect')} to be "
                "aware of before these numbers are used.",
                reasons=["The page Runs lists each, and how it was handled."],
            )
        )
    return blocks


def learning_verdict(task: Task) -> Verdict | None:
    """State whether the trained networks score above a policy that was never trained."""
    found = [each.level("return_mean") for each in task.references if each.untrained]
    # Of several untrained policies the best one has to be beaten.
    floor = max((each for each in found if each), key=lambda each: each.high, default=None)
    groups = [(group.name, group.level("return_mean")) for group in task.groups]
    known = [(name, value) for name, value in groups if value is not None]
    if floor is None or not known:
        return None
    better = [name for name, value in known if value.low > floor.high]
    others = [name for name, value in known if value.low <= floor.high]
    if better and not others:
        sentence = f"training succeeded: {listed(better)} scored above the untrained policy."
    elif better:
        sentence = f"{listed(better)} scored above the untrained policy, {listed(others)} did not."
    else:
        sentence = "no trained agent scored clearly above the untrained policy."
    tone: Tone = "good" if not others else "open" if better else "bad"
    shown = "; ".join(f"{name} {_shown(value)}" for name, value in known)
    reason = (
        f"Mean return on the same episodes, 95 % intervals: {shown}; untrained {_shown(floor)}."
    )
    return Verdict(sentence=f"{task.title}: {sentence}", reasons=[reason], tone=tone)


def eyes_verdict(task: Task) -> Verdict | None:
    """State how much of each agent's success needs eyes."""
    found = [
        (group.name, group.level("needs_eyes"), group.level("success")) for group in task.groups
    ]
    known = [(name, eyes, success) for name, eyes, success in found if eyes and success]
    if not known:
        return None
    see = [name for name, eyes, _ in known if eyes.low > 0]
    blind = [name for name, eyes, _ in known if eyes.low <= 0]
    if not blind:
        sentence = f"a part of the success of {listed(see)} needs eyes."
    elif not see:
        sentence = f"the success of {listed(blind)} is not shown to need eyes."
    else:
        sentence = f"a part of the success of {listed(see)} needs eyes"
        sentence += f"; of that of {listed(blind)} this is not shown."
    reasons = [
        f"{name}: {_points(eyes.estimate)} points (95 % interval {_points(eyes.low)} to "
        f"{_points(eyes.high)}) of its success of {format.percent(success.estimate)} need eyes; "
        "a fixed list of actions or black images suffice for the rest."
        for name, eyes, success in known
    ]
    tone: Tone = "open" if blind else "good"
    return Verdict(sentence=f"{task.title}: {sentence}", reasons=reasons, tone=tone)


def _tiles(task: Task) -> Tiles:
    tiles = []
    for group in task.groups:
        success = group.level("success")
        if success is not None:
            seeds = len(group.evaluations)
            over = "episodes" if seeds == 1 else "seeds"
            interval = f"{format.percent(success.low)} to {format.percent(success.high)}"
            tiles.append(
                Tile(
                    label=group.name,
                    value=format.percent(success.estimate),
                    detail=f"success; 95 % {interval} over {over}, "
                    f"{counted(seeds, 'training seed')}",
                    colour=task.colours[group.name],
                )
            )
    return Tiles(tiles=tiles)


def _results(study: Study) -> Figure:
    rows: list[Row] = []
    panels: list[Panel] = []
    alone = len(study.tasks) == 1
    measures = {"success": SUCCESS_AXIS} | ({"return_mean": RETURN_AXIS} if alone else {})
    for task in study.tasks:
        lines = (*task.groups, *task.references)
        for each in lines:
            seeds = len(each.evaluations) if each in task.groups else None
            row: Row = {"task": task.title, "agent": each.name, "seeds": seeds}
            for key in KEYS:
                row |= cells(key, each.level(key))
            rows.append(row | {"_colour": task.colours[each.name]})
        for key, axis in measures.items():
            dots = [group_dot(each, key, task.colours) for each in lines]
            name = f"{axis.title} of each agent on {task.title}"
            title = axis.title if alone else task.title
            panels.append(Panel(svg=dot_chart(dots, name, axis, left=NAMES), title=title))
    return Figure(
        title="After training",
        caption="Dot: mean over training seeds. Line: 95 % interval, over seeds where there are "
        "several, over episodes where there is one. Small dots: single seeds.",
        panels=panels,
        table=Table(
            name="summary",
            title="Success, accuracy and return after training",
            columns=shared("task", "agent", "seeds", "success", "accuracy", "return_mean"),
            rows=rows,
            sources=[run.path for run in study.runs],
            note="Success: distance and angle within the thresholds at once. Accuracy: final "
            "distance within the threshold, as in the paper.",
        ),
    )


def _shown(value: Interval) -> str:
    ends = f"{format.number(value.low, 1)} to {format.number(value.high, 1)}"
    return f"{format.number(value.estimate, 1)} ({ends})"


def _points(value: float) -> str:
    return format.number(100 * value, 1)
