"""Learning curves: area, first crossing of a threshold, interpolation, trend line."""

import numpy as np


def area_under_curve(steps: np.ndarray, values: np.ndarray, until: float) -> float:
    """Compute the mean height of a learning curve over 0..until with the trapezoid rule.

    The first value is extended back to step 0 and the last one forward to ``until``.

    Args:
        steps: (n,) increasing environment steps.
        values: (n,) values, for instance success in 0..1.
        until: right end [steps].

    Returns:
        Area divided by ``until``, in the unit of ``values``.
    """
    inside = steps < until
    xs = np.concatenate([[0.0], steps[inside], [until]])
    ys = np.concatenate([values[:1], values[inside], [np.interp(until, steps, values)]])
    return float(np.trapezoid(ys, xs) / until)


def first_crossing(steps: np.ndarray, values: np.ndarray, threshold: float) -> tuple[float, bool]:
    """Find the first evaluation at or above a threshold.

    Args:
        steps: (n,) increasing environment steps, n at least 1.
        values: (n,) values, for instance success in 0..1.
        threshold: value to reach.

    Returns:
        The step of the first evaluation that reaches it and True, or the last step and False:
        the run is censored there.
    """
    reached = np.flatnonzero(values >= threshold)
    return (float(steps[reached[0]]), True) if reached.size else (float(steps[-1]), False)


def on_grid(steps: np.ndarray, values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Interpolate a curve at the steps of a grid; NaN outside the curve's own range."""
    return np.interp(grid, steps, values, left=np.nan, right=np.nan)


def trend(values: np.ndarray, window: int) -> np.ndarray:
    """Compute a centred moving average whose window narrows at both ends (the paper's trend).

    Args:
        values: (n,) float64.
        window: number of points averaged in the middle.
    """
    total = np.concatenate([[0.0], np.cumsum(values)])
    places = np.arange(len(values))
    reach = np.minimum(np.minimum(places, places[::-1]), window // 2)
    return (total[places + reach + 1] - total[places - reach]) / (2 * reach + 1)
