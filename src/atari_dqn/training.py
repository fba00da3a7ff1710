"""The training loop: play a step of every game, remember it, learn what is due.

    for every vector step:
        act        epsilon-greedily, one forward pass for all games
        remember   one slot a game in the replay memory
        learn      one update for every `update_period` agent steps
                   and, every `target_update_period` updates, renew the target network

Nothing here may depend on how many games a run is to have: raising that number must continue a
run as if it had been meant from the start.
"""

import ctypes
import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import torch

from atari_dqn.agents import AGENTS
from atari_dqn.emulators import new_vector_env
from atari_dqn.envs import EpisodeRecord, FinishedEpisode
from atari_dqn.gpu import new_memory
from atari_dqn.native import new_learner
from atari_dqn.params import Parameters
from atari_dqn.schedules import epsilon, epsilon_greedy, learning_rate

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # names of glibc's <malloc.h>


def prepare_process() -> None:
    """Sets this process up for one run: one thread, and memory that is kept instead of returned.

    The thread count is part of what makes a run reproducible.
    """
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)  # Adam's dying moments would slow the CPU down
    if sys.platform == "linux":
        # Else glibc returns every block of some megabytes to the system, which hands it out again
        # page by page: a batch's floats, the gradients, at every update.
        libc = ctypes.CDLL(None)
        for option, value in ((M_MMAP_THRESHOLD, 32 << 20), (M_TRIM_THRESHOLD, 512 << 20)):
            libc.mallopt(option, value)


def weights_seed(seed: int) -> int:
    """What a run's initial weights are drawn from, by the run's seed."""
    return int(np.random.SeedSequence(seed).spawn(4)[3].generate_state(1)[0])


@dataclass(frozen=True)
class Episode:
    """One finished training game, a row of episodes.csv."""

    episode: int  # 1, 2, ...
    agent_steps: int  # of all games so far
    frames: int  # of all finished games
    score: float  # points of the whole game, raw and unclipped
    length: int  # agent steps
    epsilon: float  # probability of a random action when the game ended
    loss: float  # mean over the updates since games last finished; nan before the first update
    mean_q: float  # mean Q(s, a) of the same updates' transitions
    record: EpisodeRecord  # not a column

    @classmethod
    def columns(cls) -> list[str]:
        return [field.name for field in fields(cls) if field.name != "record"]


class Trainer:
    """One run: an agent, its games and its memory, from a seed.

    `initial` are weights to start from (`agents.transfer`).

    Deterministic: the same parameters, agent and seed give the same weights and the same episodes,
    bit for bit, with the native learner on any machine that has it, with PyTorch's on one machine
    and in one thread.
    """

    def __init__(
        self,
        params: Parameters,
        agent: str,
        seed: int,
        initial: dict[str, torch.Tensor] | None = None,
    ):
        seeds = np.random.SeedSequence(seed).spawn(3)  # the next is that of `weights_seed`
        self.params = params
        self.envs = new_vector_env(params, seeds[0])
        self.rng = np.random.default_rng(seeds[2])  # exploration
        given = AGENTS[agent], self.envs.actions, params, weights_seed(seed), initial
        self.learner = new_learner(*given)
        self.memory = new_memory(params, seeds[1], self.learner.device)
        self.agent_steps, self.episodes, self.frames = 0, 0, 0
        self.sums = np.zeros(3)  # loss, Q-value, updates since games last finished
        self.newest: list[Any] = []  # loss and Q-value of updates that are not in the sums yet
        self.means = (float("nan"), float("nan"))
        self.waiting: deque[Episode] = deque()  # games that ended together are reported in turn
        images = self.envs.planes[-1]
        idle = np.zeros(params.environments)
        self.memory.append(images, idle, idle, idle, idle)  # the first images, of age 0

    def run(self) -> Iterator[Episode | None]:
        """Trains for ever; yields after every vector step: a finished game, or None.

        Between two yields the trainer's state is whole: it can be saved, or left for good.
        """
        while True:
            if not self.waiting:
                self._step()
            yield self.waiting.popleft() if self.waiting else None

    def _step(self) -> None:
        probability = epsilon(self.params, self.episodes)
        q_values = self.learner.q_values(self.envs.observations())
        actions = epsilon_greedy(q_values, probability, self.rng)
        on_gpu = self.learner.device.type == "cuda"
        if on_gpu:  # what the step before left to learn, while the emulators play
            self._learn()
        self.agent_steps += int((~self.envs.ended).sum())  # an ended game only restarts
        step = self.envs.step(actions)
        self.memory.append(step.images, step.ages, actions, step.rewards, step.terminated)
        if not on_gpu:
            self._learn()
        if step.finished:
            self._finish(step.finished, probability)

    def _learn(self) -> None:
        steps = self.agent_steps - self.params.learning_starts
        due = max(0, steps // self.params.update_period) - self.learner.updates
        self.learner.set_learning_rate(learning_rate(self.params, self.episodes))
        for _ in range(due):
            self.newest.append(self.learner.learn(self.memory.sample(self.params.batch_size)))

    def _sum_up(self) -> np.ndarray:
        """The sums with the newest updates in them. A GPU gives their numbers as tensors, and is
        waited for only here. Raises FloatingPointError if an update's loss was not finite."""
        if self.newest and isinstance(self.newest[0], torch.Tensor):
            self.newest = torch.stack(self.newest).tolist()
        for loss, q in self.newest:
            self.sums += (loss, q, 1)
        self.newest = []
        if not np.isfinite(self.sums).all():
            raise FloatingPointError(
                f"the loss is no longer finite after {self.learner.updates:,} updates: learning "
                f"has diverged; try a learning_rate below {self.params.learning_rate:g}"
            )
        return self.sums

    def _finish(self, games: list[FinishedEpisode], probability: float) -> None:
        loss, q, updates = self._sum_up()
        if updates:
            self.means = (loss / updates, q / updates)
            self.sums = np.zeros(3)
        for game in games:
            self.episodes += 1
            self.frames += game.frames
            self.waiting.append(
                Episode(
                    self.episodes,
                    self.agent_steps,
                    self.frames,
                    game.score,
                    game.length,
                    probability,
                    *self.means,
                    game.record,
                )
            )

    def get_state(self) -> dict[str, Any]:
        """Everything that decides how the run goes on: nested, of numbers, bytes and arrays."""
        return {
            "games": self.envs.get_state(),
            "memory": self.memory.get_state(),
            "learner": self.learner.get_state(),
            "rng": self.rng.bit_generator.state,
            "agent_steps": self.agent_steps,
            "episodes": self.episodes,
            "frames": self.frames,
            "sums": self._sum_up(),
            "means": list(self.means),
            "waiting": [asdict(episode) for episode in self.waiting],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores what `get_state` returned."""
        self.envs.set_state(state["games"])
        self.memory.set_state(state["memory"])
        self.learner.set_state(state["learner"])
        self.rng.bit_generator.state = state["rng"]
        self.agent_steps, self.episodes = state["agent_steps"], state["episodes"]
        self.frames = state["frames"]
        self.sums[:], self.newest = state["sums"], []
        self.means = tuple(state["means"])
        self.waiting = deque(
            Episode(**{**episode, "record": EpisodeRecord(**episode["record"])})
            for episode in state["waiting"]
        )
