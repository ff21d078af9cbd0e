"""Scores, curves and counts go in; estimates with their uncertainty come out. All pure, seeded."""

from knowarm.experiment.statistics.anova import WHAT_IT_SHOWS, Anova, one_way_anova
from knowarm.experiment.statistics.bootstrap import bootstrap, iqm, mean
from knowarm.experiment.statistics.compare import Comparison, holm, paired, welch
from knowarm.experiment.statistics.curve import area_under_curve, first_crossing, on_grid, trend
from knowarm.experiment.statistics.improvement import probability_of_improvement
from knowarm.experiment.statistics.interval import Interval
from knowarm.experiment.statistics.power import power_of_two_samples, seeds_needed
from knowarm.experiment.statistics.profile import performance_profile
from knowarm.experiment.statistics.survival import (
    Survival,
    kaplan_meier,
    median_steps,
    restricted_mean_steps,
)
from knowarm.experiment.statistics.wilson import wilson

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
