"""Page "Results": the evaluation after training, in total and by target."""

from collections.abc import Iterable

from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Figure,
    column_of,
    estimate_column,
    row_of,
    table_of,
)
from knowarm.report.charts import SUCCESS_AXIS
from knowarm.report.diagrams import dot_panels
from knowarm.report.format import facet, integer
from knowarm.report.model import HELD_OUT, Evaluated, Evaluation, TaskData
from knowarm.world.agents import BLIND_AGENTS
from knowarm.world.tasks import report_tables
from knowarm.world.tasks.probe import ReportTable

MOST_PANELS = 30  # drawings of a figure, above which only its table is shown
COLUMNS = (
    column_of("return_mean"),
    column_of("return_std", interval=False),
    column_of("success"),
    column_of("accuracy"),
    column_of("success_wide"),
    column_of("length_mean"),
    column_of("length_std", interval=False),
    column_of("failure_distance_mean", interval=False),
    column_of("failure_distance_std", interval=False),
    column_of("failure_distance_max", interval=False),
)
NOTE = (
    "95 % intervals: over five or more training seeds (bootstrap of the mean); of two to four "
    "the values of each are shown, and charts and CSV have Student's t, no narrower than the "
    "intervals over episodes; over episodes where there is one seed (Wilson for success and "
    "accuracy), which then describe that one network. Failure distance: final distance of "
    "unsuccessful episodes. Standard deviations are within an evaluation, averaged over seeds."
)
VISION_NOTE = (
    "Success of blind agents on the first {count} of the same episodes; {agents}. Depends on "
    "vision: the agent's success minus that of the better agent that sees nothing. 95 % "
    "intervals: over training seeds where there are several, otherwise over episodes "
    "(Newcombe). A better fixed list may exist than the one that the search found."
)
PARTS_CAPTION = "Dot: mean over training seeds; line: 95 % interval."


def result_blocks(task: TaskData) -> list[Block]:
    """Show all agents and the untrained policies on the same fixed episodes."""
    if not task.label:
        return []
    blocks = [
        _table(task),
        _vision(task),
        *(_brought(task, table) for table in report_tables()),
        _parts(task, "target", "target"),
        _parts(task, "facet", "target and colour"),
    ]
    return [block for block in blocks if block]


def _table(task: TaskData) -> DataTable:
    measures = [column.key for column in COLUMNS]
    rows = [row_of(agent, *measures) for agent in task.agents]
    title = conditions(first_evaluation(task.agents))
    columns = ("agent", "seeds", *COLUMNS)
    return table_of(task, "evaluation", title, columns, rows, NOTE)


def _vision(task: TaskData) -> DataTable | None:
    """Show the blind agents beside every agent, and how much of its success depends on vision."""
    groups = [group for group in task.groups if group.level("vision_gain")]
    if not groups:
        return None
    columns: list[str | Column] = ["agent", "seeds", "success"]
    differences = [
        estimate_column("vision_gain", "depends on vision [points]", "points")
    ]
    abouts = []
    for name, entry in BLIND_AGENTS.items():
        columns.append(estimate_column(name, name, hint=entry.about))
        abouts.append(f"{name}: {entry.about}")
        if not entry.sees_nothing:
            label = f"success minus {name} [points]"
            differences.append(estimate_column(f"minus {name}", label, "points"))
    rows = []
    most = 0.0
    for group in groups:
        row = row_of(group, "success", "vision_gain")
        for name in BLIND_AGENTS:
            row[name] = group.level("success", "blind", name)
            row[f"minus {name}"] = group.level("difference", "blind", name)
            played = group.level("episodes", "blind", name)
            if played:
                most = max(most, played.estimate)
        rows.append(row)
    columns += differences
    note = VISION_NOTE.format(count=integer(most), agents="; ".join(abouts))
    title = "How much of the success depends on vision"
    return table_of(task, "vision", title, columns, rows, note)


def _brought(task: TaskData, table: ReportTable) -> DataTable | None:
    """Show a table that a part of a task brings, by agent and conditions of the episodes."""
    rows = []
    for group in task.groups:
        for (label, _), agents in task.evaluation_sets.items():
            agent = agents.get(group)
            if not agent or not agent.level(table.measures[0]):
                continue
            row = row_of(agent, "success", *table.measures)
            row["rules"] = conditions(agent.evaluations[0])
            if label.endswith(HELD_OUT):
                row["rules"] += " (held out)"
            rows.append(row)
    if not rows:
        return None
    rules = Column("rules", "episodes")
    columns = ("agent", "seeds", rules, "success", *table.measures)
    return table_of(task, table.name, table.title, columns, rows, table.note)


def first_evaluation(agents: Iterable[Evaluated]) -> Evaluation | None:
    """Return the first evaluation of several agents; None if there is none."""
    for agent in agents:
        if agent.evaluations:
            return agent.evaluations[0]
    return None


def conditions(evaluation: Evaluation | None) -> str:
    """Describe the episodes, thresholds and actions of an evaluation."""
    if evaluation is None:
        return "Evaluation"
    config = evaluation.summary.config
    return (
        f"{integer(evaluation.summary['episodes'])} episodes, success within "
        f"{config.distance_m * 100:g} cm and {config.angle_deg:g}°, {config.actions} actions"
    )


def _parts(task: TaskData, part: str, title: str) -> Block | None:
    """Show the success by the values of a column of the episodes."""
    names: set[str] = set()
    for group in task.groups:
        for evaluation in group.evaluations:
            names |= evaluation.summary.groups.get(part, {}).keys()
    if part == "facet" and len({name.split("/")[0] for name in names}) == len(names):
        return None  # one colour per target: the same as per target
    rows = []
    for name in sorted(names):
        for group in task.groups:
            success = group.level("success", part, name)
            if success:
                row = row_of(group) | {"part": name, "success": success}
                rows.append(row | {"_panel": facet(name)})
    if not rows:
        return None
    columns = (Column("part", title), "agent", "success")
    table = table_of(task, f"per-{part}", f"Success by {title}", columns, rows)
    if len(names) > MOST_PANELS:
        return table
    return Figure(
        table, PARTS_CAPTION, dot_panels(table, "success", SUCCESS_AXIS, width=340)
    )
