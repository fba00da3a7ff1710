"""Going on with a run whose checkpoint is lost, from what its folder holds."""

import json
import shutil
from collections import Counter

import numpy as np
import pandas as pd
import pytest
from conftest import SMALL

from atari_dqn import __main__, native
from atari_dqn.agents import AGENTS, Learner
from atari_dqn.analysis.study import run_table
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.replay import ReplayMemory
from atari_dqn.runs import audit, checkpoints, dataset, recorder, records
from atari_dqn.runs import restore as restoring
from atari_dqn.runs.files import RunError
from atari_dqn.runs.models import read_model
from atari_dqn.runs.restore import restore
from atari_dqn.runs.run import Run
from atari_dqn.training import Trainer

GAMES = 6  # of about 27 agent steps each, in two environments


def run_of(folder, **changes):
    return Run(Parameters(**{**SMALL, "episodes": GAMES, "snapshot_games": [2], **changes}), folder)


def no_library(*_):
    raise native.Unavailable("there is none")


@pytest.fixture(params=[pytest.param("native", marks=pytest.mark.native), "torch"])
def lost(request, tmp_path, monkeypatch):
    """A run that has lost its checkpoint, and that checkpoint's contents, with each learner."""
    if request.param == "torch":
        monkeypatch.setattr(native, "load", no_library)
        monkeypatch.setattr(native, "_say_once", lambda line: None)
    run = run_of(tmp_path)
    recorder.train(run)
    saved = checkpoints.load(run.state_folder)
    shutil.rmtree(run.state_folder)
    return run, saved


