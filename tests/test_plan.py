"""What there is to see: the runs that files ask for, and those that are stored besides."""

import json
import shutil
import sys

import pandas as pd
import pytest

from atari_dqn import __main__, params
from atari_dqn.analysis.study import comparable, run_table
from atari_dqn.games import GAMES
from atari_dqn.params import ParameterError
from atari_dqn.report import build, fingerprint, plots
from atari_dqn.runs import plan, recorder, robustness, styles
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import Run

SETTINGS = {
    "max_game_frames": 200,
    "environments": 2,
    "replay_capacity": 400,
    "learning_starts": 40,
    "batch_size": 4,
    "evaluation_games": 2,
}


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project folder, the working one, whose only base is quick to train."""
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "params" / "base").mkdir(parents=True)
    lines = [f"{key}: {value}\n" for key, value in SETTINGS.items()]
    (tmp_path / "params" / "base" / "small.yaml").write_text("".join(lines))
    write(tmp_path, "small", agents="[dqn]", episodes=2)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(project, name, **values):
    lines = [f"{key}: {value}\n" for key, value in values.items()]
    path = project / "params" / f"{name}.yaml"
    path.write_text(f"experiment: {name}\nbase: base/small.yaml\n" + "".join(lines))
    return path


def train(project, name, **overrides):
    loaded = params.load(project / "params" / f"{name}.yaml", overrides)
    run = Run(params.pick(loaded, "dqn", None), project / "results")
    recorder.train(run)
    return run


def command(monkeypatch, capsys, *arguments):
    """(exit status, lines on stdout, lines on stderr) of the command line."""
    monkeypatch.setattr(sys, "argv", ["atari_dqn", *map(str, arguments)])
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        __main__.main()
    said = capsys.readouterr()
    return ended.value.code, said.out.splitlines(), said.err.splitlines()


def test_all_stored_runs_are_verified_in_one_command_and_each_that_differs_is_named(
    project, monkeypatch, capsys
):
    def verified(*arguments):
        code, lines, errors = command(monkeypatch, capsys, "verify", *arguments)
        return code, lines, [line for line in errors if line.startswith("error")]  # no bars

    code, lines, errors = verified()
    assert (code, lines) == (1, [])
    assert errors == [f"error: no run is stored in {project / 'results' / 'runs'}"]
    first, second = train(project, "small"), train(project, "small", gamma=0.5)
    code, lines, errors = verified("--episodes", 2)
    assert (code, errors) == (0, [])
    said = "2 of 4 games played again, all as the tables say"
    assert lines == [f"{run.folder}: {said}" for run in (first, second)]
    path = first.folder / "episodes.csv"
    table = pd.read_csv(path)
    table.assign(score=table.score + 1).to_csv(path, index=False)
    write(project, "bad", gamma=2)
    code, lines, errors = verified("--episodes", 2)
    assert (code, lines) == (1, [f"{second.folder}: {said}"])
    assert "gamma: 2 is not allowed" in errors[0]
    assert errors[1].startswith("error: training game (episode 1): score is")
    assert len(errors) == 2
    path.write_text(path.read_text() + "3,")
    code, lines, errors = verified(first.folder, second.folder)
    assert (code, len(lines)) == (1, 1)
    assert errors == [f"error: {path}, line 4: '3,' is cut short, without a new line"]
    code, _, errors = verified(second.folder, "--profile", "quick")
    assert (code, len(errors)) == (2, 1)


def test_changed_runs_are_known_by_what_differs_and_compared_in_one_figure(
    project, monkeypatch, capsys
):
    train(project, "small")
    changed = train(project, "small", gamma=0.5, clip_rewards=False)
    train(project, "small", seeds=[7])
    write(project, "mine", agents="[dqn]", episodes=2, game="pong")
    train(project, "mine")
    status, lines, errors = command(monkeypatch, capsys, "experiments", "status")
    assert (status, errors) == (0, [])
    assert [line.split("  ")[0] for line in lines[2:-1]] == [
        *("mine", "small", "small", "small: clip rewards false, gamma 0.5")
    ]
    table = plan.status(plan.known("full", [], None)[0])
    assert table.seed.tolist() == [1, 1, 7, 1]
    assert set(table.state) == {"complete"}

    runs = plan.stored("full", ["small"])
    assert {run.folder for run in runs} < set((project / "results" / "runs").glob("*/*/*"))
    episodes = comparable(runs)
    labels = {"as in its file", "clip rewards false, gamma 0.5"}
    assert set(episodes.label) == labels
    mine = episodes[episodes.experiment == changed.params.experiment]
    assert mine.score.tolist() == pd.read_csv(changed.folder / "episodes.csv").score.tolist()
    axes = plots.comparison(episodes, GAMES["boxing"], 1, "label").axes[0]
    assert {text.get_text() for text in axes.get_legend().get_texts()} == labels

    assert set(comparable(plan.stored("full", ["small", "mine"])).label) == {
        *("mine", "small", "small, clip rewards false, gamma 0.5")
    }
    said = run_table(plan.stored("full", []))
    assert "`small`: clip rewards false, gamma 0.5" in said.experiment.tolist()
    assert len(said) == 4


def test_curves_of_experiments_of_the_same_agent_and_seed_are_not_mixed():
    rows = [("a", score, n) for n, score in enumerate((1.0, 1.0), 1)]
    rows += [("b", score, n) for n, score in enumerate((5.0, 5.0), 1)]
    table = pd.DataFrame(rows, columns=["experiment", "score", "episode"])
    table = table.assign(agent="dqn", seed=1, variation="", label=table.experiment)
    assert plots.smoothed(table, 2)["mean"].tolist() == [1.0, 5.0]


def test_a_stored_experiment_without_a_file_is_known_and_a_copy_kept_aside_is_not(project):
    run = train(project, "small")
    changed = train(project, "small", gamma=0.5)
    aside = run.folder.with_name("seed-1.aside-1")
    shutil.copytree(run.folder, aside)
    (aside / "params.yaml").write_text("of: an older kind")
    (project / "params" / "small.yaml").unlink()
    (first, second), errors = plan.known("full", ["small"], None)
    assert errors == []
    assert (first.title, first.folder) == ("small", run.folder)
    digest = changed.params.experiment.partition("+")[2]
    assert (second.title, second.folder) == (f"small: +{digest}", changed.folder)
    with pytest.raises(ParameterError, match="experiment 'smal' is not allowed"):
        plan.known("full", ["smal"], None)


def test_a_bad_file_is_named_in_one_line_and_the_others_are_shown(project, monkeypatch, capsys):
    bad = write(project, "bad", gamma=2)
    status, lines, errors = command(monkeypatch, capsys, "experiments", "status")
    assert status == 2
    assert any(line.startswith("small ") for line in lines)
    (error,) = errors
    assert error.startswith(f"error: {bad}: gamma: 2 is not allowed")
    _, lines, errors = command(monkeypatch, capsys, "train", bad)
    assert (lines, len(errors)) == ([], 1)
    status, lines, errors = command(monkeypatch, capsys, "experiments", "run", "bad")
    assert (status, lines, len(errors)) == (2, [], 1)
    status, lines, errors = command(monkeypatch, capsys, "experiments", "status", "small")
    assert (status, errors) == (0, []), "nobody asked for the bad one"


def test_the_report_names_a_bad_file_of_somebodys_own_and_goes_on(project, monkeypatch):
    def sections(*_):
        raise RunError("the sections are executed")

    bad = write(project, "bad", gamma=2)
    for module in (styles, robustness):
        monkeypatch.setattr(module, "EXPERIMENTS", ["small"])
    monkeypatch.setattr(build, "_execute", sections)
    with (
        pytest.warns(UserWarning, match=rf"{bad}: gamma: 2 is not allowed.*; left out"),
        pytest.raises(RunError, match="the sections are executed"),
    ):
        build.build("full", project / "results")


def test_a_section_with_the_table_of_all_runs_depends_on_changed_ones_too(project, tmp_path):
    write(project, "bad", gamma=2)
    cell = {"cell_type": "code", "source": ["Study(profile)\nplan.stored(profile, [])"]}
    notebook = tmp_path / "01_one.ipynb"
    notebook.write_text(json.dumps({"cells": [cell]}))
    before = fingerprint.fingerprint(notebook, "full", project / "results")
    train(project, "small", gamma=0.5)
    assert fingerprint.fingerprint(notebook, "full", project / "results") != before, (
        "its runs table"
    )


def test_damaged_parameters_of_a_stored_run_are_named_and_the_others_are_shown(project):
    run, changed = train(project, "small"), train(project, "small", gamma=0.5)
    (changed.folder / "params.yaml").write_text("gamma: [")
    runs, (line,) = plan.known("full", [], None)
    assert [one.folder for one in runs] == [run.folder]
    assert str(changed.folder / "params.yaml") in line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train", "params/smalll.yaml"], "did you mean params/small.yaml?"),
        (["train", "small"], "did you mean params/small.yaml?"),
        (["experiments", "status", "smal"], "did you mean 'small'?"),
        (["experiments", "run", "smal"], "did you mean 'small'?"),
    ],
)
def test_a_typo_in_a_name_gets_the_nearest_one(project, monkeypatch, capsys, arguments, said):
    status, _, errors = command(monkeypatch, capsys, *arguments)
    (error,) = errors
    assert status == 2
    assert error.endswith(said)


def test_what_is_like_no_name_gets_no_guess(project, monkeypatch, capsys):
    _, _, (error,) = command(monkeypatch, capsys, "train", "params/xyz.yaml")
    assert error == "error: params/xyz.yaml: no such file or directory"


def test_what_a_base_says_that_does_not_suit_the_game_is_said_to_be_there(project):
    with (project / "params" / "base" / "small.yaml").open("a") as base:
        base.write("evaluation_difficulties: [0, 3]\n")
    path = write(project, "mine", game="space_invaders")
    with pytest.raises(
        ParameterError, match=r"space_invaders has \(0, 1\) \(it is in .*small.yaml"
    ):
        params.load(path)


def test_the_time_left_is_not_told_by_games_that_were_cut_shorter(project):
    train(project, "small", max_game_frames=100)
    runs, _ = plan.known("full", [], None)
    assert plan.status(runs).hours_left.isna().tolist() == [True, False]
