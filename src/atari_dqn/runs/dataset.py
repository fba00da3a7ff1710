"""A run's records as data to learn from offline: every image, action and reward of its games.

Nothing is trained to get them: the emulator plays the games again. The fields of an exported file
bear the names that Minari and Gymnasium use.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from atari_dqn.envs import SIZE, EpisodeRecord, learned_reward
from atari_dqn.params import ParameterError, Parameters, stored_parameters
from atari_dqn.replay import PIXELS, ReplayMemory
from atari_dqn.runs import records
from atari_dqn.runs.files import write_atomically


@dataclass(frozen=True)
class Trajectory:
    """A whole game of T agent steps."""

    observations: np.ndarray  # uint8 [T+1, 84, 84]: one image each, from before the first action on
    actions: np.ndarray  # int64 [T], indices among the cartridge's actions
    rewards: np.ndarray  # float32 [T], raw points
    life_lost: np.ndarray  # bool [T]
    terminations: np.ndarray  # bool [T]: the game is over
    truncations: np.ndarray  # bool [T]: it was cut


def trajectory(params: Parameters, record: EpisodeRecord) -> Trajectory:
    """The recorded game, played again. Raises RecordError as `records.begin` does."""
    images = np.empty((len(record.actions) + 1, SIZE, SIZE), np.uint8)
    env, images[0] = records.begin(params, record)
    steps = []
    for number, action in enumerate(record.actions, 1):
        images[number], reward, terminated, truncated, info = env.step(action)
        steps.append((reward, info["life_lost"], terminated, truncated))
    rewards, *flags = np.array(steps, float).reshape(-1, 4).T
    actions = np.frombuffer(record.actions, np.uint8).astype(np.int64)
    return Trajectory(images, actions, rewards.astype(np.float32), *(each > 0 for each in flags))


def trajectories(folder: Path, first: int, last: int) -> Iterator[tuple[int, Trajectory]]:
    """Training games `first` to `last` of a stored run, each with its number.

    Raises ParameterError if there are none, RecordError if the records cannot be read.
    """
    params = stored_parameters(folder)
    games = [
        (heading["episode"], record)
        for heading, record in records.read_file(folder, torn=True)
        if heading["kind"] == records.TRAINING
    ]
    chosen = [game for game in games if first <= game[0] <= last]
    if not chosen:
        raise ParameterError(
            f"{folder} has training games 1 to {len(games)}, none from {first} to {last}"
        )
    for episode, record in chosen:
        yield episode, trajectory(params, record)


def rebuilt_memory(folder: Path, games: int, capacity: int, seed: int = 0) -> ReplayMemory:
    """A replay memory with the newest transitions of a stored run's first `games` training games.

    The transitions are those that the run had in its memory then, but for the games that were
    still being played; they lie in one stream, game after game.
    """
    params = stored_parameters(folder)
    sequence = np.random.SeedSequence(seed)
    memory = ReplayMemory(capacity, 1, params.frame_stack, params.gamma, sequence, params.n_steps)
    fill(memory, folder, games)
    return memory


def fill(memory: ReplayMemory, folder: Path, games: int) -> None:
    """Adds to `memory` the newest of a stored run's first `games` training games, played again: as
    many as fit. Its streams each take the next game when their own has ended.

    Raises RecordError as `records.begin` does.
    """
    params = stored_parameters(folder)
    played = [
        record
        for heading, record in records.read_file(folder, torn=True)
        if heading["kind"] == records.TRAINING and heading["episode"] <= games
    ]
    slots = np.cumsum([len(record.actions) + 1 for record in reversed(played)])
    kept = int(np.searchsorted(slots, memory.rows * memory.streams)) + memory.streams
    newest = iter(played[-kept:])
    streams = [_slots(params, newest) for _ in range(memory.streams)]
    blank = (np.zeros(PIXELS, np.uint8), 0, 0, 0.0, False)  # of age 0: no transition
    rows = zip_longest(*streams, fillvalue=blank)
    for row in tqdm(rows, "playing again", leave=False, unit=" steps", disable=None):
        memory.append(*map(np.array, zip(*row, strict=True)))


def _slots(
    params: Parameters, games: Iterator[EpisodeRecord]
) -> Iterator[tuple[np.ndarray, int, int, float, bool]]:
    """What a stream of a replay memory holds of some games, played again: image uint8 [84*84],
    age, action, reward, and whether the game is over."""
    for record in games:
        env, image = records.begin(params, record)
        yield image.reshape(-1), 0, 0, 0.0, False
        for age, action in enumerate(record.actions, 1):
            image, raw, terminated, _, info = env.step(action)
            reward = learned_reward(params, raw, info["life_lost"])
            yield image.reshape(-1), age, action, reward, terminated


def export(folder: Path, first: int, last: int, path: Path) -> int:
    """Writes training games `first` to `last` of a stored run to a compressed .npz file, one game
    after the other; returns their number.

    `episode_starts` are the places of the games' first images among `observations`. Raises as
    `trajectories` does.
    """
    games = [game for _, game in trajectories(folder, first, last)]
    lengths = [len(game.observations) for game in games]
    fields: dict[str, Any] = {
        name: np.concatenate([getattr(game, name) for game in games])
        for name in Trajectory.__dataclass_fields__
    }
    starts = np.cumsum([0, *lengths[:-1]])
    write_atomically(path, lambda file: np.savez_compressed(file, **fields, episode_starts=starts))
    return len(games)
