"""Diagrams with one row per item in SVG: dot charts, confusion matrices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from knowarm.report import format
from knowarm.report.charts import Axis, Box, Scale, fit
from knowarm.report.model import Evaluated
from knowarm.statistics import Interval
from knowarm.svg import drawing, element, hover, label, text_width

ROW = 34  # height of a row of a dot chart [px]
WIDTH = 560.0  # of a confusion matrix [px]
CONFUSION_CELL = 34.0  # largest side of a cell of a confusion matrix [px]


@dataclass(frozen=True, kw_only=True)
class Dot:
    """One row of a dot chart."""

    name: str  # name of the row
    colour: str  # palette class
    value: Interval | None  # the estimate with its interval, or None
    single: Sequence[float] = ()  # values of the training seeds, drawn small
    ring: float | None = None  # another value for comparison, such as the paper's, drawn as a ring


def group_dot(
    group: Evaluated, key: str, colours: Mapping[str, str], ring: float | None = None
) -> Dot:
    """Return the row of one number of a summary: the mean over seeds, and each seed."""
    single = group.scores(key).tolist() if len(group.evaluations) > 1 else []
    name, value = group.name, group.level(key)
    return Dot(name=name, colour=colours[name], value=value, single=single, ring=ring)


def dot_chart(
    dots: Sequence[Dot],
    name: str,
    axis: Axis,
    *,
    zero: bool = False,
    width: float = 400,
    left: float = 96,
) -> str:
    """Draw one row per estimate; ``zero`` adds a line, ``left`` is least space for names [px]."""
    space = max([left, *(text_width(dot.name) + 14 for dot in dots)])
    size = {"width": max(width, space + 184), "height": ROW * len(dots) + 52}
    box = Box(**size, left=space, right=24, top=8, bottom=44)
    values = [0.0] if zero else []
    for dot in dots:
        ends = (dot.value.estimate, dot.value.low, dot.value.high) if dot.value else ()
        values += [*ends, *dot.single, *([] if dot.ring is None else [dot.ring])]
    x = Scale(*axis.range, *box.x) if axis.range else fit(values, *box.x)
    bottom, top = box.y
    parts = []
    ticks = x.ticks(max(2, int((box.x[1] - box.x[0]) / 70)))
    for value, words in zip(ticks, axis.labels(ticks), strict=True):
        at = x(value)
        parts.append(element("line", class_="grid", x1=at, x2=at, y1=top, y2=bottom))
        parts.append(label(at, bottom + 16, words, class_="tick", text_anchor="middle"))
    if zero:
        parts.append(element("line", class_="zero", x1=x(0), x2=x(0), y1=top, y2=bottom))
    parts.append(label(box.x[1], bottom + 34, axis.title, class_="axis-title", text_anchor="end"))
    frame = element("g", *parts, class_="axes", aria_hidden="true")
    rows = [_dot_row(dot, top + ROW * (i + 0.5), x, box, axis) for i, dot in enumerate(dots)]
    return drawing(box.width, box.height, name, frame, *rows, class_="chart dots")


def _dot_row(dot: Dot, y: float, x: Scale, box: Box, axis: Axis) -> str:
    parts = [label(box.left - 10, y + 4, dot.name, class_="row-name", text_anchor="end")]
    parts += [element("circle", cx=x(v), cy=y + 9, r=2.2, class_="single") for v in dot.single]
    words = dot.name
    if (value := dot.value) is not None:
        words += f": {axis.text(value.estimate)}"
        if value.low < value.high:
            low, high = max(value.low, x.low), min(value.high, x.high)
            parts.append(element("line", x1=x(low), x2=x(high), y1=y, y2=y, class_="whisker"))
            words += f" ({axis.text(value.low)} to {axis.text(value.high)})"
        parts.append(element("circle", cx=x(value.estimate), cy=y, r=5, class_="dot"))
    if dot.ring is not None:
        parts.append(element("circle", cx=x(dot.ring), cy=y, r=5, class_="ring"))
    return element("g", hover(words), *parts, class_=f"row {dot.colour}", data_name=dot.name)


def confusion_map(
    shares: np.ndarray, rows: Sequence[str], columns: Sequence[str], title: str
) -> str:
    """Draw (R, C) shares in 0..1 as cells: the larger the share, the darker."""
    left = 8 + max(text_width(each) for each in rows)
    below = 8 + max(text_width(each) for each in columns)
    size = min(CONFUSION_CELL, (WIDTH - left) / len(columns))
    parts = []
    for i, (row, values) in enumerate(zip(rows, shares.tolist(), strict=True)):
        y = i * size
        parts.append(label(left - 6, y + size / 2 + 4, row, class_="row-name", text_anchor="end"))
        for j, (column, share) in enumerate(zip(columns, values, strict=True)):
            words = f"{row}, chosen {column}: {format.percent(share, 0)}"
            cell = {"x": left + j * size, "y": y, "width": size - 1, "height": size - 1}
            shade = round(0.06 + 0.94 * share, 3)
            parts.append(element("rect", hover(words), **cell, class_="cell", fill_opacity=shade))
    bottom = len(rows) * size
    for j, column in enumerate(columns):
        x, y = left + (j + 0.5) * size + 4, bottom + 6
        turned = {"transform": f"rotate(-90 {x:.6g} {y:.6g})", "text_anchor": "end"}
        parts.append(label(x, y, column, class_="tick", **turned))
    width = left + len(columns) * size
    return drawing(width, bottom + below, title, *parts, class_="chart heat")
