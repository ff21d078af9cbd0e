"""Post-training evaluations go in; the page of the paper's table and its parts comes out."""

from pathlib import Path

from knowarm.report import format
from knowarm.report.blocks import Column, Figure, Page, Panel, Row, Table
from knowarm.report.figures import Dot, dot_chart
from knowarm.report.levels import cells, level, own_level, part_level
from knowarm.report.palette import colours
from knowarm.report.study import Study, Task

INTERVALS = ("return_mean", "success", "accuracy", "success_wide", "length_mean")
PLAIN = (
    "return_std",
    "length_std",
    "failure_distance_mean",
    "failure_distance_std",
    "failure_distance_max",
)


def results_page(study: Study) -> Page:
    """Every agent, and the untrained policy, on the same fixed episodes."""
    page = Page(
        name="results",
        short="Results",
        title="Evaluation after training",
        lead="The best model of every run on the same fixed episodes, which none was trained on.",
    )
    for task in study.tasks:
        if task.label is None:
            continue
        parts = (("per_target", "target"), ("per_facet", "target and colour"))
        figures = [_parts(task, part, what) for part, what in parts]
        page.add(task, [_table(task), *(figure for figure in figures if figure)])
    return page


def _table(task: Task) -> Table:
    chosen = colours(group.name for group in task.groups)
    rows: list[Row] = []
    for group in task.groups:
        row: Row = {"agent": group.name, "seeds": len(group.judged_runs)}
        for key in INTERVALS:
            row |= cells(key, level(group, key))
        for key in PLAIN:
            value = level(group, key)
            row[key] = value.estimate if value else None
        rows.append(row | {"_colour": chosen[group.name]})
    for each in task.references:
        summary = each.judged.summary
        row = {"agent": each.name, "seeds": None, "_colour": "c-faint"}
        for key in INTERVALS:
            row |= cells(key, own_level(summary, key))
        rows.append(row | {key: summary.get(key) for key in PLAIN})
    sources = [judged.folder / "summary.json" for g in task.groups for judged in g.judged()]
    sources += [each.judged.folder / "summary.json" for each in task.references]
    return Table(
        name=f"evaluation-{task.name}",
        title=f"{task.title}: {rules(task)}",
        columns=[
            Column(key="agent", label="agent"),
            Column(key="seeds", label="seeds", format="integer", hint="training seeds evaluated"),
            Column(key="return_mean", label="mean return", format="number1", interval=True),
            Column(key="return_std", label="std", format="number1"),
            Column(key="success", label="success", format="percent", interval=True),
            Column(key="accuracy", label="accuracy", format="percent", interval=True),
            Column(key="success_wide", label=wide_label(task), format="percent", interval=True),
            Column(key="length_mean", label="steps", format="number1", interval=True),
            Column(key="length_std", label="std", format="number1"),
            Column(key="failure_distance_mean", label="failure dist. [m]", format="number3"),
            Column(key="failure_distance_std", label="std [m]", format="number3"),
            Column(key="failure_distance_max", label="max [m]", format="number3"),
        ],
        rows=rows,
        sources=sources,
        note="95 % intervals: over training seeds where there are several (bootstrap of the mean); "
        "over episodes where there is one (Wilson for shares), and then they speak of that one "
        "network. Failure distance: final distance of the episodes without success. Standard "
        "deviations are within an evaluation, averaged over seeds.",
    )


def rules(task: Task) -> str:
    """How the task's runs were judged, in words."""
    judged = next((each for group in task.groups for each in group.judged()), None)
    settings = judged.summary.get("config", {}) if judged else {}
    if not judged or "distance_m" not in settings:
        return "evaluation"
    return (
        f"{format.integer(judged.summary['episodes'])} episodes, success within "
        f"{settings['distance_m'] * 100:g} cm and {settings['angle_deg']:g}°, "
        f"{settings.get('actions', 'greedy')} actions"
    )


def wide_label(task: Task) -> str:
    """Heading of the share of episodes that met the wider angle."""
    judged = next((each for group in task.groups for each in group.judged()), None)
    angle = judged.summary.get("config", {}).get("wide_angle_deg") if judged else None
    return f"success {angle:g}°" if angle else "success, wide angle"


def _parts(task: Task, part: str, what: str) -> Figure | None:
    names = sorted(
        {
            name
            for group in task.groups
            for judged in group.judged()
            for name in judged.summary.get(part, {})
        }
    )
    if part == "per_facet" and len({name.split("/")[0] for name in names}) == len(names):
        return None  # one colour a target: the same as per target
    if not names:
        return None
    chosen = colours(group.name for group in task.groups)
    rows, panels = [], []
    sources: list[Path] = [judged.folder for g in task.groups for judged in g.judged()]
    for name in names:
        dots = []
        for group in task.groups:
            value = part_level(group, part, name, "success")
            rows.append(
                {"part": name, "agent": group.name, "_colour": chosen[group.name]}
                | cells("success", value)
            )
            dots.append(
                Dot(
                    name=group.name,
                    colour=chosen[group.name],
                    value=value.estimate if value else None,
                    low=value.low if value else None,
                    high=value.high if value else None,
                )
            )
        title = name.replace("_", " ").replace("/", ", ")
        svg = dot_chart(
            dots,
            f"Success on {title}",
            x_title="success",
            x_format=lambda v: format.percent(v, 0),
            x_range=(0, 1),
            width=340,
        )
        panels.append(Panel(svg=svg, title=title))
    return Figure(
        title=f"Success by {what}: {task.title}",
        caption="Dot: mean over training seeds; line: 95 % interval.",
        panels=panels,
        table=Table(
            name=f"{part.replace('_', '-')}-{task.name}",
            title=f"Success by {what}",
            columns=[
                Column(key="part", label=what),
                Column(key="agent", label="agent"),
                Column(key="success", label="success", format="percent", interval=True),
            ],
            rows=rows,
            sources=sources,
        ),
    )
