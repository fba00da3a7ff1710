"""The arithmetic behind the benchmarks' figures; what they measure is no matter for tests."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from atari_dqn import cost

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import settings
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
        *["one process a core, 1 thread"] * 3,
        "one process, 1 thread",
    ]
    table = throughput.table(field, {"dqn": 125.0}).set_index(["library", "setup"])
    ours = table.loc[("atari-dqn", "one process a core, 1 thread")]
    assert (ours.steps_per_second, ours.low, ours.high, ours.rounds) == (190, 180, 200, 2)
    assert ours.ratio_to_best_peer == 2.0
    assert ours.share_of_roofline == 0.76


def evaluated(setup, scores):
    """Rows of settings.csv: an evaluation every 20 minutes of processor time."""
    return [
        {"setup": setup, "cpu_minutes": 20.0 * number, "agent_steps": 100, "updates": 10}
        | {
            "training_games": 100 * number,
            "games": 50,
            "score": score,
            "low": score - 1,
            "high": score + 1,
        }
        for number, score in enumerate(scores, start=1)
    ]


STUDY = pd.DataFrame(
    [
        {"setup": "random play", "games": 50, "score": 1.0, "low": 0.0, "high": 2.0},
        *evaluated("steady", [0.0, 25.0, 24.0]),
        *evaluated("lucky once", [0.0, 0.0, 26.0]),
        *evaluated("second", [9.0, 10.0, 30.0, 190.0]),
        *evaluated("early", [80.0, 1.0, 1.0]),
    ]
)


def trained(setup, games, score):
    """Rows of settings_training.csv: the last 50 games score differently from those before."""
    return [
        {"setup": setup, "episode": game, "epsilon": 1 / game, "score": score * (game > games - 50)}
        for game in range(1, games + 1)
    ]


GAMES = pd.DataFrame(
    [
        *trained("steady", 300, 6.0),
        *trained("lucky once", 300, 4.0),
        *trained("second", 400, 2.0),
        *trained("early", 300, 8.0),
    ]
)


def test_the_two_best_set_ups_are_those_of_the_last_two_evaluations_in_the_common_time():
    assert settings.best_after(60, STUDY.iloc[1:]) == ["steady", "second"]


@pytest.fixture
def shown(tmp_path, monkeypatch):
    """The tables and the sentences of the stored study."""
    folder = tmp_path / cost.FOLDER
    folder.mkdir(parents=True)
    STUDY.to_csv(folder / "settings.csv", index=False)
    GAMES.to_csv(folder / "settings_training.csv", index=False)
    found = {"tables": [], "texts": []}
    monkeypatch.setattr(cost.runs, "project_root", lambda: tmp_path)
    monkeypatch.setattr(cost, "show_figure", lambda *_, **__: None)
    monkeypatch.setattr(cost, "show_table", lambda table, **_: found["tables"].append(table))
    monkeypatch.setattr(cost, "show_text", found["texts"].append)
    return found


def test_the_settings_are_shown_after_the_same_time_and_then_those_that_went_on(shown):
    cost.show_settings(main_run(GAMES.head(0)))
    (table,) = shown["tables"]
    assert table.setting.tolist() == [
        *("random play", "steady", "lucky once", "second", "early"),
        "second",
    ]
    assert table.minutes.tolist()[1:] == [60, 60, 60, 60, 80]
    scores = [float(text.split(" (")[0]) for text in table["greedy score"]]
    assert scores == [1, 24, 26, 30, 1, 190]
    assert table["greedy score"].iloc[-1] == "190.0 (189.0 to 191.0)"
    assert table["last 50"].tolist()[1:] == [6, 4, 0, 8, 2]
    assert table.epsilon.tolist() == ["–", "0.00", "0.00", "0.00", "0.00", "0.00"]
    (reading,) = [text for text in shown["texts"] if text]
    assert "lie 29.0 points apart. That of one and the same run had moved by up to 79.0" in reading
    assert "too much to tell one setting from another" in reading


def main_run(games):
    """A section of one run, whose model was evaluated after 300 games and after 500."""
    played = pd.DataFrame({"trained_games": [300, 300, 500], "score": [4.0, 6.0, 9.0]})
    return SimpleNamespace(
        episodes=games, stored_evaluations=played, as_trained=lambda table: table
    )


def test_the_unchanged_set_up_is_told_to_be_the_main_run_only_if_its_games_are(shown):
    own = GAMES[GAMES.setup == "steady"]
    cost.show_settings(main_run(own.head(280)))
    said = shown["texts"].pop()
    assert "each of the 280 training games that both have played" in said
    assert "scored 5.0 points after 300 games, 9.0 points after 500 games" in said
    for other in (own.head(280).assign(score=1), own.head(20), own.head(0)):
        cost.show_settings(main_run(other))
        assert not shown["texts"].pop()
