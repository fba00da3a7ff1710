"""The tables that the report's sections share follow from the stored runs."""

import numpy as np
import pandas as pd
import pytest
from synthetic import store

from atari_dqn import exhibits, results
from atari_dqn.sections import Section


@pytest.fixture
def tables(monkeypatch):
    """{label: table} of what is shown; places that are only held are missing."""
    shown = {}

    def show(table, label, caption, decimals=2):
        shown[label] = table

    monkeypatch.setattr(results, "show_table", show)
    monkeypatch.setattr(results, "show_figure", lambda *_, **__: None)
    return shown


def test_missing_numbers_of_any_kind_are_dashes_and_numbers_stand_to_the_right(monkeypatch):
    said = []
    monkeypatch.setattr(exhibits, "show_text", said.append)
    table = pd.DataFrame({"agent": ["DQN", None], "score": [1.25, np.nan], "games": [3, pd.NA]})
    exhibits.show_table(table.astype({"games": "Int64"}), "tbl-any", "A caption.", decimals=1)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in said[0].splitlines()[:4]]
    assert rows[2:] == [["DQN", "1.2", "3"], ["–", "–", "–"]]
    assert [cell.endswith(":") for cell in rows[1]] == [False, True, True]


def test_transfer_is_measured_over_the_games_that_both_runs_have(tmp_path, tables):
    scratch = store(tmp_path, "boxing_final", "dqn", np.full(1200, 10.0))
    moved = store(tmp_path, "boxing_transfer", "dqn", np.full(900, 15.0))
    for run, score in ((scratch, 2.0), (moved, 12.0)):
        checks = pd.DataFrame({"episode": [100, 200, 900], "score": [score, score, 99.0]})
        checks.to_csv(run.folder / "values.csv", index=False)
    sections = [
        Section(name, "full", str(tmp_path)) for name in ("boxing_transfer", "boxing_final")
    ]
    results.show_transfer(*sections)
    (row,) = tables["tbl-transfer"].to_dict("records")
    assert row["games"] == 900
    assert row["early, greedy"] == 10.0, "of the first 500 games"
    assert row["area ratio"] == pytest.approx(5 / 110)
    assert row["at the end"] == pytest.approx(5.0)


def test_evaluations_under_other_conditions_are_columns_and_never_mixed(tmp_path, tables):
    run = store(tmp_path, "boxing_final", "dqn", np.full(3000, 50.0))
    rows = [
        {"game": game, "score": score + game, "difficulty": difficulty, "sticky_actions": sticky}
        for (difficulty, sticky), score in {(0, 0.0): 90, (1, 0.0): 60, (0, 0.25): 30}.items()
        for game in range(3)
    ]
    table = pd.DataFrame(rows).assign(
        epsilon=0.001, won=True, knockout=0, trained_games=3000, frames=7200, scored=60, conceded=9
    )
    table.to_csv(run.folder / "evaluations.csv", index=False)
    section = Section("boxing_final", "full", str(tmp_path))
    results.show_conditions(section)
    results.show_evaluations(section)
    shown = tables["tbl-boxing-final-conditions"].set_index(["difficulty", "sticky"])
    assert shown["mean score"].to_dict() == {(0, "0"): 91.0, (1, "0"): 61.0, (0, "0.25"): 31.0}
    (row,) = tables["tbl-boxing-final-evaluation"].to_dict("records")
    assert (row["games"], row["mean score"], row["training games"]) == (3, 91.0, 3000)
    earlier = table.assign(trained_games=500, score=-50.0)
    guessed = table[table.difficulty == 0].assign(epsilon=1.0, score=0.5, trained_games=500)
    pd.concat([earlier, table, guessed]).to_csv(run.folder / "evaluations.csv", index=False)
    results.show_evaluations(Section("boxing_final", "full", str(tmp_path)))
    shown = tables["tbl-boxing-final-evaluation"].set_index("agent")["mean score"]
    assert shown.to_dict() == {"DQN": 91.0, "random play": 0.5}, "of the newest model only"


def test_one_condition_alone_is_no_comparison(tmp_path, tables):
    run = store(tmp_path, "boxing_final", "dqn", np.full(600, 50.0))
    games = pd.DataFrame({"game": range(3), "score": 60.0, "length": 1700, "seed": 1})
    games = games.assign(won=True, knockout=0, frames=7200, scored=60, conceded=9)
    greedy = games.assign(difficulty=0, sticky_actions=0.0, epsilon=0.001, trained_games=600)
    guessed = greedy.assign(difficulty=3, epsilon=1.0)
    for table in (greedy, pd.concat([greedy, guessed])):
        table.to_csv(run.folder / "evaluations.csv", index=False)
        results.show_conditions(Section("boxing_final", "full", str(tmp_path)))
        assert not tables
