"""A run's records as data: the transitions are those that the run learned from."""

import sys

import numpy as np
import pytest
from conftest import SMALL

from atari_dqn import __main__
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.runs import dataset, recorder
from atari_dqn.runs.run import Run

GAMES = 4


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A run of Breakout, lives counted, and its replay memory as it was after every game."""
    folder = tmp_path_factory.mktemp("trained")
    values = {"game": "breakout", "episodes": GAMES, "life_loss_penalty": 1.0, "environments": 1}
    values |= {"max_game_frames": 200, "replay_capacity": 300}
    run = Run(Parameters(**{**SMALL, **values}), folder)
    memories = []
    log = recorder.Recorder.log

    def remembered(self, episode):
        memories.append(self.trainer.memory.get_state())
        log(self, episode)

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        patch.setattr(recorder.Recorder, "log", remembered)
        recorder.train(run)
    return run, memories


def contents(memory):
    """What a memory of one stream holds from the oldest slot on, as lists: age, action, reward,
    end and image, without the action that a restart ignores."""
    order = memory._oldest_first()
    ages = memory.ages[order, 0]
    images = memory._images(order[None])[0]
    rows = zip(
        ages.tolist(),
        np.where(ages > 0, memory.actions[order, 0], 0).tolist(),
        memory.rewards[order, 0].tolist(),
        memory.terminated[order, 0].tolist(),
        [image.tobytes() for image in images],
        strict=True,
    )
    return list(rows)


@pytest.mark.parametrize("games", range(1, GAMES + 1))
def test_a_rebuilt_memory_holds_what_the_runs_own_did(trained, games):
    run, memories = trained
    live = recorder.Trainer(run.params, run.agent, run.seed).memory
    live.set_state(memories[games - 1])
    rebuilt = dataset.rebuilt_memory(run.folder, games, run.params.replay_capacity)
    expected, found = contents(live), contents(rebuilt)
    assert len(found) > 30
    assert found[-len(expected) :] == expected[-len(found) :]
    assert rebuilt.gamma == run.params.gamma


def test_a_memory_smaller_than_the_games_keeps_the_newest(trained):
    run, _ = trained
    whole = contents(dataset.rebuilt_memory(run.folder, GAMES, 1000))
    assert len(whole) > 120
    assert {reward for _, _, reward, *_ in whole} == {-1.0, 0.0, 1.0}
    assert contents(dataset.rebuilt_memory(run.folder, GAMES, 50)) == whole[-50:]


def test_an_exported_file_holds_whole_games_one_after_the_other(trained, tmp_path):
    run, _ = trained
    path = tmp_path / "games.npz"
    assert dataset.export(run.folder, 2, 3, path) == 2
    with np.load(path) as file:
        data = dict(file)
    lengths = [len(game.actions) for _, game in dataset.trajectories(run.folder, 2, 3)]
    assert data["episode_starts"].tolist() == [0, lengths[0] + 1]
    assert data["observations"].shape == (sum(lengths) + 2, 84, 84)
    names = ("actions", "rewards", "life_lost", "terminations", "truncations")
    assert {len(data[name]) for name in names} == {sum(lengths)}
    last = np.cumsum(lengths) - 1
    assert np.flatnonzero(data["terminations"] | data["truncations"]).tolist() == last.tolist()
    table = np.genfromtxt(run.folder / "episodes.csv", delimiter=",", names=True)
    scores = [part.sum() for part in np.split(data["rewards"], lengths[:1])]
    assert scores == table["score"][1:3].tolist()


@pytest.mark.parametrize("asked", [(5, 9), (3, 2)])
def test_games_that_a_run_has_not_are_refused(trained, asked, tmp_path):
    run, _ = trained
    with pytest.raises(ParameterError, match="has training games 1 to 4, none from"):
        dataset.export(run.folder, *asked, tmp_path / "none.npz")
    assert not list(tmp_path.iterdir())


def test_the_command_line_exports_games_and_refuses_a_file_of_another_kind(
    trained, tmp_path, monkeypatch, capsys
):
    run, _ = trained
    asked = ["atari_dqn", "export", str(run.folder)]
    monkeypatch.setattr(sys, "argv", [*asked, str(tmp_path / "a.npz"), "--first", "2"])
    with pytest.raises(SystemExit) as ended:
        __main__.main()
    assert not ended.value.code
    assert "a.npz: 3 games" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", [*asked, str(tmp_path / "a.csv")])
    with pytest.raises(SystemExit) as ended:
        __main__.main()
    assert ended.value.code == 2
    assert "expected FILE.npz" in capsys.readouterr().err
