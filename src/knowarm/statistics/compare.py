"""Comparisons of agents: t tests, the paper's analysis of variance, Holm's correction, power."""

import math
import warnings
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy

from knowarm.arrays import Floats
from knowarm.statistics.bootstrap import CONFIDENCE, Interval


@dataclass(frozen=True)
class Comparison:
    """Difference of two means."""

    difference: Interval  # first minus second, with the interval of the t test
    p_value: float  # two-sided p-value of no difference
    effect_size: float | None  # in standard deviations (Cohen's d); None without spread
    first_count: int  # observations of the first agent
    second_count: int  # observations of the second agent


def welch(first: Floats, second: Floats) -> Comparison:
    """Compare the means of two independent samples of unequal variance (Welch's t test).

    With few training seeds its interval keeps its coverage; the percentile bootstrap's does not.

    Args:
        first: (n,) scores, one per training run.
        second: (m,) scores.

    Raises:
        ValueError: a side has fewer than two scores.
    """
    first = np.asarray(first, np.float64)
    second = np.asarray(second, np.float64)
    if min(first.size, second.size) < 2:
        raise ValueError("a difference between methods needs at least two runs of each")
    variance = (first.var(ddof=1) + second.var(ddof=1)) / 2
    spread = math.sqrt(variance)
    return _t_test(scipy.stats.ttest_ind, first, second, spread, equal_var=False)


def paired(first: Floats, second: Floats) -> Comparison:
    """Compare pairs of values, such as a method's with chance (Student's paired t test).

    Args:
        first: (n,) one value per training seed.
        second: (n,) values of the same seeds in the same order.

    Raises:
        ValueError: the lengths differ, or there are fewer than two pairs.
    """
    first = np.asarray(first, np.float64)
    second = np.asarray(second, np.float64)
    if first.shape != second.shape or first.size < 2:
        raise ValueError("paired values need two equal shapes of at least two pairs")
    spread = float((first - second).std(ddof=1))
    return _t_test(scipy.stats.ttest_rel, first, second, spread)


def one_way_anova(groups: Sequence[Floats]) -> tuple[float, float]:
    """Run the paper's test (section 5.3): 30 success rates per network, 100 episodes each.

    All observations of a group come from one trained network. The test therefore says whether
    these networks differ, and nothing about other training seeds of the same methods.

    Args:
        groups: one (n_i,) array of success rates per trained network, n_i at least 2.

    Returns:
        F value and p-value of equal means.
    """
    if not any(map(np.ptp, groups)):  # 0 / 0: no variance within to divide by
        if len(set(map(np.mean, groups))) == 1:
            return 0.0, 1.0
        return math.inf, 0.0
    result = scipy.stats.f_oneway(*groups)
    return float(result.statistic), float(result.pvalue)


def holm(p_values: Sequence[float]) -> Floats:
    """Adjust p-values for a family of comparisons with Holm's step-down correction.

    The i-th smallest of m is multiplied by m - i (i from 0), made monotone and limited to 1.

    Returns:
        (m,) float64 adjusted p-values, in the given order.
    """
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values, kind="stable")
    scaled = values[order] * np.arange(values.size, 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted


def power_of_two_samples(effect_size: float, count: int, alpha: float = 0.05) -> float:
    """Compute the power of the two-sided two-sample t test at a significance level ``alpha``.

    Args:
        effect_size: true difference in standard deviations (Cohen's d).
        count: runs of each agent, at least 2.
    """
    freedom = 2 * count - 2
    noncentrality = abs(effect_size) * math.sqrt(count / 2)
    critical = scipy.stats.t.ppf(1 - alpha / 2, freedom)
    upper = scipy.stats.nct.sf(critical, freedom, noncentrality)
    lower = scipy.stats.nct.cdf(-critical, freedom, noncentrality)
    # Where SciPy's tail underflows to NaN the power is 1 to machine precision.
    return float(np.nan_to_num(upper, nan=1.0) + np.nan_to_num(lower, nan=0.0))


def seeds_needed(effect_size: float) -> int | None:
    """Compute the number of training seeds per agent that detects a difference of this size.

    For a difference that was selected because it was large the number is too small.

    Args:
        effect_size: difference in standard deviations (Cohen's d).

    Returns:
        Smallest number, at least 2, with which 80 % of such studies detect it, two-sided at 5 %;
        None above 10,000.
    """
    counts = range(2, 10_001)
    power = partial(power_of_two_samples, effect_size)
    index = bisect_left(counts, 0.8, key=power)
    if index == len(counts):
        return None
    return counts[index]


def _t_test(
    test: Callable[..., Any],
    first: Floats,
    second: Floats,
    spread: float,
    **options: Any,
) -> Comparison:
    """Run one of SciPy's t tests; without any spread the difference is exact."""
    difference = float(first.mean() - second.mean())
    largest = max(np.abs(first).max(), np.abs(second).max())
    rounding = 1e-12 * largest
    interval = Interval(difference, difference, difference)
    p_value = 0.0 if abs(difference) > rounding else 1.0
    effect_size = None
    if spread > rounding:  # False also of values that are NaN
        with warnings.catch_warnings():  # of a sample whose values are all equal
            warnings.filterwarnings("ignore", "Precision loss", RuntimeWarning)
            result = test(first, second, **options)
        low, high = result.confidence_interval(CONFIDENCE)
        interval = Interval(difference, float(low), float(high))
        p_value = float(result.pvalue)
        effect_size = difference / spread
    return Comparison(
        difference=interval,
        p_value=p_value,
        effect_size=effect_size,
        first_count=first.size,
        second_count=second.size,
    )
