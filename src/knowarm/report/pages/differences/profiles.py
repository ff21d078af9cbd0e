"""Runs of one task go in; the share of runs above each success level comes out."""

import numpy as np

from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table
from knowarm.report.claims import FEWEST_SEEDS, scores
from knowarm.report.figures import Box, Series, line_chart
from knowarm.report.palette import colours
from knowarm.report.study import Task
from knowarm.statistics import performance_profile

LEVELS = np.linspace(0, 1, 21)

BOXES = (("wide", Box(width=640, height=300)), ("narrow", Box(width=350, height=250, left=44)))


def profiles(task: Task) -> list[Block]:
    """Performance profiles; nothing below three seeds, where they are mere steps."""
    chosen = colours(group.name for group in task.groups)
    series, rows = [], []
    for group in task.groups:
        final = scores(task, group, "success")
        if final.size < FEWEST_SEEDS:
            continue
        share, low, high = performance_profile([final], LEVELS)
        name, colour = group.name, chosen[group.name]
        series.append(Series(name=name, colour=colour, x=LEVELS, y=share, low=low, high=high))
        rows += [_row(name, colour, *v) for v in zip(LEVELS, share, low, high, strict=True)]
    if not series:
        return []
    panels = [
        Panel(
            svg=line_chart(
                series,
                f"Share of runs above each level of success on {task.title}",
                x_title="success",
                y_title="share of runs above",
                x_format=lambda value: format.percent(value, 0),
                y_format=lambda value: format.percent(value, 0),
                y_range=(0, 1),
                box=box,
            ),
            only="wide" if only == "wide" else "narrow",
        )
        for only, box in BOXES
    ]
    return [
        Figure(
            title=f"Performance profile: {task.title}",
            caption="Share of training runs that end above each level of success; further right is "
            "better. Band: 95 % bootstrap over seeds, pointwise.",
            panels=panels,
            legend=[(each.name, each.colour) for each in series],
            table=Table(
                name=f"profile-{task.name}",
                title="Share of runs above each level of success",
                columns=[
                    Column(key="agent", label="agent"),
                    Column(key="level", label="success", format="percent"),
                    Column(key="share", label="runs above", format="percent", interval=True),
                ],
                rows=rows,
                sources=[run.path for run in task.runs],
            ),
        )
    ]


def _row(name: str, colour: str, level: float, share: float, low: float, high: float) -> Row:
    return {
        "agent": name,
        "level": float(level),
        "share": float(share),
        "share_low": float(low),
        "share_high": float(high),
        "_colour": colour,
    }
