"""Page "Knowledge": each subject against the controls, in total and by target."""

import numpy as np

from knowarm.experiment.agents import AGENTS
from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table, cells, shared
from knowarm.report.claims import Claim
from knowarm.report.collect import LATEST, UNTRAINED
from knowarm.report.diagrams import POINTS_AXIS, Dot, dot_chart
from knowarm.report.format import slugs
from knowarm.report.pages.differences import forest_figure
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
            Column(key="control", label="agent"),
            Column(key="role", label="role"),
            Column(key="about", label="about"),
            Column(key="parameters", label="parameters", format="integer"),
            Column(key="equal", label=f"as many as {subject.name}", hint="within 2 %"),
            Column(key="difference", label="success [points]", format="points", interval=True),
            Column(key="adjusted_p", label="adjusted p", format="p"),
            Column(key="verdict", label=f"{subject.name} is"),
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


def _size(group: Group) -> int | None:
    totals = (run.parameters.get("total") for run in group.runs)
    return next((int(total) for total in totals if total), None)


def _by_target(task: Task, subject: Group, final: list[Claim], stem: str) -> list[Block]:
    """Show the differences by target, or by target and colour where a target has several."""
    summary = subject.evaluations[0].summary if subject.evaluations else {}
    facets, targets = summary.get("per_facet", {}), summary.get("per_target", {})
    part, names = ("per_facet", facets) if len(facets) > len(targets) else ("per_target", targets)
    rows: list[Row] = []
    panels = []
    for name in sorted(names):
        dots = []
        for group in (claim.second for claim in final if claim.comparison):
            value, colour = _difference(subject, group, part, name), task.colours[group.name]
            if value is not None:
                row = {"part": name, "control": group.name, "_colour": colour}
                rows.append(row | cells("difference", value))
                dots.append(Dot(name=f"\u2212 {group.name}", colour=colour, value=value))
        if dots:
            words = format.facet(name)
            label = f"{subject.name} minus other agents on {words}"
            svg = dot_chart(dots, label, POINTS_AXIS, zero=True, width=340, left=100)
            panels.append(Panel(svg=svg, title=words))
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
                    Column(key="part", label="target"),
                    Column(key="control", label="agent"),
                    Column(key="difference", label="points", format="points", interval=True),
                ],
                rows=rows,
                sources=[each.folder / "summary.json" for each in subject.evaluations],
            ),
        )
    ]


def _difference(first: Group, second: Group, part: str, name: str) -> Interval | None:
    scores = [
        np.array([v["success"] for each in group.evaluations if (v := each.numbers(part, name))])
        for group in (first, second)
    ]
    return welch(*scores).difference if min(map(len, scores)) > 1 else None


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
                Column(key="label", label="evaluation"),
                *shared("agent", "seeds"),
                Column(key="success", label="success", format="percent"),
                Column(key="difference", label=difference, format="points", interval=True),
            ],
            rows=rows,
            sources=sources,
            note="Evaluations stored under another label: held-out colours, other thresholds, "
            "sampled actions. 95 % intervals over training seeds, not corrected.",
        )
    ]
