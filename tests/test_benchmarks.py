"""The arithmetic behind the benchmarks' figures; what they measure is no matter for tests."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from atari_dqn import params
from atari_dqn.runs import checkpoints, dataset, recorder
from atari_dqn.runs.models import read_model
from atari_dqn.runs.run import Run

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import again
import drift
import learners
import soak
import throughput
import whole_run
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


def test_a_soak_finds_whatever_differs_but_for_what_the_clock_decides(tmp_path, small, monkeypatch):
    monkeypatch.delenv("ATARI_DQN_STATE")  # each has its checkpoints among its results
    one, two = (Run(small(episodes=1, snapshot_games=[1]), tmp_path / name) for name in "ab")
    recorder.train(one, None)
    shutil.copytree(one.results, two.results)
    assert soak.differences(one, two) == []
    names = [name for name in soak.contents(two) if not name.startswith("checkpoint: ")]
    assert {"episodes.csv", "games.jsonl.zst", "snapshots/games-00001.safetensors"} < set(names)
    for name in [*names, "timing.csv", "provenance.json"]:
        path = two.folder / name
        whole = path.read_bytes()
        path.write_bytes(whole + b" ")
        assert soak.differences(one, two) == [name] * (name in names)
        path.unlink()
        assert soak.differences(one, two) == [name] * (name in names)
        path.write_bytes(whole)
    saved = checkpoints.load(two.state_folder)
    saved["seconds"] += 1
    checkpoints.save(two.state_folder, saved)
    assert soak.differences(one, two) == []
    saved["trainer"]["learner"]["moments"]["convolutions.0.bias.exp_avg"][0] += 1
    checkpoints.save(two.state_folder, saved)
    assert soak.differences(one, two) == ["checkpoint: trainer"]


def test_a_soak_trains_twice_and_tells_what_came_of_it(tmp_path, small, monkeypatch):
    monkeypatch.delenv("ATARI_DQN_STATE")
    told = soak.soak(small(), tmp_path, seconds=1, times=1, busy=0)
    assert (told["games"], told["different"]) == (3, "none")
    assert told["kills"] <= 1, "it may have ended before"
    assert told["files"] == 7
    assert all(told[f"megabytes_{quarter}"] > 10 for quarter in (1, 2, 3, 4))


def test_a_run_trained_again_is_compared_game_by_game_with_what_is_stored(
    tmp_path, small, monkeypatch
):
    monkeypatch.delenv("ATARI_DQN_STATE")
    run = Run(small(snapshot_games=[1, 2]), tmp_path / "stored")
    monkeypatch.setattr(params, "VALUES_PERIOD", 2)
    recorder.train(run)
    told = again.again(run, tmp_path / "again", games=2, times=1, checked=2)
    assert (told["games"], told["kills"], told["different"]) == (2, 1, "none")
    other = Run(run.params, tmp_path / "again")
    compared = again.contents(run, 2)
    of_check = 1 + params.VALUE_GAMES  # its row, and the games behind it
    assert told["compared"] == len(compared) == 6 + of_check, "of two games rows, records, weights"
    (other.folder / "snapshots" / "games-00001.safetensors").write_bytes(b"another's")
    path = other.folder / "episodes.csv"
    head, first, *rest = path.read_text().splitlines(keepends=True)
    fields = first.split(",")
    path.write_text("".join([head, ",".join([*fields[:3], "77", *fields[4:]]), *rest]))
    found = again.differences(run, other, 2)
    assert found == ["episodes.csv, episode 1", "games-00001.safetensors"]


@pytest.mark.native
def test_both_learners_are_timed_in_turns_from_the_same_memory(monkeypatch):
    monkeypatch.setattr(learners, "TURN", 8)
    monkeypatch.setattr(learners, "WARM_UP", 8)
    row = learners.compare("boxing_final", "dqn", transitions=400, rounds=2)
    assert 400 <= row["transitions"] < 500
    assert row["low"] <= row["ratio"] <= row["high"]
    assert min(row["native_steps_per_second"], row["torch_steps_per_second"]) > 0


def test_a_whole_process_is_timed_and_goes_on_from_its_checkpoint(tmp_path, small, monkeypatch):
    monkeypatch.setattr(whole_run, "WARM_UP", 8)
    monkeypatch.setattr(whole_run, "SAVES", 1)
    parameters = small(learning_starts=0)
    row = whole_run.train(parameters, 200, 8, tmp_path)
    assert row["transitions"] == 200
    assert row["steps_per_second"] > 0
    assert row["checkpoint_megabytes"] > 10, "weights and moments of 1.7 million"
    assert whole_run.resume(parameters, tmp_path)["load_seconds"] >= 0


@pytest.mark.native
def test_learners_drift_apart_by_rounding_alone(tmp_path, small):
    run = Run(small(), tmp_path)
    recorder.train(run)
    weights = read_model(run.folder / "model.safetensors")
    memory = dataset.rebuilt_memory(run.folder, 3, 200, seed=1)
    found = drift.drift(run.params, weights, memory, 4, np.random.default_rng(0))
    assert found["moved"] > 1e-3
    assert 0 < found["native"] < found["moved"] / 100
    assert 0 < found["permuted"] < found["moved"] / 100
