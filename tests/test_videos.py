"""Which run and game a video is of, and that its caption says so; nothing is recorded here."""

from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import AGENTS, evaluate, facts, numbers, store, study

from atari_dqn.report import videos

DQN, DOUBLE, DUELING = AGENTS


@pytest.fixture
def recorded(monkeypatch):
    """Stands in for models and cameras: what is recorded, and under which caption. A run has models
    of 100 games, and of all its games."""
    seen = SimpleNamespace(captions={}, data={}, played=None, contestants=None, seconds=None)
    monkeypatch.setattr(
        videos.models, "stored", lambda run: {100: "", run.status()["episodes_done"]: ""}
    )
    monkeypatch.setattr(videos, "_network", lambda run, games: (run.agent, games))

    def play_with_instruments(network, params, title, seed, game, seconds=(None, None), layer=None):
        seen.played = {"network": network, "title": title, "game": game, "seconds": seconds}
        seen.played["layer"] = layer
        return SimpleNamespace(games=[SimpleNamespace(score=-7.0)])

    def side_by_side(contestants, seed, game, seconds):
        seen.seconds = seconds
        seen.contestants = {title: network for title, (network, _) in contestants.items()}
        scores = range(10, 10 + len(contestants))
        return SimpleNamespace(games=[SimpleNamespace(score=float(score)) for score in scores])

    def show_video(video, label, caption, alt, data, layer=""):
        seen.captions[label], seen.data[label], seen.layer = caption, data, layer

    monkeypatch.setattr(videos, "play_with_instruments", play_with_instruments)
    monkeypatch.setattr(videos, "side_by_side", side_by_side)
    monkeypatch.setattr(videos, "show_video", show_video)
    return seen


def test_the_best_is_the_run_that_scored_most_in_its_last_hundred_games(tmp_path, recorded):
    store(tmp_path, "boxing_final", DQN, np.repeat([99.0, 5.0], [600, 100]))
    store(tmp_path, "boxing_final", DOUBLE, np.repeat([0.0, 9.0], [600, 100]))
    store(tmp_path, "boxing_final", DUELING, np.repeat([9.0, -50.0], [699, 51]))
    videos.show_best(study(tmp_path)["boxing_final"], "vid-best", seconds=20)
    assert recorded.played["network"] == (DOUBLE, 700)
    assert recorded.played["seconds"] == (None, 20)
    assert facts(recorded.played["title"]) == ["Double DQN", 700]
    caption = recorded.captions["vid-best"]
    assert numbers(caption) == [700, 20, -7]
    assert caption.startswith("Double DQN after")


def test_early_and_late_are_the_same_runs_first_model_and_its_last(tmp_path, recorded):
    store(tmp_path, "boxing_final", DQN, np.zeros(299))  # not long enough between the two
    store(tmp_path, "boxing_final", DOUBLE, np.zeros(300))
    videos.show_early_and_late(study(tmp_path)["boxing_final"], "vid-early-late")
    assert list(recorded.contestants.values()) == [(DOUBLE, 100), (DOUBLE, 300)]
    assert [numbers(title) for title in recorded.contestants] == [[100], [300]]
    assert recorded.seconds == (None, 30)
    assert facts(recorded.captions["vid-early-late"]) == ["Double DQN", 100, 300, 30, 10, 11]


def test_side_by_side_each_agent_has_its_own_name_and_newest_model(tmp_path, recorded):
    for agent, games in ((DUELING, 400), (DQN, 200), (DOUBLE, 300)):
        store(tmp_path, "boxing_final", agent, np.zeros(games))
    videos.show_side_by_side(study(tmp_path)["boxing_final"], "vid-side-by-side")
    assert recorded.contestants == {
        "DQN, 200": (DQN, 200),
        "Double DQN, 300": (DOUBLE, 300),
        "Dueling Double DQN, 400": (DUELING, 400),
    }
    assert recorded.seconds == (None, 30)
    assert numbers(recorded.captions["vid-side-by-side"]) == [30, 10, 11, 12]


def test_a_knock_out_is_given_by_the_best_agent_that_gives_one(tmp_path, recorded):
    everyone = ((DQN, [0, 1, 0, 0], 30.0), (DOUBLE, [-1, 0, 1, 1], 40.0), (DUELING, [0] * 4, 50.0))
    for agent, knocked, score in everyone:
        run = store(tmp_path, "boxing_final", agent, np.zeros(700))
        evaluate(run, games=4, trained=700, knockout=knocked, score=score)
    videos.show_knockout(study(tmp_path)["boxing_final"], "vid-knockout")
    assert recorded.played["network"] == (DOUBLE, 700)
    assert recorded.played["game"] == 2
    assert recorded.played["seconds"] == (-15, None)
    assert facts(recorded.captions["vid-knockout"]) == ["Double DQN", 700, 15, 2, -7, 100]


def test_heat_is_of_the_evaluated_run_that_scored_best_there(tmp_path, recorded, monkeypatch):
    for agent, score in ((DQN, 30.0), (DOUBLE, 40.0)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(700))
        evaluate(run, games=4, trained=700, score=score)
    store(tmp_path, "boxing_final", DUELING, np.full(700, 90.0))  # not evaluated yet
    monkeypatch.setattr(videos.heat, "light", lambda network, seen: (network, seen))
    videos.show_heat(study(tmp_path)["boxing_final"], "vid-heat", seconds=16)
    assert recorded.played["network"] == (DOUBLE, 700)
    assert (recorded.played["game"], recorded.played["seconds"]) == (0, (None, 16))
    assert recorded.played["layer"]("seen") == ((DOUBLE, 700), "seen"), "of the same network"
    assert recorded.layer == "heat"
    caption = recorded.captions["vid-heat"]
    assert facts(caption)[:4] == ["Double DQN", 700, 16, -7]
    assert "@fig-boxing-final-saliency" in caption


def test_without_an_evaluated_game_there_is_no_heat_and_its_place_is_held(
    tmp_path, recorded, shown
):
    store(tmp_path, "boxing_final", DQN, np.zeros(700))
    videos.show_heat(study(tmp_path)["boxing_final"], "vid-heat", seconds=16)
    assert recorded.played is None
    assert shown.texts == ["[]{#vid-heat .absent}"]
