"""Real, tiny training runs on the real cartridges."""

from copy import deepcopy
from dataclasses import astuple
from functools import cache

import numpy as np
import pytest
import torch
from conftest import SMALL

from atari_dqn import training
from atari_dqn.agents import AGENTS
from atari_dqn.params import Parameters
from atari_dqn.runs import checkpoints
from atari_dqn.schedules import epsilon_greedy
from atari_dqn.training import Trainer


def flat(state, name=""):
    """A nested state as {path: bytes or value}, comparable with ==."""
    if name.endswith(".pieces"):
        return {name: b"".join(state)}  # where a segment ends does not matter
    if isinstance(state, dict):
        return {k: v for key in state for k, v in flat(state[key], f"{name}.{key}").items()}
    if isinstance(state, list | tuple):
        return {k: v for i, s in enumerate(state) for k, v in flat(s, f"{name}.{i}").items()}
    if isinstance(state, torch.Tensor):
        state = state.numpy()
    if isinstance(state, np.ndarray):
        return {name: (state.dtype.str, state.shape, state.tobytes())}
    return {name: repr(state)}


def numbers(episode):
    """An episode's values as text, since nan equals no nan."""
    return [str(value) for value in astuple(episode)]


def episodes_after(trainer, steps):
    """Trains for `steps` vector steps; the games that ended."""
    running = trainer.run()
    return [numbers(episode) for _, episode in zip(range(steps), running, strict=False) if episode]


@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize("game", ["boxing", "breakout"])
def test_the_same_seed_gives_the_same_run_and_another_seed_another(small, agent, game):
    parameters = small(game=game, epsilon_start=0.5)
    first, again, other = (Trainer(parameters, agent, seed) for seed in (1, 1, 2))
    games = [episodes_after(trainer, 75) for trainer in (first, again, other)]
    assert games[0] == games[1] != games[2]
    assert flat(first.get_state()) == flat(again.get_state()) != flat(other.get_state())
    assert first.learner.updates > 20


PARAMETERS = Parameters(
    **{**SMALL, "max_game_frames": 150, "replay_capacity": 80},
    sticky_actions=0.25,
    epsilon_start=0.3,
)


@cache
def uninterrupted(agent):
    """The games and the final state of a run of 100 steps, in one of which two games end."""
    trainer = Trainer(PARAMETERS, agent, 6)
    return episodes_after(trainer, 100), flat(trainer.get_state())


def right_after_a_target_update(trainer):
    learner = trainer.learner
    renewed = learner.updates > 0 and learner.updates % learner.params.target_update_period == 0
    state = learner.get_state()
    pairs = zip(state["online"].values(), state["target"].values(), strict=True)
    assert not renewed or all(torch.equal(online, target) for online, target in pairs)
    return renewed


STOPS = {
    "before learning starts": lambda trainer: trainer.agent_steps == 6,
    "in the middle of both games": lambda trainer: (
        trainer.learner.updates > 3 and all(game.length > 20 for game in trainer.envs.envs)
    ),
    "right after a target update": right_after_a_target_update,
    "while a finished game waits to be reported": lambda trainer: bool(trainer.waiting),
    "after the memory's ring has wrapped": lambda trainer: (
        trainer.memory.full and trainer.memory.row == 5
    ),
}


@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize("agent", ["dqn", "dueling_double_dqn"])
def test_a_resumed_run_is_bit_for_bit_the_one_that_was_never_stopped(tmp_path, stop, agent):
    expected, final = uninterrupted(agent)
    stopped, resumed = Trainer(PARAMETERS, agent, 6), Trainer(PARAMETERS, agent, 6)
    games, steps = [], 0
    for episode in stopped.run():
        games += [numbers(episode)] if episode else []
        steps += 1
        assert steps < 95, f"never {stop}"
        if STOPS[stop](stopped):
            break
    checkpoints.save(tmp_path / "saved", stopped.get_state())
    resumed.set_state(checkpoints.load(tmp_path / "saved"))
    games += episodes_after(resumed, 100 - steps)
    assert games == expected
    assert flat(resumed.get_state()) == final


@pytest.mark.parametrize(
    "lost",
    [
        "rng",
        "agent_steps",
        "games.games",
        "games.planes",
        "games.ended",
        "memory.rng",
        "memory.row",
        "memory.actions",
        "memory.frames",
        "learner.target",
        "learner.moments",
        "learner.updates",
    ],
)
def test_a_resume_with_one_piece_of_an_older_state_plays_or_learns_differently(small, lost):
    """The test above would notice, and every piece matters."""
    parameters = small(replay_capacity=60, sticky_actions=0.25, epsilon_start=0.3)
    stopped, whole, resumed = (Trainer(parameters, "dqn", 2) for _ in range(3))
    episodes_after(stopped, 33)  # before the target network is first renewed
    older = deepcopy(stopped.get_state())
    while not stopped.envs.ended.any():
        episodes_after(stopped, 1)
    state = stopped.get_state()
    whole.set_state(state)
    *path, last = lost.split(".")
    place, source = state, older
    for key in path:
        place, source = place[key], source[key]
    place[last] = source[last]
    resumed.set_state(state)
    outcomes = [
        (
            trainer.learner.q_values(trainer.envs.observations()).tolist(),  # what it goes on by
            episodes_after(trainer, 40),
            flat(trainer.learner.weights()),
        )
        for trainer in (whole, resumed)
    ]
    assert outcomes[0] != outcomes[1]


