"""Watching a stored run: real games, on video where no window can be opened."""

import io
import os
import signal
from contextlib import contextmanager
from multiprocessing import Pipe
from types import SimpleNamespace

import av
import pandas as pd
import pytest
from conftest import SMALL

from atari_dqn import __main__, params
from atari_dqn.envs import EpisodeRecord
from atari_dqn.report import watch as watching
from atari_dqn.report import window
from atari_dqn.report.watch import watch
from atari_dqn.report.window import Window
from atari_dqn.runs import recorder
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import Run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """That of a finished run."""
    results = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(results / "state"))
        run = Run(params.Parameters(**{**SMALL, "episodes": 1}), results)
        recorder.train(run)
    return run.folder


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """In an empty folder, and without a display."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SDL_VIDEODRIVER", "x11")
    monkeypatch.delenv("DISPLAY", raising=False)


@contextmanager
def showing(shown):
    yield shown


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def pictures(path):
    with av.open(io.BytesIO(path.read_bytes())) as container:
        return sum(1 for _ in container.decode(video=0))


def test_without_a_display_the_evaluation_games_go_to_a_new_video(folder, tmp_path, capsys):
    before = contents(folder)
    (tmp_path / "small-double_dqn-seed-1.mp4").write_text("of another day")
    watch(folder, {}, 2, None)
    table = pd.read_csv(folder / "evaluations.csv")
    assert capsys.readouterr().out.splitlines() == [
        "no display to open a window on: what is played goes to small-double_dqn-seed-1-2.mp4",
        f"game 0: {table.score[0]:g} points, 0:02",
        f"game 1: {table.score[1]:g} points, 0:02",
        "video: small-double_dqn-seed-1-2.mp4",
    ]
    assert pictures(tmp_path / "small-double_dqn-seed-1-2.mp4") == (table.length + 1).sum()
    assert (tmp_path / "small-double_dqn-seed-1.mp4").read_text() == "of another day"
    assert contents(folder) == before, "nothing is stored"


@pytest.mark.parametrize(
    ("knockout", "won", "said"),
    [(1, True, ", knock-out"), (-1, False, ", knocked out"), (0, True, ", won"), (0, False, "")],
)
def test_how_a_game_ends_is_told_from_the_agents_side(knockout, won, said):
    assert watching._ending(SimpleNamespace(knockout=knockout, won=won)) == said


def test_other_conditions_are_those_that_are_played(folder, monkeypatch):
    played = []
    recorded = SimpleNamespace(show=lambda order: played.append(order) or True)
    monkeypatch.setattr(window, "opened", lambda params: showing(recorded))
    watch(folder, {"sticky_actions": 0.5, "evaluation_epsilon": 1.0}, 1, None)
    start, *actions = played
    assert start.rng is not None, "that of sticky actions"
    assert len(set(actions)) > 10, "at random"


def test_a_window_plays_the_game_to_its_end_and_no_video_is_made(
    folder, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # a window that nobody sees
    watch(folder, {}, 1, None)
    assert capsys.readouterr().out.startswith("game 0: ")
    assert not list(tmp_path.glob("*.mp4"))


def test_closing_the_window_ends_it_in_one_line_and_keeps_the_video(
    folder, tmp_path, monkeypatch, capsys
):
    answers = iter([True, True, True, False])
    closing = SimpleNamespace(show=lambda order: next(answers))
    monkeypatch.setattr(window, "opened", lambda params: showing(closing))
    watch(folder, {}, 2, tmp_path / "game.mp4")
    ended, video = capsys.readouterr().out.splitlines()
    assert ended.startswith("the window was closed in game 0: ")
    assert video == f"video: {tmp_path / 'game.mp4'}"
    assert pictures(tmp_path / "game.mp4") == 4


def test_ctrl_c_ends_it_in_one_line(folder, monkeypatch, capsys):
    interrupting = SimpleNamespace(show=lambda order: not os.kill(os.getpid(), signal.SIGINT))
    monkeypatch.setattr(window, "opened", lambda params: showing(interrupting))
    watch(folder, {}, 1, None)
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("stopped in game 0: 0 points")


def test_a_window_that_fails_is_not_taken_for_one_that_was_closed():
    def gone(exitcode):
        ours, theirs = Pipe()
        theirs.close()
        return Window(SimpleNamespace(join=lambda: None, exitcode=exitcode), ours)

    assert gone(0).show(EpisodeRecord(0, b"", None)) is False
    with pytest.raises(RunError, match=r"the window failed \(exit code 1\)"):
        gone(1).show(3)


def test_what_cannot_be_watched_is_named(folder, tmp_path):
    run = tmp_path / "seed-1"
    with pytest.raises(params.ParameterError, match=r"seed-1: there is no such folder"):
        watch(run, {}, 1, None)
    run.mkdir()
    (run / "params.yaml").write_bytes((folder / "params.yaml").read_bytes())
    with pytest.raises(params.ParameterError, match=r"seed-1: no model.safetensors here"):
        watch(run, {}, 1, None)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"video": "game.avi"}, r"--video 'game.avi': expected FILE.mp4"),
        ({"difficulty": 9}, r"params.yaml: difficulty: 9 is not allowed"),
        ({"sticky": 1.0}, r"params.yaml: sticky_actions: 1.0 is not allowed"),
        ({"epsilon": -1.0}, r"params.yaml: evaluation_epsilon: -1.0 is not allowed"),
    ],
)
def test_bad_options_are_one_line(folder, tmp_path, options, said):
    if "video" in options:
        options = {"video": __main__.Path(options["video"])}
    with pytest.raises(params.ParameterError, match=said) as error:
        __main__.watch(folder, **options)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())
