"""The arithmetic behind the benchmarks' figures; what they measure is no matter for tests."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import throughput
from throughput import Contestant

FORWARD = {  # float operations an image, by hand: 2 x kernel x inputs x outputs
    "convolution 1": 2 * 8 * 8 * 4 * 32 * 20 * 20,
    "convolution 2": 2 * 4 * 4 * 32 * 64 * 9 * 9,
    "convolution 3": 2 * 3 * 3 * 64 * 64 * 7 * 7,
    "hidden": 2 * 3136 * 512,
    "output": 2 * 512 * 18,
}


@pytest.mark.parametrize(("agent", "passes"), [("dqn", 2), ("double_dqn", 3)])
def test_the_roofline_counts_every_pass_and_no_gradient_of_the_pixels(agent, passes):
    forward = sum(FORWARD.values())
    backward = 2 * forward - FORWARD["convolution 1"]
    an_update = 32 * (passes * forward + backward)
    assert throughput.operations(agent) == an_update / 4 + forward


def test_the_multiplications_really_needed_are_those_of_the_tiles():
    """By hand: 25 points for each of 25 tiles, 16 for each of 9, 36 for each of 4."""
    forward = 2 * (25 * 25 * 64 * 32 + 9 * 16 * 128 * 64 + 4 * 36 * 64 * 64)
    forward += FORWARD["hidden"] + FORWARD["output"]
    backward = 2 * forward - 2 * 25 * 25 * 64 * 32
    wanted = 32 * (2 * forward + backward) / 4 + forward
    assert throughput.operations("dqn", needed=True) == pytest.approx(wanted)


def test_each_librarys_faster_set_up_goes_on_and_ratios_are_to_the_fastest_peer():
    field = {
        Contestant("atari-dqn", "dqn", 1, 2, 8): [100.0, 120.0],
        Contestant("atari-dqn", "dqn", 2, 1, 8): [200.0, 180.0],
        Contestant("atari-dqn", "dqn", 1, 1, 8): [90.0, 90.0],
        Contestant("Tianshou", "dqn", 2, 1, 8): [70.0, 70.0],
        Contestant("Stable-Baselines3", "dqn", 2, 1, 8): [100.0, 90.0],
        Contestant("Stable-Baselines3", "dqn", 1, 2, 8): [96.0, 90.0],
    }
    chosen = throughput.finalists(field)
    assert [contestant.setup for contestant in chosen] == [
        *["one process per core, 1 thread"] * 3,
        "one process, 1 thread",
    ]
    table = throughput.table(
        field,
        {"share_of_direct_roofline": {"dqn": 125.0}, "share_of_needed_roofline": {"dqn": 190.0}},
    ).set_index(["library", "setup"])
    ours = table.loc[("atari-dqn", "one process per core, 1 thread")]
    assert (ours.steps_per_second, ours.low, ours.high, ours.rounds) == (190, 180, 200, 2)
    assert ours.ratio_to_best_peer == 2.0
    assert ours.share_of_direct_roofline == 0.76
    assert ours.share_of_needed_roofline == 0.5
