"""Page "Training": learning curves, steps to fixed levels of success, time and speed."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from knowarm.arrays import Floats, Mask
from knowarm.experiment.csv_log import training_seconds
from knowarm.report.blocks import (
    Block,
    DataTable,
    Figure,
    Panel,
    Row,
    row_of,
    table_of,
)
from knowarm.report.charts import (
    BOXES,
    RETURN_AXIS,
    STEPS_AXIS,
    SUCCESS_AXIS,
    Axis,
    Series,
    line_chart,
)
from knowarm.report.format import steps
from knowarm.report.model import CONTROLS, Curve, Group, RunData, TaskData
from knowarm.report.pages.paper import time_saved
from knowarm.statistics import (
    Interval,
    first_crossing,
    mean_band,
    median_steps,
    restricted_mean_steps,
    trend,
)

GRID = 48  # points of a drawn curve
MOST_POINTS = 120  # of a single seed's curve

# Drawn columns of ``evaluations.csv`` and their axes.
MEASURES = {"return_mean": RETURN_AXIS, "success": SUCCESS_AXIS}
LEVELS = (0.5, 0.7, 0.8)  # levels of success whose first crossing is estimated


def training_blocks(task: TaskData) -> list[Block]:
    """Show how each agent learned: interim evaluations, steps to thresholds, speed."""
    blocks: list[Block] = []
    if any(run.interim for run in task.runs):
        blocks.append(curve_figure(task, MEASURES, "training", "Learning curves"))
    groups = [group for group in task.groups if group.success_curves]
    if groups:
        blocks.append(_thresholds(task, groups))
    return [*blocks, _speed(task)]


def curve_figure(
    task: TaskData,
    measures: Mapping[str, Axis],
    name: str,
    title: str,
) -> Figure:
    """Draw columns of ``evaluations.csv``, names of measures by axis, over the steps."""
    lines = curve_lines(task, measures)
    rows = line_rows(lines, "step")
    table = table_of(task, name, rows, like="curves", more=measures, title=title)
    return line_figure(table, lines, STEPS_AXIS, measures)


def curve_lines(task: TaskData, measures: Iterable[str]) -> dict[str, list[Series]]:
    """Return the line of each agent by measure, a column of ``evaluations.csv``."""
    lines: dict[str, list[Series]] = {}
    for key in measures:
        for group in task.groups:
            curves = [_extended(run) for run in group.runs if key in run.interim]
            if curves:
                line = group_series(group, curves, key)
                lines.setdefault(key, []).append(line)
    return lines


def line_rows(lines: Mapping[str, Sequence[Series]], x: str) -> list[Row]:
    """Return the values of lines by the column of each: a row per agent and value of ``x``."""
    rows: dict[tuple[str, float], Row] = {}
    for key, series in lines.items():
        for line in series:
            columns = [line.x, line.y, *(line.band or ())]
            for at, value, *ends in np.transpose(columns).tolist():
                new = {"agent": line.name, "_colour": line.colour, x: at}
                row = rows.setdefault((line.name, at), new)
                row[key] = Interval(value, *ends) if ends else value
                reaching = sum(bool(xs[0] <= at <= xs[-1]) for xs, _ in line.faint)
                row.setdefault("seeds", reaching)
    return list(rows.values())


def line_figure(
    table: DataTable,
    lines: Mapping[str, Sequence[Series]],
    x_axis: Axis,
    axes: Mapping[str, Axis],
) -> Figure:
    """Draw the lines of each column, in a chart for large and in one for small screens."""
    panels = []
    legend: dict[str, str] = {}
    for key, series in lines.items():
        name = f"{axes[key].title} over {x_axis.title}: {table.title}"
        for only, box in BOXES.items():
            svg = line_chart(series, name, x_axis, axes[key], box=box)
            panels.append(Panel(svg, only=only))
        legend |= {line.name: line.colour for line in series}
    return Figure(table, panels, legend=list(legend.items()))


def _extended(run: RunData) -> Curve:
    """Return the interim curve; where ``stop_when`` ended a run its last values go on."""
    if not run.ended_early:
        return run.interim
    curve = {}
    for name, values in run.interim.items():
        curve[name] = np.append(values, values[-1])
    curve["step"][-1] = run.config.total_steps
    return curve


def group_series(group: Group, curves: Sequence[Curve], key: str) -> Series:
    """Compute the mean trend of a group's runs on a common grid, with a band over seeds."""
    steps = np.concatenate([curve["step"] for curve in curves])
    grid = np.unique(np.linspace(steps.min(), steps.max(), GRID))
    table = np.empty((len(curves), len(grid)))
    for i, curve in enumerate(curves):
        good = np.isfinite(curve[key])
        values = trend(curve[key][good], max(1, int(good.sum()) // 10))
        table[i] = np.interp(grid, curve["step"][good], values, np.nan, np.nan)
    known = np.ma.masked_invalid(table)
    return Series(
        name=group.name,
        colour=group.colour,
        x=grid,
        y=known.mean(axis=0).filled(np.nan),
        band=_band(table) if len(curves) > 1 else None,
        faint=[_thinned(curve, key) for curve in curves],
        dashed=group.role in CONTROLS,
    )


def _band(table: Floats) -> tuple[Floats, Floats]:
    """Bootstrap the mean over seeds pointwise, (G,) each; NaN below two seeds."""
    low, high = mean_band(table, 1_000)
    enough = np.isfinite(table).sum(axis=0) > 1
    return np.where(enough, low, np.nan), np.where(enough, high, np.nan)


def _thinned(curve: Curve, key: str) -> tuple[Floats, Floats]:
    """Return at most `MOST_POINTS` of a curve's points."""
    count = len(curve["step"])
    places = np.linspace(0, count - 1, min(count, MOST_POINTS)).round().astype(int)
    return curve["step"][places], curve[key][places]


def _thresholds(task: TaskData, groups: Sequence[Group]) -> DataTable:
    """Estimate the steps until an interim evaluation first reaches each level of success."""
    baseline = task.baseline if task.baseline in groups else None
    saved = f"saved against {baseline.name}" if baseline else "saved"
    until = task.horizon
    rows = []
    for level in LEVELS:
        base = None
        if baseline:
            base = restricted_mean_steps(*_crossings(baseline, level), until)
        for group in groups:
            first_steps, reached = _crossings(group, level)
            middle, low, high = median_steps(first_steps, reached)
            mean = restricted_mean_steps(first_steps, reached, until)
            row = row_of(group) | {
                "level": level,
                "reached": f"{reached.sum()} of {len(reached)}",
                "median": middle,
                "median_low": low,
                "median_high": high,
                "mean": mean,
            }
            if base and group is not baseline and reached.any():
                row["saved"] = time_saved(mean.estimate, base.estimate)
            rows.append(row)
    return table_of(task, "thresholds", rows, saved=saved, until=steps(until))


def _crossings(group: Group, level: float) -> tuple[Floats, Mask]:
    """Return the step of the first crossing, or of the end, and whether it crossed, per run."""
    crossings = [
        first_crossing(curve["step"], curve["success"], level)
        for curve in group.success_curves
    ]
    first_steps, reached = zip(*crossings, strict=True)
    return np.array(first_steps), np.array(reached)


def _speed(task: TaskData) -> DataTable:
    rows = []
    for group in task.groups:
        for run in group.runs:
            row = row_of(group) | {
                "seed": run.config.seed,
                "steps": run.steps_done,
                "best_step": run.best_step,
                "parameters": run.provenance.parameter_counts.get("total"),
            }
            seconds = _finite(run, "wall_time_s")
            if seconds.size:
                row["hours"] = training_seconds(seconds) / 3600
            speed = _finite(run, "steps_per_s")
            if speed.size:
                row["steps_per_s"] = np.median(speed)
            rows.append(row)
    return table_of(task, "training-runs", rows)


def _finite(run: RunData, key: str) -> Floats:
    """Return the finite values of a column of the metrics, else of the interim evaluations."""
    curve = run.metrics if key in run.metrics else run.interim
    values = curve.get(key, np.empty(0))
    return values[np.isfinite(values)]
