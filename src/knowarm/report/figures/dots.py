"""Estimates with intervals go in; a row of dots with whiskers for each comes out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from knowarm.report import format
from knowarm.report.figures.frame import Box
from knowarm.report.figures.scale import Scale, fit
from knowarm.report.figures.svg import drawing, element, hover, label

ROW = 34


@dataclass(frozen=True, kw_only=True)
class Dot:
    """One row.

    Attributes:
        name: left of the row.
        colour: palette class.
        value: the estimate, or None where there is none.
        low: lower end of its interval.
        high: upper end.
        single: values of the training seeds, drawn small.
        beside: another value to compare with, such as the paper's, drawn as a ring.
    """

    name: str
    colour: str
    value: float | None
    low: float | None = None
    high: float | None = None
    single: Sequence[float] = ()
    beside: float | None = None


def dot_chart(
    dots: Sequence[Dot],
    name: str,
    *,
    x_title: str,
    x_format: Callable[[float], str] = format.number,
    x_range: tuple[float, float] | None = None,
    zero: bool = False,
    width: float = 400,
    left: float = 96,
) -> str:
    """Draw one row a dot: the estimate, its interval, the seeds behind it.

    Args:
        dots: rows, from the top.
        name: what a screen reader says.
        x_title: title of the axis, with its unit.
        x_format: of tick labels and values.
        x_range: ends of the axis; None fits the data.
        zero: whether zero is drawn as the line of no difference.
        width: of the drawing [px].
        left: room for the names [px].
    """
    box = Box(width=width, height=ROW * len(dots) + 52, left=left, right=24, top=8, bottom=44)
    values = [v for d in dots for v in (d.value, d.low, d.high, d.beside, *d.single)]
    shown = [v for v in values if v is not None] + ([0.0] if zero else [])
    x = Scale(*x_range, *box.x) if x_range else fit(shown, *box.x)
    bottom, top = box.y
    parts = []
    for value in x.ticks(max(2, int((box.x[1] - box.x[0]) / 70))):
        at = x(value)
        parts.append(element("line", class_="grid", x1=at, x2=at, y1=top, y2=bottom))
        parts.append(label(at, bottom + 16, x_format(value), class_="tick", text_anchor="middle"))
    if zero:
        parts.append(element("line", class_="zero", x1=x(0), x2=x(0), y1=top, y2=bottom))
    parts.append(label(box.x[1], bottom + 34, x_title, class_="axis-title", text_anchor="end"))
    frame = element("g", *parts, class_="axes", aria_hidden="true")
    rows = [_row(dot, top + ROW * (i + 0.5), x, box, x_format) for i, dot in enumerate(dots)]
    return drawing(box.width, box.height, name, frame, *rows, class_="chart dots")


def _row(dot: Dot, y: float, x: Scale, box: Box, shown: Callable[[float], str]) -> str:
    parts = [label(box.left - 10, y + 4, dot.name, class_="row-name", text_anchor="end")]
    parts += [element("circle", cx=x(v), cy=y + 9, r=2.2, class_="single") for v in dot.single]
    words = dot.name
    if dot.value is not None:
        if dot.low is not None and dot.high is not None:
            low, high = max(dot.low, x.low), min(dot.high, x.high)
            parts.append(element("line", x1=x(low), x2=x(high), y1=y, y2=y, class_="whisker"))
            words += f": {shown(dot.value)} ({shown(dot.low)} to {shown(dot.high)})"
        else:
            words += f": {shown(dot.value)}"
        parts.append(element("circle", cx=x(dot.value), cy=y, r=5, class_="dot"))
    if dot.beside is not None:
        parts.append(element("circle", cx=x(dot.beside), cy=y, r=5, class_="ring"))
    parts.insert(0, hover(words))
    return element("g", *parts, class_=f"row {dot.colour}", data_name=dot.name)
