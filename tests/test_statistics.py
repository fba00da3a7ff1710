import numpy as np
import pandas as pd
import pytest
from scipy import stats

from atari_dqn.analysis import statistics
from atari_dqn.analysis.statistics import scores_at_milestones, trailing_mean


def test_a_trailing_mean_is_of_the_last_games_and_waits_for_enough():
    means = trailing_mean(pd.Series([1.0, 2.0, 3.0, 6.0]), 2)
    assert np.isnan(means[0])
    assert means[1:].tolist() == [1.5, 2.5, 4.5]


def test_scores_at_marks_are_means_of_the_games_before_and_missing_where_not_reached():
    episodes = pd.DataFrame({"episode": [1, 2, 3], "score": [1, 2, 6], "agent": "dqn", "seed": 1})
    table = scores_at_milestones(episodes, (2, 3, 4), window=2)
    assert table.loc[("dqn", 1)].tolist()[:2] == [1.5, 4.0]
    assert np.isnan(table.loc[("dqn", 1), 4])


def test_welchs_interval_is_antisymmetric_and_a_point_for_constants():
    rng = np.random.default_rng(1)
    first, second = rng.normal(3, 2, 400), rng.normal(1, 5, 300)
    low, high = statistics.welch_interval(first, second)
    assert statistics.welch_interval(second, first) == pytest.approx((-high, -low))
    assert statistics.welch_interval(np.full(3, 5.0), np.full(4, 2.0)) == (3.0, 3.0)
    expected = stats.ttest_ind(first, second, equal_var=False).confidence_interval()
    assert (low, high) == pytest.approx((expected.low, expected.high))


def test_values_that_repeat_others_of_their_cluster_narrow_no_interval():
    values = np.random.default_rng(0).normal(size=10)
    repeated = statistics.by_cluster(np.tile(values, 100), np.tile(np.arange(10), 100))
    assert sorted(repeated) == pytest.approx(sorted(values))


def test_values_by_cluster_have_the_mean_of_all_and_an_interval_that_holds_the_truth():
    """Clusters of different sizes, whose values resemble one another; the truth is 0."""
    rng, held = np.random.default_rng(0), {"by cluster": 0, "as if alone": 0}
    for _ in range(400):
        clusters = rng.integers(30, size=100)
        values = rng.normal(size=30)[clusters] + 0.5 * rng.normal(size=100)
        found = statistics.by_cluster(values, clusters)
        assert found.mean() == pytest.approx(values.mean())
        for name, sample in (("by cluster", found), ("as if alone", values)):
            low, high = statistics.student_interval(sample)
            held[name] += low <= 0 <= high
    assert 0.91 < held["by cluster"] / 400 < 0.98
    assert held["as if alone"] / 400 < 0.85


def test_values_of_a_single_cluster_are_one_value_and_make_no_interval():
    values = np.array([1.0, 2.0, 6.0])
    assert statistics.by_cluster(values, np.zeros(3)).tolist() == [3.0]
    with pytest.raises(ValueError, match="at least two"):
        statistics.cluster_interval(values, np.zeros(3))


def test_an_interval_by_cluster_is_students_over_the_clusters():
    low, high = statistics.cluster_interval(np.array([1.0, 1.0, 5.0, 5.0]), np.array([1, 1, 2, 2]))
    half = 2 * stats.t.ppf(0.975, 1)  # standard error 2, of two values
    assert (low, high) == pytest.approx((3 - half, 3 + half))


def test_too_few_values_make_no_interval():
    first, second = np.arange(4.0), np.arange(3.0)
    with pytest.raises(ValueError, match="two values"):
        statistics.welch_interval(first, second[:1])


@pytest.mark.parametrize(
    ("likeness", "number", "covered"),
    [(0.0, 10, 0.97), (0.5, 10, 0.90), (0.7, 10, 0.86), (0.9, 10, 0.71), (0.7, 60, 0.94)],
)
def test_the_interval_of_a_series_covers_its_mean_as_often_as_is_said(likeness, number, covered):
    """Of series whose neighbours are alike by so much, around a true mean of 0."""
    rng, hits = np.random.default_rng(0), 0
    for _ in range(500):
        series = [rng.normal()]
        for shock in np.sqrt(1 - likeness**2) * rng.normal(size=number - 1):
            series.append(likeness * series[-1] + shock)
        low, high = statistics.series_interval(np.array(series))
        hits += low < 0 < high
    assert hits / 500 == pytest.approx(covered, abs=0.05)
    assert statistics.coverage(likeness, number) == pytest.approx(covered, abs=0.04)


