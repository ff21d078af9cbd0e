from importlib import import_module

import numpy as np
import pytest
import scipy

from knowarm.statistics import (
    CrossedScores,
    Interval,
    area_under_curve,
    bootstrap,
    crossed_difference,
    crossed_mean,
    crossed_share,
    first_crossing,
    holm,
    iqm,
    mean_of_runs,
    median_steps,
    one_way_anova,
    paired,
    performance_profile,
    probability_of_improvement,
    restricted_mean_steps,
    seeds_needed,
    trend,
    welch,
    wilson,
)


def test_bootstrap_gives_the_same_bytes_twice():
    scores = np.random.default_rng(1).random(20)
    assert bootstrap(scores, iqm) == bootstrap(scores, iqm)


def test_bootstrap_blocks_do_not_change_its_result(monkeypatch):
    scores = np.random.default_rng(0).random(10)
    whole = bootstrap(scores, repetitions=2_000)
    monkeypatch.setattr(import_module("knowarm.statistics.bootstrap"), "BLOCK", 100)
    assert bootstrap(scores, repetitions=2_000) == whole


def test_one_score_has_no_interval():
    assert bootstrap(np.array([0.5])) == Interval(0.5, 0.5, 0.5)


def test_bootstrap_covers_the_truth():
    generator = np.random.default_rng(7)
    inside = 0
    for _ in range(1_000):
        interval = bootstrap(generator.normal(0, 1, 30), repetitions=400)
        inside += interval.low <= 0 <= interval.high
    assert 0.9 <= inside / 1_000 <= 0.97


def test_welch_keeps_its_promise_at_three_seeds():
    generator = np.random.default_rng(8)
    wrong = sum(
        welch(generator.normal(0, 1, 3), generator.normal(0, 1, 3)).p_value <= 0.05
        for _ in range(1_000)
    )
    assert wrong <= 65


def test_one_run_allows_no_comparison():
    with pytest.raises(ValueError, match="at least two runs"):
        welch(np.array([0.9]), np.array([0.1, 0.2]))


def test_equal_scores_without_spread_are_no_difference():
    same = welch(np.full(3, 0.5), np.full(3, 0.5))
    assert same.p_value == 1
    assert same.effect_size is None
    assert paired(np.ones(4), np.ones(4)).p_value == 1
    assert one_way_anova([np.ones(3), np.ones(3)]) == (0, 1)
    assert one_way_anova([np.ones(3), np.zeros(3)]) == (np.inf, 0)


def test_a_spread_of_rounding_alone_is_none():
    compared = welch(np.full(3, 0.7), np.full(3, 0.1))
    assert (compared.effect_size, compared.p_value) == (None, 0)
    assert compared.difference.low == compared.difference.high == pytest.approx(0.6)
    steps = np.array([0.3, 0.4, 0.5])
    assert paired(steps, steps - 0.2).effect_size is None
    assert paired(steps, np.array([0.1, 0.2, 0.3]) + 0.2).p_value == 1


def test_one_side_without_spread_is_compared_without_a_warning():
    compared = welch(np.full(3, 0.5), np.array([0.2, 0.3, 0.4]))
    assert (
        compared.difference.low
        < compared.difference.estimate
        < compared.difference.high
    )


def test_probability_of_improvement_of_the_clearly_better_is_one():
    better = probability_of_improvement(np.array([3.0, 4]), np.array([1.0, 2]))
    assert (better.estimate, better.low, better.high) == (1, 1, 1)
    tied = probability_of_improvement(np.ones(3), np.ones(3))
    assert tied.estimate == 0.5


def test_performance_profile_counts_runs_above_each_score():
    share, low, high = performance_profile(
        np.array([0.2, 0.4, 0.6, 0.8]), np.array([0.0, 0.3, 0.6, 0.9])
    )
    np.testing.assert_allclose(share, [1, 0.75, 0.25, 0])
    assert (low <= share).all()
    assert (share <= high).all()


