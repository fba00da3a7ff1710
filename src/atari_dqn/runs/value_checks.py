"""Checking values while a run trains: in turn with training, or, where the run has several
processes, in another one meanwhile."""

import os
from collections import deque
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import torch

from atari_dqn import evaluation
from atari_dqn.agents import AGENTS, Learner
from atari_dqn.envs import make_env
from atari_dqn.evaluation import EvaluationEpisode, ValueCheck
from atari_dqn.native import NativeLearner
from atari_dqn.params import Parameters
from atari_dqn.runs.processes import end_with_parent
from atari_dqn.training import prepare_process

Checked = tuple[ValueCheck, list[EvaluationEpisode]]


class ValueChecks:
    """Those of one run, in the order in which they are asked for."""

    def __init__(self, params: Parameters, seed: int):
        self.params, self.seed = params, seed
        self.waiting: deque[Future[Checked]] = deque()
        self.states: np.ndarray | None = None
        self.pool: ProcessPoolExecutor | None = None
        if params.emulator_processes > 1:
            self.pool = ProcessPoolExecutor(1, get_context("spawn"), _prepare)

    def ask(self, learner: Learner | NativeLearner, episode: int) -> None:
        """For a check of the learner's weights as they are after so many games."""
        if self.states is None:
            self.states = evaluation.held_out_states(self.params)
        given = (self.params, self.states, episode, self.seed)
        if self.pool is not None:
            weights = {name: value.cpu().numpy() for name, value in learner.weights().items()}
            self.waiting.append(self.pool.submit(_check_weights, weights, *given))
            return
        future: Future[Checked] = Future()
        future.set_result(evaluation.check_values(learner.q_values, *given))
        self.waiting.append(future)

    def finished(self, wait: bool = False) -> list[Checked]:
        """Those not yet returned; with `wait` all of them, else those before the first that is
        still under way."""
        done = []
        while self.waiting and (wait or self.waiting[0].done()):
            done.append(self.waiting.popleft().result())
        return done

    def close(self) -> None:
        if self.pool is not None:
            self.pool.shutdown(cancel_futures=True)


def _prepare() -> None:
    os.setpgrp()  # Ctrl-C and what else is sent to a whole group is for the run to obey
    end_with_parent()
    prepare_process()


def _check_weights(
    weights: dict[str, np.ndarray],
    params: Parameters,
    states: np.ndarray,
    episode: int,
    seed: int,
) -> Checked:
    params = params.model_copy(update={"device": "cpu"})
    network = AGENTS[params.agents[0]].network(params.frame_stack, len(make_env(params).actions))
    network.load_state_dict({name: torch.from_numpy(value) for name, value in weights.items()})
    player = evaluation.player_of(network, params)
    return evaluation.check_values(player, params, states, episode, seed)
