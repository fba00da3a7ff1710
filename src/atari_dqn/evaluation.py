"""Playing whole games with a finished agent: greedy evaluation.

Everything but the check of values while training plays the published model, `model.safetensors`
(float16), so that what is shown is what anyone can reproduce from the repository. What a player is
given and gives: observations, bytes [N, 84, 84, stack], and Q-values, float32 [N, A].
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from torch import nn

from atari_dqn.agents import AGENTS
from atari_dqn.envs import SIZE, EpisodeRecord, interleave, learned_reward, make_env
from atari_dqn.native import new_learner
from atari_dqn.params import EVALUATION, HELD_OUT_STATES, VALUE_GAMES, Parameters
from atari_dqn.schedules import epsilon_greedy

Player = Callable[[np.ndarray], np.ndarray]

EMULATORS = 8  # games played at once
BATCH = 8  # observations a forward pass; fixed, since the last bits of Q depend on it


@dataclass(frozen=True)
class EvaluationEpisode:
    """One evaluation game, a row of evaluations.csv."""

    game: int  # 0, 1, ...; decides the game's random seeds
    score: float  # points, raw and unclipped
    length: int  # agent steps
    frames: int  # emulator frames
    won: bool
    knockout: int  # 1 given, -1 received, 0 neither
    difficulty: int
    sticky_actions: float  # probability per frame
    epsilon: float  # probability of a random action
    seed: int
    scored: float  # points of the agent alone
    conceded: float  # points of its rival
    distance: float  # pixels between the two boxers, mean over the steps; nan in other games
    record: EpisodeRecord  # not a column

    def row(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in PLAYED_COLUMNS}


PLAYED_COLUMNS = [field.name for field in fields(EvaluationEpisode) if field.name != "record"]


def player_of(network: nn.Module, params: Parameters) -> Player:
    """What plays with the network of `params`' first agent: the learner that would train with them
    here, so that the native one's evaluations are the same games wherever they are repeated."""
    learner = new_learner(AGENTS[params.agents[0]], len(make_env(params).actions), params, seed=0)
    learner.set_weights(network.state_dict())
    return learner.q_values


class EpisodeInProgress:
    """A game in progress at one emulator."""

    def __init__(self, params: Parameters):
        self.env = make_env(params)
        self.planes = np.zeros((params.frame_stack, SIZE * SIZE), np.uint8)
        self.game = -1
        self.rng = np.random.default_rng()
        self.params = params
        self.rewards: list[float] = []  # of every step, as they are learned from
        self.distances: list[float] = []

    def start(self, game: int, seed: int) -> None:
        """Begins game number `game`: all that is random in it follows from the two numbers."""
        sequence = np.random.SeedSequence(seed, spawn_key=(EVALUATION, game))
        emulator_seed, action_seed = sequence.generate_state(2)
        self.planes[:] = self.env.reset(seed=int(emulator_seed))[0].reshape(-1)
        self.rng = np.random.default_rng(action_seed)
        self.game, self.rewards, self.distances = game, [], []

    def replay(self, record: EpisodeRecord) -> None:
        """Begins the recorded game, whose actions are then to be stepped."""
        self.planes[:] = self.env.reset(options={"record": record})[0].reshape(-1)
        self.rewards, self.distances = [], []

    def step(self, action: int) -> bool:
        """Plays one agent step; true when the game has ended."""
        image, raw, terminated, truncated, info = self.env.step(action)
        self.rewards.append(learned_reward(self.params, raw, info["life_lost"]))
        self.distances.append(self.env.distance())
        self.planes[:-1] = self.planes[1:]
        self.planes[-1] = image.reshape(-1)
        return terminated or truncated

    def result(self, seed: int) -> EvaluationEpisode:
        env, params = self.env, self.params
        return EvaluationEpisode(
            self.game,
            env.score,
            env.length,
            env.frames,
            env.score >= env.facts.wins_at,
            env.knockout(),
            params.difficulty,
            params.sticky_actions,
            params.evaluation_epsilon,
            seed,
            *env.points(),
            float(np.mean(self.distances)) if self.distances else float("nan"),
            env.played(),
        )


