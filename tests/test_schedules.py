import numpy as np
import pytest

from atari_dqn.schedules import epsilon, epsilon_greedy


def test_epsilon_is_multiplied_for_every_finished_game_down_to_its_floor(small):
    parameters = small(epsilon_start=1.0, epsilon_decay=0.995, epsilon_floor=0.01)
    assert epsilon(parameters, 0) == 1.0
    assert epsilon(parameters, 100) == pytest.approx(0.995**100)
    assert epsilon(parameters, 5000) == 0.01


def test_actions_are_greedy_but_for_the_share_epsilon():
    q_values = np.tile([0.0, 3.0, 1.0], (20_000, 1))
    rng = np.random.default_rng(0)
    assert (epsilon_greedy(q_values, 0.0, rng) == 1).all()
    others = (epsilon_greedy(q_values, 0.3, rng) != 1).mean()
    assert others == pytest.approx(0.3 * 2 / 3, abs=0.015)
