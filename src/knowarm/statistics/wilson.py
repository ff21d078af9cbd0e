"""Successes and trials go in; Wilson's interval of their share comes out."""

import math

from scipy.stats import norm

from knowarm.statistics.interval import Interval


def wilson(successes: int, trials: int, confidence: float = 0.95) -> Interval:
    """Wilson's score interval of a share.

    With p = successes / trials, n = trials and z the normal quantile::

        (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    Unlike p -+ z sqrt(p (1 - p) / n) it stays inside 0..1 and has a width at 0 % and 100 %.

    Args:
        successes: number of successes, 0..trials.
        trials: number of trials, at least 1.
        confidence: coverage in 0..1.

    Raises:
        ValueError: no trials, or more successes than trials.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials")
    z2 = float(norm.ppf(0.5 + confidence / 2)) ** 2
    share = successes / trials
    centre = share + z2 / (2 * trials)
    half = math.sqrt(z2 * (share * (1 - share) / trials + z2 / (4 * trials**2)))
    scale = 1 + z2 / trials
    low = 0.0 if successes == 0 else (centre - half) / scale
    high = 1.0 if successes == trials else (centre + half) / scale
    return Interval(share, low, high, confidence)
