"""Diagrams with one row per item in SVG: dot charts."""

from collections.abc import Sequence
from dataclasses import dataclass

from knowarm.report.blocks import DataTable, Panel
from knowarm.report.charts import CHARTS, Axis, Box
from knowarm.report.model import Evaluated
from knowarm.statistics import Interval
from knowarm.svg import text_width

LEAST_SPACE = 100.0  # for the names of the rows of a dot chart [px]
ROW = 34  # height of a row of a dot chart [px]


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
            dot = Dot(
                name=name,
                colour=agent.colour,
                value=row[key],
                single=single,
                ring=ring,
            )
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
    x = axis.scale(_drawn_values(dots, zero), box.x)
    return CHARTS.dot_chart(
        box=box,
        name=name,
        x=x,
        axis=axis,
        dots=dots,
        zero=zero,
        row=ROW,
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
