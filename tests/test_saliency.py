"""What a network looks at is found where it looks."""

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from synthetic import numbers, store, study
from torch import nn

from atari_dqn.agents import AGENTS
from atari_dqn.envs import EpisodeRecord
from atari_dqn.networks import DuelingNetwork
from atari_dqn.report import saliency
from atari_dqn.runs import records
from atari_dqn.runs.dataset import Trajectory
from atari_dqn.training import Trainer


class Looks(nn.Module):
    """Two actions: the values rise with the brightness around one place of the newest image, and
    the first one's advantage with that around another."""

    def __init__(self, value, advantage):
        super().__init__()
        self.value, self.advantage = value, advantage
        self.unused = nn.Parameter(torch.zeros(1))

    def forward(self, observations):
        def bright(place):
            row, column = place
            near = observations[:, row - 2 : row + 3, column - 2 : column + 3, -1]
            return near.float().mean(dim=(1, 2))

        state, apart = bright(self.value), bright(self.advantage)
        return torch.stack([state + apart, state - apart], dim=1)


@pytest.mark.parametrize(("value", "advantage"), [((10, 70), (62, 18)), ((62, 18), (10, 70))])
def test_each_map_is_brightest_where_its_values_come_from(value, advantage):
    rng = np.random.default_rng(0)
    observation = rng.integers(0, 255, (84, 84, 4)).astype(np.uint8)
    found = saliency.saliency(Looks(value, advantage), observation)
    for place, heat in ((value, found.value), (advantage, found.advantages)):
        row, column = np.unravel_index(heat.argmax(), heat.shape)
        centre = np.array([row, column]) * saliency.STRIDE + saliency.STRIDE // 2
        assert abs(centre - np.array(place)).max() <= 4
        assert heat[row, column] > 20 * np.median(heat)


def test_a_blur_changes_nothing_in_an_even_picture():
    found = saliency.saliency(Looks((10, 70), (62, 18)), np.full((84, 84, 4), 90, np.uint8))
    assert max(found.value.max(), found.advantages.max()) < 1e-3


def test_every_map_is_drawn_under_the_name_of_what_it_shows():
    """Of two networks, the second with the places of the first the other way round."""
    value, advantage = (10, 70), (62, 18)
    networks = {"one": Looks(value, advantage), "other": Looks(advantage, value)}
    observation = np.random.default_rng(0).integers(0, 255, (84, 84, 4)).astype(np.uint8)
    seen, *panels = saliency.figure({"half": observation}, networks).axes
    assert (seen.get_images()[0].get_array() == observation[..., -1]).all(), "the newest image"
    found = {}
    for axes in panels:
        heat = axes.get_images()[-1].get_array()
        brightest = np.unravel_index(heat.argmax(), heat.shape)
        found[axes.get_title()] = [saliency.STRIDE * place + 2 for place in brightest]
    near = {name: pytest.approx(place, abs=4) for name, place in (("v", value), ("a", advantage))}
    assert found == {
        **{"one\nvalue": near["v"], "one\nadvantages": near["a"]},
        **{"other\nvalue": near["a"], "other\nadvantages": near["v"]},
    }


