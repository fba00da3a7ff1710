"""The tables of runs, read strictly: what is damaged is named by file and line, and none of it ever
passes for whole.

Every table is written by this project alone, so whatever else is found in one is damage: another
header (of an older version), a field too many or too few, a letter in a number, a row that is
missing, repeated or out of its place. Only the end of a table that training is adding to may be
half a line, which is left out.
"""

import io
import re
import time
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from atari_dqn import params
from atari_dqn.params import ParameterError, shown
from atari_dqn.runs import compression, weights
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import COMPLETE, MISSING, Run, stored_json

if TYPE_CHECKING:  # it takes half a second to import
    import pandas as pd

EPISODES, TIMING, VALUES = "episodes.csv", "timing.csv", "values.csv"
EVALUATIONS, ROBUSTNESS = "evaluations.csv", "robustness"
STYLES = {"boxing": "styles of Boxing", "breakout": "styles of Breakout"}  # by game
SPEEDS = ("slow", "medium", "fast")  # of Breakout's ball
THIRDS = ("left", "middle", "right")  # of its court
GROWING = (EPISODES, TIMING, VALUES)  # line by line, while a run trains; the others are replaced

# The kinds of fields; more digits than these are damage, and no number here is infinite
WHOLE = "-?[0-9]{1,15}"
NUMBER = rf"{WHOLE}(?:\.[0-9]+)?(?:e[+-]?[0-9]{{1,2}})?"
OR_NAN = rf"(?:{NUMBER}|nan)?"  # pandas writes nothing for nan
TRUTH = "(?:True|False)"
DIGEST = "[0-9a-f]+"
CONDITION = "(?:sequence|mirrored|field|scoreboard)"
SAID = {
    WHOLE: "a whole number",
    NUMBER: "a number",
    OR_NAN: "a number or nan",
    TRUTH: "True or False",
    DIGEST: "a hexadecimal number",
    CONDITION: "sequence, mirrored, field or scoreboard",
}
STYLE = {"episode": WHOLE, "game": WHOLE, "digest": DIGEST, "frames": WHOLE, "score": NUMBER}
COLUMNS: dict[str, dict[str, str]] = {
    EPISODES: {
        "episode": WHOLE,
        "agent_steps": WHOLE,
        "frames": WHOLE,
        "score": NUMBER,
        "length": WHOLE,
        "epsilon": NUMBER,
        "loss": OR_NAN,
        "mean_q": OR_NAN,
    },
    TIMING: {"episode": WHOLE, "seconds": NUMBER, "cpu_seconds": NUMBER},
    VALUES: {
        "episode": WHOLE,
        **dict.fromkeys(("held_out_q", "predicted", "realised", "score"), NUMBER),
    },
    EVALUATIONS: {
        "game": WHOLE,
        "score": NUMBER,
        "length": WHOLE,
        "frames": WHOLE,
        "won": TRUTH,
        "knockout": WHOLE,
        "difficulty": WHOLE,
        "sticky_actions": NUMBER,
        "epsilon": NUMBER,
        "seed": WHOLE,
        "scored": NUMBER,
        "conceded": NUMBER,
        "distance": OR_NAN,
        "trained_games": WHOLE,
    },
    STYLES["boxing"]: {
        **STYLE,
        "scored": NUMBER,
        "conceded": NUMBER,
        "punches": WHOLE,
        "reach": NUMBER,
        "distance": NUMBER,
        "blows": WHOLE,
        "doubles": WHOLE,
        "ropes": NUMBER,
        "rival_ropes": NUMBER,
    },
    STYLES["breakout"]: {
        **STYLE,
        **{f"returned_{speed}": WHOLE for speed in SPEEDS},
        **{f"lost_{speed}": WHOLE for speed in SPEEDS},
        **{f"lost_{third}": WHOLE for third in THIRDS},
        "tunnel": WHOLE,
        "above": NUMBER,
    },
    ROBUSTNESS: {
        "condition": CONDITION,
        "game": WHOLE,
        "score": NUMBER,
        "length": WHOLE,
        "trained_games": WHOLE,
    },
}
LINES = {name: re.compile(",".join(columns.values())) for name, columns in COLUMNS.items()}
# What evaluations are sorted by; under the same settings the games are 0, 1, 2, ...
SETTINGS = ("trained_games", "difficulty", "sticky_actions", "epsilon", "seed")
# What tells apart the rows of the tables that are in no particular order
APART = {**dict.fromkeys(STYLES.values(), ("episode", "game")), ROBUSTNESS: ("condition", "game")}


