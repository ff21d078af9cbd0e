"""Confidence intervals: their type, and Wilson's interval of a proportion."""

from dataclasses import dataclass

from scipy import stats

CONFIDENCE = 0.95
"""Coverage of every interval of this package, unless an argument says otherwise."""


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval.

    Attributes:
        estimate: point estimate.
        low: lower end; equal to ``estimate`` where a single observation allows no interval.
        high: upper end.
    """

    estimate: float
    low: float
    high: float


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
    ends = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return Interval(successes / trials, float(ends.low), float(ends.high))
