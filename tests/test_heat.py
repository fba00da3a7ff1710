"""The layer of heat over a video is where the values change with the picture, and how steeply."""

import numpy as np
import pytest
import torch
from torch import nn

from atari_dqn.networks import DuelingNetwork, NatureNetwork
from atari_dqn.report import heat


def in_double(network, pixels):
    """A network's values of one observation, float64, worked out apart from its own `forward`."""
    network = network.double()
    seen = torch.from_numpy(pixels / 255).permute(2, 0, 1)[None]
    found = nn.Sequential.forward(network.convolutions, seen).permute(0, 2, 3, 1).flatten()
    if isinstance(network, NatureNetwork):
        return network.output(network.hidden(found).relu()).numpy()
    value = network.value_output(network.value_hidden(found).relu())
    advantages = network.advantage_output(network.advantage_hidden(found).relu())
    return (value + advantages - advantages.mean()).numpy()


@pytest.mark.parametrize("kind", [NatureNetwork, DuelingNetwork])
def test_slopes_are_those_of_small_steps(kind):
    torch.manual_seed(3)
    network = kind(4, 6).requires_grad_(False)
    rng = np.random.default_rng(5)
    observations = rng.integers(0, 255, (heat.SOME + 1, 84, 84, 4)).astype(np.uint8)
    found = heat.slopes(network, observations)
    assert found.shape == (heat.SOME + 1, 84, 84, 2)
    for number in (0, heat.SOME):  # of two batches
        best = in_double(network, observations[number].astype(float)).argmax()
        for row, column in rng.integers(0, 84, (8, 2)):
            ends = []
            for step in (-1e-4, 1e-4):
                moved = observations[number].astype(float)
                moved[row, column, -1] += step
                values = in_double(network, moved)
                ends.append(np.array([values.mean(), values[best] - values.mean()]))
            expected = np.abs(ends[1] - ends[0]) / 2e-4
            assert found[number, row, column] == pytest.approx(expected, rel=2e-3, abs=1e-9)
        network.float()


class Known(nn.Module):
    """Two actions: the value is the square of a pixel of the newest image plus one of the oldest,
    and the first action's advantage is a third pixel of the newest."""

    VALUE, ADVANTAGE, OLDEST = (20, 60), (60, 20), (60, 60)

    def __init__(self):
        super().__init__()
        self.unused = nn.Parameter(torch.zeros(1))

    def forward(self, observations):
        (one, two, old) = (
            observations[:, row, column, image]
            for (row, column), image in ((self.VALUE, -1), (self.ADVANTAGE, -1), (self.OLDEST, 0))
        )
        value = one.float() ** 2 + old.float()
        return torch.stack([value + two.float(), value - two.float()], dim=1)


def observations(*brightness):
    """One of each brightness."""
    return np.stack([np.full((84, 84, 4), level, np.uint8) for level in brightness])


def test_values_and_advantages_light_their_own_places_each_in_its_colour(monkeypatch):
    monkeypatch.setattr(heat, "FULL", 1)
    (light,) = heat.light(Known(), observations(50))
    assert light[Known.VALUE] == pytest.approx((255, 140, 0), abs=1), "orange, as captions say"
    assert light[Known.ADVANTAGE] == pytest.approx((0, 150, 255), abs=1), "blue"
    assert not light[Known.OLDEST].any(), "older images are not in the picture"
    assert (light.max(axis=2) > 0).mean() < 0.1


def test_moments_of_a_video_are_on_one_scale(monkeypatch):
    monkeypatch.setattr(heat, "FULL", 1)
    dim, bright = heat.light(Known(), observations(25, 100))  # of a square, the slopes are 1 to 4
    assert dim[Known.VALUE] == pytest.approx(bright[Known.VALUE] / 4, abs=1)
    assert dim[Known.ADVANTAGE] == pytest.approx(bright[Known.ADVANTAGE], abs=1)


def test_what_depends_on_nothing_stays_dark():
    class Constant(Known):
        def forward(self, observations):
            return 0 * observations.float().sum(dim=(1, 2, 3))[:, None] + torch.tensor([1.0, 2.0])

    assert not heat.light(Constant(), observations(50)).any()