# ---- One table ----------------------------------------------------------------------------------


def read(folder: Path, name: str) -> "pd.DataFrame":
    """A table of a stored run's folder; of one that is not there, no rows.

    Raises RunError, in one line that says which line of the table is wrong and what it should be.
    """
    torn = name in GROWING and not _complete(folder)  # asked first: it may be complete by then
    return read_file(folder / name, name, torn)


def read_file(path: Path, name: str, torn: bool = False) -> "pd.DataFrame":
    """The table `name` that is in a file; with `torn`, its end may be half a line."""
    import pandas as pd

    if not path.exists():
        return pd.DataFrame()
    at = path.stat()
    return _read_file(path, name, torn, (at.st_ino, at.st_mtime_ns, at.st_size)).copy()


@lru_cache(maxsize=256)  # since a table is read to be checked, and again to be used
def _read_file(path: Path, name: str, torn: bool, version: tuple[int, ...]) -> "pd.DataFrame":
    import pandas as pd

    *lines, rest = path.read_bytes().decode("utf-8", "backslashreplace").split("\n")
    header = ",".join(COLUMNS[name])
    if not lines or lines[0] != header:
        found = shown((lines or [rest])[0])
        raise RunError(f"{path}, line 1: {found} should be the header {header}, and a new line")
    for number, line in enumerate(lines[1:], 2):
        if not LINES[name].fullmatch(line):
            raise RunError(f"{path}, line {number}: {_fault(line, COLUMNS[name])}")
    if rest and not torn:
        number = len(lines) + 1
        raise RunError(f"{path}, line {number}: {shown(rest)} is cut short, without a new line")
    table = pd.read_csv(io.StringIO("\n".join([*lines, ""])), dtype={"digest": str})
    if (fault := _disorder(table, name)) is not None:
        row, said = fault
        raise RunError(f"{path}, line {row + 2}: {said}")
    return table


def _fault(line: str, columns: dict[str, str]) -> str:
    """What is wrong with a line that is none of its table's."""
    fields = line.split(",")
    if len(fields) != len(columns):
        return f"{len(fields)} fields should be {len(columns)}: {','.join(columns)}"
    return next(
        f"{name}: {shown(field)} should be {SAID[kind]}"
        for field, (name, kind) in zip(fields, columns.items(), strict=True)
        if not re.fullmatch(kind, field)
    )


def _disorder(table: "pd.DataFrame", name: str) -> tuple[int, str] | None:
    """The first row that is not in its place, counted from 0, and why."""
    if name in APART:
        again = table.duplicated([*APART[name]])
        said = f"{' and '.join(APART[name])} are those of another row"
        return (int(again.to_numpy().argmax()), said) if again.any() else None
    if name == EVALUATIONS:
        return _disordered_evaluation(table)
    step = params.VALUES_PERIOD if name == VALUES else 1
    for row, episode in enumerate(table.episode):
        if episode != step * (row + 1):
            return row, f"episode {episode} should be {step * (row + 1)}"
    return None


def _disordered_evaluation(table: "pd.DataFrame") -> tuple[int, str] | None:
    if table.empty:
        return 0, "missing, since the file is made with the first games"
    keys = [(), *_settings(table)]
    games = [-1, *table.game]
    for row, (before, now) in enumerate(pairwise(keys)):
        if now < before:
            return row, f"should be above: rows are sorted by {', '.join(SETTINGS)} and game"
        game = games[row] + 1 if now == before else 0
        if games[row + 1] != game:
            return row, f"game {games[row + 1]} should be {game}"
    return None


def _settings(evaluations: "pd.DataFrame") -> list[tuple[float, ...]]:
    """What each evaluation game was played with."""
    return list(zip(*(evaluations[name] for name in SETTINGS), strict=True))


