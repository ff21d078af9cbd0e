"""Curves with bands go in; a line chart comes out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from knowarm.report import format
from knowarm.report.figures.frame import Box, axes
from knowarm.report.figures.scale import Scale, fit
from knowarm.report.figures.svg import band, drawing, element, path

DEFAULT = Box()


@dataclass(frozen=True, kw_only=True)
class Series:
    """One line.

    Attributes:
        name: as the legend has it.
        colour: palette class.
        x: (n,) float64, increasing.
        y: (n,) float64; nan where there is no value.
        low: (n,) lower end of the band, or None.
        high: (n,) upper end of the band, or None.
        faint: (x, y) lines drawn thin behind, one a training seed.
        dashed: whether the line is dashed, to be told apart without colour.
    """

    name: str
    colour: str
    x: np.ndarray
    y: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    faint: Sequence[tuple[np.ndarray, np.ndarray]] = ()
    dashed: bool = False


def line_chart(
    series: Sequence[Series],
    name: str,
    *,
    x_title: str,
    y_title: str,
    x_format: Callable[[float], str] = format.steps,
    y_format: Callable[[float], str] = format.number,
    y_range: tuple[float, float] | None = None,
    box: Box = DEFAULT,
    levels: Sequence[tuple[str, float]] = (),
) -> str:
    """Draw lines over their bands; the page's script reads values off under the pointer.

    Args:
        series: the lines, drawn in order.
        name: what a screen reader says.
        x_title: title of the level axis, with its unit.
        y_title: title of the upright axis, with its unit.
        x_format: of tick labels.
        y_format: of tick labels.
        y_range: lowest and highest value shown; None fits the data.
        box: size.
        levels: names and heights of level lines across the plot.
    """
    xs = np.concatenate([each.x for each in series])
    scale_x = Scale(float(xs.min()), max(float(xs.max()), float(xs.min()) + 1e-9), *box.x)
    if y_range is None:
        heights = [value for _, value in levels]
        for each in series:
            for values in (each.y, each.low, each.high, *(y for _, y in each.faint)):
                if values is not None:
                    heights += [float(v) for v in values[np.isfinite(values)]]
        scale_y = fit(heights, *box.y)
    else:
        scale_y = Scale(*y_range, *box.y)
    parts = [
        axes(
            box,
            scale_x,
            scale_y,
            x_title=x_title,
            y_title=y_title,
            x_format=x_format,
            y_format=y_format,
        )
    ]
    for title, height in levels:
        left, right = box.x
        at = scale_y(height)
        parts.append(element("line", class_="level", x1=left, x2=right, y1=at, y2=at))
        parts.append(
            element("text", title, x=right, y=at - 4, class_="level-name", text_anchor="end")
        )
    parts += [_series(each, scale_x, scale_y) for each in series]
    plot = [scale_x.start, scale_x.end, scale_x.low, scale_x.high, scale_y.start, scale_y.end]
    return drawing(
        box.width,
        box.height,
        name,
        *parts,
        class_="chart lines many" if len(series) > 3 else "chart lines",
        data_plot=" ".join(f"{value:.10g}" for value in plot),
        data_y=f"{scale_y.low:.10g} {scale_y.high:.10g}",
    )


def _series(series: Series, x: Scale, y: Scale) -> str:
    parts = []
    for xs, ys in series.faint:
        parts += [
            path(_pixels(xs[piece], ys[piece], x, y), class_="seed") for piece in _pieces(xs, ys)
        ]
    if series.low is not None and series.high is not None:
        for piece in _pieces(series.x, series.low + series.high):
            upper = _pixels(series.x[piece], series.high[piece], x, y)
            lower = _pixels(series.x[piece], series.low[piece], x, y)
            parts.append(band(upper, lower, class_="band"))
    for piece in _pieces(series.x, series.y):
        points = _pixels(series.x[piece], series.y[piece], x, y)
        parts.append(path(points, class_="line dashed" if series.dashed else "line"))
        if len(points) == 1:
            parts.append(element("circle", cx=points[0][0], cy=points[0][1], r=3, class_="dot"))
    data = ";".join(
        f"{a:.9g},{b:.9g}"
        for a, b in zip(series.x.tolist(), series.y.tolist(), strict=True)
        if np.isfinite(b)
    )
    return element(
        "g", *parts, class_=f"series {series.colour}", data_name=series.name, data_points=data
    )


def _pieces(x: np.ndarray, y: np.ndarray) -> list[slice]:
    """Stretches without a gap."""
    good = np.isfinite(x) & np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _pixels(xs: np.ndarray, ys: np.ndarray, x: Scale, y: Scale) -> list[tuple[float, float]]:
    return [(x(float(a)), y(float(b))) for a, b in zip(xs, ys, strict=True)]
