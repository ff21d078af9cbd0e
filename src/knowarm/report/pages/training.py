"""Page "Training": learning curves, steps to fixed levels of success, time and speed."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table, cells, shared
from knowarm.report.charts import (
    RETURN_AXIS,
    STEPS_AXIS,
    SUCCESS_AXIS,
    Axis,
    Box,
    Series,
    line_chart,
)
from knowarm.report.pages.paper import time_saved
from knowarm.report.study import CONTROLS, Curve, Group, Run, Task
from knowarm.statistics import first_crossing, median_steps, on_grid, restricted_mean_steps, trend

GRID = 48
"""Points of a drawn curve."""

MOST_POINTS = 120
"""Maximum number of points of a single seed's curve."""

BOXES: dict[Literal["large", "small"], Box] = {
    "large": Box(width=530, height=310),
    "small": Box(width=350, height=250, left=44),
}
"""Sizes of a chart on large and on small screens, so that its text stays readable."""

MEASURES = {"return_mean": RETURN_AXIS, "success": SUCCESS_AXIS}
"""Drawn columns of ``evaluations.csv`` and their axes."""

LEVELS = (0.5, 0.7, 0.8)
"""Levels of success whose first crossing is estimated."""


def training_blocks(task: Task) -> list[Block]:
    """Show how each agent learned: interim evaluations, steps to thresholds, speed."""
    blocks: list[Block] = []
    if any(run.interim for run in task.runs):
        blocks.append(curve_figure(task, MEASURES, "training", "Learning curves"))
    groups = [g for g in task.groups if any(run.has_success_curve for run in g.runs)]
    if groups:
        blocks.append(_thresholds(task, groups))
    return [*blocks, _speed(task)]


def curve_figure(task: Task, measures: Mapping[str, Axis], name: str, title: str) -> Figure:
    """Draw columns of ``evaluations.csv`` over environment steps, one line per agent.

    Args:
        task: the task.
        measures: drawn columns and their axes; each is a key of `blocks.SHARED`.
        name: name of the table.
        title: heading, before the title of the task.
    """
    rows: dict[tuple[str, float], Row] = {}
    panels, legend = [], {}
    for key, axis in measures.items():
        series = []
        for group in task.groups:
            curves = [run.interim for run in group.runs if key in run.interim]
            if curves:
                line = group_series(group, curves, key, task.colours[group.name])
                series.append(line)
                legend[line.name] = line.colour
                _add_rows(rows, line, key)
        words = f"{axis.title} over environment steps on {task.title}"
        for only, box in BOXES.items() if series else ():
            panels.append(
                Panel(svg=line_chart(series, words, STEPS_AXIS, axis, box=box), only=only)
            )
    return Figure(
        title=f"{title}: {task.title}",
        caption="Line: moving average over a tenth of the curve, averaged over training seeds. "
        "Band: 95 % bootstrap interval over seeds, where there are several. Thin lines: the "
        "measured values of each seed. Dashed: controls. Click a name to hide its line.",
        panels=panels,
        legend=list(legend.items()),
        table=Table(
            name=f"{name}-{task.name}",
            title=f"Moving averages of the interim evaluations: {task.title}",
            columns=[
                *shared("agent", "seeds"),
                Column("step", "steps", "steps"),
                *shared(*measures),
            ],
            rows=list(rows.values()),
            sources=[run.path / "evaluations.csv" for run in task.runs if run.interim],
        ),
    )


