"""What experiment.ipynb shows of a run, while it trains and afterwards."""

import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from synthetic import numbers, store

from atari_dqn import params
from atari_dqn.params import ParameterError
from atari_dqn.report import experiment, notebook
from atari_dqn.runs import plan, tables
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import Run

SMOKE = {"experiment": "boxing_final", "profile": "smoke"}


class Output:
    """A notebook's output that can be changed later; keeps all that was shown in it."""

    def __init__(self, first):
        self.shown = [first]

    def update(self, thing):
        self.shown.append(thing)

    @property
    def texts(self):
        return [each.data for each in self.shown]


@pytest.fixture
def displayed(monkeypatch):
    """The outputs that `experiment` makes."""
    outputs = []

    def display(thing, display_id=False, raw=False):
        outputs.append(Output(thing))
        return outputs[-1]

    monkeypatch.setattr(experiment, "display", display)
    monkeypatch.setattr(experiment, "SECONDS", 0.0)
    monkeypatch.setattr(experiment, "SHARE", 1e9)
    return outputs


def test_a_run_is_followed_while_it_trains_and_its_evaluation_too(small, tmp_path, displayed):
    run = Run(small(episodes=3, evaluation_games=2, evaluation_stickiness=[0.25]), tmp_path)
    experiment.train(run)
    line, curve = displayed
    texts = line.texts
    assert texts[0] == "small/double_dqn/seed-1 begins"
    assert texts[1] == "**small/double_dqn/seed-1**: 0 of 3 games"
    scores = tables.of_runs([run], "episodes.csv").score
    mean = f"{scores[:2].mean():.1f}".replace("-", "−")
    assert f"2 of 3 games, mean score {mean} (last 2), about" in texts[3]
    assert texts[4].endswith("0 of 4 games of the final evaluation")
    assert texts[6].endswith("2 of 4 games of the final evaluation")
    assert texts[-1] == "small/double_dqn/seed-1 is complete: 3 games"
    assert all(isinstance(each, Figure) for each in curve.shown[1:])
    assert len(curve.shown[-1].axes[0].lines[-1].get_xdata()) == 3


def test_drawing_is_left_out_where_it_would_take_too_much_time(
    small, tmp_path, displayed, monkeypatch
):
    monkeypatch.setattr(experiment, "SECONDS", 3600)
    experiment.train(Run(small(episodes=3), tmp_path))
    line, curve = displayed
    assert len(curve.shown) == 2, "only what there is in the end"
    assert len(line.shown) == 4


def test_an_interrupted_run_is_one_line_and_goes_on(small, tmp_path, displayed, monkeypatch):
    run = Run(small(episodes=4), tmp_path)
    train = experiment.recorder.train

    def interrupted(run, **options):
        return train(run, **options, asked_to_stop=lambda: run.status()["episodes_done"] == 2)

    monkeypatch.setattr(experiment.recorder, "train", interrupted)
    with pytest.raises(RunError, match=r"^interrupted after 2 games, which are saved; this"):
        experiment.train(run)
    assert run.state() == "interrupted"
    monkeypatch.setattr(experiment.recorder, "train", train)
    experiment.train(run)
    assert displayed[-2].texts[-1] == "small/double_dqn/seed-1 is complete: 4 games"


@pytest.fixture
def stored(tmp_path, small, monkeypatch):
    """A small run, and beside it one of another agent, one with a changed parameter, one of another
    experiment."""
    monkeypatch.setattr(plan, "files", lambda profile: [])
    runs = [
        Run(small(episodes=3, **changes), tmp_path)
        for changes in (
            {},
            {"agents": ["dqn"]},
            {"experiment": "small+0123abcd", "gamma": 0.5},
            {"experiment": "other"},
        )
    ]
    for run in runs:
        experiment.recorder.train(run, position=None)
    return runs


def test_a_run_is_shown_beside_the_stored_ones_of_its_experiment(stored, shown):
    run, dqn, changed, _ = stored
    experiment.show_curve(run)
    axes = shown.figures["fig-curve"].axes[0]
    curves = {
        line.get_label(): line.get_ydata() for line in axes.lines if len(line.get_xdata()) > 2
    }
    assert set(curves) == {"this run", "DQN, seed 1", "Double DQN, +0123abcd, seed 1"}
    for label, each in (("this run", run), ("DQN, seed 1", dqn)):
        assert curves[label].tolist() == tables.of_runs([each], "episodes.csv").score.tolist()
    experiment.show_scores(run)
    rows = {row["who"]: row for row in shown.tables["tbl-scores"]}
    assert next(iter(rows)) == "this run"
    assert set(rows) - set(curves) == {"human tester", "random play"}
    greedy = tables.of_runs([changed], "evaluations.csv").query("sticky_actions == 0").score.mean()
    row = rows["Double DQN, +0123abcd, seed 1"]
    assert (row["games"], row["greedy"]) == ("3", f"{greedy:.1f}")
    assert rows["human tester"]["greedy"] == "12.1"
    assert rows["random play"]["greedy"] == "0.1"
    assert numbers(shown.captions["tbl-scores"]) == [100]


