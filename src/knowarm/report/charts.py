"""Charts with two axes in SVG: scales, axes, line charts, density charts."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from knowarm.report import format
from knowarm.svg import Point, band, drawing, element, label, path

BINS = 48  # of a density chart


@dataclass(frozen=True)
class Scale:
    """Linear map from values to pixels."""

    low: float  # value at ``start``
    high: float  # value at ``end``; above ``low``
    start: float  # first pixel
    end: float  # last pixel; below ``start`` for a vertical axis

    def __call__(self, value: float) -> float:
        """Return the pixel of a value."""
        share = (value - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)

    def ticks(self, count: int = 5) -> list[float]:
        """Return about ``count`` round values inside the range."""
        rough = (self.high - self.low) / max(1, count)
        power = 10.0 ** math.floor(math.log10(rough))
        step = min((m * power for m in (1, 2, 2.5, 5, 10)), key=lambda s: abs(math.log(s / rough)))
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [round(i * step, 12) for i in range(first, last + 1)]


def fit(values: Iterable[float], start: float, end: float) -> Scale:
    """Return a scale that covers all finite values with some margin."""
    finite = [value for value in values if math.isfinite(value)] or [0.0, 1.0]
    low, high = min(finite), max(finite)
    margin = (high - low) * 0.06 or abs(high) * 0.1 or 1.0
    return Scale(low - margin, high + margin, start, end)


@dataclass(frozen=True)
class Box:
    """Size of a drawing and of the margins around its plot area [px]."""

    width: float = 400
    height: float = 250
    left: float = 46  # margin for the tick labels of the vertical axis
    right: float = 26  # margin
    top: float = 24  # margin for the title of the vertical axis
    bottom: float = 40  # margin for the tick labels and the title of the horizontal axis

    @property
    def x(self) -> tuple[float, float]:
        """First and last pixel of the plot area."""
        return self.left, self.width - self.right

    @property
    def y(self) -> tuple[float, float]:
        """First and last pixel of the plot area, from bottom to top."""
        return self.height - self.bottom, self.top


BOXES: Mapping[Literal["large", "small"], Box] = {
    "large": Box(width=530, height=310),
    "small": Box(width=350, height=250, left=44),
}
"""Sizes of a chart on large and on small screens, so that its text stays readable."""
STARTS = (0.0, 0.5, 0.75, 0.9)
"""Where an axis of shares may start."""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Title and tick labels of an axis."""

    title: str  # title, with the unit
    format: Callable[[float, int], str] = format.number  # formats a value with a number of decimals
    decimals: int = 0  # fewest decimals; tick labels have as many as their values need
    unit: float = 1.0  # shown number of the value 1: 100 for per cent
    range: tuple[float, float] | None = None  # ends of the axis; None fits the data

    def text(self, value: float) -> str:
        """Format a value, for tooltips."""
        return self.format(value, self.decimals)

    def labels(self, ticks: Sequence[float]) -> list[str]:
        """Format ticks so that no label is rounded to another value."""
        shown = [tick * self.unit for tick in ticks]
        decimals = self.decimals
        while decimals < 9 and any(abs(round(v, decimals) - v) > 1e-9 * abs(v) for v in shown):
            decimals += 1
        return [self.format(tick, decimals) for tick in ticks]


def percent_axis(title: str, *, whole: bool = True) -> Axis:
    """Return an axis of fractions in per cent; ``whole`` shows all of 0 to 100 %."""
    return Axis(title=title, format=format.percent, unit=100, range=(0.0, 1.0) if whole else None)


def near(axis: Axis, values: Iterable[float]) -> Axis:
    """Return an axis of shares that starts just below the smallest value."""
    smallest = min(values, default=0.0)
    return replace(axis, range=(max(start for start in STARTS if start <= max(smallest, 0)), 1.0))


STEPS_AXIS = Axis(title="environment steps", format=lambda value, _: format.steps(value))
SUCCESS_AXIS = percent_axis("success")
CHOICE_AXIS = percent_axis("right choices")
RETURN_AXIS = Axis(title="mean return")
POINTS_AXIS = Axis(title="difference [points]", format=format.points, unit=100)


def axes(box: Box, x: Scale, y: Scale, x_axis: Axis, y_axis: Axis) -> str:
    """Draw grid lines, tick labels and axis titles; the vertical axis has its title on top."""
    left, right = box.x
    bottom, top = box.y
    parts = []
    ticks = y.ticks(4)
    for value, words in zip(ticks, y_axis.labels(ticks), strict=True):
        at = y(value)
        parts.append(element("line", class_="grid", x1=left, x2=right, y1=at, y2=at))
        parts.append(label(left - 6, at + 4, words, class_="tick", text_anchor="end"))
    ticks = x.ticks(max(4, int((right - left) / 85)))
    for value, words in zip(ticks, x_axis.labels(ticks), strict=True):
        at = x(value)
        parts.append(element("line", class_="mark", x1=at, x2=at, y1=bottom, y2=bottom + 4))
        parts.append(label(at, bottom + 17, words, class_="tick", text_anchor="middle"))
    parts.append(element("line", class_="axis", x1=left, x2=right, y1=bottom, y2=bottom))
    parts.append(label(left - 40, top - 11, y_axis.title, class_="axis-title"))
    end = {"class_": "axis-title", "text_anchor": "end"}
    parts.append(label(right, bottom + 33, x_axis.title, **end))
    return element("g", *parts, class_="axes", aria_hidden="true")


