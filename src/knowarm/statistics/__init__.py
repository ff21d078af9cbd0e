"""Statistics of training runs and evaluations over SciPy: pure functions, 95 % intervals."""

from knowarm.statistics.bootstrap import (
    Interval,
    bootstrap,
    iqm,
    performance_profile,
    probability_of_improvement,
    share_difference,
    wilson,
)
from knowarm.statistics.compare import (
    Comparison,
    holm,
    one_way_anova,
    paired,
    power_of_two_samples,
    seeds_needed,
    welch,
)
from knowarm.statistics.survival import (
    area_under_curve,
    first_crossing,
    median_steps,
    restricted_mean_steps,
    trend,
)

__all__ = [
    "Comparison",
    "Interval",
    "area_under_curve",
    "bootstrap",
    "first_crossing",
    "holm",
    "iqm",
    "median_steps",
    "one_way_anova",
    "paired",
    "performance_profile",
    "power_of_two_samples",
    "probability_of_improvement",
    "restricted_mean_steps",
    "seeds_needed",
    "share_difference",
    "trend",
    "welch",
    "wilson",
]
