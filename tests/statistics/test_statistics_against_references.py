"""Our numbers beside those of SciPy and statsmodels, where these compute the same."""

import numpy as np
import pytest
from scipy import stats

from knowarm.statistics import (
    bootstrap,
    holm,
    iqm,
    median_steps,
    one_way_anova,
    paired,
    power_of_two_samples,
    probability_of_improvement,
    restricted_mean_steps,
    seeds_needed,
    share_difference,
    welch,
    wilson,
)
from knowarm.statistics.bootstrap import CONFIDENCE

proportion = pytest.importorskip("statsmodels.stats.proportion")
survival = pytest.importorskip("statsmodels.duration.survfunc")


@pytest.mark.parametrize(
    ("successes", "trials"), [(0, 10), (3, 10), (10, 10), (917, 1000)]
)
def test_wilson(successes, trials):
    ours, confidence = wilson(successes, trials), CONFIDENCE
    low, high = proportion.proportion_confint(
        successes, trials, 1 - confidence, method="wilson"
    )
    assert ours.low == pytest.approx(max(low, 0), abs=1e-12)
    assert ours.high == pytest.approx(min(high, 1), abs=1e-12)
    scipy = stats.binomtest(successes, trials).proportion_ci(
        confidence, method="wilson"
    )
    assert (ours.low, ours.high) == pytest.approx((scipy.low, scipy.high), abs=1e-12)


@pytest.mark.parametrize(
    "counts", [(56, 70, 48, 80), (200, 200, 0, 50), (9, 10, 10, 10)]
)
def test_difference_of_shares(counts):
    hits, trials, other_hits, other_trials = counts
    ours = share_difference(wilson(hits, trials), wilson(other_hits, other_trials))
    ends = proportion.confint_proportions_2indep(
        *counts, method="newcomb", compare="diff"
    )
    assert ours.estimate == pytest.approx(hits / trials - other_hits / other_trials)
    assert (ours.low, ours.high) == pytest.approx(ends, abs=1e-9)


def test_welch():
    generator = np.random.default_rng(0)
    first, second = generator.normal(0.7, 0.1, 6), generator.normal(0.6, 0.02, 9)
    ours = welch(first, second)
    scipy = stats.ttest_ind(first, second, equal_var=False)
    interval = scipy.confidence_interval()
    assert ours.p_value == pytest.approx(scipy.pvalue)
    assert (ours.difference.low, ours.difference.high) == pytest.approx(tuple(interval))


def test_paired():
    generator = np.random.default_rng(1)
    first, second = generator.normal(0.7, 0.1, 50), generator.normal(0.6, 0.1, 50)
    ours, scipy = paired(first, second), stats.ttest_rel(first, second)
    assert ours.p_value == pytest.approx(scipy.pvalue)
    interval = scipy.confidence_interval()
    assert (ours.difference.low, ours.difference.high) == pytest.approx(tuple(interval))


@pytest.mark.parametrize("count", [1, 2, 5, 30])
def test_holm(count):
    multitest = pytest.importorskip("statsmodels.stats.multitest")
    values = np.random.default_rng(count).uniform(0, 0.2, count)
    _, reference, _, _ = multitest.multipletests(values, method="holm")
    np.testing.assert_allclose(holm(values), reference)


def test_one_way_anova():
    oneway = pytest.importorskip("statsmodels.stats.oneway")
    generator = np.random.default_rng(2)
    groups = [generator.normal(0.8, 0.04, 30), generator.normal(0.7, 0.05, 30)]
    ours = one_way_anova(groups)
    reference = oneway.anova_oneway(groups, use_var="equal")
    assert ours == pytest.approx((reference.statistic, reference.pvalue))
    assert (reference.df_num, reference.df_denom) == (1, 58)


@pytest.mark.parametrize("effect", [0.4, 0.8, 2.0])
def test_power(effect):
    power = pytest.importorskip("statsmodels.stats.power").TTestIndPower()
    for count in (3, 10, 40):
        for alpha in (0.05, 0.05 / 6):
            expected = power.power(effect, count, alpha)
            # Near 1, with SciPy before 1.17
            expected = 1.0 if np.isnan(expected) else expected
            assert power_of_two_samples(effect, count, alpha) == pytest.approx(
                expected, abs=1e-9
            )
    needed = power.solve_power(effect_size=effect, power=0.8, alpha=0.05)
    assert seeds_needed(effect) == int(np.ceil(needed))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("until", [6.0, 11.0])
def test_restricted_mean(seed, until):
    generator = np.random.default_rng(seed)
    steps = generator.integers(1, 12, 25).astype(float)  # ties on purpose
    steps[0] = 12.0
    reached = generator.random(25) < 0.7
    reference = survival.SurvfuncRight(steps, reached)
    inside = reference.surv_times < until
    times = np.concatenate([reference.surv_times[inside], [until]])
    waiting = reference.surv_prob[inside]
    areas = waiting * np.diff(times)
    right = areas[::-1].cumsum()[::-1]
    # Greenwood's
    terms = np.diff((reference.surv_prob_se[inside] / waiting) ** 2, prepend=0.0)
    ours = restricted_mean_steps(steps, reached, until)
    assert ours.estimate == pytest.approx(times[0] + areas.sum())
    error = np.sqrt((right**2 * terms).sum())
    assert ours.low == pytest.approx(ours.estimate - 1.959964 * error)


@pytest.mark.parametrize("seed", range(4))
def test_median_steps(seed):
    generator = np.random.default_rng(seed)
    steps = generator.exponential(4, 40)
    reached = generator.random(40) < 0.8
    ours = median_steps(steps, reached)
    reference = survival.SurvfuncRight(steps, reached)
    with np.errstate(
        divide="ignore", invalid="ignore"
    ):  # theirs takes log(0) at its ends
        low, high = reference.quantile_ci(0.5, method="cloglog")
    assert ours[0] == pytest.approx(reference.quantile(0.5))
    assert ours[1:] == pytest.approx((low, high))


def test_restricted_mean_without_censoring_is_the_mean_of_the_shortened():
    steps = np.random.default_rng(3).exponential(5, 30)
    ours = restricted_mean_steps(steps, np.ones(30, bool), 6.0)
    shortened = np.minimum(steps, 6.0)
    assert ours.estimate == pytest.approx(shortened.mean())
    # Greenwood's form of its variance is the plain one, divided by n.
    assert (ours.high - ours.low) / 2 == pytest.approx(
        1.959964 * shortened.std() / np.sqrt(30)
    )


def test_bootstrap_of_the_mean():
    scores = np.random.default_rng(4).normal(0.6, 0.1, 12)
    ours = bootstrap(scores, repetitions=20_000)
    reference = stats.bootstrap(
        (scores,),
        np.mean,
        method="percentile",
        n_resamples=20_000,
        rng=np.random.default_rng(1),
    ).confidence_interval
    assert (ours.low, ours.high) == pytest.approx(tuple(reference), abs=2e-3)


def test_interquartile_mean():
    scores = np.random.default_rng(5).normal(size=(3, 20))
    np.testing.assert_allclose(
        iqm(scores), [stats.trim_mean(row, 0.25) for row in scores]
    )


def test_probability_of_improvement_is_mann_whitney():
    generator = np.random.default_rng(6)
    first, second = (
        generator.normal(0.3, 1, 9).round(1),
        generator.normal(0, 1, 7).round(1),
    )
    u = stats.mannwhitneyu(first, second).statistic
    assert probability_of_improvement(first, second).estimate == pytest.approx(u / 63)
