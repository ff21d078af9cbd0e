"""Confidence intervals: their type, and Wilson's interval of a proportion."""

import math
from dataclasses import dataclass

import scipy

CONFIDENCE = 0.95  # of every interval of this package, unless an argument says otherwise


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval; no width where one observation allows none."""

    estimate: float  # point estimate
    low: float  # lower end
    high: float  # upper end


def wilson(successes: int, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """Compute Wilson's score interval of a proportion.

    Unlike the normal approximation it stays inside 0..1 and has a positive width at 0 and 100 %.

    Args:
        successes: number of successes, 0..trials.
        trials: number of trials, at least 1.
        confidence: coverage, in 0..1.

    Raises:
        ValueError: there are no trials, or more successes than trials.
    """
    ends = scipy.stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return Interval(successes / trials, float(ends.low), float(ends.high))


def share_difference(first: Interval, second: Interval) -> Interval:
    """Subtract two proportions with Wilson intervals (Newcombe 1998, method 10).

    The samples are taken as independent. For two agents on the same episodes, which tend to
    succeed on the same ones, the interval is too wide rather than too narrow.

    Args:
        first: of `wilson`.
        second: of `wilson`, of the same coverage.

    Returns:
        First minus second, with an interval of their coverage.
    """
    difference = first.estimate - second.estimate
    below = math.hypot(first.estimate - first.low, second.high - second.estimate)
    above = math.hypot(first.high - first.estimate, second.estimate - second.low)
    return Interval(difference, difference - below, difference + above)
