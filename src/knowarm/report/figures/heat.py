"""A knowledge vector in slots goes in; a image with one cell a number comes out."""

from collections.abc import Sequence

import numpy as np

from knowarm.report.figures.svg import drawing, element, hover, label

CELLS_A_ROW = 25


def heat_strip(matrix: np.ndarray, names: Sequence[str], title: str, *, width: float = 560) -> str:
    """Draw each slot as rows of cells: blue below zero, orange above, pale near zero.

    Args:
        matrix: (S, D) the slots.
        names: one a slot.
        title: what a screen reader says.
        width: of the drawing [px].
    """
    largest = float(np.abs(matrix).max()) if matrix.size else 0.0
    cell = width / CELLS_A_ROW
    rows = -(-matrix.shape[1] // CELLS_A_ROW) if matrix.size else 0
    height = min(cell, 16.0)
    parts: list[str] = []
    y = 0.0
    for slot, name in zip(matrix, names, strict=True):
        norm = float(np.linalg.norm(slot.astype(np.float64)))
        parts.append(label(0, y + 13, name, class_="row-name"))
        parts.append(label(width, y + 13, f"norm {norm:.2f}", class_="tick", text_anchor="end"))
        y += 20
        for i, value in enumerate(slot.tolist()):
            share = abs(value) / largest if largest else 0.0
            parts.append(
                element(
                    "rect",
                    hover(f"{name} [{i}] {value:.4f}"),
                    x=(i % CELLS_A_ROW) * cell,
                    y=y + (i // CELLS_A_ROW) * height,
                    width=cell - 1,
                    height=height - 1,
                    class_="cell up" if value > 0 else "cell down",
                    fill_opacity=round(0.06 + 0.94 * share, 3),
                )
            )
        y += rows * height + 12
    return drawing(width, max(y, 1.0), title, *parts, class_="chart heat")
