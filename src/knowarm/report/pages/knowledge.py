"""Page "Knowledge": each subject against the controls, in total and by target."""

from collections.abc import Mapping, Sequence

import numpy as np

from knowarm.experiment.agents import AGENTS
from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table, cells, shared
from knowarm.report.claims import Claim
from knowarm.report.collect import LATEST, UNTRAINED
from knowarm.report.diagrams import POINTS_AXIS, Dot, dot_chart
from knowarm.report.format import slugs
from knowarm.report.pages.results import part_panels
from knowarm.report.study import Evaluation, Group, Task
from knowarm.report.verdict import finding
from knowarm.statistics import Interval, welch

EXPLANATION = (
    "A vector that is the same in every episode carries no information about the episode: for the "
    "network it is a bias. It can still change learning, because it makes the network larger and "
    "because its weights have a gradient of their own. An advantage over the baseline alone is "
    "therefore no evidence for knowledge. What counts is the advantage over controls that differ "
    "in the knowledge only."
)


def knowledge_blocks(task: Task, decided: list[Claim]) -> list[Block]:
    """Compare each subject with every other agent, in total and by target."""
    blocks: list[Block] = []
    for subject in task.subjects if len(task.groups) > 1 else ():
        stem = task.name
        if subject is not task.subjects[0]:
            stem += f"-{slugs([subject.name])[subject.name]}"
        mine = [claim for claim in decided if claim.task is task and claim.first is subject]
        final = [claim for claim in mine if claim.outcome == "success"]
        blocks += [
            finding(task, decided, "success", subject).verdict(),
            finding(task, decided, "speed", subject).verdict(),
            _controls(task, subject, final, stem),
            *_by_target(task, subject, final, stem),
            *_other_conditions(task, subject, stem),
        ]
    return blocks


def _controls(task: Task, subject: Group, final: list[Claim], stem: str) -> Block:
    """Show the difference to every other agent, with its role and its size."""
    size = _size(subject)
    rows: list[Row] = []
    for claim in final:
        other = claim.second
        parameters = _size(other)
        row: Row = {
            "control": other.name,
            "role": (other.role or "unknown").replace("_", " "),
            "about": AGENTS[other.agent].about if other.agent in AGENTS else None,
            "parameters": parameters,
            "equal": None if not (size and parameters) else abs(parameters / size - 1) <= 0.02,
            "adjusted_p": claim.adjusted_p,
            "verdict": claim.verdict,
        }
        if claim.comparison:
            row |= cells("difference", claim.comparison.difference)
        rows.append(row)
    table = Table(
        name=f"controls-{stem}",
        title=f"{subject.name} against each other agent: {task.title}",
        columns=[
            Column("control", "agent"),
            Column("role", "role"),
            Column("about", "about"),
            Column("parameters", "parameters", "integer"),
            Column("equal", f"as many as {subject.name}", hint="within 2 %"),
            Column("difference", "success [points]", "points", interval=True),
            Column("adjusted_p", "adjusted p", "p"),
            Column("verdict", f"{subject.name} is"),
        ],
        rows=rows,
        sources=[run.path for run in task.runs],
        note=f"{subject.name} has {format.integer(size)} trainable parameters.",
    )
    caption = (
        "Success after training in percentage points, with the 95 % interval over training seeds. "
        f"Right of the line: {subject.name} is ahead."
    )
    return forest_figure(table, caption, {"": final})


def forest_figure(table: Table, caption: str, panels: Mapping[str, Sequence[Claim]]) -> Block:
    """Draw the intervals of differences around zero; the table alone if there are none.

    Args:
        table: the claims as a table.
        caption: how to read the drawings.
        panels: the claims of each drawing, by its title.
    """
    drawn = []
    for title, claims in panels.items():
        dots = [
            Dot(
                name=f"{claim.first.name} \u2212 {claim.second.name}",
                colour=claim.task.colours[claim.second.name],
                value=claim.comparison.difference,
            )
            for claim in claims
            if claim.comparison
        ]
        if dots:
            name = f"{table.title}, {title}" if title else table.title
            svg = dot_chart(dots, name, POINTS_AXIS, zero=True, width=390, left=132)
            drawn.append(Panel(svg=svg, title=title))
    if not drawn:
        return table
    return Figure(title=table.title, caption=caption, panels=drawn, table=table, open_table=True)


def _size(group: Group) -> int | None:
    totals = (run.parameters.get("total") for run in group.runs)
    return next((int(total) for total in totals if total), None)


def _by_target(task: Task, subject: Group, final: list[Claim], stem: str) -> list[Block]:
    """Show the differences by target, or by target and colour where a target has several."""
    summary = subject.evaluations[0].summary if subject.evaluations else {}
    facets, targets = summary.get("per_facet", {}), summary.get("per_target", {})
    part, names = ("per_facet", facets) if len(facets) > len(targets) else ("per_target", targets)
    others = [claim.second for claim in final if claim.comparison]

    def difference(group: Group, name: str) -> Interval | None:
        scores = [
            np.array([v["success"] for e in g.evaluations if (v := e.numbers(part, name))])
            for g in (subject, group)
        ]
        return welch(*scores).difference if min(map(len, scores)) > 1 else None

    rows, panels = part_panels(task, sorted(names), others, difference, POINTS_AXIS, sign="\u2212 ")
    if not panels:
        return []
    return [
        Figure(
            title=f"{subject.name} minus each other agent, by target: {task.title}",
            caption="Success after training, 95 % intervals over training seeds, not corrected for "
            "their number: descriptive, to locate a difference found above.",
            panels=panels,
            table=Table(
                name=f"control-parts-{stem}",
                title="Differences by target and colour",
                columns=[
                    Column("part", "target"),
                    *shared("agent"),
                    Column("success", "success [points]", "points", interval=True),
                ],
                rows=rows,
                sources=[each.folder / "summary.json" for each in subject.evaluations],
            ),
        )
    ]


def _other_conditions(task: Task, subject: Group, stem: str) -> list[Block]:
    """Show the evaluations under other labels, such as held-out colours or sampled actions."""
    by_label: dict[str, dict[str, list[Evaluation]]] = {}
    for group in task.groups:
        for run in group.runs:
            for label, evaluation in run.evaluations.items():
                if label != task.label and not label.endswith((UNTRAINED, LATEST)):
                    by_label.setdefault(label, {}).setdefault(group.name, []).append(evaluation)
    rows: list[Row] = []
    sources = []
    for label, groups in sorted(by_label.items()):
        success = {
            name: np.array([each.summary["success"] for each in evaluations])
            for name, evaluations in groups.items()
        }
        own = success.get(subject.name, np.empty(0))
        for name, values in success.items():
            row: Row = {
                "label": label,
                "agent": name,
                "seeds": len(values),
                "success": float(values.mean()),
                "_colour": task.colours[name],
            }
            if name != subject.name and min(len(own), len(values)) > 1:
                row |= cells("difference", welch(own, values).difference)
            rows.append(row)
            sources += [each.folder for each in groups[name]]
    if not rows:
        return []
    difference = f"{subject.name} minus it [points]"
    return [
        Table(
            name=f"elsewhere-{stem}",
            title=f"Other conditions: {task.title}",
            columns=[
                Column("label", "evaluation"),
                *shared("agent", "seeds"),
                Column("success", "success", "percent"),
                Column("difference", difference, "points", interval=True),
            ],
            rows=rows,
            sources=sources,
            note="Evaluations stored under another label: held-out colours, other thresholds, "
            "sampled actions. 95 % intervals over training seeds, not corrected.",
        )
    ]
