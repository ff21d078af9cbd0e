"""Runs of one task go in; mean, interquartile mean and rank of each agent come out."""

from knowarm.report.blocks import Block, Column, Row, Table
from knowarm.report.claims import scores
from knowarm.report.levels import cells
from knowarm.report.palette import colours
from knowarm.report.study import Task
from knowarm.statistics import bootstrap, iqm, probability_of_improvement


def scores_table(task: Task) -> list[Block]:
    """Levels of success over training seeds; agents of one seed have no interval."""
    baseline = next((group for group in task.groups if group.agent == "bm"), task.groups[0])
    chosen = colours(group.name for group in task.groups)
    rows: list[Row] = []
    for group in task.groups:
        final, speed = scores(task, group, "success"), scores(task, group, "speed")
        base = scores(task, baseline, "success")
        row: Row = {"agent": group.name, "seeds": len(final), "_colour": chosen[group.name]}
        for key, values, statistic in (
            ("mean", final, None),
            ("iqm", final, iqm),
            ("area", speed, None),
        ):
            if values.size == 0:
                continue
            interval = bootstrap([values], statistic) if statistic else bootstrap([values])
            row |= cells(key, interval) if values.size > 1 else {key: interval.estimate}
        if group is not baseline and final.size > 1 and base.size > 1:
            row |= cells("improvement", probability_of_improvement([final], [base]))
        rows.append(row)
    return [
        Table(
            name=f"scores-{task.name}",
            title=f"Success over training seeds: {task.title}",
            columns=[
                Column(key="agent", label="agent"),
                Column(key="seeds", label="seeds", format="integer"),
                Column(key="mean", label="mean", format="percent", interval=True),
                Column(key="iqm", label="interquartile mean", format="percent", interval=True),
                Column(
                    key="improvement",
                    label=f"P(better than {baseline.name})",
                    format="percent",
                    interval=True,
                    hint="probability that a run of the agent beats a run of the baseline",
                ),
                Column(
                    key="area",
                    label="mean while learning",
                    format="percent",
                    interval=True,
                    hint="area under the curve of interim success over its length",
                ),
            ],
            rows=rows,
            sources=[run.path for run in task.runs],
            note="Intervals: 95 % percentile bootstrap over training seeds, 10,000 resamples "
            "(2,000 for the probability), fixed seed.",
        )
    ]
