"""Steps to a threshold, some censored, go in; median and restricted mean come out."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from knowarm.statistics.interval import Interval


@dataclass(frozen=True)
class Survival:
    """Kaplan-Meier estimate of the share of runs that have not reached a threshold yet.

    Attributes:
        steps: (k,) float64, increasing: steps at which at least one run reached it.
        waiting: (k,) share still below the threshold just after each of them.
        variance: (k,) Greenwood's variance of ``waiting``.
    """

    steps: np.ndarray
    waiting: np.ndarray
    variance: np.ndarray


def kaplan_meier(steps: np.ndarray, reached: np.ndarray) -> Survival:
    """Estimate S(t), the share of runs still below the threshold after t steps.

    S(t) is the product over crossings t_i <= t of (1 - d_i / n_i): d_i runs cross at t_i out of
    n_i that are still watched. A run that ends below the threshold counts among the n_i as long
    as it ran and is never taken for a crossing (Kaplan and Meier 1958). The variance is
    Greenwood's: S^2 sum d_i / (n_i (n_i - d_i)).

    Args:
        steps: (n,) step of the crossing, or of the end of a run that never crossed.
        reached: (n,) bool; False marks a censored run.
    """
    steps, reached = np.asarray(steps, np.float64), np.asarray(reached, bool)
    times = np.unique(steps[reached])
    at_risk = (steps[:, None] >= times).sum(axis=0)
    crossings = ((steps[:, None] == times) & reached[:, None]).sum(axis=0)
    waiting = np.cumprod(1 - crossings / at_risk)
    left = at_risk - crossings
    terms = np.divide(crossings, at_risk * left, out=np.zeros(len(times)), where=left > 0)
    return Survival(times, waiting, waiting**2 * np.cumsum(terms))


def median_steps(survival: Survival, confidence: float = 0.95) -> tuple[float | None, ...]:
    """Median steps to the threshold with Brookmeyer and Crowley's interval.

    The interval holds every t at which S(t) = 1/2 is not rejected, on the log-log scale.

    Returns:
        Estimate, low, high; None for an end beyond what the runs show.
    """
    if not survival.steps.size:
        return None, None, None
    z = float(norm.ppf(0.5 + confidence / 2))
    inner = (survival.waiting > 0) & (survival.waiting < 1)
    shares = np.where(inner, survival.waiting, 0.5)
    log = np.log(shares)
    half = z * np.sqrt(survival.variance) / np.abs(shares * log)
    centre = np.log(-log)
    lower = np.where(inner, np.exp(-np.exp(centre + half)), survival.waiting)
    upper = np.where(inner, np.exp(-np.exp(centre - half)), survival.waiting)
    return tuple(_first(survival.steps, curve <= 0.5) for curve in (survival.waiting, lower, upper))


def restricted_mean_steps(
    steps: np.ndarray, reached: np.ndarray, until: float, confidence: float = 0.95
) -> Interval:
    """Mean steps to the threshold, counting at most ``until`` for each run.

    The area under the Kaplan-Meier curve over 0..until. Defined however many runs are censored,
    where the median is not. Its variance is sum A_i^2 d_i / (n_i (n_i - d_i)) with A_i the area
    right of the i-th crossing (Klein and Moeschberger 2003, section 4.5).

    Args:
        steps: (n,) step of the crossing, or of the end of a run that never crossed.
        reached: (n,) bool; False marks a censored run.
        until: the restriction [steps]; at least one run must have been watched that long.
        confidence: coverage in 0..1.
    """
    steps, reached = np.asarray(steps, np.float64), np.asarray(reached, bool)
    curve = kaplan_meier(np.minimum(steps, until), reached & (steps <= until))
    edges = np.concatenate([[0.0], curve.steps, [until]])
    heights = np.concatenate([[1.0], curve.waiting])
    pieces = heights * np.diff(edges)
    mean = float(pieces.sum())
    right = np.cumsum(pieces[::-1])[::-1][1:]  # area from each crossing to `until`
    clipped = np.minimum(steps, until)
    at_risk = (clipped[:, None] >= curve.steps).sum(axis=0)
    crossed = ((clipped[:, None] == curve.steps) & (reached & (steps <= until))[:, None]).sum(0)
    left = at_risk - crossed
    terms = np.divide(crossed, at_risk * left, out=np.zeros(len(at_risk)), where=left > 0)
    half = float(norm.ppf(0.5 + confidence / 2)) * float(np.sqrt((right**2 * terms).sum()))
    return Interval(mean, max(0.0, mean - half), min(until, mean + half), confidence)


def _first(steps: np.ndarray, condition: np.ndarray) -> float | None:
    places = np.flatnonzero(condition)
    return float(steps[places[0]]) if places.size else None
