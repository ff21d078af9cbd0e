"""Scores of training runs, grouped by task, go in; bootstrap intervals come out."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import trim_mean

from knowarm.statistics.interval import Interval

Statistic = Callable[[np.ndarray], np.ndarray]
"""Maps (repetitions, n) float64 scores to (repetitions,) values."""

REPETITIONS = 10_000
BLOCK = 2_000_000
"""Numbers resampled at once, which bounds the memory."""


def mean(scores: np.ndarray) -> np.ndarray:
    """Mean along the last axis."""
    return np.mean(scores, axis=-1)


def iqm(scores: np.ndarray) -> np.ndarray:
    """Interquartile mean along the last axis: the mean without the lowest and highest quarter.

    As robust to one failed run as the median, with a narrower interval (Agarwal et al. 2021,
    "Deep reinforcement learning at the edge of the statistical precipice").
    """
    return np.asarray(trim_mean(scores, 0.25, axis=-1))


def bootstrap(
    strata: Sequence[np.ndarray],
    statistic: Statistic = mean,
    *,
    confidence: float = 0.95,
    repetitions: int = REPETITIONS,
    seed: int = 0,
) -> Interval:
    """Stratified percentile bootstrap: runs are drawn again within each stratum.

    The unit is whatever one number stands for: the score of one training run when methods are
    compared, the return of one episode when a single trained network is described.

    Args:
        strata: one (n_i,) array a task; statistics are taken over all of them together.
        statistic: ``mean``, ``iqm`` or any function with their signature.
        confidence: coverage in 0..1.
        repetitions: number of resamples.
        seed: of the resampling; the same seed gives the same interval.

    Returns:
        The statistic of the scores as they are, and the percentiles of its resamples. A single
        score has no spread to resample: its interval is the score itself.

    Raises:
        ValueError: no scores at all, or a stratum without any.
    """
    strata = [np.asarray(stratum, dtype=np.float64) for stratum in strata]
    if not strata or any(stratum.size == 0 for stratum in strata):
        raise ValueError("every stratum needs at least one score")
    generator = np.random.default_rng(seed)
    size = sum(stratum.size for stratum in strata)
    block = max(1, BLOCK // size)
    values = []
    for start in range(0, repetitions, block):
        count = min(block, repetitions - start)
        drawn = [s[generator.integers(0, s.size, (count, s.size))] for s in strata]
        values.append(statistic(np.concatenate(drawn, axis=1)))
    tail = (1 - confidence) / 2
    low, high = np.quantile(np.concatenate(values), [tail, 1 - tail])
    estimate = float(statistic(np.concatenate(strata)[None])[0])
    return Interval(estimate, float(low), float(high), confidence)
