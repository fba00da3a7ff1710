"""What changes with every finished game: how much an agent explores, and its learning rate."""

import numpy as np

from atari_dqn.params import Parameters


def epsilon(params: Parameters, games_finished: int) -> float:
    """Probability of a random action: multiplied by `epsilon_decay` for every finished game."""
    decayed = params.epsilon_start * params.epsilon_decay**games_finished
    return max(params.epsilon_floor, decayed)


def learning_rate(params: Parameters, games_finished: int) -> float:
    """Step size of Adam: rises linearly over the first `warmup_games`, then stays."""
    if games_finished >= params.warmup_games:
        return params.learning_rate
    share = games_finished / params.warmup_games
    return params.warmup_learning_rate * (1 - share) + params.learning_rate * share


def epsilon_greedy(q_values: np.ndarray, epsilon: float, rng: np.random.Generator) -> np.ndarray:
    """Actions [N] for Q-values [N, A]: random with probability `epsilon`, else the greatest.

    The same number of random draws is made whatever the outcome.
    """
    count, actions = q_values.shape
    explore = rng.random(count) < epsilon
    random = rng.integers(actions, size=count)
    return np.where(explore, random, q_values.argmax(axis=1))
