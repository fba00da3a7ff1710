"""Stable-Baselines3's DQN, as `throughput.py` times it.

Its loss is the Huber loss and it clips gradients by norm; neither can be turned off, and neither
costs much.
"""

import ale_py
import gymnasium
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_atari_env
from stable_baselines3.common.vec_env import VecFrameStack
from workload import BATCH, CAPACITY, EPSILON, LEARNING_STARTS, UPDATE_PERIOD, Stopwatch, arguments

gymnasium.register_envs(ale_py)
chosen = arguments()
stopwatch = Stopwatch(chosen.steps)


class Timing(BaseCallback):
    """Stops the training when the time is taken."""

    def _on_step(self) -> bool:
        return not stopwatch.finished(self.num_timesteps)


environments = make_atari_env("BoxingNoFrameskip-v4", n_envs=chosen.environments, seed=1)
# train_freq counts steps of all environments together
one = chosen.environments == 1
model = DQN(
    "CnnPolicy",
    VecFrameStack(environments, n_stack=4),
    buffer_size=CAPACITY,
    batch_size=BATCH,
    learning_starts=LEARNING_STARTS,
    train_freq=UPDATE_PERIOD if one else 1,
    gradient_steps=1 if one else chosen.environments // UPDATE_PERIOD,
    exploration_initial_eps=EPSILON,
    exploration_final_eps=EPSILON,
    target_update_interval=1000 * UPDATE_PERIOD,
    optimize_memory_usage=False,
    device="cpu",
    seed=1,
)
model.learn(10**6, callback=Timing(), log_interval=10**6)
