"""Evaluations over many evaluation seeds go in; the paper's analysis of variance comes out."""

import numpy as np

from knowarm.errors import UserError
from knowarm.report.blocks import Block, Column, Row, Table
from knowarm.report.claims import pairs
from knowarm.report.paper import ANOVA_F
from knowarm.report.study import Group, Judged, Task
from knowarm.statistics import WHAT_IT_SHOWS, one_way_anova

FEWEST_RATES = 5
"""Evaluation seeds below which the test is not shown."""


def variance(task: Task) -> list[Block]:
    """The paper's one-way ANOVA (section 5.3) on success rates over evaluation seeds."""
    rows: list[Row] = []
    sources = []
    for first, second, _ in pairs(task):
        one, other = _rates(first), _rates(second)
        if one is None or other is None:
            continue
        test = one_way_anova([one[1], other[1]])
        known = {first.agent, second.agent} == {"full", "bm"}
        rows.append(
            {
                "first": first.name,
                "second": second.name,
                "rates": len(one[1]),
                "first_mean": float(one[1].mean()),
                "second_mean": float(other[1].mean()),
                "f": test.f_value,
                "p": test.p_value,
                "paper_f": ANOVA_F.get((task.robot, task.colours)) if known else None,
            }
        )
        sources += [each[0].folder / "episodes.parquet" for each in (one, other)]
    if not rows:
        return []
    return [
        Table(
            name=f"anova-{task.name}",
            title=f"The paper's analysis of variance over evaluation seeds: {task.title}",
            columns=[
                Column(key="first", label="network of"),
                Column(key="second", label="against that of"),
                Column(key="rates", label="evaluation seeds", format="integer"),
                Column(key="first_mean", label="success", format="percent"),
                Column(key="second_mean", label="success", format="percent"),
                Column(key="f", label="F"),
                Column(key="p", label="p", format="p"),
                Column(key="paper_f", label="paper's F", format="number"),
            ],
            rows=[row | {"f": round(row["f"], 2)} for row in rows],
            sources=sources,
            note=f"What it shows. {WHAT_IT_SHOWS}",
        )
    ]


def _rates(group: Group) -> tuple[Judged, np.ndarray] | None:
    """Success rate of each evaluation seed, from any evaluation of the best run that has many."""
    run = group.best_run()
    for judged in run.judged.values() if run else ():
        if int(judged.summary.get("config", {}).get("seeds", 1)) < FEWEST_RATES:
            continue
        try:
            episodes = judged.episodes()
        except UserError:
            continue
        seeds = np.unique(episodes["evaluation_seed"])
        success = episodes["success"]
        return judged, np.array([success[episodes["evaluation_seed"] == s].mean() for s in seeds])
    return None
