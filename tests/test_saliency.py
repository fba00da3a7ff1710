"""What a network looks at is found where it looks."""

import numpy as np
import pytest
import torch
from synthetic import store
from torch import nn

from atari_dqn.envs import EpisodeRecord
from atari_dqn.networks import DuelingNetwork
from atari_dqn.report import saliency
from atari_dqn.runs import records
from atari_dqn.runs.dataset import Trajectory


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
    assert middles[:, 0].tolist() == [0.25, 0.5, 0.75, 1]
    assert middles[:, 7].tolist() == [-0.25, -0.5, -0.75, -1]
    below, above = axes.get_ylim()
    assert below > above, "the first row is drawn at the top"
    assert axes.get_title(loc="left") == "any"


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


def test_the_spreads_are_those_of_the_states_and_of_the_actions_in_them():
    class Known(nn.Module):
        """The state's value is the brightness, and the actions lie 1, 0 and -4 around it, moved."""

        def __init__(self):
            super().__init__()
            self.unused = nn.Parameter(torch.zeros(1))

        def forward(self, observations):
            state = observations[:, 0, 0, -1].float()
            return state[:, None] + torch.tensor([2.0, 1.0, -3.0])

    observations = np.zeros((600, 84, 84, 4), np.uint8)
    observations[::2, 0, 0, -1] = 20
    found = saliency.spreads(Known(), observations)
    within = np.var([2.0, 1.0, -3.0])
    assert list(found.values()) == pytest.approx(
        [10, 10, np.sqrt(within), 1, 100 * 100 / (100 + within)]
    )


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
