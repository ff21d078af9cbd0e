"""A table of numbers between -1 and 1 goes in; an SVG image of it comes out."""

from collections.abc import Sequence
from html import escape

import numpy as np

CELL, LETTER, TOP = 46, 7.2, 60
BLUE, RED = (33, 102, 172), (178, 24, 43)


def heatmap_svg(values: np.ndarray, rows: Sequence[str], title: str, note: str = "") -> str:
    """Draw a square table, such as cosines: white is 0, red 1, blue -1; each number is written.

    Args:
        values: (n, n) float; NaN is left blank.
        rows: names of rows and columns, n.
        title, note: heading and a line below it.

    Returns:
        The text of an SVG file.
    """
    left = 20 + LETTER * max(len(name) for name in rows)
    width = max(left + CELL * len(rows) + 20, 20 + 8.4 * max(len(title), 0.8 * len(note)))
    height = TOP + CELL * len(rows) + 34
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" font-size="13" '
        f'font-family="Helvetica, Arial, sans-serif">',
        f"<title>{escape(title)}</title>",
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        f'<text x="10" y="22" font-size="15" font-weight="bold" fill="#222">{escape(title)}</text>',
        f'<text x="10" y="42" fill="#555">{escape(note)}</text>',
    ]
    for i, name in enumerate(rows):
        middle = TOP + CELL * (i + 0.5) + 4
        parts.append(
            f'<text x="{left - 8:.1f}" y="{middle:.1f}" text-anchor="end" fill="#222">'
            f"{i + 1}. {escape(name)}</text>"
        )
        centre = left + CELL * (i + 0.5)
        parts.append(
            f'<text x="{centre:.1f}" y="{TOP + CELL * len(rows) + 18:.1f}" '
            f'text-anchor="middle" fill="#222">{i + 1}</text>'
        )
        for j, value in enumerate(values[i]):
            parts += _cell(left + CELL * j, TOP + CELL * i, float(value))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _cell(x: float, y: float, value: float) -> list[str]:
    if np.isnan(value):
        return []
    strength = min(abs(value), 1.0)
    target = RED if value > 0 else BLUE
    red, green, blue = (round(255 + (part - 255) * strength) for part in target)
    ink = "#ffffff" if strength > 0.6 else "#222222"
    return [
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{CELL}" height="{CELL}" '
        f'fill="rgb({red},{green},{blue})" stroke="#ffffff"/>',
        f'<text x="{x + CELL / 2:.1f}" y="{y + CELL / 2 + 4:.1f}" text-anchor="middle" '
        f'fill="{ink}">{value:.2f}</text>',
    ]
