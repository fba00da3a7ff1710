"""This project's training loop, as `throughput.py` times it."""

import torch
from workload import BATCH, CAPACITY, EPSILON, LEARNING_STARTS, UPDATE_PERIOD, Stopwatch, arguments

from atari_dqn.params import Parameters
from atari_dqn.training import Trainer, prepare_process

chosen = arguments()
prepare_process()
torch.set_num_threads(chosen.threads)
parameters = Parameters(
    experiment="benchmark",
    device="cpu",
    environments=chosen.environments,
    batch_size=BATCH,
    epsilon_start=EPSILON,
    update_period=UPDATE_PERIOD,
    replay_capacity=CAPACITY,
    learning_starts=LEARNING_STARTS,
)
trainer, stopwatch = Trainer(parameters, chosen.agent, seed=1), Stopwatch(chosen.steps)
for _ in trainer.run():
    if stopwatch.finished(trainer.agent_steps):
        break
