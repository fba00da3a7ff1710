"""What the report says of the records as data."""

import json

import numpy as np
import pandas as pd
import pytest
from synthetic import AGENTS, FRAMES, lines_of, numbers, store, study

from atari_dqn.analysis.study import Section
from atari_dqn.report import offline
from atari_dqn.runs import frames

DQN, DOUBLE, DUELING = AGENTS


def test_the_size_is_that_of_all_runs_records_and_games(tmp_path, shown):
    offline.show_size(study(tmp_path))
    assert not shown.texts
    rng = np.random.default_rng(0)
    for agent, games, size in ((DQN, 3000, 1_000_000), (DOUBLE, 500, 500_000)):
        run = store(tmp_path, "boxing_final", agent, np.zeros(games))
        (run.folder / frames.FILE).write_bytes(frames.encode(rng.bytes(size)))
    offline.show_size(study(tmp_path))
    played = 3500 * FRAMES
    hours = round(played / 60 / 3600)
    bits = round(8 * 1_500_000 / (played / 4), 1)
    expected = [2, 3500, played / 1e6, hours, 60, 1.5, bits]
    assert numbers(shown.texts[-1]) == pytest.approx(expected)


def test_the_speed_is_in_agent_steps_with_images_and_without(tmp_path, shown, monkeypatch):
    monkeypatch.setattr(offline, "FOLDER", str(tmp_path))
    offline.show_speed()
    assert not shown.texts
    measured = {"with_images": 2.0, "emulator_alone": 4.0, "agent_steps_per_game": 500.0}
    (tmp_path / "records.json").write_text(json.dumps({**measured, "processor": "X"}))
    offline.show_speed()
    assert numbers(shown.texts[-1]) == [1000, 2000]


def test_the_curve_of_watching_is_the_mean_of_the_games_after_every_update(
    tmp_path, shown, monkeypatch
):
    monkeypatch.setattr(offline, "FOLDER", str(tmp_path))
    store(tmp_path, "boxing_final", DOUBLE, np.r_[np.zeros(2900), np.full(100, 80.0)])
    section = Section("boxing_final", "full", str(tmp_path), [DOUBLE])
    offline.show_watching(section)
    assert "fig-watching" not in shown.figures
    measured = {"experiment": "boxing_final", "agent": DOUBLE, "transitions": 200_000}
    (tmp_path / "records.json").write_text(json.dumps(measured))
    games = [(0, -30.0), (0, -10.0), (5000, 2.0), (5000, 4.0)]
    table = pd.DataFrame(games, columns=["update", "score"])
    table.to_csv(tmp_path / "watching.csv", index=False)
    offline.show_watching(section)
    (axes,) = shown.figures["fig-watching"].axes
    assert ([0, 5], [-20, 3]) in lines_of(axes)
    assert numbers(shown.captions["fig-watching"])[:2] == [200_000, 2]
    half = 12.706 * np.sqrt(2) / np.sqrt(2)  # Student's t of one degree of freedom
    told = [5000, 3.0, 95, round(3 - half, 1), round(3 + half, 1), 200_000, 80.0]
    assert numbers(shown.texts[-1]) == pytest.approx(told)