def test_area_under_curve_by_hand():
    steps, values = np.array([10.0, 20.0]), np.array([0.2, 0.6])
    # 0..10 at .2, 10..20 rising to .6, 20..40 at .6: (2 + 4 + 12) / 40
    assert area_under_curve(steps, values, 40) == pytest.approx(0.45)
    assert area_under_curve(steps, values, 15) == pytest.approx((2 + 1.5) / 15)


def test_first_crossing_marks_what_was_never_seen():
    steps, values = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.6, 0.4])
    assert first_crossing(steps, values, 0.5) == (2.0, True)
    assert first_crossing(steps, values, 0.7) == (3.0, False)


def test_censored_runs_by_hand():
    # 5 runs: crossings at 2 and 6, censored at 4, crossing at 8, censored at 9.
    # S is 1 up to 2, then .8, from 6 on .8 * 2 / 3, from 8 on half of that.
    steps, reached = np.array([2, 4, 6, 8, 9.0]), np.array([1, 0, 1, 1, 0], bool)
    assert median_steps(steps, reached)[0] == 8
    restricted = restricted_mean_steps(steps, reached, 9.0)
    assert restricted.estimate == pytest.approx(2 + 4 * 0.8 + 2 * 1.6 / 3 + 0.8 / 3)
    variance = (4 * 0.8 + 2 * 1.6 / 3 + 0.8 / 3) ** 2 / 20
    variance += (2 * 1.6 / 3 + 0.8 / 3) ** 2 / 6 + (0.8 / 3) ** 2 / 2
    assert restricted.low == pytest.approx(
        restricted.estimate - 1.959964 * np.sqrt(variance)
    )


def test_the_median_is_reached_by_exactly_half_of_the_runs():
    # (1 - 1/28)(1 - 1/27)... is rounded to more than 1/2 after 14 of 28 crossings.
    for count in range(2, 60, 2):
        assert (
            median_steps(np.arange(1.0, count + 1), np.ones(count, bool))[0]
            == count / 2
        )


def test_a_threshold_nobody_reached_has_no_median_and_costs_all_steps():
    steps, reached = np.array([5.0, 5.0, 5.0]), np.zeros(3, bool)
    assert median_steps(steps, reached) == (None, None, None)
    assert restricted_mean_steps(steps, reached, 5.0) == Interval(5.0, 5.0, 5.0)


def test_trend_keeps_a_straight_line():
    values = np.arange(20.0)
    np.testing.assert_allclose(trend(values, 7), values)
    np.testing.assert_allclose(trend(values, 1), values)


def test_seeds_needed_falls_with_the_effect_and_gives_up():
    assert seeds_needed(0.5) > seeds_needed(1.0) > seeds_needed(3.0) >= 2
    assert seeds_needed(0.001) is None


def test_holm_by_hand():
    np.testing.assert_allclose(holm([0.04, 0.01, 0.03]), [0.06, 0.03, 0.06])
    assert holm([]).size == 0


@pytest.mark.parametrize(("successes", "trials"), [(1, 0), (3, 2), (-1, 2)])
def test_wilson_refuses_what_cannot_be(successes, trials):
    with pytest.raises(ValueError, match="must"):
        wilson(successes, trials)


def test_few_runs_have_an_interval_as_wide_as_students_t_and_as_their_own():
    def run(value: float, half: float) -> Interval:
        return Interval(value, value - half, value + half)

    found = mean_of_runs([run(0.91, 0.02), run(0.95, 0.02)])
    # Quantile of t with 1 degree of freedom, standard error of the mean
    half = 12.706 * 0.02
    assert (found.low, found.high) == pytest.approx(
        (0.93 - half, 0.93 + half), rel=1e-3
    )
    assert found.runs == (0.91, 0.95)
    equal = mean_of_runs([run(0.9, 0.05)] * 3)
    assert (equal.low, equal.high) == pytest.approx((0.85, 0.95))
    five = mean_of_runs([run(value, 0.5) for value in (0.1, 0.2, 0.3, 0.4, 0.5)])
    assert five == bootstrap(np.array([0.1, 0.2, 0.3, 0.4, 0.5]))


def ends_of(interval):
    return interval.low, interval.high


