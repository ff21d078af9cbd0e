"""Scores of two agents go in; the probability that a run of the first is better comes out."""

from collections.abc import Sequence

import numpy as np

from knowarm.statistics.interval import Interval


def probability_of_improvement(
    first: Sequence[np.ndarray],
    second: Sequence[np.ndarray],
    *,
    confidence: float = 0.95,
    repetitions: int = 2_000,
    seed: int = 0,
) -> Interval:
    """P(a run of the first scores higher than one of the second), ties counting one half.

    The mean over tasks of the Mann-Whitney statistic U / (n m), with a bootstrap interval that
    draws the runs of both agents again within each task.

    Args:
        first: one (n_i,) array a task.
        second: one (m_i,) array a task, tasks in the same order.
        confidence: coverage in 0..1.
        repetitions: number of resamples.
        seed: of the resampling.

    Raises:
        ValueError: different numbers of tasks, or a task without runs.
    """
    if len(first) != len(second) or not first:
        raise ValueError("both agents need runs on the same tasks")
    generator = np.random.default_rng(seed)
    estimates, resampled = [], []
    for a, b in zip(first, second, strict=True):
        a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
        if min(a.size, b.size) == 0:
            raise ValueError("every task needs at least one run of each agent")
        wins = (a[:, None] > b) + 0.5 * (a[:, None] == b)
        estimates.append(wins.mean())
        rows = generator.integers(0, a.size, (repetitions, a.size))
        columns = generator.integers(0, b.size, (repetitions, b.size))
        resampled.append(wins[rows[:, :, None], columns[:, None, :]].mean(axis=(1, 2)))
    tail = (1 - confidence) / 2
    low, high = np.quantile(np.mean(resampled, axis=0), [tail, 1 - tail])
    return Interval(float(np.mean(estimates)), float(low), float(high), confidence)
