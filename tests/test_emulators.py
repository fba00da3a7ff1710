"""A run's emulators in several processes do what they do in one."""

import numpy as np
import pytest

from atari_dqn.emulators import ParallelVectorEnv, new_vector_env
from atari_dqn.envs import VectorEnv
from atari_dqn.training import Trainer


@pytest.fixture
def both(small):
    """The same games in one process, and in two that share them unequally."""
    parameters = small(game="breakout", environments=3, replay_capacity=300, max_game_frames=160)
    alone = new_vector_env(parameters, np.random.SeedSequence(3))
    shared = new_vector_env(
        parameters.model_copy(update={"emulator_processes": 2}), np.random.SeedSequence(3)
    )
    assert isinstance(alone, VectorEnv)
    assert isinstance(shared, ParallelVectorEnv)
    return alone, shared


def played(envs, actions):
    """What a step of all games gave, as bytes, and the games that ended."""
    step = envs.step(actions)
    arrays = (step.images, step.ages, step.rewards, step.terminated, step.ended)
    return [*(array.tobytes() for array in (*arrays, envs.observations())), step.finished]


def test_games_in_several_processes_are_those_in_one(both):
    alone, shared = both
    rng, finished = np.random.default_rng(0), 0
    assert alone.observations().tobytes() == shared.observations().tobytes()
    for _ in range(90):
        actions = rng.integers(4, size=3)
        expected = played(alone, actions)
        assert played(shared, actions) == expected
        assert alone.ended.tolist() == shared.ended.tolist()
        finished += len(expected[-1])
    assert finished > 3


def test_their_states_can_be_exchanged(both):
    alone, shared = both
    for _ in range(45):  # until all games have restarted once
        for envs in both:
            envs.step(np.array([1, 2, 3]))
    before = shared.get_state()
    assert before["games"] == alone.get_state()["games"]
    expected = [played(alone, np.array([3, 0, 2])) for _ in range(20)]
    for envs in (alone, shared):
        envs.set_state(before)
        assert [played(envs, np.array([3, 0, 2])) for _ in range(20)] == expected


def test_a_run_with_several_emulator_processes_is_the_run_with_one(small):
    weights = []
    for processes in (1, 2):
        trainer = Trainer(small(emulator_processes=processes), "double_dqn", 1)
        training = trainer.run()
        while trainer.episodes < 3:
            next(training)
        weights.append(
            {key: value.numpy().tobytes() for key, value in trainer.learner.weights().items()}
        )
    assert trainer.learner.updates > 3
    assert weights[0] == weights[1]
