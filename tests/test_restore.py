"""Going on with a run whose checkpoint is lost, from what its folder holds."""

import json
import shutil
from collections import Counter

import numpy as np
import pytest
from conftest import SMALL

from atari_dqn import __main__, native
from atari_dqn.analysis.study import run_table
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.runs import audit, checkpoints, recorder, records
from atari_dqn.runs.files import RunError
from atari_dqn.runs.models import read_model
from atari_dqn.runs.restore import restore
from atari_dqn.runs.run import Run
from atari_dqn.training import Trainer

GAMES = 6  # of about 45 agent steps each, in two environments


def run_of(folder, **changes):
    return Run(Parameters(**{**SMALL, "episodes": GAMES, "snapshot_games": [2], **changes}), folder)


def no_library(*_):
    raise native.Unavailable("there is none")


@pytest.fixture(params=["native", "torch"])
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


def slots(memory, state):
    """How often a memory holds each image with its age, action, reward and end."""
    memory.set_state(state)
    ages = memory.ages[: memory.row].reshape(-1)
    images = memory._images(np.arange(len(memory))[None])[0]
    rows = zip(
        ages.tolist(),
        np.where(ages > 0, memory.actions[: memory.row].reshape(-1), 0).tolist(),
        memory.rewards[: memory.row].reshape(-1).tolist(),
        memory.terminated[: memory.row].reshape(-1).tolist(),
        map(bytes, images),
        strict=True,
    )
    return Counter(rows)


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
    before = slots(own, saved["trainer"]["memory"])
    after = slots(other, found["trainer"]["memory"])
    begun = Counter({slot: count for slot, count in (after - before).items() if slot[0] == 0})
    assert after - before == begun, "but for the games that begin now"
    assert begun.total() == run.params.environments
    assert (before - after).total() < 10 < before.total() / 20, "what is cut at the end"


def test_the_learner_is_the_published_model_with_adams_moments(lost):
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
    for name, value in learner["moments"].items():
        if name.endswith(".step"):
            assert value == before["updates"]
        elif name.endswith("exp_avg_sq"):
            sizes = np.sqrt([np.mean(value), np.mean(before["moments"][name])])
            assert 1 / 3 < sizes[0] / sizes[1] < 3, name


def test_moments_are_those_of_gradients_at_weights_that_stand_still(tmp_path):
    """The first update after it is one of Adam in the middle of a run: with moments of zero it
    would be more than three learning rates long in every weight."""
    run = run_of(tmp_path)
    recorder.train(run)
    shutil.rmtree(run.state_folder)
    restore(run.folder)
    trainer = Trainer(run.params, run.agent, run.seed)
    trainer.set_state(checkpoints.load(run.state_folder)["trainer"])
    before = {name: value.clone() for name, value in trainer.learner.weights().items()}
    trainer.learner.learn(trainer.memory.sample(run.params.batch_size))
    for name, value in trainer.learner.weights().items():
        moved = (value - before[name]).abs()
        assert 0 < moved.max() < 2 * run.params.learning_rate, name


def test_a_restored_run_goes_on_to_its_end_and_says_where(lost):
    run, _ = lost
    before = (run.folder / "episodes.csv").read_bytes()
    sessions = run.provenance()["sessions"]
    restore(run.folder)
    longer = Run(run.params.model_copy(update={"episodes": GAMES + 4}), run.results)
    recorder.train(longer)
    assert longer.state() == "complete"
    after = (run.folder / "episodes.csv").read_bytes()
    assert after.startswith(before)
    assert after.count(b"\n") == 1 + GAMES + 4
    assert len(list(audit.verify(run.folder, None))) > GAMES + 4
    *first, made, on = run.provenance()["sessions"]
    assert first == sessions
    assert (made["restored"], made["first_episode"]) == (True, GAMES + 1)
    assert "restored" not in on
    assert f"; restored after game {GAMES}" in run_table([run])["trained on"][0]
    assert on["learner"] == sessions[0]["learner"]
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


def refused(run, said, folder=None, kind=RunError):
    with pytest.raises(kind, match=said):
        restore(folder or run.folder)


def test_what_cannot_be_restored_is_refused_in_one_line(tmp_path):
    run = run_of(tmp_path)
    recorder.train(run)
    refused(run, "has a checkpoint in")
    shutil.rmtree(run.state_folder)
    copy = shutil.copytree(run.folder, run.folder.with_name("seed-1.aside-1"))
    refused(run, "is trained in", copy, ParameterError)
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
    table.write_bytes(b"".join([rows[0], b"1,2\n"]))
    refused(run, "2 fields should be 8")
    (run.folder / "model.safetensors").unlink()
    refused(run, "no model.safetensors", kind=ParameterError)
    assert not checkpoints.exist(run.state_folder)


def test_the_command_line_restores_and_tells_how_to_go_on(tmp_path, capsys, monkeypatch):
    run = run_of(tmp_path)
    recorder.train(run)
    shutil.rmtree(run.state_folder)
    with pytest.raises(RunError, match=f"restore {run.folder}` makes it anew"):
        recorder.train(run_of(tmp_path, episodes=GAMES + 1))
    __main__.app(["restore", str(run.folder)], standalone_mode=False)
    assert f"goes on after game {GAMES}" in capsys.readouterr().out
    recorder.train(run_of(tmp_path, episodes=GAMES + 1))
