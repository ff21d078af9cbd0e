"""Learning curves, and steps to a threshold with censored runs (Kaplan and Meier 1958)."""

import warnings
from typing import Any

import numpy as np
import scipy

from knowarm.arrays import Floats, Mask
from knowarm.statistics.bootstrap import CONFIDENCE, Interval

Step = float | None
"""A step of a training, None where no run shows it."""


def median_steps(steps: Floats, reached: Mask) -> tuple[Step, Step, Step]:
    """Estimate the median steps to a threshold, with Brookmeyer and Crowley's interval.

    The interval holds every t at which S(t) = 1/2 is not rejected, on the log-log scale. S(t) is
    the Kaplan-Meier estimate of the fraction of runs still below the threshold after t steps.

    The median is the first step at which S(t) is at most 1/2, as in lifelines. Where S(t) is
    exactly 1/2 between two steps, R's ``survfit`` gives the midpoint instead.

    Args:
        steps: (n,) step at which the run reached the threshold, or its end if it never did.
        reached: (n,) bool; False marks a censored run.

    Returns:
        Estimate, low, high; None for an end that the observed runs do not show.
    """
    curve = _below_threshold(steps, reached)
    with warnings.catch_warnings():  # The interval is NaN where S is 0 or 1.
        warnings.simplefilter("ignore", RuntimeWarning)
        ends = curve.confidence_interval(CONFIDENCE, method="log-log")

    def first_at_most_half(bound: Any) -> Step:
        fractions = bound.probabilities
        fractions = np.where(np.isnan(fractions), curve.probabilities, fractions)
        is_passed = fractions <= 0.5 + 1e-12  # products are rounded
        return _first(curve.quantiles, is_passed)

    estimate = first_at_most_half(curve)
    low = first_at_most_half(ends.low)
    high = first_at_most_half(ends.high)
    return estimate, low, high


def restricted_mean_steps(steps: Floats, reached: Mask, until: float) -> Interval:
    """Estimate the mean steps to a threshold, counting at most ``until`` steps per run.

    The area under the Kaplan-Meier curve over 0..until: defined however many runs are censored,
    unlike the median. Its variance is the sum of A_i^2 d_i / (n_i (n_i - d_i)) over the steps at
    which d_i of the n_i runs still observed reach the threshold, where A_i is the area right of
    the i-th (Klein and Moeschberger 2003, section 4.5).

    Args:
        steps: (n,) step at which the run reached the threshold, or its end if it never did.
        reached: (n,) bool; False marks a censored run.
        until: restriction [steps]; at least one run must have been observed that long.
    """
    is_in_time = np.asarray(steps) <= until
    reached = np.asarray(reached, bool) & is_in_time
    counted = np.minimum(steps, until, dtype=np.float64)
    curve = _below_threshold(counted, reached)
    heights = np.append(1.0, curve.probabilities)
    widths = np.diff(curve.quantiles, prepend=0.0, append=until)
    areas = heights * widths
    areas_right = _sum_from_right(areas)[1:]  # From each step to `until`
    _, index, runs = np.unique(counted, return_inverse=True, return_counts=True)
    crossings = np.bincount(index, weights=reached)
    at_risk = _sum_from_right(runs)
    staying = at_risk - crossings
    pairs = at_risk * staying
    # Where no run stays, no area is left to its right, and the term is 0.
    terms = np.zeros(len(staying))
    np.divide(crossings, pairs, out=terms, where=staying > 0)
    terms *= areas_right**2
    variance = terms.sum()
    quantile = scipy.stats.norm.ppf(0.5 + CONFIDENCE / 2)
    half_width = float(quantile * np.sqrt(variance))
    estimate = float(areas.sum())
    low = max(0.0, estimate - half_width)
    high = min(until, estimate + half_width)
    return Interval(estimate, low, high)


def _sum_from_right(values: np.ndarray) -> np.ndarray:
    """Sum each value and all after it."""
    return np.cumsum(values[::-1])[::-1]


def _first(steps: Floats, condition: Mask) -> Step:
    """Return the first step at which a condition holds; None if it never does."""
    if not condition.any():
        return None
    return float(steps[condition.argmax()])


def _below_threshold(steps: Floats, reached: Mask) -> Any:
    """Estimate S(t) at every observed step."""
    is_censored = ~np.asarray(reached, bool)
    sample = scipy.stats.CensoredData.right_censored(steps, is_censored)
    return scipy.stats.ecdf(sample).sf


def area_under_curve(steps: Floats, values: Floats, until: float) -> float:
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
    last = np.interp(until, steps, values)
    xs = np.concatenate([[0.0], steps[inside], [until]])
    ys = np.concatenate([values[:1], values[inside], [last]])
    area = np.trapezoid(ys, xs)
    return float(area / until)


def first_crossing(
    steps: Floats,
    values: Floats,
    threshold: float,
) -> tuple[float, bool]:
    """Find the first evaluation at or above a threshold.

    Args:
        steps: (n,) increasing environment steps, n at least 1.
        values: (n,) values, for instance success in 0..1.
        threshold: value to reach.

    Returns:
        The step of the first evaluation that reaches it and True, or the last step and False:
        the run is censored there.
    """
    step = _first(steps, values >= threshold)
    if step is None:
        return float(steps[-1]), False
    return step, True


def trend(values: Floats, window: int) -> Floats:
    """Compute a centred moving average whose window narrows at both ends (the paper's trend).

    Args:
        values: (n,) float64.
        window: number of points averaged in the middle; one more if it is even.
    """
    cumulative = np.append(0.0, np.cumsum(values))
    index = np.arange(len(values))
    to_nearer_end = np.minimum(index, index[::-1])
    half_window = np.minimum(window // 2, to_nearer_end)
    first = index - half_window
    end = index + half_window + 1
    return (cumulative[end] - cumulative[first]) / (end - first)