# ---- All of a run -------------------------------------------------------------------------------


def of_runs(runs: list[Run], name: str) -> "pd.DataFrame":
    """One table of all runs' `name`, with experiment, variation, agent and seed. Raises RunError as
    `read`."""
    import pandas as pd

    tables = [
        read(run.folder, name).assign(
            experiment=run.params.experiment,
            variation=run.variation,
            agent=run.agent,
            seed=run.seed,
        )
        for run in runs
        if (run.folder / name).exists()
    ]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def damage(run: Run) -> str:
    """What keeps a stored run from being read, in one line; nothing if it can be."""
    try:
        if run.state() != MISSING and (run.folder / "status.json").exists():  # or it just begins
            check(run.folder)
            compression.check(run.folder, torn=not _complete(run.folder))
            for path in weights.files(run.folder):
                _check_weights(path, path.stat().st_mtime_ns)
            _check_beside(run.robustness, ROBUSTNESS)
            if run.params.game in STYLES:
                _check_beside(run.styles, STYLES[run.params.game])
    except (RunError, ParameterError) as error:
        return str(error)
    except OSError as error:
        return f"{error.filename}: {error.strerror}"
    return ""


@cache
def _check_weights(path: Path, changed: int) -> None:
    weights.read(path)


def _check_beside(path: Path, name: str) -> None:
    try:
        read_file(path, name)
    except RunError as error:
        raise RunError(f"{error}; without the file, `report` measures it again") from None


def check(folder: Path) -> None:
    """Raises RunError if a table of a stored run's folder is damaged or lacks rows: of a complete
    run any, of another those that the other tables prove."""
    try:
        _check(folder)
    except RunError:
        if _complete(folder):
            raise
        time.sleep(0.1)  # training may have written between two of the tables
        _check(folder)


def _check(folder: Path) -> None:
    status = stored_json(folder, "status.json")
    complete, done = status["state"] == COMPLETE, status["episodes_done"]
    # In the opposite order of writing: what the former tables tell of, the last one must have
    order = (EVALUATIONS, VALUES, TIMING, EPISODES)
    evaluations, values, timing, episodes = (read(folder, name) for name in order)
    games, period = len(episodes), params.VALUES_PERIOD
    if complete:
        _count(folder / EPISODES, games, done, done, f"status.json says {done} games")
        _check_evaluations(folder, evaluations, games)
    else:
        told = {TIMING: len(timing), VALUES: period * len(values)}
        for name, least in told.items():
            _count(folder / EPISODES, games, least, games, f"{name} tells of game {least}")
    late = 0 if complete else 1  # a row that is about to be written
    for name, table, most in ((TIMING, timing, games), (VALUES, values, games // period)):
        if (folder / name).exists():
            said = f"{EPISODES} has {games} games"
            _count(folder / name, len(table), most - late, most, said)


def _count(path: Path, rows: int, least: int, most: int, why: str) -> None:
    if rows < least:
        raise RunError(f"{path}, line {rows + 2}: missing, since {why}")
    if rows > most:
        raise RunError(f"{path}, line {most + 2}: one too many, since {why}")


def _check_evaluations(folder: Path, evaluations: "pd.DataFrame", games: int) -> None:
    """Raises RunError unless all games that end a run are in the table, if there is one."""
    if not (folder / EVALUATIONS).exists():
        return
    keys = _settings(evaluations)
    for setting in params.conditions(params.stored_parameters(folder)):
        stickiness, epsilon = setting.sticky_actions, setting.evaluation_epsilon
        key = (games, setting.difficulty, stickiness, epsilon, setting.seeds[0])
        if keys.count(key) < setting.evaluation_games:
            line = 2 + sum(each <= key for each in keys)
            names = ", ".join(f"{name} {each:g}" for name, each in zip(SETTINGS, key, strict=True))
            raise RunError(
                f"{folder / EVALUATIONS}, line {line}: missing, since {setting.evaluation_games} "
                f"games end a run, and {keys.count(key)} are here with {names}"
            )


def _complete(folder: Path) -> bool:
    path = folder / "status.json"
    return path.exists() and stored_json(folder, path.name)["state"] == COMPLETE
