"""What the report says of the design is computed from the design."""

from pathlib import Path

import pandas as pd
import pytest
import torch
from synthetic import numbers
from torch import nn

from atari_dqn import params
from atari_dqn.analysis import study
from atari_dqn.envs import AtariEnv
from atari_dqn.games import GAMES
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
    assert "batch size × 2" in table["`boxing_sensitivity`"]


def test_exploration_is_told_with_the_games_until_its_floor():
    p = Parameters(
        experiment="any", epsilon_start=1.0, epsilon_decay=0.5, epsilon_floor=0.125,
        target_update_period=3000,
    )  # fmt: skip
    assert numbers(design.exploration_text(p)) == [1, 0.5, 0.125, 3, 3000]


def test_units_follow_from_the_frames_of_a_full_game():
    p = Parameters(experiment="any", frame_skip=5, update_period=2, episodes=1000)
    table = design.units(p).set_index("unit")
    frames = GAMES["boxing"].full_frames
    game, everything = table.columns[1:]
    assert numbers(everything) == [1000]
    counts = {"frame": frames, "agent step": frames / 5, "update": frames / 10, "game": 1}
    for unit, count in counts.items():
        assert numbers(table.loc[unit, game]) == pytest.approx([count], rel=0.005)
        assert numbers(table.loc[unit, everything]) == pytest.approx([1000 * count], rel=0.005)
    assert numbers(table.loc["agent step", "is"]) == [5]
    assert numbers(table.loc["update", "is"]) == [2]


def test_a_full_game_of_boxing_has_as_many_frames_as_is_said():
    """Two boxers of whom one never moves: nobody is knocked out."""
    game = AtariEnv("boxing")
    game.reset(seed=1)
    over = False
    while not over:
        _, _, terminated, truncated, _ = game.step(0)
        over = terminated or truncated
    assert game.frames == GAMES["boxing"].full_frames


def test_a_million_images_are_a_thousandth_of_a_gigabyte_for_every_byte_of_one(
    monkeypatch, tmp_path
):
    sizes = {"boxing": [400, 600], "breakout": [110, 130]}
    monkeypatch.setattr(design, "_compressed_sizes", lambda name, images: sizes[name])
    monkeypatch.setattr(design, "project_root", lambda: tmp_path)
    found = numbers(design.memory_text(images=300))
    assert found == [300, 84 * 84, 500, 120, 0.50, 0.12]
    folder = tmp_path / "results" / "benchmarks"
    folder.mkdir(parents=True)
    rows = [("boxing", 500_000, 250.0), ("boxing", 1_000_000, 510.0), ("breakout", 1_000_000, 90.0)]
    columns = ["game", "transitions", "resident_megabytes"]
    pd.DataFrame(rows, columns=columns).to_csv(folder / "memory.csv", index=False)
    assert numbers(design.memory_text(images=300))[6:] == [1_000_000, 0.51, 0.09]


def test_settings_are_each_experiments_own():
    loaded = {path.stem: params.load(path) for path in plan.files("full")}
    table = design.settings([loaded["boxing_final"], loaded["breakout_final"]])
    table = table.set_index("parameter")
    for key, boxing, breakout in (
        ("`game`", "boxing", "breakout"),
        ("`batch_size`", "32", "64"),
        ("`life_loss_penalty`", "0", "1"),
        ("`epsilon_floor`", "0.01", "0.01"),
        ("`learning_rate`", "1e-4", "1e-4"),
        ("`adam_epsilon`", "1.5e-4", "1.5e-4"),
        ("`replay_capacity`", "1,000,000", "1,000,000"),
    ):
        assert table.loc[key, ["`boxing_final`", "`breakout_final`"]].tolist() == [boxing, breakout]
    rows = design.differences(list(loaded.values())).set_index("experiment")
    assert rows.games["`boxing_final`"] == "3,000"
    assert rows.games["`breakout_early`"] == "7,000"
    assert rows.agents["`boxing_final`"] == "all"
    assert rows.agents["`boxing_high_gamma`"] == "Dueling Double DQN"
