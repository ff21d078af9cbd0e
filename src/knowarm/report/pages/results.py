"""Page "Results": the evaluation after training, in total and by target."""

from collections.abc import Callable, Iterable, Sequence

from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table, cells, shared
from knowarm.report.charts import SUCCESS_AXIS, Axis
from knowarm.report.diagrams import Dot, dot_chart
from knowarm.report.study import Evaluation, Group, Task
from knowarm.statistics import Interval
from knowarm.world.agents import BLIND_AGENTS

INTERVALS = ("return_mean", "success", "accuracy", "success_wide", "length_mean")
PLAIN = (
    "return_std",
    "length_std",
    "failure_distance_mean",
    "failure_distance_std",
    "failure_distance_max",
)


def result_blocks(task: Task) -> list[Block]:
    """Show all agents and the untrained policies on the same fixed episodes."""
    if not task.label:
        return []
    parts = (("per_target", "target"), ("per_facet", "target and colour"))
    figures = [_parts(task, part, what) for part, what in parts]
    found = (_table(task), _eyes(task), *figures)
    return [block for block in found if block]


def _table(task: Task) -> Table:
    rows: list[Row] = []
    for each in (*task.groups, *task.references):
        seeds = len(each.evaluations) if each in task.groups else None
        row: Row = {"agent": each.name, "seeds": seeds, "_colour": task.colours[each.name]}
        for key in INTERVALS:
            row |= cells(key, each.level(key))
        for key in PLAIN:
            value = each.level(key)
            row[key] = value.estimate if value else None
        rows.append(row)
    shown = [e for each in (*task.groups, *task.references) for e in each.evaluations]
    first = shown[0] if shown else None
    return Table(
        name=f"evaluation-{task.name}",
        title=f"{task.title}: {_rules(first)}",
        columns=[
            *shared("agent", "seeds", "return_mean"),
            Column("return_std", "std", "number1"),
            *shared("success", "accuracy"),
            Column("success_wide", _wide(first), "percent", interval=True),
            Column("length_mean", "steps", "number1", interval=True),
            Column("length_std", "std", "number1"),
            Column("failure_distance_mean", "failure dist. [m]", "number3"),
            Column("failure_distance_std", "std [m]", "number3"),
            Column("failure_distance_max", "max [m]", "number3"),
        ],
        rows=rows,
        sources=[evaluation.folder / "summary.json" for evaluation in shown],
        note="95 % intervals: over training seeds where there are several (bootstrap of the mean); "
        "over episodes where there is one (Wilson for success and accuracy), which then describe "
        "that one network. Failure distance: final distance of unsuccessful episodes. Standard "
        "deviations are within an evaluation, averaged over seeds.",
    )


def _eyes(task: Task) -> Table | None:
    """Show the blind agents beside every agent, and how much of its success needs eyes."""
    rows: list[Row] = []
    shown = [group for group in task.groups if group.level("needs_eyes")]
    for group in shown:
        row: Row = {"agent": group.name, "seeds": len(group.evaluations)}
        row |= cells("success", group.level("success")) | {"_colour": task.colours[group.name]}
        for name, entry in BLIND_AGENTS.items():
            row |= cells(name, group.level("success", "blind_agents", name))
            if not entry.sees_nothing:
                difference = group.level("difference", "blind_agents", name)
                row |= cells(f"minus {name}", difference)
        rows.append(row | cells("needs_eyes", group.level("needs_eyes")))
    if not rows:
        return None
    blind = [
        Column(name, name, "percent", interval=True, hint=entry.about)
        for name, entry in BLIND_AGENTS.items()
    ]
    once = [
        Column(f"minus {name}", f"success minus {name} [points]", "points", interval=True)
        for name, entry in BLIND_AGENTS.items()
        if not entry.sees_nothing
    ]
    evaluations = [evaluation for group in shown for evaluation in group.evaluations]
    abouts = "; ".join(f"{name}: {entry.about}" for name, entry in BLIND_AGENTS.items())
    played = max(n["episodes"] for e in evaluations for n in e.summary["blind_agents"].values())
    needs = Column("needs_eyes", "needs eyes [points]", "points", interval=True)
    return Table(
        name=f"eyes-{task.name}",
        title=f"How much of the success needs eyes: {task.title}",
        columns=[*shared("agent", "seeds", "success"), *blind, needs, *once],
        rows=rows,
        sources=[evaluation.folder / "summary.json" for evaluation in evaluations],
        note=f"Success of blind agents on the first {format.integer(played)} of the same episodes; "
        f"{abouts}. Needs eyes: the agent's success minus that of the better agent that sees "
        "nothing. 95 % intervals: over training seeds where there are "
        "several, otherwise over episodes (Newcombe). A better fixed list may exist than the one "
        "that the search found.",
    )


