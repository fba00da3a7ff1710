"""What the report says of the design is computed from the design."""

from pathlib import Path

import pytest
import torch
from torch import nn

from atari_dqn import params
from atari_dqn.analysis import study
from atari_dqn.params import Parameters
from atari_dqn.report import design
from atari_dqn.runs import plan

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("kernel", [1, 3, 8])
@pytest.mark.parametrize("stride", [1, 2, 4])
@pytest.mark.parametrize("padding", [0, 2])
@pytest.mark.parametrize("dilation", [1, 2])
def test_the_formula_of_a_convolutions_size_is_torchs(kernel, stride, padding, dilation):
    layer = nn.Conv2d(1, 1, kernel, stride, padding, dilation)
    side = layer(torch.zeros(1, 1, 40, 40)).shape[-1]
    assert design.conv_output(40, kernel, stride, padding, dilation) == side


def test_the_layer_table_holds_the_real_modules_sizes():
    table = design.layer_table()
    assert table["side by the formula"].tolist() == table["side of the module"].tolist()
    assert table.output.tolist() == ["20 × 20 × 32", "9 × 9 × 64", "7 × 7 × 64"]
    assert table.weights.tolist() == ["8,224", "32,832", "36,928"]


def test_images_of_real_games_are_much_smaller_compressed():
    sizes = design._compressed_sizes("boxing", images=300)
    assert len(sizes) == 300
    assert 50 < sum(sizes) / 300 < 1000


def test_every_decision_names_a_parameter_or_a_file_that_exists():
    for entry in study.data("deviations"):
        for where in entry["where"].split(", "):
            assert where in Parameters.model_fields or (ROOT / where).is_file(), where
        assert all(entry[key].strip() for key in ("what", "source", "why"))


def test_differences_list_what_an_experiment_changes_and_nothing_else():
    loaded = [params.load(path) for path in plan.files("full")]
    table = design.differences(loaded).set_index("experiment")["what differs"]
    assert table["`boxing_final`"] == "–"
    assert table["`boxing_expert`"] == "`difficulty` 3"
    assert table["`breakout_late`"] == "`game` breakout; `epsilon_floor` 0.1"
    assert "batch size x 2" in table["`boxing_sensitivity`"]
