"""Playing a run's games again from their records, and comparing them with the run's tables."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from atari_dqn import params
from atari_dqn.envs import EpisodeRecord, learned_reward
from atari_dqn.params import Parameters, stored_parameters
from atari_dqn.runs import compression, records, tables
from atari_dqn.runs.files import RunError, evaluations_lock
from atari_dqn.runs.records import EVALUATION, KEYS, TRAINING, VALUES, Game, Heading, RecordError
from atari_dqn.runs.run import COMPLETE, stored_json

Facts = dict[str, float]  # what is known of a game, by the names of the tables' columns
TABLES = {TRAINING: tables.EPISODES, VALUES: tables.VALUES, EVALUATION: tables.EVALUATIONS}
ROWS = {**KEYS, VALUES: ("episode",)}  # the columns that tell a table's rows apart
LENGTHS = ("score", "length", "frames")
# The columns that a game played again has its own numbers for
COMPARED = {
    TRAINING: LENGTHS,
    VALUES: ("score", "realised"),
    EVALUATION: (*LENGTHS, "won", "knockout", "scored", "conceded", "distance"),
}


class Difference(RunError):
    """A stored run whose tables and records do not agree; the message says where first."""


@dataclass(frozen=True)
class Stored:
    """What a run's folder says of its games."""

    folder: Path
    params: Parameters
    provenance: dict[str, Any]
    complete: bool
    tables: dict[str, list[Facts]]  # by the kinds of games
    games: list[Game]


def verify(folder: Path, games: int | None) -> Iterator[str]:
    """Plays games of a stored run again, and yields the name of each that agrees.

    `games` of training and evaluation, evenly spaced, or None for all, among them the greedy games
    behind values.csv. That tables, records and models are whole, and that the first two list the
    same games, is always checked. Of a run that is not complete, the last games may be in no table
    yet. Raises Difference at the first that is not as the tables say, RunError or ParameterError if
    a file cannot be read.
    """
    stored = _stored(folder)
    _compare_lists(stored)
    rows = {(kind, *_key(kind, row)): row for kind in TABLES for row in stored.tables[kind]}
    chosen = [game for game in stored.games if (_place(game) in rows and game[0]["kind"] != VALUES)]
    if games is not None and games < len(chosen):
        chosen = [chosen[at] for at in np.linspace(0, len(chosen) - 1, games).round().astype(int)]
    for heading, record in chosen:
        try:
            facts = outcome(records.settings(stored.params, heading), record)
        except RecordError as error:
            path = folder / records.FILE
            raise RecordError(f"{path}: {_name(heading)}: {error}") from None
        _compare(stored, _name(heading), heading["kind"], facts, rows[_place((heading, record))])
        yield _name(heading)
    for row in stored.tables[VALUES] if games is None else []:
        behind = [
            record
            for heading, record in stored.games
            if heading["kind"] == VALUES and heading["episode"] == row["episode"]
        ]
        facts = _values(stored.params, behind)
        name = f"the {len(behind)} greedy games after game {row['episode']:g}"
        _compare(stored, name, VALUES, facts, row)
        yield name


def choice(folder: Path) -> int:
    """How many games `verify` chooses from: those of training and evaluation that are in tables.
    Raises RunError if these are damaged."""
    return len(tables.read(folder, tables.EPISODES)) + len(tables.read(folder, tables.EVALUATIONS))


def outcome(parameters: Parameters, record: EpisodeRecord) -> Facts:
    """What a recorded game comes to when it is played again."""
    distances: list[float] = []
    for game in records.replay(parameters, record):
        if game.length:
            distances.append(game.distance())
    scored, conceded = game.points()
    return {
        "score": game.score,
        "length": game.length,
        "frames": game.frames,
        "won": game.score >= game.facts.wins_at,
        "knockout": game.knockout(),
        "scored": scored,
        "conceded": conceded,
        "distance": float(np.mean(distances)) if distances else float("nan"),
    }


def find(folder: Path, episode: int) -> EpisodeRecord:
    """The record of a training game. Raises RecordError if there is none."""
    games = [game for game in records.read_file(folder) if game[0]["kind"] == TRAINING]
    for heading, record in games:
        if heading["episode"] == episode:
            return record
    there = [heading["episode"] for heading, _ in games]
    which = f"it has {min(there)} to {max(there)}" if there else "it has none"
    raise RecordError(f"{folder / records.FILE} has no training game {episode}; {which}")


