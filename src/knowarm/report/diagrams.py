"""Diagrams with one row per item in SVG: dot charts, confusion matrices."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from knowarm.arrays import Floats
from knowarm.report.blocks import DataTable, Panel
from knowarm.report.charts import Axis, Box, Scale, axis_below, frame, rule, tick
from knowarm.report.format import percent
from knowarm.report.model import Evaluated
from knowarm.statistics import Interval
from knowarm.svg import drawing, element, hover, label, text_width

LEAST_SPACE = 100.0  # for the names of the rows of a dot chart [px]
ROW = 34  # height of a row of a dot chart [px]
WIDTH = 560.0  # of a confusion matrix [px]
CONFUSION_CELL = 34.0  # largest side of a cell of a confusion matrix [px]


@dataclass(frozen=True)
class Dot:
    """One row of a dot chart."""

    name: str  # name of the row
    colour: str  # palette class
    value: Interval | None  # the estimate with its interval, or None
    single: Sequence[float] = ()  # values of the training seeds, drawn small
    # Another value for comparison, such as the paper's, drawn as a ring.
    ring: float | None = None


def dot_panels(
    table: DataTable,
    key: str,
    axis: Axis,
    *,
    seeds: bool = False,
    zero: bool = False,
    width: float = 400,
) -> list[Panel]:
    """Draw a column of a table: one dot chart per title ``_panel`` of its rows.

    Rows without such a title are not drawn. ``seeds`` adds the values of the training seeds, and a
    column ``paper_<key>`` is drawn as a ring.
    """
    charts: dict[str, list[Dot]] = {}
    for row in table.rows:
        if "_panel" in row:
            agent: Evaluated = row["_agent"]
            single = []
            if seeds and len(agent.evaluations) > 1:
                single = agent.scores(key).tolist()
            name = row.get("_name", agent.name)
            ring = row.get(f"paper_{key}")
            dot = Dot(name, agent.colour, row[key], single, ring)
            charts.setdefault(row["_panel"], []).append(dot)
    panels = []
    for title, dots in charts.items():
        name = f"{table.title}, {title}"
        panels.append(Panel(dot_chart(dots, name, axis, zero=zero, width=width), title))
    return panels


def dot_chart(
    dots: Sequence[Dot],
    name: str,
    axis: Axis,
    *,
    zero: bool = False,
    width: float = 400,
) -> str:
    """Draw one row per estimate; ``zero`` adds a line at 0."""
    space = max(LEAST_SPACE, *(text_width(dot.name) + 14 for dot in dots))
    box = Box(
        width=max(width, space + 184),
        height=ROW * len(dots) + 52,
        left=space,
        right=24,
        top=8,
        bottom=44,
    )
    bottom, top = box.y
    x = axis.scale(_drawn_values(dots, zero), box.x)
    elements = axis_below(box, x, axis, is_grid=True)
    if zero:
        elements.append(rule("zero", x(0), x(0), top, bottom))
    rows = [
        _dot_row(dot, top + ROW * (i + 0.5), x, box, axis) for i, dot in enumerate(dots)
    ]
    return drawing(
        box.width, box.height, name, frame(elements), *rows, class_="chart dots"
    )


def _drawn_values(dots: Sequence[Dot], zero: bool) -> list[float]:
    values = [0.0] if zero else []
    for dot in dots:
        values += dot.single
        if dot.value:
            values += [dot.value.estimate, dot.value.low, dot.value.high]
        if dot.ring is not None:
            values.append(dot.ring)
    return values


def _dot_row(dot: Dot, y: float, x: Scale, box: Box, axis: Axis) -> str:
    def circle(value: float, y: float, r: float, kind: str) -> None:
        elements.append(element("circle", cx=x(value), cy=y, r=r, class_=kind))

    words = dot.name
    elements = [_row_name(box.left - 10, y + 4, words)]
    for single in dot.single:
        circle(single, y + 9, 2.2, "single")
    value = dot.value
    if value:
        words += f": {axis.text(value.estimate)}"
        if value.low < value.high:
            start = x(max(value.low, x.low))
            end = x(min(value.high, x.high))
            elements.append(
                element("line", x1=start, x2=end, y1=y, y2=y, class_="whisker")
            )
            words += f" ({axis.text(value.low)} to {axis.text(value.high)})"
        circle(value.estimate, y, 5, "dot")
    if dot.ring is not None:
        circle(dot.ring, y, 5, "ring")
    return element(
        "g", hover(words), *elements, class_=f"row {dot.colour}", data_name=dot.name
    )


def confusion_map(
    shares: Floats, rows: Sequence[str], columns: Sequence[str], title: str
) -> str:
    """Draw (R, C) shares in 0..1 as cells: the larger the share, the darker."""
    left = 8 + max(map(text_width, rows))
    below = 8 + max(map(text_width, columns))
    size = min(CONFUSION_CELL, (WIDTH - left) / len(columns))
    bottom = len(rows) * size
    elements = []
    for i, row in enumerate(rows):
        middle = (i + 0.5) * size + 4
        elements.append(_row_name(left - 6, middle, row))
    for j, column in enumerate(columns):  # their names are turned
        x = left + (j + 0.5) * size + 4
        turn = f"rotate(-90 {x:.6g} {bottom + 6:.6g})"
        elements.append(
            element("g", tick(x, bottom + 6, column, "end"), transform=turn)
        )
    for (i, j), share in np.ndenumerate(shares):
        cell = element(
            "rect",
            hover(f"{rows[i]}, chosen {columns[j]}: {percent(share, 0)}"),
            x=left + j * size,
            y=i * size,
            width=size - 1,
            height=size - 1,
            class_="cell",
            fill_opacity=round(0.06 + 0.94 * float(share), 3),
        )
        elements.append(cell)
    width = left + len(columns) * size
    return drawing(width, bottom + below, title, *elements, class_="chart heat")


def _row_name(x: float, y: float, name: str) -> str:
    return label(x, y, name, class_="row-name", text_anchor="end")
