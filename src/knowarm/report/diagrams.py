"""Diagrams with one row per item in SVG: dot charts, confusion matrices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from knowarm.arrays import Floats
from knowarm.report.blocks import Panel
from knowarm.report.charts import Axis, Box, Scale, rule
from knowarm.report.format import facet, percent
from knowarm.report.model import Evaluated, TaskData
from knowarm.statistics import Interval
from knowarm.svg import drawing, element, hover, label, text_width

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


def group_dot(
    task: TaskData, group: Evaluated, key: str, ring: float | None = None
) -> Dot:
    """Return the row of one number of a summary: the mean over seeds, and each seed."""
    single = []
    if len(group.evaluations) > 1:
        single = group.scores(key).tolist()
    return Dot(group.name, task.colours[group.name], group.level(key), single, ring)


def part_panels(dots: Mapping[str, Sequence[Dot]], axis: Axis) -> list[Panel]:
    """Draw one dot chart per target, facet or kind of query."""
    panels = []
    for part, rows in dots.items():
        title = facet(part)
        svg = dot_chart(rows, f"{axis.title} on {title}", axis, width=340, left=100)
        panels.append(Panel(svg, title))
    return panels


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
    box = Box(
        width=max(width, space + 184),
        height=ROW * len(dots) + 52,
        left=space,
        right=24,
        top=8,
        bottom=44,
    )
    start, end = box.x
    bottom, top = box.y
    x = axis.scale(_drawn_values(dots, zero), box.x)
    elements = []
    for at, words in axis.ticks(x, max(2, int((end - start) / 70))):
        elements.append(rule("grid", at, at, top, bottom))
        elements.append(
            label(at, bottom + 16, words, class_="tick", text_anchor="middle")
        )
    if zero:
        elements.append(rule("zero", x(0), x(0), top, bottom))
    elements.append(
        label(end, bottom + 34, axis.title, class_="axis-title", text_anchor="end")
    )
    frame = element("g", *elements, class_="axes", aria_hidden="true")
    rows = [
        _dot_row(dot, top + ROW * (i + 0.5), x, box, axis) for i, dot in enumerate(dots)
    ]
    return drawing(box.width, box.height, name, frame, *rows, class_="chart dots")


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
    elements = [
        label(box.left - 10, y + 4, words, class_="row-name", text_anchor="end")
    ]
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
        y = i * size
        elements.append(
            label(left - 6, y + size / 2 + 4, row, class_="row-name", text_anchor="end")
        )
        for j, column in enumerate(columns):
            share = float(shares[i, j])
            cell = element(
                "rect",
                hover(f"{row}, chosen {column}: {percent(share, 0)}"),
                x=left + j * size,
                y=y,
                width=size - 1,
                height=size - 1,
                class_="cell",
                fill_opacity=round(0.06 + 0.94 * share, 3),
            )
            elements.append(cell)
    y = bottom + 6  # of the names below, which are turned
    for j, column in enumerate(columns):
        x = left + (j + 0.5) * size + 4
        turn = f"rotate(-90 {x:.6g} {y:.6g})"
        elements.append(
            label(x, y, column, class_="tick", transform=turn, text_anchor="end")
        )
    width = left + len(columns) * size
    return drawing(width, bottom + below, title, *elements, class_="chart heat")