def _values(parameters: Parameters, behind: list[EpisodeRecord]) -> Facts:
    """What the greedy games behind a row of values.csv come to."""
    from atari_dqn import evaluation  # which imports torch

    scores, returns = [], []
    for record in behind:
        rewards: list[float] = []
        score, lives = 0.0, 0
        for game in records.replay(parameters, record):
            if game.length:
                raw, life_lost = game.score - score, game.lives < lives
                rewards.append(learned_reward(parameters, raw, life_lost))
            score, lives = game.score, game.lives
        scores.append(score)
        returns.append(evaluation.discounted(rewards, parameters.gamma))
    return {
        "score": float(np.mean(scores)),
        "realised": float(np.concatenate(returns).mean()),
    }


# ---- Reading ------------------------------------------------------------------------------------


def _stored(folder: Path) -> Stored:
    parameters = stored_parameters(folder)  # first: it says where there is no run
    with evaluations_lock(folder):  # and the tables first: no row is written before its record
        provenance = stored_json(folder, "provenance.json")
        complete = stored_json(folder, "status.json")["state"] == COMPLETE
        tables.check_parameters(folder)
        tables.check(folder)
        tables.check_models(folder)
        if not complete:  # else `read_file` says so
            compression.check(folder, torn=True)
        found = {kind: _table(folder, kind) for kind in TABLES}
        games = records.read_file(folder, torn=not complete)
    total = 0.0
    for row in found[TRAINING]:  # whose frames are those of all games so far
        total, row["frames"] = row["frames"], row["frames"] - total
    return Stored(folder, parameters, provenance, complete, found, games)


def _table(folder: Path, kind: str) -> list[Facts]:
    """The rows of a table, as far as verifying needs them."""
    table = tables.read(folder, TABLES[kind])
    if table.empty:
        return []
    return table[[*ROWS[kind], *COMPARED[kind]]].astype(float).to_dict("records")


# ---- Comparing ----------------------------------------------------------------------------------


def _key(kind: str, row: Heading | Facts) -> tuple:
    """What tells a row of a table from the others."""
    return tuple(row[name] for name in ROWS[kind])


def _place(game: Game) -> tuple:
    heading, _ = game
    return (heading["kind"], *_key(heading["kind"], heading))


def _name(heading: Heading) -> str:
    rest = ", ".join(f"{key} {value:g}" for key, value in heading.items() if key != "kind")
    return f"{heading['kind']} game ({rest})"


def _compare(stored: Stored, name: str, kind: str, facts: Facts, row: Facts) -> None:
    for column in COMPARED[kind]:
        if not np.array_equal(facts[column], row[column], equal_nan=True):
            raise Difference(
                f"{name}: {column} is {facts[column]:g} when played again, {row[column]:g} in "
                f"{stored.folder / TABLES[kind]}{_other_emulator(stored)}"
            )


def _other_emulator(stored: Stored) -> str:
    here = version("ale-py")
    there = {stretch["versions"]["ale-py"] for stretch in stored.provenance["sessions"]}
    return "" if there == {here} else f" (played with ale-py {', '.join(there)}, here is {here})"


def _compare_lists(stored: Stored) -> None:
    """Raises Difference unless just the games of the tables are on record."""
    recorded = Counter(tuple(heading.items()) for heading, _ in stored.games)
    path = stored.folder / records.FILE
    for heading, times in recorded.items():
        if times > 1:
            raise Difference(f"{path} has {times} times the {_name(dict(heading))}")
    if not stored.games:
        raise Difference(f"{path} has no game")
    there = Counter(_place(game) for game in stored.games)
    for kind, table in TABLES.items():
        rows = {(kind, *_key(kind, row)) for row in stored.tables[kind]}
        each = params.VALUE_GAMES if kind == VALUES else 1
        for place in rows:
            if there[place] != each:
                raise Difference(
                    f"{path} has {there[place]} games, not {each}, of "
                    f"{_named(kind, place[1:])} in {table}"
                )
        beyond = [place for place in there if place[0] == kind and place not in rows]
        last = max((place[1] for place in rows), default=0)
        for place in beyond:
            if kind == EVALUATION:
                remedy = "; `evaluate` with the same settings writes both again"
            elif not stored.complete and place[1] > last:
                continue  # a game whose row was about to be written
            else:
                remedy = ""
            raise Difference(
                f"{_named(kind, place[1:])} is on record, but not in {stored.folder / table}"
                f"{remedy}"
            )


def _named(kind: str, key: tuple) -> str:
    return _name({"kind": kind, **dict(zip(ROWS[kind], key, strict=True))})
