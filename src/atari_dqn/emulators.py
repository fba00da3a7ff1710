"""A run's emulators shared among processes, for machines with many cores and a GPU that would
otherwise wait for them.

Each process steps a share of the games in turn, the run's own process the first; together they do,
bit for bit, what `envs.VectorEnv` does alone.
"""

import os
from itertools import pairwise
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from atari_dqn.envs import VectorEnv, VectorStep, interleave
from atari_dqn.params import Parameters


def new_vector_env(
    params: Parameters, seed: np.random.SeedSequence
) -> "VectorEnv | ParallelVectorEnv":
    """A run's games, in as many processes as `params` ask for."""
    if params.emulator_processes == 1:
        return VectorEnv(params, seed)
    return ParallelVectorEnv(params, seed)


class ParallelVectorEnv:
    """A look-alike of `envs.VectorEnv`; their states can be exchanged.

    The processes end with this one.
    """

    def __init__(self, params: Parameters, seed: np.random.SeedSequence):
        processes = min(params.emulator_processes, params.environments)
        bounds = np.linspace(0, params.environments, processes + 1).astype(int).tolist()
        self.shares = [slice(*pair) for pair in pairwise(bounds)]
        self.others = [_Process(params, seed, share) for share in self.shares[1:]]
        self.own = VectorEnv(params, seed, self.shares[0])
        self.actions = self.own.actions
        self.planes = np.concatenate(
            [self.own.planes, *(other.result() for other in self.others)], axis=1
        )
        self.ended = np.zeros(params.environments, bool)

    def observations(self) -> np.ndarray:
        """uint8 [E, 84, 84, frame_stack], the newest image last."""
        return interleave(self.planes)

    def step(self, actions: np.ndarray) -> VectorStep:
        """Steps every game by its action (int [E])."""
        for other, share in zip(self.others, self.shares[1:], strict=True):
            other.call("step", actions[share])
        steps = [self.own.step(actions[self.shares[0]]), *(each.result() for each in self.others)]

        def joined(name: str) -> np.ndarray:
            return np.concatenate([getattr(each, name) for each in steps])

        step = VectorStep(
            joined("images"),
            joined("ages"),
            joined("rewards"),
            joined("terminated"),
            joined("ended"),
            [game for each in steps for game in each.finished],
        )
        self.planes[:-1] = self.planes[1:]
        self.planes[-1] = step.images
        begun = step.ages == 0
        self.planes[:, begun] = step.images[begun]
        self.ended = step.ended
        return step

    def get_state(self) -> dict[str, Any]:
        for other in self.others:
            other.call("get_state")
        states = [self.own.get_state(), *(other.result() for other in self.others)]
        return {
            "games": [game for state in states for game in state["games"]],
            "planes": self.planes,
            "ended": self.ended,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        self.planes[:] = state["planes"]
        self.ended = np.array(state["ended"])
        parts = [
            {
                "games": state["games"][share],
                "planes": self.planes[:, share],
                "ended": self.ended[share],
            }
            for share in self.shares
        ]
        for other, part in zip(self.others, parts[1:], strict=True):
            other.call("set_state", part)
        self.own.set_state(parts[0])
        for other in self.others:
            other.result()


class _Process:
    """One that plays a share of the games and answers calls in their order."""

    def __init__(self, params: Parameters, seed: np.random.SeedSequence, games: slice):
        context = get_context("spawn")  # a process that uses a GPU must not be forked
        self.connection, theirs = context.Pipe()
        context.Process(target=_serve, args=(theirs, params, seed, games), daemon=True).start()
        theirs.close()

    def call(self, method: str, *arguments: Any) -> None:
        self.connection.send((method, arguments))

    def result(self) -> Any:
        """Of the oldest call not yet asked for; the first result is the games' first images."""
        return self.connection.recv()


def _serve(
    connection: Connection, params: Parameters, seed: np.random.SeedSequence, games: slice
) -> None:
    os.setpgrp()  # Ctrl-C and what else is sent to a whole group is for the run to obey
    envs = VectorEnv(params, seed, games)
    connection.send(envs.planes)
    while True:
        try:
            method, arguments = connection.recv()
        except EOFError:
            return
        connection.send(getattr(envs, method)(*arguments))