def test_a_training_score_is_the_mean_of_the_last_hundred_games(tmp_path):
    run = store(tmp_path, "boxing_final", "dqn", np.repeat([0.0, 7.0], [50, 100]))
    row = experiment._row("any", run)
    assert (row["games"], row["training"], row["greedy"]) == (150, 7.0, None)


def test_the_source_reports_figures_stand_beside_an_experiment_of_its_own(tmp_path):
    run = notebook.run_from_notebook({**SMOKE, "agent": "dqn", "results_dir": str(tmp_path)})
    source = experiment._source(run)
    assert source.episode.tolist() == [500, 1000, 1500, 2000, 2500, 3000]
    episodes = np.arange(1, 801)
    table = experiment.pd.DataFrame({"episode": episodes, "score": 1.0, "variation": "this run"})
    table = table.assign(agent="dqn", seed=1)
    facts = experiment.GAMES["boxing"]
    axes = experiment.plots.comparison(table, facts, 5, "variation", source).axes[0]
    (points,) = [line for line in axes.lines if line.get_marker() == "o"]
    assert points.get_xdata().tolist() == [500, 1000], "as far as a little beyond the curve"


def test_the_video_and_the_commands_are_of_this_run(stored, shown, displayed, monkeypatch):
    run, *_ = stored
    made = {}
    monkeypatch.setattr(experiment.outputs, "show_video", lambda video, **said: made.update(said))
    experiment.show_video(run, seconds=1)
    score = tables.of_runs([run], "evaluations.csv").score[0]
    assert made["caption"].startswith("small/double_dqn/seed-1 after 3 training games: the first")
    assert made["caption"].endswith(f"ends with {score:g} points.".replace("-", "−"))
    experiment.show_commands(run)
    text = displayed[-1].texts[0]
    command = re.search(r"python -m atari_dqn train (\S+) --results again", text)[1]
    again = params.load(experiment.Path(command))
    assert again.identity() == run.params.identity()
    assert (again.agents, again.seeds) == ([run.agent], [run.seed])


def test_of_a_run_without_a_game_one_line_says_so(small, tmp_path):
    run = Run(small(agents=["dqn"]), tmp_path)
    shows = (experiment.show_curve, experiment.show_scores)
    for show in (*shows, lambda run: experiment.show_video(run, 5)):
        with pytest.raises(RunError, match="before its first game"):
            show(run)


def test_every_parameter_is_shown_with_its_unit(small, tmp_path, displayed):
    experiment.show_parameters(Run(small(gamma=0.5), tmp_path))
    text = displayed[0].shown[0]["text/plain"]
    assert "gamma: 0.5  # discount per agent step" in text
    names = [line.partition(":")[0] for line in text.splitlines()]
    assert names == list(params.Parameters.model_fields)
    assert all(" # " in line for line in text.splitlines())


def test_none_leaves_a_parameter_as_the_file_has_it(tmp_path):
    given = {"results_dir": str(tmp_path), "gamma": None, "agent": None, "seed": None}
    run = notebook.run_from_notebook({**SMOKE, **given})
    assert run.folder == tmp_path / "runs" / "boxing_final" / "dqn" / "seed-1"
    changed = notebook.run_from_notebook({**SMOKE, **given, "gamma": 0.5})
    assert changed.folder.parts[-3].startswith("boxing_final+")


@pytest.mark.parametrize(("typo", "meant"), [("agnet", "agent"), ("gama", "gamma")])
def test_a_typo_names_the_nearest_parameter(typo, meant):
    with pytest.raises(ParameterError, match=rf"^unknown parameter '{typo}'; did you .*'{meant}'"):
        notebook.run_from_notebook({**SMOKE, typo: 1})


def test_the_notebooks_own_parameters_are_known_to_papermill_and_to_the_project():
    """papermill warns of those whose lines it cannot read."""
    from papermill import inspect_notebook

    found = inspect_notebook(str(experiment.project_root() / "notebooks" / "experiment.ipynb"))
    trained = set(found) - {"agent", "seed", "results_dir"}
    assert len(found) == 14
    assert trained <= set(params.Parameters.model_fields)
    assert all(each["help"] for each in found.values())
