"""Study and claims go in; the page that says what was found comes out."""

from collections.abc import Callable
from dataclasses import dataclass

from knowarm.report import format
from knowarm.report.blocks import (
    Block,
    Column,
    Figure,
    Page,
    Panel,
    Row,
    Table,
    Tile,
    Tiles,
    Tone,
    Verdict,
)
from knowarm.report.claims import Claim, count
from knowarm.report.figures import Dot, dot_chart
from knowarm.report.levels import cells, level, own_level
from knowarm.report.palette import colours
from knowarm.report.study import Study, Task
from knowarm.report.verdict import finding
from knowarm.statistics import Interval

Measure = tuple[str, str, Callable[[float], str], tuple[float, float] | None]

MEASURES: tuple[Measure, ...] = (
    ("success", "success", lambda value: format.percent(value, 0), (0.0, 1.0)),
    ("return_mean", "mean return", format.decimals(0), None),
)
"""Number of the summary, its name, its format and the ends of its axis."""

NAMES = 124
"""Room for the agents' names [px]."""


def summary_page(study: Study, decided: list[Claim]) -> Page:
    """What the runs show, in sentences made from their numbers, then the numbers."""
    blocks: list[Block] = []
    for task in study.tasks:
        blocks.append(finding(task, decided).verdict(shown_reasons=1))
        learned = learning_verdict(task)
        if learned:
            blocks.append(learned)
    if len(study.tasks) == 1:
        blocks.append(_tiles(study.tasks[0]))
    if any(task.label for task in study.tasks):
        blocks.append(_results(study))
    if study.problems:
        blocks.append(
            Verdict(
                tone="bad",
                sentence=f"{count(len(study.problems), 'thing')} about the run folders "
                "should be known before these numbers are used.",
                reasons=["Each is named, with what was done about it, under Runs."],
            )
        )
    runs = len(study.runs)
    return Page(
        name="summary",
        short="Summary",
        title="Summary",
        lead=f"{count(runs, 'training run')}, {count(len(study.tasks), 'task')}. "
        "Every sentence on this page is generated from the intervals beside it.",
        blocks=blocks,
    )


def learning_verdict(task: Task) -> Verdict | None:
    """Whether the trained networks do better than a policy that was never trained."""
    floors = [
        own_level(each.judged.summary, "return_mean")
        for each in task.references
        if each.name.startswith("untrained")
    ]
    # The best of several untrained policies is the one to beat.
    floor = max((each for each in floors if each), key=lambda each: each.high, default=None)
    groups = [(group, level(group, "return_mean")) for group in task.groups]
    known = [(group, value) for group, value in groups if value is not None]
    if floor is None or not known:
        return None
    better = [group.name for group, value in known if value.low > floor.high]
    others = [group.name for group, value in known if value.low <= floor.high]
    shown = "; ".join(f"{group.name} {_shown(value)}" for group, value in known)
    if better and not others:
        sentence = (
            f"{task.title}: training worked, {_listed(better)} scored above the untrained policy."
        )
    elif better:
        sentence = f"{_listed(better)} scored above the untrained policy, {_listed(others)} not."
    else:
        sentence = "No trained agent scored clearly above the untrained policy."
    reasons = [
        f"Mean return on the same episodes, 95 % intervals: {shown}; untrained {_shown(floor)}."
    ]
    tone: Tone = "good" if not others else "open" if better else "bad"
    return Verdict(sentence=sentence, reasons=reasons, tone=tone)


def _tiles(task: Task) -> Tiles:
    tiles = []
    chosen = colours(group.name for group in task.groups)
    for group in task.groups:
        success = level(group, "success")
        if success is None:
            continue
        interval = f"{format.percent(success.low)} to {format.percent(success.high)}"
        over = "over episodes" if len(group.judged_runs) == 1 else "over seeds"
        tiles.append(
            Tile(
                label=group.name,
                value=format.percent(success.estimate),
                detail=f"success; 95 % {interval} {over}, "
                f"{count(len(group.judged_runs), 'training seed')}",
                colour=chosen[group.name],
            )
        )
    return Tiles(tiles=tiles)


@dataclass(frozen=True)
class _Line:
    """An agent, or a reference, as the figure draws it."""

    name: str
    colour: str
    seeds: int | None
    values: dict[str, Interval | None]
    single: dict[str, list[float]]

    def dot(self, key: str) -> Dot:
        """The row of one measure's drawing."""
        value = self.values[key]
        return Dot(
            name=self.name,
            colour=self.colour,
            value=value.estimate if value else None,
            low=value.low if value else None,
            high=value.high if value else None,
            single=self.single.get(key, []),
        )


def _results(study: Study) -> Figure:
    rows: list[Row] = []
    panels: list[Panel] = []
    alone = len(study.tasks) == 1
    for task in study.tasks:
        lines = _lines(task)
        for line in lines:
            row: Row = {"task": task.title, "agent": line.name, "seeds": line.seeds}
            for key in ("success", "accuracy", "return_mean"):
                row |= cells(key, line.values[key])
            rows.append(row | {"_colour": line.colour})
        for key, name, shown, ends in MEASURES if alone else MEASURES[:1]:
            svg = dot_chart(
                [line.dot(key) for line in lines],
                f"{name} of each agent on {task.title}",
                x_title=name,
                x_format=shown,
                x_range=ends,
                left=NAMES,
            )
            panels.append(Panel(svg=svg, title=name if alone else task.title))
    return Figure(
        title="After training",
        caption="Dot: mean over training seeds. Line: its 95 % interval, over seeds where there "
        "are several, over episodes where there is one. Small dots: single seeds.",
        panels=panels,
        table=Table(
            name="summary",
            title="Success, accuracy and return after training",
            columns=[
                Column(key="task", label="task"),
                Column(key="agent", label="agent"),
                Column(key="seeds", label="seeds", format="integer"),
                Column(key="success", label="success", format="percent", interval=True),
                Column(key="accuracy", label="accuracy", format="percent", interval=True),
                Column(key="return_mean", label="mean return", format="number1", interval=True),
            ],
            rows=rows,
            sources=[run.path for run in study.runs],
            note="success: distance and angle within the thresholds at once; accuracy: the "
            "paper's, final distance alone.",
        ),
    )


def _lines(task: Task) -> list[_Line]:
    chosen = colours(group.name for group in task.groups)
    keys = ("success", "accuracy", "return_mean")
    lines = []
    for group in task.groups:
        count_of_seeds = len(group.judged_runs)
        single = {key: group.scores(key).tolist() for key in keys} if count_of_seeds > 1 else {}
        values = {key: level(group, key) for key in keys}
        lines.append(_Line(group.name, chosen[group.name], count_of_seeds, values, single))
    for each in task.references:
        values = {key: own_level(each.judged.summary, key) for key in keys}
        lines.append(_Line(each.name, "c-faint", None, values, {}))
    return lines


def _shown(value: Interval) -> str:
    ends = f"{format.number(value.low, 1)} to {format.number(value.high, 1)}"
    return f"{format.number(value.estimate, 1)} ({ends})"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
