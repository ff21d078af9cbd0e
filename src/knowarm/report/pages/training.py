"""Runs go in; the page of learning curves comes out."""

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from knowarm.report import format
from knowarm.report.blocks import Column, Figure, Page, Panel, Row, Table
from knowarm.report.figures import Box, Series, line_chart
from knowarm.report.palette import colours
from knowarm.report.study import Curve, Group, Run, Study, Task
from knowarm.statistics import on_grid, trend

GRID = 48
"""Points of a drawn curve."""

THIN = 120
"""Most points of a seed's own, faint curve."""

DASHED = ("zeros", "random", "shuffled", "onehot", "wide", "untrained")
"""Controls, drawn dashed."""

BOXES: dict[Literal["wide", "narrow"], Box] = {
    "wide": Box(width=530, height=310),
    "narrow": Box(width=350, height=250, left=44),
}
"""Sizes of a curve on large and on small screens, so that its letters stay readable."""

Measure = tuple[str, str, Callable[[float], str], tuple[float, float] | None]

MEASURES: tuple[Measure, ...] = (
    ("return_mean", "mean return", format.decimals(0), None),
    ("success", "success", lambda value: format.percent(value, 0), (0.0, 1.0)),
)
"""Column, its name, its format and the ends of its axis."""


def training_page(study: Study) -> Page:
    """How each agent learned: interim evaluations on fixed episodes, and the losses."""
    page = Page(
        name="training",
        short="Training",
        title="Training",
        lead="Interim evaluations on the same fixed episodes, by the training thresholds.",
    )
    for task in study.tasks:
        curves = [_curves(task)] if any(run.interim for run in task.runs) else []
        page.add(task, [*curves, _speed(task)])
    return page


def _curves(task: Task) -> Figure:
    chosen = colours(group.name for group in task.groups)
    rows: dict[tuple[str, float], Row] = {}
    panels, legend = [], {}
    for key, name, shown, y_range in MEASURES:
        series = []
        for group in task.groups:
            curves = [run.interim for run in group.runs if key in run.interim]
            if curves:
                line = group_series(group, curves, key, chosen[group.name])
                series.append(line)
                legend[line.name] = line.colour
                _add_rows(rows, line, key)
        for only, box in BOXES.items() if series else ():
            svg = line_chart(
                series,
                f"{name} over environment steps on {task.title}",
                x_title="environment steps",
                y_title=name,
                y_format=shown,
                y_range=y_range,
                box=box,
            )
            panels.append(Panel(svg=svg, only=only))
    return Figure(
        title=f"Learning curves: {task.title}",
        caption="Line: trend, a moving average over a tenth of the curve, averaged over training "
        "seeds. Band: 95 % bootstrap interval over seeds, where there are several. Thin: each "
        "seed as it was measured. Names switch lines off and on.",
        panels=panels,
        legend=list(legend.items()),
        table=Table(
            name=f"training-{task.name}",
            title=f"Trends of the interim evaluations: {task.title}",
            columns=[
                Column(key="agent", label="agent"),
                Column(key="seeds", label="seeds", format="integer"),
                Column(key="step", label="steps", format="steps"),
                Column(key="return_mean", label="mean return", format="number1", interval=True),
                Column(key="success", label="success", format="percent", interval=True),
            ],
            rows=list(rows.values()),
            sources=[run.path / "evaluations.csv" for run in task.runs if run.interim],
        ),
    )


def group_series(group: Group, curves: Sequence[Curve], key: str, colour: str) -> Series:
    """Mean trend of a group's runs on a common grid, with a bootstrap band over seeds."""
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
    mean = np.divide(totals, counts, out=np.full(len(grid), np.nan), where=counts > 0)
    low = high = None
    if len(curves) > 1:
        low, high = _band(table, present)
    return Series(
        name=group.name,
        colour=colour,
        x=grid,
        y=mean,
        low=low,
        high=high,
        faint=[_thin(curve, key) for curve in curves],
        dashed=group.agent in DASHED,
    )


def _band(table: np.ndarray, present: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pointwise bootstrap over seeds, (G,) each; nan where fewer than two seeds are there."""
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


def _thin(curve: Curve, key: str) -> tuple[np.ndarray, np.ndarray]:
    count = len(curve["step"])
    places = np.unique(np.linspace(0, count - 1, min(count, THIN)).round().astype(int))
    return curve["step"][places], curve[key][places]


def _add_rows(rows: dict[tuple[str, float], Row], line: Series, key: str) -> None:
    """Add a line's values to the rows of its agent and steps."""
    for i, (x, y) in enumerate(zip(line.x.tolist(), line.y.tolist(), strict=True)):
        row = rows.setdefault(
            (line.name, x),
            {"agent": line.name, "seeds": len(line.faint), "step": x, "_colour": line.colour},
        )
        row[key] = y
        if line.low is not None and line.high is not None:
            row |= {f"{key}_low": float(line.low[i]), f"{key}_high": float(line.high[i])}


def _speed(task: Task) -> Table:
    chosen = colours(group.name for group in task.groups)
    rows = [
        {
            "agent": group.name,
            "seed": run.seed,
            "steps": run.steps_done,
            "best_step": run.best_step,
            "hours": _last(run, "wall_time_s", 1 / 3600),
            "steps_per_s": _median(run, "steps_per_s"),
            "parameters": run.provenance.get("parameter_counts", {}).get("total"),
            "_colour": chosen[group.name],
        }
        for group in task.groups
        for run in group.runs
    ]
    columns = [
        Column(key="agent", label="agent"),
        Column(key="seed", label="seed", format="integer"),
        Column(key="steps", label="steps trained", format="steps"),
        Column(key="best_step", label="best model at", format="steps"),
        Column(key="hours", label="time [h]", format="number"),
        Column(key="steps_per_s", label="steps/s", format="integer"),
        Column(key="parameters", label="parameters", format="integer"),
    ]
    return Table(
        name=f"training-runs-{task.name}",
        title=f"Training runs: {task.title}",
        columns=columns,
        rows=rows,
        sources=[run.path / "metrics.csv" for run in task.runs],
        note="The best model is that of the interim evaluation with the highest mean return.",
    )


def _last(run: Run, key: str, factor: float) -> float | None:
    curve = run.metrics if key in run.metrics else run.interim
    values = curve.get(key, np.empty(0))
    values = values[np.isfinite(values)]
    return float(values[-1]) * factor if values.size else None


def _median(run: Run, key: str) -> float | None:
    values = run.metrics.get(key, np.empty(0))
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else None
