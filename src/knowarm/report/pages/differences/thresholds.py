"""Learning curves go in; the steps to 50, 70 and 80 % success, censored runs kept, come out."""

import numpy as np

from knowarm.report.blocks import Block, Column, Row, Table
from knowarm.report.claims import has_curve, horizon
from knowarm.report.levels import cells
from knowarm.report.palette import colours
from knowarm.report.paper import learning_time_reduction
from knowarm.report.study import Group, Task
from knowarm.statistics import (
    Interval,
    first_crossing,
    kaplan_meier,
    median_steps,
    restricted_mean_steps,
)

LEVELS = (0.5, 0.7, 0.8)


def thresholds(task: Task) -> list[Block]:
    """Steps until an interim evaluation first reaches each level of success."""
    groups = [group for group in task.groups if any(has_curve(run) for run in group.runs)]
    if not groups:
        return []
    chosen = colours(group.name for group in task.groups)
    baseline = next((group for group in groups if group.agent == "bm"), None)
    until = horizon(task)
    rows: list[Row] = []
    for wanted in LEVELS:
        base = _restricted(baseline, wanted, until) if baseline else None
        for group in groups:
            steps, reached = _crossings(group, wanted)
            middle, low, high = median_steps(kaplan_meier(steps, reached))
            mean = _restricted(group, wanted, until)
            saved = None
            if base and group is not baseline:
                saved = learning_time_reduction(mean.estimate, base.estimate)
            rows.append(
                {
                    "level": wanted,
                    "agent": group.name,
                    "reached": f"{int(reached.sum())} of {len(reached)}",
                    "median": middle,
                    "median_low": low,
                    "median_high": high,
                    "saved": saved,
                    "_colour": chosen[group.name],
                }
                | cells("mean", mean)
            )
    return [
        Table(
            name=f"thresholds-{task.name}",
            title=f"Steps to a level of success: {task.title}",
            columns=[
                Column(key="level", label="success", format="percent"),
                Column(key="agent", label="agent"),
                Column(key="reached", label="runs that reached it"),
                Column(key="median", label="median steps", format="steps", interval=True),
                Column(key="mean", label="restricted mean", format="steps", interval=True),
                Column(key="saved", label="saved against bm", format="percent"),
            ],
            rows=rows,
            sources=[run.path / "evaluations.csv" for run in task.runs if run.interim],
            note="From interim evaluations at the training thresholds. A run that ended below a "
            "level is censored at its end, never counted as reaching it. Median: Kaplan-Meier with "
            "Brookmeyer and Crowley's interval (log-log), empty where the runs do not show it. "
            f"Restricted mean: mean steps counting at most {until / 1e6:g} M a run, as far as "
            "every agent has a run; it is defined however many runs are censored.",
        )
    ]


def _crossings(group: Group, wanted: float) -> tuple[np.ndarray, np.ndarray]:
    found = [
        first_crossing(run.interim["step"], run.interim["success"], wanted)
        for run in group.runs
        if has_curve(run)
    ]
    return np.array([step for step, _ in found]), np.array([seen for _, seen in found])


def _restricted(group: Group, wanted: float, until: float) -> Interval:
    return restricted_mean_steps(*_crossings(group, wanted), until)
