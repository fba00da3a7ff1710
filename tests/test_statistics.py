import numpy as np
import pandas as pd
import pytest
from scipy import stats

from atari_dqn import statistics
from atari_dqn.statistics import interval, scores_at_marks, trailing_mean


def test_a_trailing_mean_is_of_the_last_games_and_waits_for_enough():
    means = trailing_mean(pd.Series([1.0, 2.0, 3.0, 6.0]), 2)
    assert np.isnan(means[0])
    assert means[1:].tolist() == [1.5, 2.5, 4.5]


def test_scores_at_marks_are_means_of_the_games_before_and_missing_where_not_reached():
    episodes = pd.DataFrame({"episode": [1, 2, 3], "score": [1, 2, 6], "agent": "dqn", "seed": 1})
    table = scores_at_marks(episodes, (2, 3, 4), window=2)
    assert table.loc[("dqn", 1)].tolist()[:2] == [1.5, 4.0]
    assert np.isnan(table.loc[("dqn", 1), 4])


def test_the_interval_covers_the_true_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(200):
        low, high = interval(rng.normal(3, 2, size=60))
        hits += low < 3 < high
    assert 180 <= hits <= 200


def test_one_value_has_no_interval():
    with pytest.raises(ValueError, match="at least two"):
        interval(np.array([1.0]))


def test_the_interval_of_a_difference_agrees_with_welchs():
    rng = np.random.default_rng(1)
    first, second = rng.normal(3, 2, 400), rng.normal(1, 5, 300)
    low, high = statistics.difference(first, second)
    welch = stats.ttest_ind(first, second, equal_var=False).confidence_interval()
    assert (low, high) == pytest.approx((welch.low, welch.high), abs=0.1)
    assert statistics.difference(second, first) == pytest.approx((-high, -low), abs=0.1)
    with pytest.raises(ValueError, match="two values"):
        statistics.difference(first, second[:1])


def test_blocks_are_means_of_fifty_successive_games_and_the_oldest_remainder_goes():
    scores = np.r_[np.full(7, 99.0), np.full(50, 1.0), np.full(50, 3.0)]
    assert statistics.blocks(scores).tolist() == [1.0, 3.0]
    assert statistics.blocks(scores[:49]).size == 0
