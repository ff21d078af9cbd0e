"""Charts with two axes in SVG: scales, axes, line charts, density charts."""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from knowarm import svg
from knowarm.arrays import Floats
from knowarm.report.format import facet, number, percent, points, steps
from knowarm.svg import Point, band, path

TEMPLATES = Environment(
    loader=PackageLoader("knowarm.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
"""Templates of a report, with the formats of numbers that they use."""
TEMPLATES.filters["px"] = svg.number
TEMPLATES.filters["facet"] = facet
CHARTS: Any = TEMPLATES.get_template("charts.svg.j2").module  # its macros
BINS = 48  # of a density chart
PIXELS_PER_TICK = 70  # of a horizontal axis, at least


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
        sizes = [multiple * power for multiple in (1, 2, 2.5, 5, 10)]
        step = min(sizes, key=lambda size: abs(math.log(size / rough)))
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [round(i * step, 12) for i in range(first, last + 1)]


def fit(values: Iterable[float], start: float, end: float) -> Scale:
    """Return a scale that covers all finite values with some margin."""
    finite = list(filter(math.isfinite, values)) or [0.0, 1.0]
    low = min(finite)
    high = max(finite)
    margin = (high - low) * 0.06 or abs(high) * 0.1 or 1.0
    return Scale(
        low=low - margin,
        high=high + margin,
        start=start,
        end=end,
    )


@dataclass(frozen=True)
class Box:
    """Size of a drawing and of the margins around its plot area [px]."""

    width: float = 400
    height: float = 250
    left: float = 46  # margin for the tick labels of the vertical axis
    right: float = 26  # margin
    top: float = 24  # margin for the title of the vertical axis
    bottom: float = 40  # margin for tick labels and title of the horizontal axis

    @property
    def x(self) -> tuple[float, float]:
        """First and last pixel of the plot area."""
        return self.left, self.width - self.right

    @property
    def y(self) -> tuple[float, float]:
        """First and last pixel of the plot area, from bottom to top."""
        return self.height - self.bottom, self.top

    @property
    def ticks_below(self) -> int:
        """Wanted number of ticks of the horizontal axis."""
        start, end = self.x
        return max(2, int((end - start) / PIXELS_PER_TICK))


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
    # Formats a value with a number of decimals.
    format: Callable[[float, int], str] = number
    decimals: int = 0  # fewest decimals; tick labels have as many as their values need
    unit: float = 1.0  # shown number of the value 1: 100 for per cent
    range: tuple[float, float] | None = None  # ends of the axis; None fits the data

    def text(self, value: float) -> str:
        """Format a value, for tooltips."""
        return self.format(value, self.decimals)

    def labels(self, ticks: Sequence[float]) -> list[str]:
        """Format ticks so that no label is rounded to another value."""
        values = np.multiply(ticks, self.unit)
        for decimals in range(self.decimals, 10):
            if np.allclose(values.round(decimals), values, rtol=1e-9, atol=0.0):
                break
        return [self.format(tick, decimals) for tick in ticks]

    def scale(self, values: Iterable[float], ends: tuple[float, float]) -> Scale:
        """Return the scale of the axis between two pixels; it fits the data without a range."""
        if self.range is None:
            return fit(values, *ends)
        return Scale(*self.range, *ends)

    def ticks(self, scale: Scale, count: int) -> list[tuple[float, str]]:
        """Return the pixels and labels of about ``count`` ticks."""
        values = scale.ticks(count)
        pixels = map(scale, values)
        return list(zip(pixels, self.labels(values), strict=True))


def percent_axis(title: str, *, whole: bool = True) -> Axis:
    """Return an axis of fractions in per cent; ``whole`` shows all of 0 to 100 %."""
    axis = Axis(title=title, format=percent, unit=100)
    return replace(axis, range=(0.0, 1.0)) if whole else axis


def near(axis: Axis, values: Iterable[float]) -> Axis:
    """Return an axis of shares that starts just below the smallest value."""
    smallest = max(min(values, default=0.0), 0.0)
    start = STARTS[bisect_right(STARTS, smallest) - 1]
    return replace(axis, range=(start, 1.0))


STEPS_AXIS = Axis(title="environment steps", format=lambda value, _: steps(value))
SUCCESS_AXIS = percent_axis("success")
CHOICE_AXIS = percent_axis("right choices")
RETURN_AXIS = Axis(title="mean return")
POINTS_AXIS = Axis(title="difference [points]", format=points, unit=100)


@dataclass(frozen=True, kw_only=True)
class Series:
    """One line of a line chart."""

    name: str  # name in the legend
    colour: str  # palette class
    x: Floats  # (n,) increasing
    y: Floats  # (n,) NaN where there is no value
    band: tuple[Floats, Floats] | None = None  # (n,) its lower and upper end
    faint: Sequence[tuple[Floats, Floats]] = ()  # (x, y) of thin lines, one per seed
    dashed: bool = False  # which distinguishes the line without colour
    stairs: bool = False  # whether each value holds until the next x

    @property
    def heights(self) -> Floats:
        """All drawn values."""
        faint = [thin for _, thin in self.faint]
        return np.concatenate([self.y, *(self.band or ()), *faint])

    @property
    def points(self) -> str:
        """The known values, as the page's script reads them."""
        known = np.isfinite(self.y)
        pairs = zip(self.x[known], self.y[known], strict=True)
        return ";".join(f"{step:.9g},{value:.9g}" for step, value in pairs)

    def markup(self, x: Scale, y: Scale) -> str:
        """Draw thin lines, the band and the line, each with its gaps."""

        def pixels(xs: Floats, ys: Floats) -> list[Point]:
            if self.stairs:
                xs = np.repeat(xs, 2)[1:]
                ys = np.repeat(ys, 2)[:-1]
            return list(zip(map(x, xs.tolist()), map(y, ys.tolist()), strict=True))

        elements: list[str] = []
        for xs, ys in self.faint:
            for piece in _gapless(xs, ys):
                corners = pixels(xs[piece], ys[piece])
                elements.append(path(corners, class_="seed"))
        if self.band is not None:
            lower, upper = self.band
            for piece in _gapless(self.x, lower + upper):
                top = pixels(self.x[piece], upper[piece])
                bottom = pixels(self.x[piece], lower[piece])
                elements.append(band(top, bottom, class_="band"))
        kind = "line dashed" if self.dashed else "line"
        for piece in _gapless(self.x, self.y):
            corners = pixels(self.x[piece], self.y[piece])
            elements.append(path(corners, class_=kind))
            if len(corners) == 1:
                elements.append(CHARTS.circle("dot", *corners[0], 3))
        return "".join(elements)


def line_chart(
    series: Sequence[Series],
    name: str,
    x_axis: Axis,
    y_axis: Axis,
    *,
    box: Box = BOXES["large"],
) -> str:
    """Draw lines over their bands; the page's script shows the values under the pointer."""
    xs = np.concatenate([line.x for line in series])
    low = float(xs.min())
    high = float(xs.max())
    if low == high:
        low = min(low, 0.0)
        high = max(high, 5.0)
    x = Scale(low, high, *box.x)
    heights = np.concatenate([line.heights for line in series])
    y = y_axis.scale(heights.tolist(), box.y)
    return CHARTS.line_chart(
        box=box,
        name=name,
        x=x,
        y=y,
        x_axis=x_axis,
        y_axis=y_axis,
        lines=series,
    )


def _gapless(x: Floats, y: Floats) -> list[slice]:
    """Return the longest slices in which all values are finite."""
    return np.ma.clump_unmasked(np.ma.masked_invalid(x + y))


def histograms(samples: Sequence[Floats]) -> tuple[Floats, list[Floats]]:
    """Compute densities, (BINS,) each, on (BINS + 1,) edges around all but the outermost 0.1 %."""
    low = min(np.quantile(values, 0.001) for values in samples)
    high = max(np.quantile(values, 0.999) for values in samples)
    edges = np.linspace(low, max(high, low + 1e-3), BINS + 1)
    return edges, [np.histogram(values, edges, density=True)[0] for values in samples]


def density_chart(
    samples: Mapping[str, Floats],
    colours: Mapping[str, str],
    name: str,
    x_title: str,
) -> str:
    """Draw distributions, (n_i,) samples by name, as filled steps with a line at each mean."""
    edges, heights = histograms(list(samples.values()))
    top = 1.08 * float(np.max(heights))
    lines = []
    for (agent, values), height in zip(samples.items(), heights, strict=True):
        mean = np.repeat(values.mean().clip(edges[0], edges[-1]), 2)
        steps = np.append(height, 0.0)
        line = Series(
            name=agent,
            colour=colours[agent],
            x=edges,
            y=steps,
            band=(np.zeros_like(steps), steps),
            faint=[(mean, np.array([0.0, top]))],
            stairs=True,
        )
        lines.append(line)
    x_axis = Axis(title=x_title, decimals=1)
    y_axis = Axis(title="density", decimals=1, range=(0.0, top))
    box = Box(width=320, height=190, left=40, top=26)
    return line_chart(lines, name, x_axis, y_axis, box=box)
