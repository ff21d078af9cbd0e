"""An effect size goes in; the number of training seeds that would show it comes out."""

import math

from scipy import stats


def power_of_two_samples(effect_size: float, count: int, alpha: float = 0.05) -> float:
    """Power of the two-sided two-sample t test with ``count`` runs on each side.

    Args:
        effect_size: true difference in standard deviations (Cohen's d).
        count: runs of each agent, at least 2.
        alpha: accepted share of false claims.
    """
    freedom = 2 * count - 2
    noncentrality = abs(effect_size) * math.sqrt(count / 2)
    critical = stats.t.ppf(1 - alpha / 2, freedom)
    # Where scipy's tail underflows to nan the power has long reached 1.
    upper = float(stats.nct.sf(critical, freedom, noncentrality))
    lower = float(stats.nct.cdf(-critical, freedom, noncentrality))
    return (1.0 if math.isnan(upper) else upper) + (0.0 if math.isnan(lower) else lower)


def seeds_needed(
    effect_size: float, *, power: float = 0.8, alpha: float = 0.05, most: int = 10_000
) -> int | None:
    """Training seeds of each agent that would show a difference of this size.

    Planned from the difference that was seen, this is optimistic where the difference was
    picked because it was large: a guide for the next study, no statement about this one.

    Args:
        effect_size: difference in standard deviations (Cohen's d).
        power: share of such studies that should find it.
        alpha: accepted share of false claims.
        most: give up beyond this many.

    Returns:
        The smallest sufficient number (at least 2), or None above ``most``.
    """
    if power_of_two_samples(effect_size, most, alpha) < power:
        return None
    low, high = 1, most  # `low` never suffices (one seed has no spread), `high` does
    while high - low > 1:
        middle = (low + high) // 2
        if power_of_two_samples(effect_size, middle, alpha) >= power:
            high = middle
        else:
            low = middle
    return high
