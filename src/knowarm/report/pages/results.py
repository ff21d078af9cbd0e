"""Page "Results": the evaluation after training, in total and by target."""

from collections.abc import Iterable

from knowarm.report.blocks import (
    Block,
    Column,
    DataTable,
    Figure,
    row_of,
    table_of,
)
from knowarm.report.charts import SUCCESS_AXIS
from knowarm.report.diagrams import dot_panels
from knowarm.report.format import facet, integer
from knowarm.report.model import (
    HELD_OUT,
    Evaluated,
    Evaluation,
    Group,
    TaskData,
)
from knowarm.world.agents import BLIND_AGENTS
from knowarm.world.tasks import report_tables
from knowarm.world.tasks.probe import ReportTable

MEASURES = (
    "return_mean",
    "return_std",
    "success",
    "accuracy",
    "success_wide",
    "length_mean",
    "length_std",
    "failure_distance_mean",
    "failure_distance_std",
    "failure_distance_max",
)
MOST_PANELS = 30  # drawings of a figure, above which only its table is shown


def result_blocks(task: TaskData) -> list[Block]:
    """Show all agents and the untrained policies on the same fixed episodes."""
    if not task.label:
        return list(filter(None, [_solved(task)]))
    blocks = [
        _table(task),
        _vision(task),
        _solved(task),
        *(_brought(task, table) for table in report_tables()),
        _parts(task, "target", "target"),
        _parts(task, "facet", "target and colour"),
    ]
    return [block for block in blocks if block]


def _table(task: TaskData) -> DataTable:
    rows = [row_of(agent, *MEASURES) for agent in task.agents]
    played = conditions(first_evaluation(task.agents))
    return table_of(task, "evaluation", rows, conditions=played)


def _vision(task: TaskData) -> DataTable | None:
    """Show the blind agents beside every agent, and how much of its success depends on vision."""
    groups = [group for group in task.groups if group.level("vision_gain")]
    if not groups:
        return None
    columns: list[str | Column] = []
    differences: list[str | Column] = ["vision_gain"]
    abouts = []
    for name, entry in BLIND_AGENTS.items():
        columns.append(Column(name, name, "percent", True, entry.about))
        abouts.append(f"{name}: {entry.about}")
        if not entry.sees_nothing:
            label = f"success minus {name} [points]"
            differences.append(Column(f"minus {name}", label, "points", True))
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
    words = {"count": integer(most), "agents": "; ".join(abouts)}
    return table_of(task, "vision", rows, more=columns, **words)


def _solved(task: TaskData) -> DataTable | None:
    """Show what is solved for what a network sees, beside its policy on the same episodes."""
    policies: dict[tuple[str, Group], Group] = {}
    for (_, rules), agents in task.evaluation_sets.items():
        for group, agent in agents.items():
            policies[rules, group] = agent
    rows = []
    for group in task.groups:
        solved: dict[str, list[Evaluation]] = {}
        for run in group.runs:
            for evaluation in run.evaluations.values():
                if evaluation.is_solved:
                    solved.setdefault(evaluation.policy_rules, []).append(evaluation)
        for rules, evaluations in solved.items():
            seen = Evaluated(group.name, group.colour, evaluations)
            row = row_of(seen) | {"rules": conditions(evaluations[0])}
            row["split"] = evaluations[0].summary.config.split or ""
            row["solved"] = seen.level("success")
            policy = policies.get((rules, group))
            row["success"] = policy.level("success") if policy else None
            rows.append(row)
    return table_of(task, "solved", rows) if rows else None


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
    words = {"title": table.title, "note": table.note}
    more = table.measures
    return table_of(task, table.name, rows, like="of-the-task", more=more, **words)


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
    table = table_of(task, f"per-{part}", rows, like="parts", part=title)
    if len(names) > MOST_PANELS:
        return table
    return Figure(table, dot_panels(table, "success", SUCCESS_AXIS, width=340))
