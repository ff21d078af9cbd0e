"""Claims of one task go in; the same differences target by target come out."""

import numpy as np

from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table
from knowarm.report.claims import Claim
from knowarm.report.figures import Dot, dot_chart
from knowarm.report.levels import cells
from knowarm.report.palette import colours
from knowarm.report.study import Group, Task
from knowarm.statistics import Interval, welch


def parts(task: Task, asked: Group, claims: list[Claim]) -> list[Block]:
    """Differences by target, or by target and colour where targets have several."""
    judged = asked.judged()
    facets = judged[0].summary.get("per_facet", {}) if judged else {}
    targets = judged[0].summary.get("per_target", {}) if judged else {}
    part, names = ("per_facet", facets) if len(facets) > len(targets) else ("per_target", targets)
    others = [claim.second for claim in claims if claim.outcome == "success" and claim.comparison]
    chosen = colours(group.name for group in task.groups)
    rows: list[Row] = []
    panels = []
    for name in sorted(names):
        dots = []
        for group in others:
            interval = _part_difference(asked, group, part, name)
            if interval is None:
                continue
            rows.append(
                {"part": name, "control": group.name, "_colour": chosen[group.name]}
                | cells("difference", interval)
            )
            dots.append(
                Dot(
                    name=f"\u2212 {group.name}",
                    colour=chosen[group.name],
                    value=interval.estimate,
                    low=interval.low,
                    high=interval.high,
                )
            )
        if dots:
            words = name.replace("_", " ").replace("/", ", ")
            svg = dot_chart(
                dots,
                f"{asked.name} minus controls on {words}",
                x_title="difference [points]",
                x_format=lambda value: format.points(value, 0),
                zero=True,
                width=340,
                left=100,
            )
            panels.append(Panel(svg=svg, title=words))
    if not panels:
        return []
    return [
        Figure(
            title=f"{asked.name} minus each control, part by part: {task.title}",
            caption="Success after training, 95 % intervals over training seeds, not corrected for "
            "their number: to look where a difference comes from, not to find one.",
            panels=panels,
            table=Table(
                name=f"control-parts-{task.name}",
                title="Differences by target and colour",
                columns=[
                    Column(key="part", label="target"),
                    Column(key="control", label="control"),
                    Column(key="difference", label="points", format="points", interval=True),
                ],
                rows=rows,
                sources=[each.folder / "summary.json" for each in judged],
            ),
        )
    ]


def _part_difference(first: Group, second: Group, part: str, name: str) -> Interval | None:
    scores = [
        [
            each.summary[part][name]["success"]
            for each in group.judged()
            if name in each.summary.get(part, {})
        ]
        for group in (first, second)
    ]
    if min(map(len, scores)) < 2:
        return None
    return welch(np.array(scores[0]), np.array(scores[1])).difference