def transitions(memory):
    """How often a memory holds each transition: its images, action, reward and end."""
    written = np.arange(len(memory) // memory.streams)
    if memory.full:  # what is before the oldest is overwritten
        written = np.roll(written, -memory.row)[memory.stack :]
    places, streams = np.nonzero(memory.ages[written])
    rows = written[places]
    back = np.minimum(np.arange(memory.stack, -1, -1)[:, None], memory.ages[rows, streams])
    images = memory._images((rows - back) % memory.rows * memory.streams + streams)
    given = (memory.actions, memory.rewards, memory.terminated)
    facts = zip(*(each[rows, streams].tolist() for each in given), strict=True)
    return Counter(zip(map(bytes, images.swapaxes(0, 1)), facts, strict=True))


def test_counters_tables_and_memory_are_those_of_the_lost_checkpoint(lost):
    run, saved = lost
    assert restore(run.folder) == GAMES
    found = checkpoints.load(run.state_folder)
    for name in ("episodes", "scores", "snapshots", "seconds", "cpu_seconds"):
        # timing.csv has a digit after the point, and the last game's time is not the end's
        expected = pytest.approx(saved[name], abs=2) if "seconds" in name else saved[name]
        assert found[name] == expected, name
    for name in ("agent_steps", "episodes", "frames", "means"):
        assert found["trainer"][name] == saved["trainer"][name], name
    written, expected = found["written"], saved["written"]
    games = [records.read(each.pop("games.jsonl.zst"), run.folder) for each in (written, expected)]
    assert list(games[0]) == list(games[1]), "in other frames"
    assert written == expected
    own, other = (Trainer(run.params, run.agent, run.seed).memory for _ in range(2))
    own.set_state(saved["trainer"]["memory"])
    other.set_state(found["trainer"]["memory"])
    before, after = transitions(own), transitions(other)
    assert after <= before, "those of games under way are not there"
    assert before.total() - after.total() < GAMES
    assert after.total() == sum(pd.read_csv(run.folder / "episodes.csv").length)
    begun = (other.row - 1) * other.streams + np.arange(other.streams)
    assert np.array_equal(other._images(begun), found["trainer"]["games"]["planes"][-1])
    assert not other.ages[other.row - 1].any(), "the games that begin now"


def test_the_learner_is_the_published_model_as_often_updated(lost):
    run, saved = lost
    restore(run.folder)
    learner, before = (
        state["trainer"]["learner"] for state in (checkpoints.load(run.state_folder), saved)
    )
    for name, weight in read_model(run.folder / "model.safetensors").items():
        assert np.array_equal(learner["online"][name], weight), name
        assert np.array_equal(learner["target"][name], weight), name
    assert learner["updates"] == before["updates"]
    assert learner["moments"].keys() == before["moments"].keys()
    steps = {value.item() for name, value in learner["moments"].items() if name.endswith(".step")}
    assert steps == {before["updates"]}


@pytest.mark.parametrize("agent", ["dqn", "dueling_double_dqn"])
def test_moments_are_averages_of_gradients_at_the_published_weights(tmp_path, monkeypatch, agent):
    """Against PyTorch's gradients of the same batches, averaged in float64."""
    run = run_of(tmp_path, agents=[agent])
    recorder.train(run)
    shutil.rmtree(run.state_folder)
    batches, sample = [], ReplayMemory.sample

    def remembered(self, count):
        batches.append(sample(self, count))
        return batches[-1]

    monkeypatch.setattr(ReplayMemory, "sample", remembered)
    monkeypatch.setattr(restoring, "MOMENT_UPDATES", 30)
    restore(run.folder)
    learner = checkpoints.load(run.state_folder)["trainer"]["learner"]
    moments, updates = learner["moments"], run.provenance()["updates"]
    reference = Learner(AGENTS[agent], 18, run.params, 1)
    reference.set_weights(read_model(run.folder / "model.safetensors"))
    reference.target.load_state_dict(reference.weights())
    names = [name for name, _ in reference.online.named_parameters()]
    first, second = ({name: np.zeros(1) for name in names} for _ in range(2))
    assert len(batches) == 30
    for batch in batches:
        reference.set_learning_rate(0.0)
        reference.learn(batch)
        for name, parameter in reference.online.named_parameters():
            gradient = parameter.grad.double().numpy()
            first[name] = 0.9 * first[name] + 0.1 * gradient
            second[name] = 0.999 * second[name] + 0.001 * gradient**2
    assert learner["updates"] == updates > 30
    assert all(moments[f"{name}.step"] == updates for name in names)
    for expected, moment in ((first, "exp_avg"), (second, "exp_avg_sq")):
        for name in names:
            close(moments[f"{name}.{moment}"], expected[name])


def close(found, expected):
    error, size = np.abs(found - expected).max(), np.abs(expected).max()
    assert error <= 1e-3 * size
    assert size > 0


def test_a_restored_run_goes_on_to_its_end_and_says_where(lost):
    run, _ = lost
    before = (run.folder / "episodes.csv").read_bytes()
    sessions = run.provenance()["sessions"]
    restore(run.folder)
    shutil.rmtree(run.folder / "snapshots")
    longer = Run(run.params.model_copy(update={"episodes": GAMES + 4}), run.results)
    recorder.train(longer)
    assert longer.state() == "complete"
    after = (run.folder / "episodes.csv").read_bytes()
    assert after.startswith(before)
    assert after.count(b"\n") == 1 + GAMES + 4
    assert len(list(audit.verify(run.folder, None))) > GAMES + 4
    first, second = run.provenance()["sessions"]
    assert first == {**sessions[0], "restored_after": GAMES}
    assert second["learner"] == first["learner"]
    assert f"; restored after game {GAMES}" in run_table([run])["trained on"][0]
    assert (run.folder / "snapshots" / "games-00002.safetensors").exists()


def test_games_after_the_published_model_are_played_again(tmp_path, monkeypatch):
    """A killed run's tables are ahead of its model, which is as of the last checkpoint."""
    run = run_of(tmp_path)
    recorder.train(run)
    model = (run.folder / "model.safetensors").read_bytes()
    longer = run_of(tmp_path, episodes=GAMES + 2)
    recorder.train(longer)
    (run.folder / "model.safetensors").write_bytes(model)
    status = {**longer.status(), "state": "running"}
    (run.folder / "status.json").write_text(json.dumps(status))
    shutil.rmtree(run.state_folder)
    assert restore(run.folder) == GAMES
    written = checkpoints.load(run.state_folder)["written"]
    assert written["episodes.csv"].count(b"\n") == 1 + GAMES
    assert written["timing.csv"].count(b"\n") == 1 + GAMES
    recorder.train(longer)
    assert longer.state() == "complete"


@pytest.mark.parametrize("streams", [3, 8])
@pytest.mark.parametrize("capacity", [120, 1000])
def test_several_streams_hold_the_newest_games_though_these_end_apart(tmp_path, streams, capacity):
    run = run_of(tmp_path, game="breakout", episodes=7, noop_max=30, max_game_frames=160)
    recorder.train(run)
    one = dataset.rebuilt_memory(run.folder, 7, 1000)
    lengths = pd.read_csv(run.folder / "episodes.csv").length
    assert lengths.nunique() > 1
    several = ReplayMemory(capacity, streams, 4, 0.99, np.random.SeedSequence(1))
    dataset.fill(several, run.folder, 7)
    found, everything = transitions(several), transitions(one)
    assert everything.total() == lengths.sum()
    if capacity == 1000:
        assert found == everything
    else:
        assert len(several) == capacity
        assert found <= everything
        assert found.total() > capacity - streams * (4 + 7), "the oldest rows, and restarts"


def refused(run, said, folder=None, kind=RunError):
    with pytest.raises(kind, match=said):
        restore(folder or run.folder)


def test_what_cannot_be_restored_is_refused_in_one_line(tmp_path):
    run = run_of(tmp_path)
    recorder.train(run)
    refused(run, "has a checkpoint in")
    shutil.rmtree(run.state_folder)
    copy = shutil.copytree(run.folder, run.folder.with_name("seed-1.aside-1"))
    refused(run, "is not trained here", copy, ParameterError)
    with run.lock():
        refused(run, "is being trained")
    table = run.folder / "episodes.csv"
    rows = table.read_bytes().splitlines(keepends=True)
    status = {**run.status(), "state": "interrupted"}
    (run.folder / "status.json").write_text(json.dumps(status))
    for name in ("episodes.csv", "timing.csv"):
        path = run.folder / name
        path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-1]))
    refused(run, f"is of {GAMES} games; episodes.csv has {GAMES - 1}")
    (run.folder / "values.csv").rename(tmp_path / "values.csv")
    refused(run, "values.csv is missing")
    table.write_bytes(b"".join([rows[0], b"1,2\n"]))
    refused(run, "2 fields should be 8")
    (run.folder / "model.safetensors").unlink()
    refused(run, "no model.safetensors", kind=ParameterError)
    assert not checkpoints.exist(run.state_folder)


def test_the_command_line_restores_and_tells_how_to_go_on(tmp_path, capsys, monkeypatch):
    run = run_of(tmp_path)
    recorder.train(run)
    shutil.rmtree(run.state_folder)
    with pytest.raises(RunError, match=f"restore {run.folder}` makes it again"):
        recorder.train(run_of(tmp_path, episodes=GAMES + 1))
    __main__.app(["restore", str(run.folder)], standalone_mode=False)
    assert f"has a checkpoint of game {GAMES};" in capsys.readouterr().out
    recorder.train(run_of(tmp_path, episodes=GAMES + 1))
