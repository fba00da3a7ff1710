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
from atari_dqn.games import GAMES
from atari_dqn.params import ParameterError, shown
from atari_dqn.runs import compression, weights
from atari_dqn.runs.files import RunError, read_bytes
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
COUNT = "[0-9]{1,15}"
SOME = "[1-9][0-9]{0,14}"
NUMBER = rf"{WHOLE}(?:\.[0-9]+)?(?:e-[0-9]{{1,2}})?"  # nothing that is measured is as large as e+
LEARNED = rf"{WHOLE}(?:\.[0-9]+)?(?:e[+-][0-9]{{1,2}})?"  # but what a network says, if it diverges
OR_NAN = rf"(?:{LEARNED}|nan)?"  # pandas writes nothing for nan
SHARE = r"(?:0(?:\.[0-9]+)?|1(?:\.0+)?|[0-9](?:\.[0-9]+)?e-[0-9]{2})"
TRUTH = "(?:True|False)"
DIGEST = "[0-9a-f]+"
CONDITION = "(?:sequence|mirrored|field|scoreboard|bar_moved|bar_gone)"
SAID = {
    WHOLE: "a whole number",
    COUNT: "a whole number from 0 on",
    SOME: "a whole number from 1 on",
    NUMBER: "a number",
    LEARNED: "a number",
    OR_NAN: "a number or nan",
    SHARE: "a number from 0 to 1",
    TRUTH: "True or False",
    DIGEST: "a hexadecimal number",
    CONDITION: "sequence, mirrored, field, scoreboard, bar_moved or bar_gone",
}
STYLE = {"episode": SOME, "game": COUNT, "digest": DIGEST, "frames": SOME, "score": NUMBER}
COLUMNS: dict[str, dict[str, str]] = {
    EPISODES: {
        "episode": SOME,
        "agent_steps": SOME,
        "frames": SOME,
        "score": NUMBER,
        "length": SOME,
        "epsilon": SHARE,
        "loss": OR_NAN,
        "mean_q": OR_NAN,
    },
    TIMING: {"episode": SOME, "seconds": NUMBER, "cpu_seconds": NUMBER},
    VALUES: {
        "episode": SOME,
        **dict.fromkeys(("held_out_q", "predicted"), LEARNED),
        **dict.fromkeys(("realised", "score"), NUMBER),
    },
    EVALUATIONS: {
        "game": COUNT,
        "score": NUMBER,
        "length": SOME,
        "frames": SOME,
        "won": TRUTH,
        "knockout": WHOLE,
        "difficulty": COUNT,
        "sticky_actions": SHARE,
        "epsilon": SHARE,
        "seed": COUNT,
        "scored": NUMBER,
        "conceded": NUMBER,
        "distance": OR_NAN,
        "trained_games": COUNT,
    },
    STYLES["boxing"]: {
        **STYLE,
        "scored": NUMBER,
        "conceded": NUMBER,
        "punches": COUNT,
        "reach": SHARE,
        "distance": NUMBER,
        "blows": COUNT,
        "doubles": COUNT,
        "ropes": SHARE,
        "rival_ropes": SHARE,
    },
    STYLES["breakout"]: {
        **STYLE,
        **{f"returned_{speed}": COUNT for speed in SPEEDS},
        **{f"lost_{speed}": COUNT for speed in SPEEDS},
        **{f"lost_{third}": COUNT for third in THIRDS},
        "tunnel": COUNT,
        "above": NUMBER,
    },
    ROBUSTNESS: {
        "condition": CONDITION,
        "game": COUNT,
        "score": NUMBER,
        "length": SOME,
        "trained_games": COUNT,
    },
}
LINES = {name: re.compile(",".join(columns.values())) for name, columns in COLUMNS.items()}
ADDED_UP = {"agent_steps", "frames", "seconds", "cpu_seconds"}  # over all games so far
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

    *lines, rest = read_bytes(path).decode("utf-8", "backslashreplace").split("\n")
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
    for column in ADDED_UP & {*table}:
        least = table.length if column == "frames" else 0  # a step lasts a frame or more
        behind = (table[column].diff().fillna(table[column]) < least).to_numpy()
        if behind.any():
            row = int(behind.argmax())
            return row, f"{column} {table[column][row]} is too few after the row above"
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


