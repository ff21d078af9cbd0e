"""Counts by part go in; stacked bars on a common scale come out."""

from collections.abc import Mapping

from knowarm.report import format
from knowarm.report.figures.svg import drawing, element, hover, label

SHADES = ("s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7")
ROW = 46


def stacked_bars(counts: Mapping[str, Mapping[str, int]], title: str, *, width: float = 560) -> str:
    """Draw one bar a name, its parts from left to right in the order they come.

    Args:
        counts: parts and their counts for each name.
        title: what a screen reader says.
        width: of the drawing [px].
    """
    largest = max((sum(parts.values()) for parts in counts.values()), default=0) or 1
    groups = list(dict.fromkeys(part for parts in counts.values() for part in parts))
    rows = []
    for row, (name, parts) in enumerate(counts.items()):
        y, x = row * ROW, 0.0
        total = sum(parts.values())
        rows.append(label(0, y + 13, name, class_="row-name"))
        rows.append(label(width, y + 13, format.integer(total), class_="tick", text_anchor="end"))
        for part, count in parts.items():
            extent = width * count / largest
            rows.append(
                element(
                    "rect",
                    hover(f"{name}: {part} {format.integer(count)}"),
                    x=x,
                    y=y + 19,
                    width=max(extent - 1, 0.5),
                    height=15,
                    class_=f"bar {SHADES[groups.index(part) % len(SHADES)]}",
                )
            )
            x += extent
    return drawing(width, max(ROW * len(counts), 1), title, *rows, class_="chart bars")
