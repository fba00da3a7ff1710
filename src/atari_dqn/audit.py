"""Playing a run's games again from their records, and comparing them with the run's tables."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from atari_dqn import params, records
from atari_dqn.envs import GameRecord
from atari_dqn.evaluation import VALUE_GAMES
from atari_dqn.params import Parameters
from atari_dqn.records import EVALUATION, TRAINING, VALUES, RecordError

EVALUATION_KEY = ["trained_games", "difficulty", "sticky_actions", "epsilon", "seed", "game"]
Facts = dict[str, float]  # score in points, length in agent steps, frames


class Difference(Exception):
    """A stored run whose tables and records do not agree; the message says where first."""


def verify(folder: Path, games: int | None) -> Iterator[str]:
    """Plays games of a stored run again, and yields the name of each that agrees.

    `games` of training and evaluation, evenly spaced, or None for all, among them the greedy games
    behind values.csv, of which only the mean score is stored. Raises Difference at the first that
    is not as the tables say, RecordError or ParameterError if a file cannot be read.
    """
    parameters = stored_parameters(folder)
    played = records.read_file(folder)
    expected = _expected(folder)
    _compare_lists(expected, played)
    alone = [game for game in played if game[0]["kind"] != VALUES]
    chosen = alone
    if games is not None and games < len(alone):
        chosen = [
            alone[place] for place in np.linspace(0, len(alone) - 1, games).round().astype(int)
        ]
    for heading, record in chosen:
        facts = outcome(records.settings(parameters, heading), record)
        for name, stored in expected[_key(heading)].items():
            if facts[name] != stored:
                raise Difference(
                    f"{_name(heading)}: {name} is {facts[name]:g} when played again, "
                    f"{stored:g} in {_table(heading)}"
                )
        yield _name(heading)
    if games is None:
        yield from _verify_values(folder, parameters, played)


def stored_parameters(folder: Path) -> Parameters:
    """The parameters of a stored run."""
    path = folder / params.STORED
    return params.parse(params.read_values(path), str(path))


def outcome(parameters: Parameters, record: GameRecord) -> Facts:
    """What a recorded game comes to when it is played again."""
    *_, game = records.replay(parameters, record)  # one and the same, at its end
    return {"score": game.score, "length": game.length, "frames": game.frames}


def find(folder: Path, episode: int) -> GameRecord:
    """The record of a training game. Raises RecordError if there is none."""
    for heading, record in records.read_file(folder):
        if heading["kind"] == TRAINING and heading["episode"] == episode:
            return record
    raise RecordError(f"{folder / records.FILE} has no training game {episode}")


def _expected(folder: Path) -> dict[tuple, Facts]:
    """What the tables say of every game of training and evaluation."""
    episodes = _read(folder / "episodes.csv")
    episodes["frames"] = episodes.frames.diff().fillna(episodes.frames)  # of each game
    evaluations = _read(folder / "evaluations.csv")
    names = ["score", "length", "frames"]
    return {
        **{(TRAINING, row["episode"]): _facts(row, names) for row in _rows(episodes)},
        **{
            (EVALUATION, *(row[key] for key in EVALUATION_KEY)): _facts(row, names)
            for row in _rows(evaluations)
        },
    }


def _read(path: Path) -> pd.DataFrame:
    """A table; an empty one if there is no file."""
    return pd.read_csv(path) if path.exists() else pd.DataFrame(columns=["episode", "frames"])


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    return table.to_dict("records")


def _facts(row: dict[str, Any], names: list[str]) -> Facts:
    return {name: float(row[name]) for name in names}


def _key(heading: dict[str, Any]) -> tuple:
    if heading["kind"] == TRAINING:
        return (TRAINING, heading["episode"])
    return (EVALUATION, *(heading[key] for key in EVALUATION_KEY))


def _name(heading: dict[str, Any]) -> str:
    rest = ", ".join(f"{key} {value}" for key, value in heading.items() if key != "kind")
    return f"{heading['kind']} game ({rest})"


def _table(heading: dict[str, Any]) -> str:
    return "episodes.csv" if heading["kind"] == TRAINING else "evaluations.csv"


def _compare_lists(expected: dict[tuple, Facts], played: list) -> None:
    """Raises Difference unless every game is once in the tables and once on record."""
    recorded = Counter(_key(heading) for heading, _ in played if heading["kind"] != VALUES)
    for key, times in recorded.items():
        if times > 1:
            raise Difference(f"{key} is on record {times} times")
        if key not in expected:
            raise Difference(f"{key} is on record, but in no table")
    for key in expected:
        if key not in recorded:
            raise Difference(f"{key} is in a table, but not on record")


def _verify_values(folder: Path, parameters: Parameters, played: list) -> Iterator[str]:
    for row in _rows(_read(folder / "values.csv")):
        episode = int(row["episode"])
        games = [
            record
            for heading, record in played
            if heading["kind"] == VALUES and heading["episode"] == episode
        ]
        if len(games) != VALUE_GAMES:
            raise Difference(
                f"{len(games)} greedy games after game {episode} are on record, not {VALUE_GAMES}"
            )
        score = float(np.mean([outcome(parameters, game)["score"] for game in games]))
        if score != row["score"]:
            raise Difference(
                f"the greedy games after game {episode}: score is {score:g} when played again, "
                f"{row['score']:g} in values.csv"
            )
        yield f"{VALUE_GAMES} greedy games after game {episode}"
