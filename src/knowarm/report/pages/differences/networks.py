"""Evaluations of two networks on the same episodes go in; their paired difference comes out."""

import numpy as np

from knowarm.errors import UserError
from knowarm.report.blocks import Block, Column, Row, Table
from knowarm.report.claims import pairs
from knowarm.report.levels import cells
from knowarm.report.study import Group, Judged, Task
from knowarm.statistics import paired


def networks(task: Task) -> list[Block]:
    """Best runs of two agents, episode by episode: about these networks, not about methods."""
    rows: list[Row] = []
    sources = []
    for first, second, _ in pairs(task):
        judged = (best(first), best(second))
        if judged[0] is None or judged[1] is None:
            continue
        try:
            episodes = [each.episodes() for each in judged if each]
        except UserError:
            continue  # named under Runs when the summary is missing too
        if not np.array_equal(episodes[0]["facet"], episodes[1]["facet"]):
            continue
        row: Row = {
            "first": first.name,
            "second": second.name,
            "episodes": len(episodes[0]["facet"]),
        }
        for key in ("success", "return", "length"):
            row |= cells(key, paired(episodes[0][key], episodes[1][key]).difference)
        rows.append(row)
        sources += [each.folder / "episodes.parquet" for each in judged if each]
    if not rows:
        return []
    return [
        Table(
            name=f"networks-{task.name}",
            title=f"Two networks on the same episodes: {task.title}",
            columns=[
                Column(key="first", label="network of"),
                Column(key="second", label="against that of"),
                Column(key="episodes", label="episodes", format="integer"),
                Column(key="success", label="success [points]", format="points", interval=True),
                Column(key="return", label="return", format="signed", interval=True),
                Column(key="length", label="steps", format="signed", interval=True),
            ],
            rows=rows,
            sources=sources,
            note="The best run of each agent, paired by episode (Student's t, 95 %). Shows whether "
            "these two networks differ on this task; one network a method shows nothing about the "
            "methods.",
        )
    ]


def best(group: Group) -> Judged | None:
    """The evaluation of a group's best run."""
    run = group.best_run()
    return run.judged[group.label] if run and group.label else None
