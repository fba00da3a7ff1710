import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch import nn

from atari_dqn.agents import AGENTS, Agent, Learner, double_q_learning, q_learning
from atari_dqn.native import NativeLearner
from atari_dqn.networks import FEATURES, DuelingNetwork, NatureNetwork
from atari_dqn.params import AGENT_NAMES, ParameterError, title
from atari_dqn.replay import Batch
from atari_dqn.runs import recorder, tables
from atari_dqn.runs.run import Run
from atari_dqn.schedules import learning_rate

# Q-values of two next states, three actions; the networks disagree about the best one.
TARGET = torch.tensor([[1.0, 5.0, 2.0], [4.0, 0.0, -1.0]])
ONLINE = torch.tensor([[9.0, 1.0, 0.0], [0.0, 1.0, 7.0]])


# The first game goes on with a reward of 0.5, the second one ended with 1.
LAST = Batch(None, None, torch.tensor([0.5, 1.0]), torch.tensor([0.9, 0.0]), None)


def test_dqn_takes_the_target_networks_own_maximum():
    target = q_learning(LAST, lambda _: ONLINE, lambda _: TARGET)
    assert target.tolist() == pytest.approx([0.5 + 0.9 * 5, 1])


def test_double_dqn_takes_the_target_value_of_the_online_networks_choice():
    target = double_q_learning(LAST, lambda _: ONLINE, lambda _: TARGET)
    assert target.tolist() == pytest.approx([0.5 + 0.9 * 1, 1])


def test_the_dueling_agent_is_double_dqn_with_another_network():
    double, dueling = AGENTS["double_dqn"], AGENTS["dueling_double_dqn"]
    assert double.target is dueling.target
    assert (double.network, dueling.network) == (NatureNetwork, DuelingNetwork)


LEARNERS = {"torch": Learner, "native": NativeLearner}
both_learners = pytest.mark.parametrize(
    "make",
    [
        pytest.param(learner, id=name, marks=[pytest.mark.native] * (name == "native"))
        for name, learner in LEARNERS.items()
    ],
)


def batch_of(count, rng, terminated=(), gamma=0.99):
    discount_t = np.full(count, gamma, np.float32)
    discount_t[list(terminated)] = 0
    return Batch(
        s_tm1=rng.integers(256, size=(count, 84, 84, 4), dtype=np.uint8),
        a_tm1=rng.integers(18, size=count),
        r_t=rng.choice([-1.0, 0.0, 1.0], count).astype(np.float32),
        discount_t=discount_t,
        s_t=rng.integers(256, size=(count, 84, 84, 4), dtype=np.uint8),
    )


class PlainNature(nn.Module):
    """The source report's network, written anew: channels first, 64-bit."""

    def __init__(self, weights):
        super().__init__()
        self.weights = weights
        self.nearest = float("inf")  # to zero that the input of a ReLU has come

    def relu(self, x):
        self.nearest = min(self.nearest, x.detach().abs().min().item())
        return torch.relu(x)

    def features(self, observations):
        w = self.weights
        x = observations.permute(0, 3, 1, 2).double() / 255
        for layer, stride in ((0, 4), (2, 2), (4, 1)):
            kernel = w[f"convolutions.{layer}.weight"], w[f"convolutions.{layer}.bias"]
            x = self.relu(nn.functional.conv2d(x, *kernel, stride=stride))
        return x.permute(0, 2, 3, 1).flatten(1)

    def stream(self, x, hidden, output):
        w = self.weights
        x = self.relu(x @ w[f"{hidden}.weight"].T + w[f"{hidden}.bias"])
        return x @ w[f"{output}.weight"].T + w[f"{output}.bias"]

    def forward(self, observations):
        x = self.features(observations)
        if "hidden.weight" in self.weights:
            return self.stream(x, "hidden", "output")
        value = self.stream(x, "value_hidden", "value_output")
        advantage = self.stream(x, "advantage_hidden", "advantage_output")
        return value + (advantage - advantage.mean(1, keepdim=True))


def doubled(weights):
    return {name: value.detach().double() for name, value in weights.items()}


@both_learners
def test_weights_that_were_asked_for_stay_as_they_were(make, small):
    learner = make(AGENTS["dueling_double_dqn"], 18, small(device="cpu"), 1)
    before = learner.weights()
    copied = {name: value.clone() for name, value in before.items()}
    learner.learn(batch_of(4, np.random.default_rng(0)))
    assert all(before[name].equal(copied[name]) for name in copied)
    assert not learner.weights()["advantage_output.bias"].equal(copied["advantage_output.bias"])


@both_learners
@pytest.mark.parametrize("agent", AGENTS)
def test_one_update_equals_an_independent_computation(agent, make, small):
    """Target, loss, gradient and Adam's step, in 64 bits and without any of our code."""
    parameters = small(gamma=0.9, learning_rate=1e-3)
    learner = make(AGENTS[agent], 18, parameters, seed=0)
    state, generator = learner.get_state(), torch.manual_seed(1)
    for weight in state["target"].values():  # else both networks agree about the best action
        weight.add_(torch.randn(weight.shape, generator=generator) * 0.02)
    learner.set_state(state)
    batch = batch_of(6, np.random.default_rng(0), terminated=[2], gamma=0.9)
    weights = {name: w.requires_grad_() for name, w in doubled(state["online"]).items()}
    online, target = PlainNature(weights), PlainNature(doubled(state["target"]))
    s_tm1, s_t = torch.from_numpy(batch.s_tm1), torch.from_numpy(batch.s_t)
    with torch.no_grad():
        q_target, q_online = target(s_t).numpy(), online(s_t).numpy()
    best = (q_target if agent == "dqn" else q_online).argmax(1)
    if agent != "dqn":
        assert (best != q_target.argmax(1)).any(), "the test would not tell the rules apart"
    value = q_target[np.arange(6), best]
    expected = batch.r_t + 0.9 * np.where(np.arange(6) == 2, 0.0, value)
    taken = online(s_tm1)[torch.arange(6), torch.from_numpy(batch.a_tm1)]
    loss = ((taken - torch.from_numpy(expected)) ** 2).mean()
    loss.backward()
    mean_loss, mean_q = learner.learn(batch)
    assert mean_loss == pytest.approx(loss.item(), rel=1e-4)
    assert mean_q == pytest.approx(taken.mean().item(), rel=1e-4)
    moments = learner.get_state()["moments"]
    for name, after in learner.weights().items():
        gradient = weights[name].grad.numpy()
        moment = moments[f"{name}.exp_avg"].numpy()  # a tenth of the first gradient
        np.testing.assert_allclose(moment, 0.1 * gradient, rtol=1e-3, atol=1e-6)
        # Adam's first step: the bias-corrected moments are the gradient and its square.
        step = 1e-3 * gradient / (np.abs(gradient) + 1e-8)
        sure = np.abs(gradient) > 1e-5  # elsewhere rounding decides the sign of the step
        wanted = weights[name].detach().numpy() - step
        np.testing.assert_allclose(after.numpy()[sure], wanted[sure], atol=2e-5)
        assert sure.any()


@both_learners
@pytest.mark.parametrize("tau", [1.0, 0.25])
def test_the_target_network_moves_by_tau_every_period_and_not_before(small, tau, make):
    learner = make(AGENTS["dqn"], 18, small(target_update_period=3, tau=tau), seed=0)
    start = {name: weight.clone() for name, weight in learner.get_state()["target"].items()}
    rng = np.random.default_rng(0)
    for _ in range(2):
        learner.learn(batch_of(4, rng))
    state = learner.get_state()
    assert all(torch.equal(start[name], now) for name, now in state["target"].items())
    learner.learn(batch_of(4, rng))
    state = learner.get_state()
    for name, now in state["target"].items():
        wanted = (1 - tau) * start[name] + tau * state["online"][name]
        torch.testing.assert_close(now, wanted)
        assert not torch.equal(now, start[name])


@pytest.mark.parametrize(
    ("network", "hidden"), [(NatureNetwork, ["hidden"]), (DuelingNetwork, ["value_hidden"])]
)
def test_networks_have_the_papers_layers(network, hidden):
    made = network(4, 18)
    layers = [layer for layer in made.convolutions if isinstance(layer, nn.Conv2d)]
    assert [(c.out_channels, c.kernel_size[0], c.stride[0]) for c in layers] == [
        (32, 8, 4),
        (64, 4, 2),
        (64, 3, 1),
    ]
    assert getattr(made, hidden[0]).weight.shape == (512, FEATURES)
    parameters = sum(weight.numel() for weight in made.parameters())
    convolutions = 32 * (4 * 64 + 1) + 64 * (32 * 16 + 1) + 64 * (64 * 9 + 1)
    streams = {NatureNetwork: 1, DuelingNetwork: 2}[network]
    outputs = 18 * 513 + (513 if network is DuelingNetwork else 0)
    assert parameters == convolutions + streams * 512 * (FEATURES + 1) + outputs
    assert made(torch.zeros(2, 84, 84, 4, dtype=torch.uint8)).shape == (2, 18)


def test_advantages_of_the_dueling_network_have_no_mean():
    """Adding a constant to every advantage must not change Q."""
    network = DuelingNetwork(4, 18)
    observation = torch.randint(256, (3, 84, 84, 4), dtype=torch.uint8)
    with torch.no_grad():
        before = network(observation)
        network.advantage_output.bias += 10
        torch.testing.assert_close(network(observation), before, rtol=1e-4, atol=1e-4)


def corridor():
    """A deterministic problem with a known optimum, as one batch of all its transitions.

    Four places in a row; action 1 goes right and pays 1 at the end of the row, action 0 goes left
    and pays 0.3 at its other end. Both ends are final.
    """
    pictures = np.zeros((4, 84, 84, 4), np.uint8)
    for place in range(4):
        pictures[place, :, 21 * place : 21 * (place + 1)] = 255
    places, actions = np.repeat(np.arange(4), 2), np.tile([0, 1], 4)
    following = places + np.where(actions == 1, 1, -1)
    ended = (following < 0) | (following > 3)
    rewards = np.where(following > 3, 1.0, np.where(following < 0, 0.3, 0.0))
    following = following.clip(0, 3)
    batch = Batch(
        s_tm1=pictures[places],
        a_tm1=actions,
        r_t=rewards.astype(np.float32),
        discount_t=np.where(ended, 0, 0.8).astype(np.float32),
        s_t=pictures[following],
    )
    optimum = np.zeros((4, 2))
    for _ in range(50):  # value iteration
        values = rewards + 0.8 * np.where(ended, 0.0, optimum.max(1)[following])
        optimum[places, actions] = values
    return batch, pictures, optimum


@both_learners
@pytest.mark.parametrize("agent", AGENTS)
def test_each_agent_finds_the_known_optimum_of_a_small_problem(agent, make, small):
    batch, pictures, optimum = corridor()
    parameters = small(gamma=0.8, learning_rate=3e-4, target_update_period=10)
    learner = make(AGENTS[agent], 2, parameters, seed=1)
    for _ in range(120):
        learner.learn(batch)
    found = learner.q_values(pictures)
    np.testing.assert_allclose(found, optimum, atol=0.04)
    assert (found.argmax(1) == optimum.argmax(1)).all()


@both_learners
@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize("layers", ["all", "convolutions"])
def test_transfer_takes_over_the_named_layers_and_leaves_the_rest_fresh(agent, layers, make, small):
    source = make(AGENTS[agent], 4, small(), seed=1).weights()
    parameters = small(transferred_layers=layers)
    fresh = make(AGENTS[agent], 18, parameters, seed=2).weights()
    state = make(AGENTS[agent], 18, parameters, 2, initial=source).get_state()
    for name, weight in state["online"].items():
        taken = name.startswith("convolutions") or (layers == "all" and "hidden" in name)
        assert torch.equal(weight, source[name] if taken else fresh[name]), name
        assert torch.equal(weight, state["target"][name]), name


def test_weights_of_another_network_are_refused(small):
    source = Learner(AGENTS["dqn"], 18, small(), seed=1).online.state_dict()
    with pytest.raises(ParameterError, match=r"no value_hidden\.weight of shape \(512, 3136\)"):
        Learner(AGENTS["dueling_double_dqn"], 18, small(), 1, initial=source)


@both_learners
def test_frozen_convolutions_never_change_and_everything_else_does(small, make):
    learner = make(AGENTS["double_dqn"], 18, small(freeze_convolutions=True), seed=0)
    before = {name: weight.clone() for name, weight in learner.weights().items()}
    for _ in range(2):
        learner.learn(batch_of(4, np.random.default_rng(0)))
    for name, weight in learner.weights().items():
        assert torch.equal(weight, before[name]) == name.startswith("convolutions"), name
    restored = make(AGENTS["double_dqn"], 18, small(freeze_convolutions=True), seed=5)
    restored.set_state(learner.get_state())
    one, other = batch_of(4, np.random.default_rng(1)), batch_of(4, np.random.default_rng(1))
    assert learner.learn(one) == restored.learn(other)


def test_the_learning_rate_warms_up_over_finished_games(small):
    parameters = small(warmup_games=200, warmup_learning_rate=1e-6, learning_rate=1e-5)
    rates = [learning_rate(parameters, games) for games in (0, 100, 200, 5000)]
    assert rates == pytest.approx([1e-6, 5.5e-6, 1e-5, 1e-5])
    assert learning_rate(small(), 0) == small().learning_rate


def test_every_agent_that_may_be_named_exists():
    assert tuple(AGENTS) == AGENT_NAMES


def test_a_fourth_agent_is_a_name_an_entry_and_a_function(tmp_path, small, monkeypatch):
    """The mean of the next state's values, in place of the greatest, trains and is evaluated."""

    def mean_learning(batch, online, target_network):
        return batch.r_t + batch.discount_t * target_network(batch.s_t).mean(dim=1)

    monkeypatch.setattr("atari_dqn.params.AGENT_NAMES", (*AGENTS, "mean_dqn"))
    monkeypatch.setitem(AGENTS, "mean_dqn", Agent(NatureNetwork, mean_learning))
    run = Run(small(agents=["mean_dqn"], learner="torch"), tmp_path)
    recorder.train(run)
    assert run.state() == "complete"
    assert len(tables.of_runs([run], "evaluations.csv")) == 2
    assert title("mean_dqn") == "Mean DQN"
    draw = """
import pandas as pd
from atari_dqn import params
params.AGENT_NAMES = (*params.AGENT_NAMES, "mean_dqn")
from atari_dqn.report import plots
episodes = pd.DataFrame({"episode": [1, 2], "score": [3, 4], "agent": "mean_dqn", "seed": 1})
episodes["frames"] = 4 * episodes.episode
from atari_dqn.games import GAMES
none = pd.DataFrame({"agent": [], "episode": [], "score": [], "window": []})
plots.learning_curves(episodes, GAMES["boxing"], 1, None, none)
assert len({look.colour for look in plots.STYLES.values()}) == 4
"""
    subprocess.run(
        [sys.executable, "-c", draw], check=True, env={**os.environ, "MPLBACKEND": "agg"}
    )