def group_series(group: Group, curves: Sequence[Curve], key: str, colour: str) -> Series:
    """Compute the mean trend of a group's runs on a common grid, with a band over seeds."""
    start = min(float(curve["step"][0]) for curve in curves)
    end = max(float(curve["step"][-1]) for curve in curves)
    grid = np.linspace(start, end, GRID) if end > start else np.array([start])
    smooth = []
    for curve in curves:
        good = np.isfinite(curve[key])
        values = trend(curve[key][good], max(1, int(good.sum()) // 10))
        smooth.append(on_grid(curve["step"][good], values, grid))
    table = np.array(smooth)
    present = np.isfinite(table)
    counts = present.sum(axis=0)
    totals = np.where(present, table, 0.0).sum(axis=0)
    low, high = _band(table, present) if len(curves) > 1 else (None, None)
    return Series(
        name=group.name,
        colour=colour,
        x=grid,
        y=np.divide(totals, counts, out=np.full(len(grid), np.nan), where=counts > 0),
        low=low,
        high=high,
        faint=[_thinned(curve, key) for curve in curves],
        dashed=group.role in CONTROLS,
    )


def _band(table: np.ndarray, present: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bootstrap the mean over seeds pointwise, (G,) each; NaN below two seeds."""
    generator = np.random.default_rng(0)
    draws = generator.multinomial(len(table), np.full(len(table), 1 / len(table)), 1_000)
    totals = draws @ np.where(present, table, 0.0)
    weights = draws @ present.astype(float)
    enough = present.sum(axis=0) > 1
    means = np.divide(totals, weights, out=np.full(totals.shape, np.nan), where=weights > 0)
    ends = np.full((2, table.shape[1]), np.nan)
    if enough.any():
        ends[:, enough] = np.nanquantile(means[:, enough], [0.025, 0.975], axis=0)
    return ends[0], ends[1]


def _thinned(curve: Curve, key: str) -> tuple[np.ndarray, np.ndarray]:
    count = len(curve["step"])
    places = np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).round().astype(int))
    return curve["step"][places], curve[key][places]


def _add_rows(rows: dict[tuple[str, float], Row], line: Series, key: str) -> None:
    """Add the values of a line to the rows of its agent and steps."""
    for i, (x, y) in enumerate(zip(line.x.tolist(), line.y.tolist(), strict=True)):
        row = rows.setdefault(
            (line.name, x),
            {"agent": line.name, "seeds": len(line.faint), "step": x, "_colour": line.colour},
        )
        row[key] = y
        if line.low is not None and line.high is not None:
            row |= {f"{key}_low": float(line.low[i]), f"{key}_high": float(line.high[i])}


def _thresholds(task: Task, groups: Sequence[Group]) -> Table:
    """Estimate the steps until an interim evaluation first reaches each level of success."""
    baseline = task.baseline if task.baseline in groups else None
    until = task.horizon
    rows: list[Row] = []
    for wanted in LEVELS:
        base = restricted_mean_steps(*_crossings(baseline, wanted), until) if baseline else None
        for group in groups:
            steps, reached = _crossings(group, wanted)
            middle, low, high = median_steps(steps, reached)
            mean = restricted_mean_steps(steps, reached, until)
            saved = None
            if base and group is not baseline:
                saved = time_saved(mean.estimate, base.estimate)
            rows.append(
                {
                    "level": wanted,
                    "agent": group.name,
                    "reached": f"{int(reached.sum())} of {len(reached)}",
                    "median": middle,
                    "median_low": low,
                    "median_high": high,
                    **cells("mean", mean),
                    "saved": saved,
                    "_colour": task.colours[group.name],
                }
            )
    against = f" against {baseline.name}" if baseline else ""
    return Table(
        name=f"thresholds-{task.name}",
        title=f"Steps to a level of success: {task.title}",
        columns=[
            Column("level", "success", "percent"),
            *shared("agent"),
            Column("reached", "runs that reached it"),
            Column("median", "median steps", "steps", interval=True),
            Column("mean", "restricted mean", "steps", interval=True),
            Column("saved", f"saved{against}", "percent"),
        ],
        rows=rows,
        sources=[run.path / "evaluations.csv" for run in task.runs if run.interim],
        note="Descriptive. A run that ended below a level is censored at its end and never counts "
        "as having reached it. Median: Kaplan-Meier with Brookmeyer and Crowley's interval "
        "(log-log); empty where the runs do not determine it. Restricted mean: mean steps, at most "
        f"{until / 1e6:g} M per run, as far as every agent has a run; it is defined however many "
        "runs are censored.",
    )


def _crossings(group: Group, wanted: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the step of the first crossing, or of the end, and whether it crossed, per run."""
    found = [
        first_crossing(run.interim["step"], run.interim["success"], wanted)
        for run in group.runs
        if run.has_success_curve
    ]
    return np.array([step for step, _ in found]), np.array([crossed for _, crossed in found])


def _speed(task: Task) -> Table:
    rows = []
    for group in task.groups:
        for run in group.runs:
            seconds, speed = (_finite(run, key) for key in ("wall_time_s", "steps_per_s"))
            rows.append(
                {
                    "agent": group.name,
                    "seed": run.seed,
                    "steps": run.steps_done,
                    "best_step": run.best_step,
                    "hours": float(seconds[-1]) / 3600 if seconds.size else None,
                    "steps_per_s": float(np.median(speed)) if speed.size else None,
                    "parameters": run.parameters.get("total"),
                    "_colour": task.colours[group.name],
                }
            )
    return Table(
        name=f"training-runs-{task.name}",
        title=f"Training runs: {task.title}",
        columns=[
            *shared("agent", "seed"),
            Column("steps", "steps trained", "steps"),
            Column("best_step", "best model at", "steps"),
            Column("hours", "time [h]", "number"),
            Column("steps_per_s", "steps/s", "integer"),
            Column("parameters", "parameters", "integer"),
        ],
        rows=rows,
        sources=[run.path / "metrics.csv" for run in task.runs],
        note="The best model is that of the interim evaluation with the highest mean return.",
    )


def _finite(run: Run, key: str) -> np.ndarray:
    """Return the finite values of a column of the metrics, else of the interim evaluations."""
    curve = run.metrics if key in run.metrics else run.interim
    values = curve.get(key, np.empty(0))
    return values[np.isfinite(values)]
