"""Scores of two agents go in; their difference, its interval and its p-value come out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from knowarm.statistics.interval import Interval


@dataclass(frozen=True)
class Comparison:
    """Difference of two means.

    Attributes:
        difference: first minus second, with Welch's or Student's t interval.
        p_value: two-sided; of no difference at all.
        effect_size: difference in pooled standard deviations (Cohen's d); None without spread.
        first_count: observations of the first agent.
        second_count: observations of the second agent.
    """

    difference: Interval
    p_value: float
    effect_size: float | None
    first_count: int
    second_count: int


def welch(first: np.ndarray, second: np.ndarray, confidence: float = 0.95) -> Comparison:
    """Compare the means of two independent samples of unequal variance (Welch's t).

    For training seeds: runs of two agents share nothing that would pair them. With few seeds
    its interval keeps its coverage where the percentile bootstrap's is too narrow.

    Args:
        first: (n,) scores, one a training run.
        second: (m,) scores.
        confidence: coverage in 0..1.

    Raises:
        ValueError: fewer than two scores on a side.
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if min(first.size, second.size) < 2:
        raise ValueError("a difference between methods needs at least two runs of each")
    difference = float(first.mean() - second.mean())
    first_variance, second_variance = first.var(ddof=1), second.var(ddof=1)
    error2 = first_variance / first.size + second_variance / second.size
    if error2 == 0:
        exact = Interval(difference, difference, difference, confidence)
        return Comparison(exact, 0.0 if difference else 1.0, None, first.size, second.size)
    freedom = error2**2 / (
        (first_variance / first.size) ** 2 / (first.size - 1)
        + (second_variance / second.size) ** 2 / (second.size - 1)
    )
    pooled = np.sqrt((first_variance + second_variance) / 2)
    return Comparison(
        _interval(difference, float(np.sqrt(error2)), float(freedom), confidence),
        float(2 * stats.t.sf(abs(difference) / np.sqrt(error2), freedom)),
        float(difference / pooled),
        first.size,
        second.size,
    )


def paired(first: np.ndarray, second: np.ndarray, confidence: float = 0.95) -> Comparison:
    """Compare two agents on the same episodes (Student's paired t).

    Says whether these two trained networks differ on these episodes, and nothing about the
    methods that trained them: another training seed would give other networks.

    Args:
        first: (n,) one value an episode.
        second: (n,) values of the same episodes in the same order.
        confidence: coverage in 0..1.

    Raises:
        ValueError: unequal lengths or fewer than two pairs.
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if first.shape != second.shape or first.size < 2:
        raise ValueError("paired values need two equal shapes of at least two pairs")
    differences = first - second
    difference = float(differences.mean())
    spread = float(differences.std(ddof=1))
    count = differences.size
    if spread == 0:
        exact = Interval(difference, difference, difference, confidence)
        return Comparison(exact, 0.0 if difference else 1.0, None, count, count)
    error = spread / np.sqrt(count)
    return Comparison(
        _interval(difference, error, count - 1, confidence),
        float(2 * stats.t.sf(abs(difference) / error, count - 1)),
        difference / spread,
        count,
        count,
    )


def _interval(difference: float, error: float, freedom: float, confidence: float) -> Interval:
    half = float(stats.t.ppf(0.5 + confidence / 2, freedom)) * error
    return Interval(difference, difference - half, difference + half, confidence)


def holm(p_values: Sequence[float]) -> np.ndarray:
    """Holm's step-down correction: p-values that hold for the whole family of comparisons.

    The i-th smallest of m is multiplied by m - i (i from 0), kept in order and below 1. Claims
    at an adjusted p of .05 are wrong together in at most 5 % of studies without any effect.

    Args:
        p_values: one a comparison.

    Returns:
        (m,) float64 adjusted p-values, in the order given.
    """
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values, kind="stable")
    scaled = values[order] * np.arange(values.size, 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted
