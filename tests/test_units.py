"""Silent units are those that are zero in every state, of every network by what it started from."""

import numpy as np
import pytest
import torch
from synthetic import AGENTS, store, study

from atari_dqn.envs import EpisodeRecord
from atari_dqn.networks import DuelingNetwork, NatureNetwork
from atari_dqn.report import saliency, units
from atari_dqn.runs.dataset import Trajectory

STATES = np.random.default_rng(0).integers(0, 255, (9, 84, 84, 4)).astype(np.uint8)
DQN, DOUBLE, _ = AGENTS


def quiet(network, layer, count):
    """A network of which so many units of a layer can never be more than zero."""
    hidden = getattr(network.requires_grad_(False), layer)
    hidden.bias[:] = 1e3
    hidden.bias[:count] = -1e3
    return network


def test_units_that_are_zero_in_every_state_are_counted_and_no_others():
    torch.manual_seed(0)
    assert units.silent(quiet(NatureNetwork(4, 6), "hidden", 128), STATES) == 25
    dueling = quiet(quiet(DuelingNetwork(4, 6), "value_hidden", 512), "advantage_hidden", 256)
    assert units.silent(dueling, STATES) == 75
    network = quiet(NatureNetwork(4, 6), "hidden", 512)
    network.hidden.weight[:] = 0
    network.hidden.weight[0, 0], network.hidden.bias[0] = 1e6, 0.0
    network.convolutions[4].bias[0] = 1.0
    assert units.silent(network, STATES) == 100 * 511 / 512, "one is not zero in some states"


@pytest.fixture
def sections(tmp_path, monkeypatch):
    for experiment in ("boxing_final", "boxing_transfer"):
        for agent in (DQN, DOUBLE):
            store(tmp_path, experiment, agent, [1.0])
    game = Trajectory(np.zeros((5, 84, 84), np.uint8), *[np.zeros(4)] * 5)
    monkeypatch.setattr(saliency, "first_evaluated", lambda run: EpisodeRecord(0, b"", None))
    monkeypatch.setattr(saliency, "trajectory", lambda params, record: game)
    monkeypatch.setattr(units.models, "untrained", lambda run: (run.experiment, run.agent, 0))
    monkeypatch.setattr(units.models, "stored", lambda run: {7: (run.experiment, run.agent)})
    monkeypatch.setattr(units.models, "load_model", lambda path, params: (*path, 7))
    return study(tmp_path)


def test_every_network_has_a_row_agent_by_agent_and_by_its_start(sections, shown, monkeypatch):
    asked = []
    monkeypatch.setattr(
        units, "silent", lambda network, seen: asked.append(network) or len(asked) + 0.25
    )
    starts = {"scratch": "boxing_final", "Breakout": "boxing_transfer"}
    units.show_silent({start: sections[name] for start, name in starts.items()})
    rows = shown.tables["tbl-boxing-final-silent"]
    assert [(row["agent"], row["start"], row["games"]) for row in rows] == [
        (agent, start, games)
        for agent in ("DQN", "Double DQN")
        for start in ("scratch", "Breakout")
        for games in ("0", "7")
    ]
    assert asked == [
        (experiment, agent, games)
        for agent in (DQN, DOUBLE)
        for experiment in ("boxing_final", "boxing_transfer")
        for games in (0, 7)
    ]
    assert [row["silent, %"] for row in rows] == [f"{number}.2" for number in range(1, 9)]


def test_without_an_evaluated_run_its_place_is_held(tmp_path, shown):
    section = study(tmp_path)["boxing_final"]
    assert units.show_silent({"scratch": section}).empty
    assert "#tbl-boxing-final-silent" in shown.texts[-1]
