"""Samples of two agents go in; their overlaid distributions come out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from knowarm.report import format
from knowarm.report.figures.frame import Box, axes
from knowarm.report.figures.scale import Scale
from knowarm.report.figures.svg import drawing, element, path

BINS = 48


@dataclass(frozen=True, kw_only=True)
class Density:
    """One distribution.

    Attributes:
        name: as the legend has it.
        colour: palette class.
        heights: (BINS,) float64 probability density.
        mean: of the samples.
    """

    name: str
    colour: str
    heights: np.ndarray
    mean: float


def densities(samples: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Histograms on common bins that hold all samples but the outermost 0.1 %.

    Returns:
        (BINS + 1,) edges, and (BINS,) densities a sample.
    """
    low = min(float(np.quantile(each, 0.001)) for each in samples)
    high = max(float(np.quantile(each, 0.999)) for each in samples)
    edges = np.linspace(low, high if high > low else low + 1e-3, BINS + 1)
    width = edges[1] - edges[0]
    return edges, [np.histogram(each, edges)[0] / (each.size * width) for each in samples]


def density_chart(
    shown: Sequence[Density], edges: np.ndarray, name: str, *, x_title: str, box: Box | None = None
) -> str:
    """Draw distributions as filled steps with a line at each mean.

    Args:
        shown: the distributions, drawn in order.
        edges: (BINS + 1,) common edges of the bins.
        name: what a screen reader says.
        x_title: title of the level axis, with its unit.
        box: size.
    """
    box = box or Box(width=320, height=190, left=40, top=26)
    x = Scale(float(edges[0]), float(edges[-1]), *box.x)
    y = Scale(0.0, 1.08 * max(float(each.heights.max()) for each in shown) or 1.0, *box.y)
    parts = [
        axes(
            box,
            x,
            y,
            x_title=x_title,
            y_title="density",
            x_format=format.decimals(1),
            y_format=format.decimals(1),
        )
    ]
    for each in shown:
        points = [(x(float(edges[0])), y(0))]
        for left, right, height in zip(edges, edges[1:], each.heights, strict=False):
            points += [(x(float(left)), y(float(height))), (x(float(right)), y(float(height)))]
        points.append((x(float(edges[-1])), y(0)))
        mean = x(min(max(each.mean, x.low), x.high))
        parts.append(
            element(
                "g",
                path(points, class_="area"),
                element("line", x1=mean, x2=mean, y1=y(0), y2=box.top, class_="mean"),
                class_=f"series {each.colour}",
                data_name=each.name,
            )
        )
    return drawing(box.width, box.height, name, *parts, class_="chart density")