def test_a_filter_is_a_column_with_the_oldest_image_at_the_top():
    network = DuelingNetwork(4, 6)
    with torch.no_grad():
        for image in range(4):  # the newest is the last
            network.convolutions[0].weight[:, image] = image + 1
        network.convolutions[0].weight[7] *= -0.5
    (axes,) = saliency.filters_figure({"any": network}).axes
    (sheet,) = axes.get_images()
    high, wide = sheet.get_array().shape
    middles = sheet.get_array()[high // 8 :: high // 4, wide // 64 :: wide // 32]
    assert middles[:, 0].tolist() == [1, 2, 3, 4]
    assert middles[:, 7].tolist() == [-0.5, -1, -1.5, -2]
    colours = sheet.to_rgba(middles)
    assert colours[3, 0, 0] > 2 * colours[3, 0, 2], "what adds is red"
    assert colours[3, 7, 2] > 1.2 * colours[3, 7, 0], "what takes away is blue"
    below, above = axes.get_ylim()
    assert below > above, "the first row is drawn at the top"
    assert axes.get_title(loc="left") == "any"


def test_all_filters_of_a_figure_have_one_scale():
    strong, weak = DuelingNetwork(4, 6), DuelingNetwork(4, 6)
    with torch.no_grad():
        strong.convolutions[0].weight.fill_(0.5)
        weak.convolutions[0].weight.fill_(0.05)
    drawn = saliency.filters_figure({"strong": strong, "weak": weak}).axes
    scales = [axes.get_images()[0].get_clim() for axes in drawn]
    assert scales == [(-0.5, 0.5)] * 2


def test_filters_that_are_in_all_networks_as_they_were_at_random_are_named(tmp_path, monkeypatch):
    """The first has learned everywhere but in two filters, the second everywhere but in one."""
    runs, networks = {}, {}
    for agent, idle in (("double_dqn", (4, 16)), ("dueling_double_dqn", (16,))):
        run = runs[agent] = store(tmp_path, "boxing_final", agent, [1.0])
        few = {"replay_capacity": 400, "environments": 1}
        trainer = Trainer(run.params.model_copy(update=few), agent, run.seed)
        networks[agent] = AGENTS[agent].network(4, trainer.envs.actions)
        networks[agent].load_state_dict(trainer.learner.weights())
        with torch.no_grad():
            for number in set(range(32)) - {*idle}:
                networks[agent].convolutions[0].weight[number] += 0.3
    with torch.no_grad():
        networks["double_dqn"].convolutions[0].weight[16, 0, 0, 0] += 0.002
    said = saliency.unlearned(networks, runs)
    assert "Column 17, counted from the left, has learned nothing" in said
    assert numbers(said)[:2] == [17, 0.002]
    with torch.no_grad():
        networks["double_dqn"].convolutions[0].weight[16, 0, 0, 0] += 0.1
    assert saliency.unlearned(networks, runs) == ""


def test_an_observation_is_the_newest_images_with_the_first_before_the_beginning():
    images = np.arange(6, dtype=np.uint8)[:, None, None] * np.ones((1, 84, 84), np.uint8)
    game = Trajectory(images, *[np.zeros(5)] * 5)
    for step, expected in ((0, [0, 0, 0, 0]), (2, [0, 0, 1, 2]), (5, [2, 3, 4, 5])):
        assert saliency.observation_at(game, step, 4)[0, 0].tolist() == expected


def test_the_shares_of_the_parts_are_those_of_the_sum():
    score, ring, rope = (np.zeros((21, 21)) for _ in range(3))
    score[1, 10], ring[12, 9], rope[12, 1] = 1, 5, 2
    found = saliency.shares([score, ring, rope])
    assert found == pytest.approx({"score and clock": 12.5, "ring": 62.5, "elsewhere": 25})


class Known(nn.Module):
    """The state's value is the brightness, and the actions lie so far from it."""

    def __init__(self, *apart):
        super().__init__()
        self.apart, self.unused = torch.tensor(apart), nn.Parameter(torch.zeros(1))

    def forward(self, observations):
        return observations[:, 0, 0, -1].float()[:, None] + self.apart


def alternating(count):
    """Images of brightness 20 and 0 in turn."""
    images = np.zeros((count, 84, 84), np.uint8)
    images[::2, 0, 0] = 20
    return images


SPREADS = {"value of a state": 10, "spread between states": 10}  # of these images


def test_the_spreads_are_those_of_the_states_and_of_the_actions_in_them():
    observations = alternating(600)[..., None].repeat(4, axis=-1)
    within = np.var([2.0, 1.0, -3.0])
    assert saliency.spreads(Known(2.0, 1.0, -3.0), observations) == pytest.approx(
        SPREADS
        | {"spread between actions": np.sqrt(within), "gap of the best two": 1}
        | {"the state's share, %": 100 * 100 / (100 + within)}
    )


@pytest.fixture
def section(tmp_path, monkeypatch):
    """Two agents with an evaluation game on record, of as many images as `play` is given; the
    networks are by agent."""

    def play(images, networks):
        for agent in networks:
            store(tmp_path, "boxing_final", agent, [1.0])
        game = Trajectory(images, *[np.zeros(len(images) - 1)] * 5)
        monkeypatch.setattr(saliency, "first_evaluated", lambda run: EpisodeRecord(0, b"", None))
        monkeypatch.setattr(saliency, "trajectory", lambda params, record: game)
        monkeypatch.setattr(
            saliency.models, "load_model", lambda path, params: networks[params.agents[0]]
        )
        monkeypatch.setattr(saliency.models, "untrained", lambda run: Known(3.0, 2.0, 1.0))
        monkeypatch.setattr(saliency.models, "stored", lambda run: {3000: run.folder})
        return study(tmp_path)["boxing_final"]

    return play


def test_each_agents_spreads_stand_in_its_row(section, shown):
    networks = {"dqn": Known(1.0, -1.0), "double_dqn": Known(10.0, -10.0)}
    saliency.show_spreads(section(alternating(201), networks))
    for row, agent, apart, gap, share in zip(
        shown.tables["tbl-boxing-final-spreads"][1::2],
        ("DQN", "Double DQN"),
        ("1.00", "10.00"),
        ("2.00", "20.00"),
        (100 * 100 / 101, 50),
        strict=True,
    ):
        assert row == {
            **{"agent": agent, "games": "3000"},
            **{name: f"{value:.2f}" for name, value in SPREADS.items()},
            **{"spread between actions": apart, "gap of the best two": gap},
            **{"the state's share, %": f"{share:.2f}"},
        }


def test_every_stored_network_of_a_run_has_a_row(section, shown, monkeypatch):
    made = section(alternating(201), {"dqn": None})
    networks = {"early": Known(1.0, -1.0), "late": Known(10.0, -10.0)}
    monkeypatch.setattr(saliency.models, "load_model", lambda path, params: networks[path])
    monkeypatch.setattr(saliency.models, "stored", lambda run: {100: "early", 3000: "late"})
    saliency.show_spreads(made)
    rows = shown.tables["tbl-boxing-final-spreads"]
    assert [(row["games"], row["gap of the best two"]) for row in rows] == [
        ("0", "1.00"),
        ("100", "2.00"),
        ("3000", "20.00"),
    ]


def test_the_parts_of_the_picture_have_the_shares_of_each_agents_two_maps(
    section, shown, monkeypatch
):
    """Either looks at the score for one map and into the ring for the other."""
    score, ring = (8, 42), (50, 40)
    networks = {"dqn": Looks(score, ring), "double_dqn": Looks(ring, score)}
    images = np.random.default_rng(0).integers(0, 255, (102, 84, 84)).astype(np.uint8)
    drawn = {}
    monkeypatch.setattr(saliency, "filters_figure", lambda networks: Figure())
    monkeypatch.setattr(saliency, "unlearned", lambda networks, runs: " Column 5 is idle.")
    monkeypatch.setattr(
        saliency, "figure", lambda seen, networks: drawn.update(seen, **networks) or Figure()
    )
    saliency.show_saliency(section(images, networks))
    rows = shown.tables["tbl-boxing-final-saliency"]
    found = {(row["agent"], row["what changes"]): row for row in rows}
    kinds = [(agent, kind) for agent in ("DQN", "Double DQN") for kind in ("value", "advantages")]
    assert list(found) == [*kinds, ("if all places", "counted alike")]
    for kind, part in zip(
        kinds, ("score and clock", "ring", "ring", "score and clock"), strict=True
    ):
        assert float(found[kind][part]) > 90, kind
    even = found["if all places", "counted alike"]  # of 21 by 21: 3 rows, and 16 rows by 14
    assert (even["score and clock"], even["ring"], even["elsewhere"]) == ("14", "51", "35")
    assert numbers(shown.captions["tbl-boxing-final-saliency"]) == [2, 50], "steps 0 and 50"
    assert {name: drawn[name] for name in ("DQN", "Double DQN")} == {
        **{"DQN": networks["dqn"], "Double DQN": networks["double_dqn"]}
    }
    for name, step in (("a quarter", 25), ("half", 50), ("the last step", 100)):
        assert (drawn[name][..., -1] == images[step]).all(), name
    assert "One game by DQN" in shown.captions["fig-boxing-final-saliency"]
    assert shown.captions["fig-boxing-final-filters"].endswith(" Column 5 is idle.")
    for name in ("fig-boxing-final-saliency", "fig-boxing-final-filters"):
        assert shown.captions[name].startswith("Boxing, final settings: ")


def test_the_game_that_is_shown_is_the_newest_models_first_as_it_was_trained(tmp_path):
    run = store(tmp_path, "boxing_final", "dqn", [1.0])
    assert saliency.first_evaluated(run) is None
    heading = {"kind": "evaluation", "difficulty": 0, "sticky_actions": 0.0, "epsilon": 0.001}
    games = [
        ({**heading, **changes, "seed": 1, "game": game}, EpisodeRecord(number, b"\1", None))
        for number, (game, changes) in enumerate(
            [
                (0, {"trained_games": 100}),
                (1, {"trained_games": 100}),
                (0, {"trained_games": 3000}),
                (1, {"trained_games": 3000}),
                (0, {"trained_games": 3000, "difficulty": 2}),
            ]
        )
    ]
    (run.folder / records.FILE).write_bytes(records.encode(games))
    assert saliency.first_evaluated(run).idle_frames == 2
