"""What the report says of the records as data."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import zstandard
from synthetic import AGENTS, FRAMES, check, lines_of, numbers, store, study

from atari_dqn.analysis.study import Section
from atari_dqn.report import offline
from atari_dqn.runs import compression

DQN, DOUBLE, DUELING = AGENTS
ROOT = Path(__file__).parents[1]


def test_the_size_is_that_of_all_runs_records_and_games(tmp_path, shown):
    offline.show_size(study(tmp_path))
    assert not shown.texts
    rng = np.random.default_rng(0)
    for agent, games, size in ((DQN, 3000, 1_000_000), (DOUBLE, 500, 500_000)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(games))
        (run.folder / compression.FILE).write_bytes(compression.encode(rng.bytes(size)))
    offline.show_size(study(tmp_path))
    played = 3500 * FRAMES
    hours = round(played / 60 / 3600)
    bits = round(8 * 1_500_000 / (played / 4), 1)
    expected = [2, 3500, played / 1e6, hours, 60, 1.5, bits]
    assert numbers(shown.texts[-1]) == pytest.approx(expected)


def test_the_speed_is_in_games_and_in_agent_steps(tmp_path, shown, monkeypatch):
    monkeypatch.setattr(offline, "FOLDER", str(tmp_path))
    offline.show_speed()
    assert not shown.texts
    measured = {"with_images": 2.0, "emulator_alone": 4.0, "agent_steps_per_game": 500.0}
    (tmp_path / "records.json").write_text(json.dumps({**measured, "processor": "X"}))
    offline.show_speed()
    assert numbers(shown.texts[-1]) == [2, 1000, 4, 2000], "games, and agent steps"


def test_the_curve_of_watching_is_the_mean_of_the_games_after_every_update(
    tmp_path, shown, monkeypatch
):
    monkeypatch.setattr(offline, "FOLDER", str(tmp_path))
    scores = np.arange(3000.0)
    epsilon = np.r_[np.full(12, 1.0), np.full(20, 0.56), np.full(2968, 0.1)]
    run = store(tmp_path, "boxing_final", DOUBLE, scores, epsilon=epsilon)
    store(tmp_path, "boxing_final", DQN, scores + 5000)  # another run
    section = Section("boxing_final", "full", str(tmp_path), [DQN, DOUBLE])
    offline.show_watching(section)
    assert "fig-watching" not in shown.figures
    measured = {"experiment": "boxing_final", "agent": DOUBLE, "seed": 1}
    measured["transitions"] = 200_000
    (tmp_path / "records.json").write_text(json.dumps(measured))
    # of the last check's games two have one opening: one piece of evidence, with twice the weight
    games = [(0, 1, -30.0), (0, 2, -10.0), (15000, 1, 2.0), (15000, 2, 3.0), (15000, 2, 7.0)]
    table = pd.DataFrame(games, columns=["update", "opening", "score"])
    table.to_csv(tmp_path / "watching.csv", index=False)
    offline.show_watching(section)
    (axes,) = shown.figures["fig-watching"].axes
    assert ([0, 15], [-20, 4]) in lines_of(axes)
    assert axes.get_xlabel() == "thousand updates"
    assert numbers(shown.captions["fig-watching"])[:2] == [200_000, 2]
    # means 2 and 5 of one and two games lie (2 - 4) * 1 / 1.5 and (5 - 4) * 2 / 1.5 from 4
    half = 12.706 * np.std([-4 / 3, 4 / 3], ddof=1) / np.sqrt(2)  # Student's t, 1 degree of freedom
    # 15,000 updates end with 20,000 + 4 * 15,000 steps, 32 games; 200,000 steps are 80
    own, watched = np.mean(scores[12:32]), np.mean(scores[-80:])
    told = [15000, 4.0, 95, round(4 - half, 1), round(4 + half, 1), own, 20, 15000, 56, watched]
    assert numbers(shown.texts[-1]) == pytest.approx(told)
    check(run, np.arange(30.0))
    more = table.assign(update=table["update"] * 20)  # 20,000 + 4 * 300,000 steps, 488 games
    more.to_csv(tmp_path / "watching.csv", index=False)
    offline.show_watching(Section("boxing_final", "full", str(tmp_path), [DQN, DOUBLE]))
    assert "after game 400 it scored 3.0" in shown.texts[-1], "its latest check by then"


def test_the_reader_of_ten_lines_plays_a_game_of_any_difficulty_again():
    folder = ROOT / "results/runs/boxing_expert/dqn/seed-1"
    table = pd.read_csv(folder / "episodes.csv")
    with zstandard.open(folder / "games.jsonl.zst", "rt") as lines:
        games = [json.loads(next(lines)) for _ in range(3)]
    scores = [offline.play_again(game, difficulty=3) for game in games]
    assert scores == table.score[:3].tolist()
    assert [offline.play_again(game) for game in games] != scores