def play(player: Player, params: Parameters, games: int, seed: int) -> Iterator[EvaluationEpisode]:
    """Plays games 0 to `games` - 1 to their ends, several at once, each as it ends.

    Every game that is begun is counted, so that short games are not favoured.
    """
    waiting = iter(range(games))
    playing = []
    for game in waiting:
        playing.append(EpisodeInProgress(params))
        playing[-1].start(game, seed)
        if len(playing) == EMULATORS:
            break
    epsilon = params.evaluation_epsilon
    while playing:
        q_values = q_of(player, np.stack([episode.planes for episode in playing], axis=1))
        for episode, q_value in zip(list(playing), q_values, strict=True):
            action = epsilon_greedy(q_value[None], epsilon, episode.rng)[0]
            if not episode.step(int(action)):
                continue
            yield episode.result(seed)
            following = next(waiting, None)
            if following is None:
                playing.remove(episode)
            else:
                episode.start(following, seed)


def q_of(player: Player, planes: np.ndarray) -> np.ndarray:
    """Q-values float32 [N, A] of images uint8 [stack, N, 84*84]."""
    stack, count, pixels = planes.shape
    padded = np.zeros((stack, -(-count // BATCH) * BATCH, pixels), np.uint8)
    padded[:, :count] = planes
    return player(interleave(padded))[:count]


@dataclass(frozen=True)
class ValueCheck:
    """How far to trust the Q-values at some point of the training, a row of values.csv."""

    episode: int  # training games finished
    held_out_q: float  # mean of max_a Q(s, a) over states of random play, the same for all runs
    predicted: float  # mean of max_a Q(s, a) over the states of a few greedy games
    realised: float  # mean discounted return, as it is learned from, that followed those states
    score: float  # points, mean of those greedy games


def held_out_states(params: Parameters) -> np.ndarray:
    """Observations of random play, uint8 [512, 84, 84, stack]: one in eight steps."""
    episode, rng = EpisodeInProgress(params), np.random.default_rng(0)
    game, states = 0, []
    episode.start(game, seed=0)
    for step in range(8 * HELD_OUT_STATES):
        if step % 8 == 0:
            states.append(interleave(episode.planes[:, None])[0])
        if episode.step(int(rng.integers(len(episode.env.actions)))):
            game += 1
            episode.start(game, seed=0)
    return np.stack(states)


def check_values(
    player: Player, params: Parameters, held_out: np.ndarray, episode: int, seed: int
) -> tuple[ValueCheck, list[EvaluationEpisode]]:
    """Compares predicted values with what then happened (van Hasselt et al., 2016, figure 3).

    `held_out` are observations [N, 84, 84, stack], of which the mean greatest value is taken. The
    games are returned too.
    """
    greedy = [EpisodeInProgress(params) for _ in range(VALUE_GAMES)]
    for number, each in enumerate(greedy):
        each.start(VALUE_GAMES * episode + number, seed)
    predictions: list[list[float]] = [[] for _ in greedy]
    playing = list(range(VALUE_GAMES))
    while playing:
        q_values = q_of(player, np.stack([greedy[number].planes for number in playing], axis=1))
        for number, q_value in zip(list(playing), q_values, strict=True):
            predictions[number].append(float(q_value.max()))
            rng = greedy[number].rng
            action = epsilon_greedy(q_value[None], params.evaluation_epsilon, rng)[0]
            if greedy[number].step(int(action)):
                playing.remove(number)
    returns = np.concatenate([discounted(each.rewards, params.gamma) for each in greedy])
    held_out_q = player(held_out).max(axis=1)
    check = ValueCheck(
        episode,
        float(held_out_q.mean()),
        float(np.concatenate(predictions).mean()),
        float(returns.mean()),
        float(np.mean([each.env.score for each in greedy])),
    )
    return check, [each.result(seed) for each in greedy]


def discounted(rewards: list[float], gamma: float) -> np.ndarray:
    """The discounted return from every step to the game's end, float64 [steps]."""
    returns, following = np.zeros(len(rewards)), 0.0
    for step in reversed(range(len(rewards))):
        returns[step] = following = rewards[step] + gamma * following
    return returns