def test_crossed_intervals_cover_the_truth_with_four_topics():
    generator = np.random.default_rng(3)
    runs, topics = np.divmod(np.arange(5 * 4 * 50) // 50, 4)
    crossed, over_runs = 0, 0
    for _ in range(300):
        of_topic = generator.beta(6, 4, 4)
        of_run = generator.normal(0, 0.02, 5)
        chances = (of_topic[topics] + of_run[runs]).clip(0, 1)
        hits = (generator.random(len(runs)) < chances).astype(float)
        share = crossed_share(CrossedScores(hits, runs, topics))
        crossed += share.low <= 0.6 <= share.high
        blind = bootstrap(hits.reshape(5, -1).mean(axis=1), repetitions=400)
        over_runs += blind.low <= 0.6 <= blind.high
    assert 0.9 <= crossed / 300 <= 0.98
    assert over_runs / 300 < 0.6


def test_crossed_differences_cover_the_truth_with_six_topics():
    generator = np.random.default_rng(5)
    runs, topics = np.divmod(np.arange(3 * 6 * 50) // 50, 6)
    crossed = 0
    for _ in range(300):
        of_topic = generator.normal(0, 1, 6)
        gain_of_topic = generator.normal(0.5, 1, 6)
        agents = []
        for gain in (gain_of_topic, np.zeros(6)):
            of_run = generator.normal(0, 0.3, 3)
            means = (of_topic + gain)[topics] + of_run[runs]
            scores = means + generator.normal(0, 1, len(runs))
            agents.append(CrossedScores(scores, runs, topics))
        difference = crossed_difference(*agents)
        crossed += difference.low <= 0.5 <= difference.high
    assert 0.92 <= crossed / 300 <= 0.99


def test_crossed_intervals_with_one_topic_are_those_over_runs():
    generator = np.random.default_rng(4)
    many = CrossedScores(generator.random(12), np.arange(12), ["mug"] * 12)
    few = CrossedScores(generator.random(7), np.arange(7), ["mug"] * 7)
    ends = scipy.stats.t.interval(
        0.95, 11, many.scores.mean(), scipy.stats.sem(many.scores)
    )
    mean = crossed_mean(many)
    assert ends_of(mean) == pytest.approx(ends)
    difference = crossed_difference(many, few)
    expected = welch(many.scores, few.scores).difference
    assert ends_of(difference) == pytest.approx(ends_of(expected))


def test_crossed_differences_of_one_run_each_are_paired_by_topic():
    generator = np.random.default_rng(4)
    first, second = generator.random((2, 9))
    topics = [*"abcdefghi"]
    difference = crossed_difference(
        CrossedScores(first, ["x"] * 9, topics),
        CrossedScores(second[::-1], ["x"] * 9, topics[::-1]),
    )
    expected = paired(first, second).difference
    assert ends_of(difference) == pytest.approx(ends_of(expected))


def test_a_topic_with_most_episodes_counts_as_one():
    topics = ["often"] * 24 + [*"abcdefghijklmnop"]
    scores = np.array([1.0] * 24 + [0.0] * 16)
    mean = crossed_mean(CrossedScores(scores, ["x"] * 40, topics))
    assert mean.estimate == 0.6
    assert mean.low < 0


def test_crossed_shares_stay_within_their_bounds():
    hits = np.array([1.0, 1.0, 1.0, 0.0])
    share = crossed_share(CrossedScores(hits, [*"aabb"], [*"xyxy"]))
    assert 0 < share.low < share.estimate == 0.75 < share.high < 1
    none = crossed_share(CrossedScores(np.zeros(4), [*"aabb"], [*"xyxy"]))
    assert none == Interval(0, 0, 0)


def test_a_topic_that_one_agent_lacks_counts_for_the_other():
    first = CrossedScores(np.array([1.0, 0.0]), [*"aa"], [*"xy"])
    second = CrossedScores(np.array([0.5, 0.5]), [*"bb"], [*"xz"])
    difference = crossed_difference(first, second)
    # Left out, x gives 0 - .5, y 1 - .5, z .5 - .5: a variance of (2 / 3) (.25 + .25) with t(2).
    half = scipy.stats.t.ppf(0.975, 2) * np.sqrt(1 / 3)
    assert ends_of(difference) == pytest.approx((-half, half))
