"""Bootstrap intervals over training runs, of the measures of Agarwal et al. 2021.

"Deep reinforcement learning at the edge of the statistical precipice".
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from math import hypot
from operator import attrgetter
from typing import Any

import numpy as np
import scipy

from knowarm.arrays import Floats

CONFIDENCE = 0.95  # of every interval of this package


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval; no width where one observation allows none."""

    estimate: float  # point estimate
    low: float  # lower end
    high: float  # upper end
    _: KW_ONLY
    runs: tuple[float, ...] = ()  # single ones, too few for it

    def named(self, name: str) -> dict[str, float]:
        """Return the numbers of a summary or table row: ``name``, ``name_low``, ``name_high``."""
        return {name: self.estimate, f"{name}_low": self.low, f"{name}_high": self.high}


def wilson(successes: int, trials: int) -> Interval:
    """Compute Wilson's score interval of a proportion.

    Unlike the normal approximation it stays inside 0..1 and has a positive width at 0 and 100 %.

    Args:
        successes: number of successes, 0..trials.
        trials: number of trials, at least 1.

    Raises:
        ValueError: there are no trials, or more successes than trials.
    """
    # SciPy checks it in some versions only
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(
            f"successes must lie between 0 and trials, got {successes} of {trials}"
        )
    test = scipy.stats.binomtest(successes, trials)
    ends = test.proportion_ci(CONFIDENCE, method="wilson")
    return Interval(successes / trials, float(ends.low), float(ends.high))


def share_of(is_so: np.ndarray) -> Interval:
    """Return the share of true values (n,), with its interval by `wilson`."""
    return wilson(int(np.count_nonzero(is_so)), len(is_so))


def share_difference(first: Interval, second: Interval) -> Interval:
    """Subtract two proportions with Wilson intervals (Newcombe 1998, method 10).

    The samples are taken as independent. For two agents on the same episodes, which tend to
    succeed on the same ones, the interval is too wide rather than too narrow.

    Args:
        first: of `wilson`.
        second: of `wilson`.
    """
    difference = first.estimate - second.estimate
    below = hypot(first.estimate - first.low, second.high - second.estimate)
    above = hypot(first.high - first.estimate, second.estimate - second.low)
    return Interval(difference, difference - below, difference + above)


FEW_RUNS = 5  # below it the runs themselves say more than an interval


def mean_of_runs(runs: Sequence[Interval]) -> Interval:
    """Estimate the mean over training runs from the estimates of two or more.

    With `FEW_RUNS` or more the interval is a bootstrap over the runs. With fewer, whose bootstrap
    is the range of their values, it is Student's t, and no narrower than the runs' own intervals
    on average: two runs of equal success do not tell the success better than one.
    """
    rows = list(map(attrgetter("estimate", "low", "high"), runs))
    values, lows, highs = np.transpose(rows).copy()
    if len(runs) >= FEW_RUNS:
        return bootstrap(values)
    mean = float(values.mean())
    quantile = scipy.stats.t.ppf((1 + CONFIDENCE) / 2, len(runs) - 1)
    half = quantile * scipy.stats.sem(values)
    below = mean - lows.mean()
    above = highs.mean() - mean
    low = mean - float(max(half, below))
    high = mean + float(max(half, above))
    return Interval(mean, low, high, runs=tuple(values.tolist()))


REPETITIONS = 2_000  # resamples of pairs of agents, and of profiles
BLOCK = 2_000_000  # most numbers resampled at once, which bounds the memory


def iqm(scores: Floats, axis: int = -1) -> Floats:
    """Compute the interquartile mean of scores: the mean of the middle half."""
    return np.asarray(scipy.stats.trim_mean(scores, 0.25, axis=axis))


def bootstrap(
    scores: Floats,
    statistic: Callable[..., Floats] = np.mean,
    *,
    repetitions: int = 10_000,
) -> Interval:
    """Compute a percentile bootstrap interval; of a single score it has no width.

    One score is one observation: the score of one training run when methods are compared, the
    return of one episode when a single trained network is described.

    Args:
        scores: (n,) array.
        statistic: function of an array and an ``axis``, such as ``np.mean`` or ``iqm``.
        repetitions: number of resamples.
    """
    scores = np.asarray(scores, np.float64)
    estimate = float(statistic(scores, axis=-1))
    if scores.size < 2:
        return Interval(estimate, estimate, estimate)
    low, high = _percentiles([scores], statistic, repetitions)
    return Interval(estimate, low, high)


def _draws(generator: np.random.Generator, count: int, repetitions: int) -> Floats:
    """Draw how often each of a number of things occurs in each resample, (repetitions, count)."""
    chances = np.full(count, 1 / count)
    return generator.multinomial(count, chances, repetitions).astype(float)


def probability_of_improvement(first: Floats, second: Floats) -> Interval:
    """Estimate P(a run of the first agent scores higher than one of the second), ties as 1/2.

    The Mann-Whitney statistic U / (n m), with a bootstrap interval that resamples the runs of
    both agents.

    Args:
        first: (n,) scores, one per training run, n at least 2.
        second: (m,) scores, m at least 2.
    """
    samples = [np.asarray(first, np.float64), np.asarray(second, np.float64)]

    def wins(a: Floats, b: Floats, *, axis: int) -> Floats:
        a = a[..., :, None]
        b = b[..., None, :]
        points = 0.5 * (a == b)
        points += a > b
        return points.mean(axis=(-2, -1))

    estimate = float(wins(*samples, axis=-1))
    low, high = _percentiles(samples, wins, REPETITIONS)
    return Interval(estimate, low, high)


def performance_profile(
    scores: Floats, thresholds: Floats
) -> tuple[Floats, Floats, Floats]:
    """Compute the fraction of runs that score above tau, for every tau.

    Args:
        scores: (n,) scores of one task.
        thresholds: (T,) values of tau.

    Returns:
        Three (T,) float64 arrays: the fraction, and the ends of its pointwise bootstrap band.
    """
    column = np.asarray(scores, np.float64)[:, None]
    above = (column > thresholds).astype(float)
    low, high = mean_band(above, REPETITIONS)
    return above.mean(axis=0), low, high


def mean_band(table: Floats, repetitions: int) -> tuple[Floats, Floats]:
    """Bootstrap the means of the columns of a table, (runs, T), over its rows.

    Missing values are NaN, and so are the ends for a column without any.

    Returns:
        Two (T,) float64 arrays: the ends of the pointwise percentile intervals.
    """
    draws = _draws(np.random.default_rng(0), len(table), repetitions)
    present = np.isfinite(table)
    totals = draws @ np.where(present, table, 0.0)
    with warnings.catch_warnings():  # resamples and columns without any value
        warnings.simplefilter("ignore", RuntimeWarning)
        means = totals / (draws @ present.astype(float))
        low, high = np.nanquantile(means, [0.025, 0.975], axis=0)
    return low, high


def _percentiles(
    samples: Sequence[Floats],
    statistic: Callable[..., Any],
    repetitions: int,
) -> tuple[float, float]:
    """Resample every sample by itself; return the ends of the percentile interval."""
    numbers = sum(map(np.size, samples))
    result = scipy.stats.bootstrap(
        samples,
        statistic,
        n_resamples=repetitions,
        batch=max(1, BLOCK // numbers),
        vectorized=True,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = map(float, result.confidence_interval)
    return low, high