def test_likeness_is_that_of_a_long_series_and_none_of_a_line():
    rng, series = np.random.default_rng(0), [0.0]
    for shock in rng.normal(size=3000):
        series.append(0.7 * series[-1] + shock)
    assert statistics.likeness(np.array(series) + np.linspace(0, 900, 3001)) == pytest.approx(
        0.7, abs=0.05
    )
    assert statistics.likeness(rng.normal(size=3000)) < 0.05
    assert statistics.likeness(np.tile([1.0, -1.0], 20)) == 0, "of values that alternate"
    with pytest.raises(ValueError, match="three"):
        statistics.likeness(np.zeros(2))


def test_an_interquartile_mean_is_of_the_middle_half_of_all_values():
    groups = np.array([-900.0, 1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0, 900.0])
    assert statistics.iqm(*groups) == 3.5  # of 2, 3, 4 and 5
    assert statistics.iqm(np.array([1.0, 2.0, 6.0])) == 3.0  # a quarter of three is none


def test_the_probability_of_improvement_counts_pairs_and_ties_half():
    one, other = np.array([1.0, 5.0, 7.0]), np.array([5.0, 6.0])
    # of six pairs 7 > 5 and 7 > 6 are above, and 5 = 5
    assert statistics.probability_of_improvement(one, other) == pytest.approx(2.5 / 6)
    assert statistics.probability_of_improvement(other, one) == pytest.approx(3.5 / 6)


def test_groups_are_resampled_each_by_itself():
    """Two groups of no spread have a difference of none, which mixing them would not."""
    gap = statistics.stratified_interval(
        lambda one, other, axis: one.mean(axis) - other.mean(axis), np.full(3, 9.0), np.full(4, 2.0)
    )
    assert gap == (7.0, 7.0)
    low, high = statistics.stratified_interval(
        statistics.iqm, np.arange(40.0), np.arange(40.0) + 100
    )
    middle = statistics.iqm(np.arange(40.0), np.arange(40.0) + 100)
    assert low < middle < high
    assert high - low < 25, "the groups are half each in every resample"


def test_without_likeness_the_interval_is_that_of_a_regressions_middle():
    values, times = np.array([3.0, -1.0, 4.0, -1.0, 5.0]), np.arange(5) - 2
    line = stats.linregress(times, values)
    half = stats.t.ppf(0.975, 3) * line.intercept_stderr
    expected = (line.intercept - half, line.intercept + half)
    assert statistics.series_interval(values) == pytest.approx(expected)


def test_a_difference_that_grows_steadily_is_no_reason_for_doubt():
    noise = np.random.default_rng(0).normal(0, 1, 10)
    low, high = statistics.series_interval(np.linspace(0, 40, 10) + noise)
    assert 16 < low < 20 < high < 24


def test_the_interval_of_independent_values_is_students():
    values = np.array([3.0, -1.0, 4.0])
    expected = stats.ttest_1samp(values, 0).confidence_interval()
    assert statistics.student_interval(values) == pytest.approx((expected.low, expected.high))


def test_blocks_are_means_of_fifty_successive_games_and_the_oldest_remainder_goes():
    scores = np.r_[np.full(7, 99.0), np.full(50, 1.0), np.full(50, 3.0)]
    assert statistics.blocks(scores).tolist() == [1.0, 3.0]
    assert statistics.blocks(scores[:49]).size == 0


def test_scores_at_marks_keep_agents_and_seeds_apart_and_end_with_the_marks_game():
    """Scores that jump at a window's edges, of two agents and two seeds."""
    rows = [
        {
            "agent": agent,
            "seed": seed,
            "episode": game,
            "score": base + seed + 100 * (4 <= game <= 6),
        }
        for agent, base in (("dqn", 10), ("double_dqn", 20))
        for seed in (1, 2)
        for game in range(1, 9)
    ]
    table = scores_at_milestones(pd.DataFrame(rows), (3, 6, 8), window=3)
    assert table.loc[("dqn", 1)].tolist() == pytest.approx([11, 111, 11 + 100 / 3])
    assert table.loc[("dqn", 2), 6] == 112
    assert table.loc[("double_dqn", 2), 6] == 122
