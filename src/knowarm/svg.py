"""SVG builder: elements, text, paths and drawings as markup strings; pages and their style."""

import math
from collections.abc import Sequence
from html import escape as _escape_markup
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

_NOT_XML = dict.fromkeys(
    (*range(9), 11, 12, *range(14, 32), *range(0xD800, 0xE000), 0xFFFE, 0xFFFF)
)
"""Characters that XML cannot hold, not even escaped."""

Point = tuple[float, float]  # x and y [px]; y points down
FONT = "Helvetica, Arial, sans-serif"  # of `document`; inline drawings have that of their page


def style_sheet() -> str:
    """Return the style sheet of all pages that KnowArm writes: reports, answers, leaderboard."""
    return (files("knowarm") / "style.css").read_text(encoding="utf-8")


def render_page(package: str, template: str, **values: Any) -> str:
    """Render a self-contained HTML page from a template of a package, with the style sheet."""
    loader = PackageLoader(package)
    pages = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return pages.get_template(template).render(values, style=Markup(style_sheet()))


def escape(text: str, *, quote: bool = False) -> str:
    """Escape text for markup, without the characters that XML cannot hold."""
    return _escape_markup(text.translate(_NOT_XML), quote=quote)


def element(tag: str, *children: str, **attributes: object) -> str:
    """Return one element around markup, which is not escaped; use `label` for text.

    Values of attributes are escaped. ``class_`` becomes ``class``, underscores become hyphens,
    floats are rounded to two decimals, and None leaves the attribute out.
    """
    start = tag
    for name, value in attributes.items():
        if value is not None:
            name = name.rstrip("_").replace("_", "-")
            start += f' {name}="{escape(number(value), quote=True)}"'
    inner = "".join(children)
    if not inner:
        return f"<{start}/>"
    return f"<{start}>{inner}</{tag}>"


def label(x: float, y: float, words: str, **attributes: object) -> str:
    """Return a text element whose baseline starts at (x, y)."""
    return element("text", escape(words), x=x, y=y, **attributes)


def hover(words: str) -> str:
    """Return a tooltip, to be a child of the element that shows it."""
    return element("title", escape(words))


def path(points: Sequence[Point], *children: str, **attributes: object) -> str:
    """Return a polyline through points."""
    return element("path", *children, d=_polyline(points), **attributes)


def band(upper: Sequence[Point], lower: Sequence[Point], **attributes: object) -> str:
    """Return the closed area between two polylines of equal x."""
    return element("path", d=_polyline([*upper, *reversed(lower)]) + "Z", **attributes)


def curve(
    start: Point,
    end: Point,
    *children: str,
    bend: float | None = None,
    **attributes: object,
) -> str:
    """Return a cubic curve that leaves and arrives horizontally.

    ``bend`` is how far the curve swings out to the right of ``start`` [px], for points above each
    other; None draws an S through the middle.
    """
    turn = (start[0] + end[0]) / 2
    if bend is not None:
        turn = start[0] + bend
    middle = number(turn)
    x0, y0 = map(number, start)
    x1, y1 = map(number, end)
    data = f"M{x0} {y0}C{middle} {y0} {middle} {y1} {x1} {y1}"
    return element("path", *children, d=data, **attributes)


def drawing(
    width: float, height: float, name: str, *children: str, **attributes: object
) -> str:
    """Return an inline ``<svg>`` element that takes its colours from the page's style sheet.

    Width and height are in pixels; ``name`` is the text alternative for screen readers.
    """
    return element(
        "svg",
        *children,
        viewBox=f"0 0 {number(width)} {number(height)}",
        width=width,
        height=height,
        role="img",
        aria_label=name,
        **attributes,
    )


def document(
    width: float, height: float, name: str, *children: str, description: str = ""
) -> str:
    """Return the text of a standalone SVG file with a white background.

    ``name`` is its title; ``description`` is a longer text alternative, "" leaves it out.
    """
    lines = ["", hover(name)]
    if description:
        lines.append(element("desc", escape(description)))
    lines.append(element("rect", width="100%", height="100%", fill="#ffffff"))
    lines += [*children, ""]
    markup = drawing(
        width,
        height,
        name,
        "\n".join(lines),
        xmlns="http://www.w3.org/2000/svg",
        font_family=FONT,
        font_size=13,
    )
    return f"{markup}\n"


def text_width(words: str, font_size: float = 13) -> float:
    """Estimate the width of text in a sans-serif font [px]: 0.57 em per character."""
    return 0.57 * font_size * len(words)


def number(value: object) -> str:
    """Return an attribute's value as text: floats with at most two decimals, NaN as 0."""
    if not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return "0"
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _polyline(points: Sequence[Point]) -> str:
    """Return the path data of straight lines through points."""
    return "M" + "L".join(f"{number(x)} {number(y)}" for x, y in points)
