"""Scales go in; axes with grid, ticks and titles come out."""

from collections.abc import Callable
from dataclasses import dataclass

from knowarm.report.figures.scale import Scale
from knowarm.report.figures.svg import element, label


@dataclass(frozen=True)
class Box:
    """Size of a drawing and of the margins around its plot area [px].

    Attributes:
        width: of the whole drawing.
        height: of the whole drawing.
        left: margin that holds the labels of the upright axis.
        right: margin.
        top: margin that holds the title of the upright axis.
        bottom: margin that holds the labels of the level axis.
    """

    width: float = 400
    height: float = 250
    left: float = 46
    right: float = 14
    top: float = 24
    bottom: float = 40

    @property
    def x(self) -> tuple[float, float]:
        """First and last pixel of the plot area, level."""
        return self.left, self.width - self.right

    @property
    def y(self) -> tuple[float, float]:
        """First and last pixel of the plot area, from the bottom up."""
        return self.height - self.bottom, self.top


def axes(
    box: Box,
    x: Scale,
    y: Scale,
    *,
    x_title: str,
    y_title: str,
    x_format: Callable[[float], str],
    y_format: Callable[[float], str],
) -> str:
    """Grid lines, tick labels and the titles of both axes; the upright one's stands on top."""
    left, right = box.x
    bottom, top = box.y
    parts = []
    for value in y.ticks(4):
        level = y(value)
        parts.append(element("line", class_="grid", x1=left, x2=right, y1=level, y2=level))
        parts.append(label(left - 6, level + 4, y_format(value), class_="tick", text_anchor="end"))
    for value in x.ticks(max(4, int((right - left) / 85))):
        place = x(value)
        parts.append(element("line", class_="mark", x1=place, x2=place, y1=bottom, y2=bottom + 4))
        parts.append(
            label(place, bottom + 17, x_format(value), class_="tick", text_anchor="middle")
        )
    parts.append(element("line", class_="axis", x1=left, x2=right, y1=bottom, y2=bottom))
    parts.append(label(left - 40, top - 11, y_title, class_="axis-title"))
    parts.append(label(right, bottom + 33, x_title, class_="axis-title", text_anchor="end"))
    return element("g", *parts, class_="axes", aria_hidden="true")