def _rules(evaluation: Evaluation | None) -> str:
    """Describe the episodes, thresholds and actions of an evaluation."""
    if evaluation is None or "distance_m" not in evaluation.config:
        return "evaluation"
    config = evaluation.config
    return (
        f"{format.integer(evaluation.summary['episodes'])} episodes, success within "
        f"{config['distance_m'] * 100:g} cm and {config['angle_deg']:g}°, "
        f"{config.get('actions', 'greedy')} actions"
    )


def _wide(evaluation: Evaluation | None) -> str:
    """Return the heading of the fraction of episodes that met the wider angle threshold."""
    angle = evaluation.config.get("wide_angle_deg") if evaluation else None
    return f"success {angle:g}°" if angle else "success, wide angle"


def _parts(task: Task, part: str, what: str) -> Figure | None:
    evaluations = [evaluation for group in task.groups for evaluation in group.evaluations]
    names = sorted({name for each in evaluations for name in each.summary.get(part, {})})
    if part == "per_facet" and len({name.split("/")[0] for name in names}) == len(names):
        return None  # one colour per target: the same as per target

    def success(group: Group, name: str) -> Interval | None:
        return group.level("success", part, name)

    rows, panels = part_panels(task, names, task.groups, success, SUCCESS_AXIS)
    if not panels:
        return None
    return Figure(
        title=f"Success by {what}: {task.title}",
        caption="Dot: mean over training seeds; line: 95 % interval.",
        panels=panels,
        table=Table(
            name=f"{part.replace('_', '-')}-{task.name}",
            title=f"Success by {what}",
            columns=[Column("part", what), *shared("agent", "success")],
            rows=rows,
            sources=[evaluation.folder for evaluation in evaluations],
        ),
    )


def part_panels(
    task: Task,
    names: Iterable[str],
    groups: Sequence[Group],
    value: Callable[[Group, str], Interval | None],
    axis: Axis,
    *,
    sign: str = "",
) -> tuple[list[Row], list[Panel]]:
    """Draw one dot chart per target or facet, one row per agent.

    Args:
        task: the task.
        names: targets or facets.
        groups: the agents.
        value: estimate of an agent on a target or facet; None leaves the agent out.
        axis: horizontal axis.
        sign: written before the agents' names, if the values are differences.

    Returns:
        Rows of the table, with the estimate in the column "success", and the drawings.
    """
    rows: list[Row] = []
    panels = []
    for name in names:
        dots = []
        for group in groups:
            found, colour = value(group, name), task.colours[group.name]
            if found is not None:
                row = {"part": name, "agent": group.name, "_colour": colour}
                rows.append(row | cells("success", found))
                dots.append(Dot(name=sign + group.name, colour=colour, value=found))
        if dots:
            title = format.facet(name)
            label = f"{axis.title} on {title}"
            svg = dot_chart(dots, label, axis, zero=bool(sign), width=340, left=100)
            panels.append(Panel(svg=svg, title=title))
    return rows, panels
