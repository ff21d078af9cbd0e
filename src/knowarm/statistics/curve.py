"""A learning curve goes in; its area, its first crossing of a threshold and its trend come out."""

import numpy as np


def area_under_curve(steps: np.ndarray, values: np.ndarray, until: float) -> float:
    """Mean height of a learning curve over 0..until, by the trapezoid rule.

    The first value is carried back to step 0 and the last one on to ``until``, so that curves
    of unequal length have areas of one scale.

    Args:
        steps: (n,) increasing, environment steps.
        values: (n,) for instance success in 0..1.
        until: right end [steps].

    Returns:
        The area divided by ``until``: in the unit of ``values``.
    """
    inside = steps < until
    xs = np.concatenate([[0.0], steps[inside], [until]])
    ys = np.concatenate([values[:1], values[inside], [np.interp(until, steps, values)]])
    return float(np.trapezoid(ys, xs) / until)


def first_crossing(steps: np.ndarray, values: np.ndarray, threshold: float) -> tuple[float, bool]:
    """First evaluation at or above a threshold.

    Args:
        steps: (n,) increasing, environment steps, n at least 1.
        values: (n,) for instance success in 0..1.
        threshold: the height to reach.

    Returns:
        The step of the first evaluation that reaches it and True, or the last step and False:
        the run is censored there, it was only seen not to reach it so far.
    """
    reached = np.flatnonzero(values >= threshold)
    if reached.size:
        return float(steps[reached[0]]), True
    return float(steps[-1]), False


def on_grid(steps: np.ndarray, values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Values of a curve at the grid's steps, interpolated; nan outside the curve's own range."""
    return np.interp(grid, steps, values, left=np.nan, right=np.nan)


def trend(values: np.ndarray, window: int) -> np.ndarray:
    """Centred moving average that narrows at both ends, the paper's trend line.

    Args:
        values: (n,) float64.
        window: number of points averaged in the middle.

    Returns:
        (n,) float64.
    """
    total = np.concatenate([[0.0], np.cumsum(values)])
    places = np.arange(len(values))
    reach = np.minimum(np.minimum(places, places[::-1]), window // 2)
    return (total[places + reach + 1] - total[places - reach]) / (2 * reach + 1)
