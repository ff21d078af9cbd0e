"""Statistics of training runs and evaluations over SciPy: pure functions, 95 % intervals."""

from knowarm.statistics.bootstrap import Interval as Interval
from knowarm.statistics.bootstrap import bootstrap as bootstrap
from knowarm.statistics.bootstrap import iqm as iqm
from knowarm.statistics.bootstrap import mean_band as mean_band
from knowarm.statistics.bootstrap import mean_of_runs as mean_of_runs
from knowarm.statistics.bootstrap import performance_profile as performance_profile
from knowarm.statistics.bootstrap import (
    probability_of_improvement as probability_of_improvement,
)
from knowarm.statistics.bootstrap import share_difference as share_difference
from knowarm.statistics.bootstrap import share_of as share_of
from knowarm.statistics.bootstrap import wilson as wilson
from knowarm.statistics.compare import Comparison as Comparison
from knowarm.statistics.compare import holm as holm
from knowarm.statistics.compare import one_way_anova as one_way_anova
from knowarm.statistics.compare import paired as paired
from knowarm.statistics.compare import power_of_two_samples as power_of_two_samples
from knowarm.statistics.compare import seeds_needed as seeds_needed
from knowarm.statistics.compare import welch as welch
from knowarm.statistics.crossed import CrossedScores as CrossedScores
from knowarm.statistics.crossed import crossed_difference as crossed_difference
from knowarm.statistics.crossed import crossed_mean as crossed_mean
from knowarm.statistics.crossed import crossed_share as crossed_share
from knowarm.statistics.survival import area_under_curve as area_under_curve
from knowarm.statistics.survival import first_crossing as first_crossing
from knowarm.statistics.survival import median_steps as median_steps
from knowarm.statistics.survival import restricted_mean_steps as restricted_mean_steps
from knowarm.statistics.survival import trend as trend