def test_updates_are_due_every_period_after_learning_starts(small):
    trainer = Trainer(small(update_period=3, learning_starts=50), "dqn", 1)
    for _ in zip(range(40), trainer.run(), strict=False):
        assert trainer.learner.updates == max(0, trainer.agent_steps - 50) // 3
    assert trainer.agent_steps == 78, "two of the 80 begin games"


@pytest.mark.native
def test_exploration_and_learning_rate_follow_the_games_finished_before(small, monkeypatch):
    schedule = {"epsilon_start": 0.8, "epsilon_decay": 0.5, "epsilon_floor": 0.15}
    warmup = {"warmup_games": 4, "warmup_learning_rate": 1e-5, "learning_rate": 5e-5}
    trainer = Trainer(small(**schedule, **warmup, max_game_frames=100, update_period=1), "dqn", 1)
    chances, rates, learn = {}, {}, trainer.learner.learn

    def choose(q_values, probability, rng):
        chances.setdefault(trainer.episodes, set()).add(probability)
        return epsilon_greedy(q_values, probability, rng)

    def update(batch):
        rates.setdefault(trainer.episodes, set()).add(trainer.learner.learning_rate)
        return learn(batch)

    monkeypatch.setattr(training, "epsilon_greedy", choose)
    monkeypatch.setattr(trainer.learner, "learn", update)
    reported = [episode[5] for episode in episodes_after(trainer, 90)]
    assert [chances[games] for games in range(5)] == [{0.8}, {0.4}, {0.2}, {0.15}, {0.15}]
    assert reported[:5] == ["0.8", "0.4", "0.2", "0.15", "0.15"]
    assert all(len(rates[games]) == 1 for games in range(2, 6))
    assert [rates[games].pop() for games in range(2, 6)] == pytest.approx([3e-5, 4e-5, 5e-5, 5e-5])


def test_nothing_depends_on_how_many_games_are_planned(small):
    few, many = (Trainer(small(episodes=n), "dqn", 1) for n in (1, 1000))
    assert episodes_after(few, 90) == episodes_after(many, 90)


def transition(s_tm1, a_tm1, r_t, discount_t, s_t):
    """One to compare with others; observations as the hashes of their bytes."""
    return hash(s_tm1.tobytes()), int(a_tm1), float(r_t), float(discount_t), hash(s_t.tobytes())


def recorded(envs, monkeypatch):
    """The list that will hold every transition, as the emulators and the agent saw it."""
    transitions, emulated = [], {}
    for index, env in enumerate(envs.envs):

        def emulate(action, index=index, step=env.step):
            result = step(action)
            emulated[index] = (action, result[1], np.float32(0 if result[2] else 0.99))
            return result

        monkeypatch.setattr(env, "step", emulate)

    def play(actions, step=envs.step):
        emulated.clear()  # a game that restarts is not stepped
        before, result, after = envs.observations(), step(actions), envs.observations()
        for index, experience in emulated.items():
            transitions.append(transition(before[index], *experience, after[index]))
        return result

    monkeypatch.setattr(envs, "step", play)
    return transitions


def test_the_memory_holds_each_step_as_it_was_played_and_none_that_restarts_a_game(
    small, monkeypatch
):
    parameters = small(
        game="breakout",
        clip_rewards=False,
        max_game_frames=540,
        replay_capacity=2000,
        learning_starts=10_000,
    )
    trainer = Trainer(parameters, "dqn", 1)
    played = recorded(trainer.envs, monkeypatch)
    episodes_after(trainer, 170)
    assert trainer.agent_steps == len(played)
    assert {action for _, action, *_ in played} == {0, 1, 2, 3}
    assert {reward for _, _, reward, *_ in played} >= {0, 1}
    over = sum(discount == 0 for *_, discount, _ in played)
    assert 0 < over < trainer.episodes, "one game ended, another was cut"
    sampled = set()
    for _ in range(12):
        batch = trainer.memory.sample(len(played))
        columns = (batch.s_tm1, batch.a_tm1, batch.r_t, batch.discount_t, batch.s_t)
        sampled |= {transition(*row) for row in zip(*columns, strict=True)}
    assert sampled == set(played)


def test_games_that_end_together_are_numbered_and_reported_one_by_one(small):
    trainer = Trainer(small(environments=4, replay_capacity=400), "dqn", 1)
    episodes = [e for _, e in zip(range(120), trainer.run(), strict=False) if e]
    assert [episode.episode for episode in episodes] == list(range(1, len(episodes) + 1))
    assert len(episodes) >= 4
    frames = [episode.frames for episode in episodes]
    assert frames == sorted(frames)
    assert frames[0] > 0
