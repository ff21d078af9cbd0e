"""Scores of training runs go in; the share of runs above each score comes out."""

from collections.abc import Sequence

import numpy as np


def performance_profile(
    strata: Sequence[np.ndarray],
    thresholds: np.ndarray,
    *,
    confidence: float = 0.95,
    repetitions: int = 2_000,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of runs that score above tau, for every tau (Agarwal et al. 2021).

    Args:
        strata: one (n_i,) array of scores a task.
        thresholds: (T,) values of tau.
        confidence: coverage of the pointwise band.
        repetitions: number of stratified resamples.
        seed: of the resampling.

    Returns:
        Three (T,) float64 arrays: the share, and the lower and upper end of its band.
    """
    generator = np.random.default_rng(seed)
    above = [
        (np.asarray(stratum, np.float64)[:, None] > thresholds).astype(float) for stratum in strata
    ]
    share = np.concatenate(above).mean(axis=0)
    drawn = np.zeros((repetitions, len(thresholds)))
    for runs in above:
        counts = generator.multinomial(len(runs), np.full(len(runs), 1 / len(runs)), repetitions)
        drawn += counts @ runs
    drawn /= sum(len(runs) for runs in above)
    tail = (1 - confidence) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail], axis=0)
    return share, low, high
