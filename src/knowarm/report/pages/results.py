"""Page "Results": the evaluation after training, in total and by target."""

from collections.abc import Callable, Iterable, Sequence

from knowarm.report import format
from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Figure,
    Panel,
    Row,
    column_of,
    files,
    row_of,
    shared,
    table_of,
)
from knowarm.report.charts import SUCCESS_AXIS, Axis
from knowarm.report.collect import HELD_OUT, evaluation_sets
from knowarm.report.diagrams import Dot, dot_chart
from knowarm.report.model import Evaluated, Evaluation, Group, TaskData
from knowarm.statistics import Interval
from knowarm.world.agents import BLIND_AGENTS
from knowarm.world.tasks import report_tables
from knowarm.world.tasks.probe import ReportTable

MOST_PANELS = 30  # drawings of a figure, above which only its table is shown
INTERVALS = ("return_mean", "success", "accuracy", "success_wide", "length_mean")
FAILURES = tuple(f"failure_distance_{each}" for each in ("mean", "std", "max"))
PLAIN = [column_of(name, interval=False) for name in ("return_std", "length_std", *FAILURES)]


def result_blocks(task: TaskData) -> list[Block]:
    """Show all agents and the untrained policies on the same fixed episodes."""
    if not task.label:
        return []
    parts = (("target", "target"), ("facet", "target and colour"))
    figures = [_parts(task, part, what) for part, what in parts]
    brought = [_brought(task, table) for table in report_tables()]
    return [block for block in (_table(task), _vision(task), *brought, *figures) if block]


def _table(task: TaskData) -> DataTable:
    lines = (*task.groups, *task.references)
    keys = (*INTERVALS, *(column.key for column in PLAIN))
    rows = [row_of(task, each, *keys) for each in lines]
    first = next((evaluation for each in lines for evaluation in each.evaluations), None)
    columns = [
        *shared("agent", "seeds", "return_mean", PLAIN[0], "success", "accuracy", "success_wide"),
        *shared("length_mean", *PLAIN[1:]),
    ]
    note = (
        "95 % intervals: over five or more training seeds (bootstrap of the mean); of two to four "
        "the values of each are shown, and charts and CSV have Student's t, no narrower than the "
        "intervals over episodes; over episodes where there is one seed (Wilson for success and "
        "accuracy), which then describe that one network. Failure distance: final distance of "
        "unsuccessful episodes. Standard deviations are within an evaluation, averaged over seeds."
    )
    return table_of(task, "evaluation", conditions(first), columns, rows, files(lines), note)


def _vision(task: TaskData) -> DataTable | None:
    """Show the blind agents beside every agent, and how much of its success depends on vision."""
    rows: list[Row] = []
    groups = [group for group in task.groups if group.level("vision_gain")]
    minus = [name for name, entry in BLIND_AGENTS.items() if not entry.sees_nothing]
    for group in groups:
        row = row_of(task, group, "success", "vision_gain")
        row |= {name: group.level("success", "blind", name) for name in BLIND_AGENTS}
        row |= {f"minus {name}": group.level("difference", "blind", name) for name in minus}
        rows.append(row)
    if not rows:
        return None
    played = [
        blind.estimate
        for group in groups
        for name in BLIND_AGENTS
        if (blind := group.level("episodes", "blind", name))
    ]
    abouts = "; ".join(f"{name}: {entry.about}" for name, entry in BLIND_AGENTS.items())
    columns = shared("agent", "seeds", "success")
    for name, entry in BLIND_AGENTS.items():
        columns.append(Column(name, name, "percent", interval=True, hint=entry.about))
    differences = {"vision_gain": "depends on vision"}
    differences |= {f"minus {name}": f"success minus {name}" for name in minus}
    for key, words in differences.items():
        columns.append(Column(key, f"{words} [points]", "points", interval=True))
    count = format.integer(max(played, default=0))
    note = (
        f"Success of blind agents on the first {count} of the same episodes; {abouts}. Depends on "
        "vision: the agent's success minus that of the better agent that sees nothing. 95 % "
        "intervals: over training seeds where there are several, otherwise over episodes "
        "(Newcombe). A better fixed list may exist than the one that the search found."
    )
    title = "How much of the success depends on vision"
    return table_of(task, "vision", title, columns, rows, files(groups), note)


def _brought(task: TaskData, table: ReportTable) -> DataTable | None:
    """Show a table that a part of a task brings, by agent and conditions of the episodes."""
    shares = ["success", *table.measures]
    tested = [
        (label, Evaluated(group.name, each[group]))
        for group in task.groups
        for (label, _), each in evaluation_sets(task).items()
        if group in each and table.measures[0] in each[group][0].summary
    ]
    if not tested:
        return None
    rows: list[Row] = [
        row_of(task, each, *shares)
        | {"rules": conditions(each.evaluations[0]) + " (held out)" * label.endswith(HELD_OUT)}
        for label, each in tested
    ]
    columns = shared("agent", "seeds", Column("rules", "episodes"), *shares)
    sources = files(each for _, each in tested)
    return table_of(task, table.name, table.title, columns, rows, sources, table.note)


def conditions(evaluation: Evaluation | None) -> str:
    """Describe the episodes, thresholds and actions of an evaluation."""
    if evaluation is None:
        return "Evaluation"
    config = evaluation.summary.config
    return (
        f"{format.integer(evaluation.summary['episodes'])} episodes, success within "
        f"{config.distance_m * 100:g} cm and {config.angle_deg:g}°, {config.actions} actions"
    )


def _parts(task: TaskData, part: str, what: str) -> Block | None:
    evaluations = [evaluation for group in task.groups for evaluation in group.evaluations]
    names = sorted({name for each in evaluations for name in each.summary.groups.get(part, {})})
    if part == "facet" and len({name.split("/")[0] for name in names}) == len(names):
        return None  # one colour per target: the same as per target
    rows, panels = part_panels(
        task, names, task.groups, lambda g, name: g.level("success", part, name), SUCCESS_AXIS
    )
    if not panels:
        return None
    columns: list[str | Column] = [Column("part", what), "agent", "success"]
    sources, name = [evaluation.folder for evaluation in evaluations], f"per-{part}"
    table = table_of(task, name, f"Success by {what}", columns, rows, sources)
    if len(panels) > MOST_PANELS:
        return table
    caption = "Dot: mean over training seeds; line: 95 % interval."
    return Figure(table=table, caption=caption, panels=panels)


def part_panels(
    task: TaskData,
    names: Iterable[str],
    groups: Sequence[Group],
    value: Callable[[Group, str], Interval | None],
    axis: Axis,
) -> tuple[list[Row], list[Panel]]:
    """Draw one dot chart per target or facet, one row per agent that has a value.

    Returns the rows of the table, with the estimate in the column "success", and the drawings.
    """
    rows: list[Row] = []
    panels = []
    for name in names:
        dots = []
        for group in groups:
            level, colour = value(group, name), task.colours[group.name]
            if level is not None:
                row = {"part": name, "agent": group.name, "success": level, "_colour": colour}
                rows.append(row)
                dots.append(Dot(name=group.name, colour=colour, value=level))
        if dots:
            title = format.facet(name)
            svg = dot_chart(dots, f"{axis.title} on {title}", axis, width=340, left=100)
            panels.append(Panel(svg=svg, title=title))
    return rows, panels