def trials(run: Run) -> "pd.DataFrame":
    """What stands in a run's file of robustness of those conditions that have all their games; one
    that lacks some is as if it had never been played. Raises RunError as `read`."""
    table, facts = read_file(run.robustness, ROBUSTNESS), GAMES[run.params.game]
    if table.empty:
        return table
    openings = {facts.opening(idle) for idle in range(1, run.params.noop_max + 1)}
    blind = len(openings) - 1  # all but that of the game whose moves are made
    wanted = table.condition.eq("sequence").map({True: blind, False: run.params.evaluation_games})
    there = table.groupby(["trained_games", "condition"]).game.transform("size")
    return table[there >= wanted]


def style(run: Run) -> "pd.DataFrame":
    """What stands in a run's file of styles of those checks that have all their games, likewise."""
    table = read_file(run.styles, STYLES[run.params.game])
    if table.empty:
        return table
    return table[table.groupby("episode").game.transform("size") >= params.VALUE_GAMES]


def damage(run: Run) -> str:
    """What keeps a stored run from being read, in one line; nothing if it can be."""
    try:
        if run.state() != MISSING and (run.folder / "status.json").exists():  # or it just begins
            _check_whose(run)
            check(run.folder)
            _check_records(run.folder)
            check_models(run.folder)
            _check_beside(run.robustness, ROBUSTNESS)
            if run.params.game in STYLES:
                _check_beside(run.styles, STYLES[run.params.game])
    except (RunError, ParameterError) as error:
        return str(error)
    except OSError as error:
        return f"{error.filename}: {error.strerror}"
    return ""


def _check_whose(run: Run) -> None:
    stored = check_parameters(run.folder)
    for name, own in (("agents", run.agent), ("seeds", run.seed)):
        if (said := getattr(stored, name)) != [own]:
            path = run.folder / params.STORED
            raise RunError(f"{path}: {name}: {shown(said)} should be {[own]!r}, as its folder says")


def check_parameters(folder: Path) -> params.Parameters:
    """What a stored run was trained with. Raises RunError unless it is what its provenance says,
    ParameterError if it cannot be read."""
    stored = params.stored_parameters(folder)
    if stored_json(folder, "provenance.json")["identity"] != stored.identity():
        path = folder / params.STORED
        raise RunError(f"{path} is not what provenance.json says of the run")
    return stored


def _check_records(folder: Path) -> None:
    """Raises RunError if the records are damaged, or fewer than the games that the tables, which
    are written after them, tell of."""
    checks = params.VALUE_GAMES * len(read(folder, VALUES))
    told = len(read(folder, EPISODES)) + checks + len(read(folder, EVALUATIONS))
    games = compression.check(folder, torn=not _complete(folder))
    if games < told:
        path = folder / compression.FILE
        said = f"holds {games:,} games" if path.exists() else "is missing"
        raise RunError(f"{path} {said}, and the tables tell of {told:,}")


def check_models(folder: Path) -> None:
    """Raises RunError if a stored model is damaged, or if a complete run has not that of its last
    game."""
    for path in weights.files(folder):
        _check_weights(path, path.stat().st_mtime_ns)
    status, path = stored_json(folder, "status.json"), folder / "model.safetensors"
    if status["state"] != COMPLETE:
        return
    if not path.exists():
        raise RunError(f"{path} is missing, and a complete run has one")
    if (games := weights.games_of(path)) != (done := status["episodes_done"]):
        raise RunError(f"{path} is of {games:,} games, and status.json says {done:,}")


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
    for name in (EPISODES, TIMING):
        if not (folder / name).exists():
            raise RunError(f"{folder / name} is missing, and every run has one")
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
        if complete or (folder / name).exists():
            said = f"{EPISODES} has {games} games"
            _count(folder / name, len(table), most - late, most, said)


def _count(path: Path, rows: int, least: int, most: int, why: str) -> None:
    if rows < least:
        where = f"{path}, line {rows + 2}: missing" if path.exists() else f"{path} is missing"
        raise RunError(f"{where}, since {why}")
    if rows > most:
        raise RunError(f"{path}, line {most + 2}: one too many, since {why}")


def _check_evaluations(folder: Path, evaluations: "pd.DataFrame", games: int) -> None:
    """Raises RunError unless all games that end a run are in the table."""
    if not (folder / EVALUATIONS).exists():
        raise RunError(f"{folder / EVALUATIONS} is missing, and a complete run has one")
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