@dataclass(frozen=True, kw_only=True)
class Series:
    """One line of a line chart."""

    name: str  # name in the legend
    colour: str  # palette class
    x: np.ndarray  # (n,) float64, increasing
    y: np.ndarray  # (n,) float64; NaN where there is no value
    band: tuple[np.ndarray, np.ndarray] | None = None  # (n,) its lower and upper end
    faint: Sequence[tuple[np.ndarray, np.ndarray]] = ()  # (x, y) of thin lines, one per seed
    dashed: bool = False  # whether the line is dashed, which distinguishes it without colour
    stairs: bool = False  # whether each value holds until the next x


def line_chart(
    series: Sequence[Series], name: str, x_axis: Axis, y_axis: Axis, *, box: Box | None = None
) -> str:
    """Draw lines over their bands; the page's script shows the values under the pointer."""
    box = box or Box()
    xs = np.concatenate([each.x for each in series])
    low, high = float(xs.min()), float(xs.max())
    x = Scale(low, high, *box.x) if high > low else Scale(min(low, 0.0), max(high, 5.0), *box.x)
    if y_axis.range is None:
        arrays = [a for s in series for a in (s.y, *(s.band or ()), *(ys for _, ys in s.faint))]
        y = fit(np.concatenate(arrays).tolist(), *box.y)
    else:
        y = Scale(*y_axis.range, *box.y)
    return drawing(
        box.width,
        box.height,
        name,
        axes(box, x, y, x_axis, y_axis),
        *(_line(each, x, y) for each in series),
        class_="chart lines many" if len(series) > 3 else "chart lines",
        data_plot=" ".join(f"{v:.10g}" for v in (x.start, x.end, x.low, x.high, y.start, y.end)),
        data_y=f"{y.low:.10g} {y.high:.10g}",
    )


def _line(series: Series, x: Scale, y: Scale) -> str:
    def pixels(xs: np.ndarray, ys: np.ndarray) -> list[Point]:
        if series.stairs:
            xs, ys = np.repeat(xs, 2)[1:], np.repeat(ys, 2)[:-1]
        return [(x(float(a)), y(float(b))) for a, b in zip(xs, ys, strict=True)]

    parts = []
    for xs, ys in series.faint:
        parts += [path(pixels(xs[p], ys[p]), class_="seed") for p in _gapless(xs, ys)]
    if series.band is not None:
        for p in _gapless(series.x, np.add(*series.band)):
            lower, upper = (pixels(series.x[p], end[p]) for end in series.band)
            parts.append(band(upper, lower, class_="band"))
    for p in _gapless(series.x, series.y):
        points = pixels(series.x[p], series.y[p])
        parts.append(path(points, class_="line dashed" if series.dashed else "line"))
        if len(points) == 1:
            parts.append(element("circle", cx=points[0][0], cy=points[0][1], r=3, class_="dot"))
    finite = np.isfinite(series.y)
    shown = zip(series.x[finite].tolist(), series.y[finite].tolist(), strict=True)
    data = {"data_name": series.name, "data_points": ";".join(f"{a:.9g},{b:.9g}" for a, b in shown)}
    return element("g", *parts, class_=f"series {series.colour}", **data)


def _gapless(x: np.ndarray, y: np.ndarray) -> list[slice]:
    """Return the longest slices in which all values are finite."""
    good = np.isfinite(x) & np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def histograms(samples: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Compute densities, (BINS,) each, on (BINS + 1,) edges around all but the outermost 0.1 %."""
    low = min(float(np.quantile(each, 0.001)) for each in samples)
    high = max(float(np.quantile(each, 0.999)) for each in samples)
    edges = np.linspace(low, high if high > low else low + 1e-3, BINS + 1)
    width = edges[1] - edges[0]
    return edges, [np.histogram(each, edges)[0] / (each.size * width) for each in samples]


def density_chart(
    samples: Mapping[str, np.ndarray], colours: Mapping[str, str], name: str, x_title: str
) -> str:
    """Draw distributions, (n_i,) samples by name, as filled steps with a line at each mean."""
    box = Box(width=320, height=190, left=40, top=26)
    edges, heights = histograms(list(samples.values()))
    x = Scale(float(edges[0]), float(edges[-1]), *box.x)
    y = Scale(0.0, 1.08 * max(float(each.max()) for each in heights) or 1.0, *box.y)
    x_axis, y_axis = (Axis(title=title, decimals=1) for title in (x_title, "density"))
    parts = [axes(box, x, y, x_axis, y_axis)]
    corners = np.repeat(edges, 2).tolist()
    for (agent, values), height in zip(samples.items(), heights, strict=True):
        levels = [0.0, *np.repeat(height, 2).tolist(), 0.0]
        points = [(x(a), y(b)) for a, b in zip(corners, levels, strict=True)]
        mean = x(min(max(float(values.mean()), x.low), x.high))
        line = element("line", x1=mean, x2=mean, y1=y(0), y2=box.top, class_="mean")
        kind = f"series {colours[agent]}"
        parts.append(element("g", path(points, class_="area"), line, class_=kind, data_name=agent))
    return drawing(box.width, box.height, name, *parts, class_="chart density")
