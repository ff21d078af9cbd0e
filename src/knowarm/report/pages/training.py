"""Page "Training": learning curves, steps to fixed levels of success, time and speed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from knowarm.experiment.csv_log import training_seconds
from knowarm.report import format
from knowarm.report.blocks import Block, Column, DataTable, Figure, Panel, Row, table_of
from knowarm.report.charts import (
    BOXES,
    RETURN_AXIS,
    STEPS_AXIS,
    SUCCESS_AXIS,
    Axis,
    Series,
    line_chart,
)
from knowarm.report.model import CONTROLS, Curve, Group, RunData, TaskData
from knowarm.report.pages.paper import time_saved
from knowarm.statistics import (
    Interval,
    first_crossing,
    median_steps,
    restricted_mean_steps,
    trend,
)

GRID = 48  # points of a drawn curve
MOST_POINTS = 120  # of a single seed's curve

# Drawn columns of ``evaluations.csv`` and their axes.
MEASURES = {"return_mean": RETURN_AXIS, "success": SUCCESS_AXIS}
LEVELS = (0.5, 0.7, 0.8)  # levels of success whose first crossing is estimated

CAPTION = (
    "Line: moving average over a tenth of the curve, averaged over training seeds. "
    "Band: 95 % bootstrap interval over several seeds. Thin lines: the values of each seed, the "
    "last one extended where stop_when ended it. Dashed: controls. Click a name to hide its line."
)


def training_blocks(task: TaskData) -> list[Block]:
    """Show how each agent learned: interim evaluations, steps to thresholds, speed."""
    blocks: list[Block] = []
    if any(run.interim for run in task.runs):
        blocks.append(curve_figure(task, MEASURES, "training", "Learning curves"))
    if groups := [g for g in task.groups if any(run.has_success_curve for run in g.runs)]:
        blocks.append(_thresholds(task, groups))
    return [*blocks, _speed(task)]


def curve_figure(task: TaskData, measures: Mapping[str, Axis], name: str, title: str) -> Figure:
    """Draw columns of ``evaluations.csv``, names of measures by axis, over the steps."""
    rows: dict[tuple[str, float], Row] = {}
    panels: list[Panel] = []
    legend: dict[str, str] = {}
    for key, axis in measures.items():
        series = []
        for group in task.groups:
            curves = [_extended(run) for run in group.runs if key in run.interim]
            if curves:
                line = group_series(group, curves, key, task.colours[group.name])
                series.append(line)
                legend[line.name] = line.colour
                _add_rows(rows, line, key)
        words = f"{axis.title} over environment steps on {task.title}"
        panels += sized_panels(series, words, STEPS_AXIS, axis) if series else []
    columns: list[str | Column] = ["agent", "seeds", Column("step", "steps", "steps"), *measures]
    note = "Moving averages of the interim evaluations."
    table = table_of(task, name, title, columns, list(rows.values()), _logs(task), note)
    return Figure(table=table, caption=CAPTION, panels=panels, legend=list(legend.items()))


def _extended(run: RunData) -> Curve:
    """Return the interim curve; where ``stop_when`` ended a run its last values go on."""
    longer = {name: np.append(values, values[-1]) for name, values in run.interim.items()}
    ends = {"step": np.append(run.interim["step"], run.config.total_steps)}
    return longer | ends if run.ended_early else run.interim


def _logs(task: TaskData) -> list[Path]:
    return [run.path / "evaluations.csv" for run in task.runs if run.interim]


def sized_panels(series: Sequence[Series], name: str, x_axis: Axis, y_axis: Axis) -> list[Panel]:
    """Draw one line chart for large and one for small screens."""
    return [
        Panel(svg=line_chart(series, name, x_axis, y_axis, box=box), only=only)
        for only, box in BOXES.items()
    ]


def group_series(group: Group, curves: Sequence[Curve], key: str, colour: str) -> Series:
    """Compute the mean trend of a group's runs on a common grid, with a band over seeds."""
    start = min(float(curve["step"][0]) for curve in curves)
    end = max(float(curve["step"][-1]) for curve in curves)
    grid = np.linspace(start, end, GRID) if end > start else np.array([start])
    table = np.empty((len(curves), len(grid)))
    for i, curve in enumerate(curves):
        good = np.isfinite(curve[key])
        values = trend(curve[key][good], max(1, int(good.sum()) // 10))
        table[i] = np.interp(grid, curve["step"][good], values, np.nan, np.nan)
    present = np.isfinite(table)
    counts = present.sum(axis=0)
    totals = np.where(present, table, 0.0).sum(axis=0)
    return Series(
        name=group.name,
        colour=colour,
        x=grid,
        y=np.divide(totals, counts, out=np.full(len(grid), np.nan), where=counts > 0),
        band=_band(table, present) if len(curves) > 1 else None,
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
        seeds = sum(bool(steps[0] <= x <= steps[-1]) for steps, _ in line.faint)
        first = {"agent": line.name, "seeds": seeds, "step": x, "_colour": line.colour}
        row = rows.setdefault((line.name, x), first)
        row[key] = Interval(y, *(float(end[i]) for end in line.band)) if line.band else y


def _thresholds(task: TaskData, groups: Sequence[Group]) -> DataTable:
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
            if base and group is not baseline and reached.any():
                saved = time_saved(mean.estimate, base.estimate)
            reached_by = f"{int(reached.sum())} of {len(reached)}"
            row = {"level": wanted, "agent": group.name, "reached": reached_by, "saved": saved}
            row |= {"median": middle, "median_low": low, "median_high": high}
            rows.append(row | {"mean": mean, "_colour": task.colours[group.name]})
    columns: list[str | Column] = [
        *(
            Column("level", "success", "percent"),
            "agent",
            Column("reached", "runs that reached it"),
        ),
        Column("median", "median steps", "steps", interval=True),
        Column("mean", "restricted mean", "steps", interval=True),
        Column("saved", f"saved against {baseline.name}" if baseline else "saved", "percent"),
    ]
    note = (
        "Descriptive. A run that ended below a level is censored at its end and never counts "
        "as having reached it. Median: Kaplan-Meier with Brookmeyer and Crowley's interval "
        "(log-log); empty where the runs do not determine it. Restricted mean: mean steps, at most "
        f"{format.steps(until)} per run, as far as every agent has a run; it is defined however "
        "many runs are censored. Saved: of the restricted mean, by agents that reached the level."
    )
    title = "Steps to a level of success"
    return table_of(task, "thresholds", title, columns, rows, _logs(task), note)


def _crossings(group: Group, wanted: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the step of the first crossing, or of the end, and whether it crossed, per run."""
    curves = [run.interim for run in group.runs if run.has_success_curve]
    found = [first_crossing(each["step"], each["success"], wanted) for each in curves]
    return np.array([step for step, _ in found]), np.array([crossed for _, crossed in found])


def _speed(task: TaskData) -> DataTable:
    rows: list[Row] = []
    for group in task.groups:
        for run in group.runs:
            seconds, speed = (_finite(run, key) for key in ("wall_time_s", "steps_per_s"))
            row: Row = {"agent": group.name, "_colour": task.colours[group.name]}
            row |= {"seed": run.config.seed, "steps": run.steps_done, "best_step": run.best_step}
            row["hours"] = training_seconds(seconds) / 3600 if seconds.size else None
            row["steps_per_s"] = float(np.median(speed)) if speed.size else None
            rows.append(row | {"parameters": run.provenance.parameter_counts.get("total")})
    columns: list[str | Column] = [
        *("agent", "seed", Column("steps", "steps trained", "steps")),
        *(Column("best_step", "best model at", "steps"), Column("hours", "time [h]", "number")),
        *(Column("steps_per_s", "steps/s", "integer"), "parameters"),
    ]
    note = "The best model is that of the interim evaluation with the highest mean return."
    logs = [run.path / "metrics.csv" for run in task.runs]
    return table_of(task, "training-runs", "Training runs", columns, rows, logs, note)


def _finite(run: RunData, key: str) -> np.ndarray:
    """Return the finite values of a column of the metrics, else of the interim evaluations."""
    curve = run.metrics if key in run.metrics else run.interim
    values = curve.get(key, np.empty(0))
    return values[np.isfinite(values)]
