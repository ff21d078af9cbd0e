"""Scores, curves and counts go in; estimates with their uncertainty come out. All pure, seeded."""

from knowarm.statistics.anova import WHAT_IT_SHOWS, Anova, one_way_anova
from knowarm.statistics.bootstrap import bootstrap, iqm, mean
from knowarm.statistics.compare import Comparison, holm, paired, welch
from knowarm.statistics.curve import area_under_curve, first_crossing, on_grid, trend
from knowarm.statistics.improvement import probability_of_improvement
from knowarm.statistics.interval import Interval
from knowarm.statistics.power import power_of_two_samples, seeds_needed
from knowarm.statistics.profile import performance_profile
from knowarm.statistics.survival import (
    Survival,
    kaplan_meier,
    median_steps,
    restricted_mean_steps,
)
from knowarm.statistics.wilson import wilson

__all__ = [
    "WHAT_IT_SHOWS",
    "Anova",
    "Comparison",
    "Interval",
    "Survival",
    "area_under_curve",
    "bootstrap",
    "first_crossing",
    "holm",
    "iqm",
    "kaplan_meier",
    "mean",
    "median_steps",
    "on_grid",
    "one_way_anova",
    "paired",
    "performance_profile",
    "power_of_two_samples",
    "probability_of_improvement",
    "restricted_mean_steps",
    "seeds_needed",
    "trend",
    "welch",
    "wilson",
]
