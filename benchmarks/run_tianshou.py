"""Tianshou's DQN, as `throughput.py` times it."""

import ale_py
import gymnasium
from tianshou.algorithm import DQN
from tianshou.algorithm.algorithm_base import policy_within_training_step
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.env.atari.atari_network import DQNet, ScaledObsInputActionReprNet
from tianshou.env.atari.atari_wrapper import wrap_deepmind
from tianshou.utils.torch_utils import torch_train_mode
from workload import BATCH, CAPACITY, EPSILON, LEARNING_STARTS, UPDATE_PERIOD, Stopwatch, arguments

gymnasium.register_envs(ale_py)
chosen = arguments()


def environment():
    return wrap_deepmind(gymnasium.make("BoxingNoFrameskip-v4"), episode_life=False)


environments = DummyVectorEnv([environment for _ in range(chosen.environments)])
actions = environments.action_space[0]
policy = DiscreteQLearningPolicy(
    model=ScaledObsInputActionReprNet(DQNet(4, 84, 84, actions.n)),
    action_space=actions,
    eps_training=EPSILON,
)
algorithm = DQN(
    policy=policy,
    optim=AdamOptimizerFactory(lr=1e-4),
    gamma=0.99,
    target_update_freq=1000,
    is_double=chosen.agent == "double_dqn",
)
memory = VectorReplayBuffer(
    CAPACITY,
    chosen.environments,
    ignore_obs_next=True,
    save_only_last_obs=True,
    stack_num=4,
)
collector = Collector(policy, environments, memory, exploration_noise=True)
collector.reset()
stopwatch, agent_steps = Stopwatch(chosen.steps), 0
each = max(UPDATE_PERIOD, chosen.environments)
while not stopwatch.finished(agent_steps):
    with policy_within_training_step(policy):
        collector.collect(n_step=each)
        agent_steps += each
        if agent_steps >= LEARNING_STARTS:
            with torch_train_mode(policy):
                for _ in range(each // UPDATE_PERIOD):
                    algorithm.update(memory, BATCH)
