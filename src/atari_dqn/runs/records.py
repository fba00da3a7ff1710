"""Every game of a run on record: `games.jsonl.zst`, from which any of them can be played again.

The file is a row of zstandard frames, each with a checksum of its own; together they hold a line of
JSON a game (`zstd -dc games.jsonl.zst` shows them). While a run trains, every game adds a frame;
in the end there is one for every hundred games, which is smaller.

    {"kind": "training", "episode": 12, "idle_frames": 7, "actions": "AKKC..."}
    {"kind": "values", "episode": 100, "game": 3, ...}
    {"kind": "evaluation", "trained_games": 3000, "difficulty": 3, "sticky_actions": 0.0,
     "epsilon": 0.001, "seed": 1, "game": 5, ...}

"values" are the greedy games behind a row of values.csv, "evaluation" those of evaluations.csv.
`actions` has a letter an agent step, A for the cartridge's first action; where actions are sticky,
`rng` is the state of numpy's PCG64 that decides when: [state, inc, has_uint32, uinteger], the first
two as hexadecimal text.
"""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from atari_dqn.envs import AtariEnv, EpisodeRecord, make_env
from atari_dqn.params import MOST, Parameters, printable, shown
from atari_dqn.runs import compression
from atari_dqn.runs.files import RunError, read_bytes

FILE = compression.FILE
TRAINING, VALUES, EVALUATION = "training", "values", "evaluation"
FRAME = 100  # games, once a run is complete

# Tables for str.translate, which is a hundred times as fast as a loop. What comes before A is no
# action: it becomes what no byte can hold, as which all that comes far after it stays.
LETTERS = {action: chr(ord("A") + action) for action in range(256)}
ACTIONS = dict.fromkeys(range(ord("A")), "\uffff") | {
    ord(letter): chr(action) for action, letter in LETTERS.items()
}


Heading = dict[str, Any]  # kind, episode, ...: what tells a game from all others of its run
Game = tuple[Heading, EpisodeRecord]


class RecordError(RunError):
    """A file of records that cannot be read; the message names it."""


def encode(games: list[Game]) -> bytes:
    """Games as they stand in the file, in one frame."""
    return compression.encode(b"".join(_line(*game) for game in games))


def _line(heading: Heading, record: EpisodeRecord) -> bytes:
    values = {**heading, "idle_frames": record.idle_frames}
    if record.rng is not None:
        values["rng"] = _flat(record.rng)
    values["actions"] = record.actions.decode("latin-1").translate(LETTERS)
    return json.dumps(values).encode() + b"\n"


def _flat(rng: dict[str, Any]) -> list[str | int]:
    state, inc = (hex(rng["state"][key]) for key in ("state", "inc"))
    return [state, inc, rng["has_uint32"], rng["uinteger"]]


def _game_record(values: dict[str, Any]) -> EpisodeRecord:
    rng = None
    if "rng" in values:
        state, inc, has_uint32, uinteger = values["rng"]
        rng = {
            "bit_generator": "PCG64",
            "state": {
                "state": _whole("rng", int(state, 16), 2**128 - 1),
                "inc": _whole("rng", int(inc, 16), 2**128 - 1),
            },
            "has_uint32": _whole("rng", has_uint32, 1),
            "uinteger": _whole("rng", uinteger, 2**32 - 1),
        }
    actions = values["actions"].translate(ACTIONS).encode("latin-1")
    return EpisodeRecord(_whole("idle_frames", values["idle_frames"], MOST), actions, rng)


def _whole(key: str, value: Any, most: int) -> int:
    """The value, if it is a whole number from 0 to `most`; raises ValueError if it is not."""
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"{key}: {shown(value)} should be a whole number from 0 to {most}")
    return value


# What each kind of heading holds besides
KEYS = {
    TRAINING: ("episode",),
    VALUES: ("episode", "game"),
    EVALUATION: ("trained_games", "difficulty", "sticky_actions", "epsilon", "seed", "game"),
}


CHANCES = ("sticky_actions", "epsilon")  # those of them that are probabilities


def read(data: bytes, source: Path) -> Iterator[Game]:
    """The headings and records in the bytes of a file, in its order.

    Raises RecordError, which names `source`, at the first frame that is damaged.
    """
    games = 0
    try:
        for frame in compression.decode(data):
            for line in frame.splitlines():
                heading = json.loads(line)
                record = _game_record(heading)
                for key in ("idle_frames", "rng", "actions"):
                    heading.pop(key, None)
                if heading.keys() != {"kind", *KEYS[heading["kind"]]}:
                    raise ValueError(f"no kind of game has the keys {', '.join(heading)}")
                for key in KEYS[heading["kind"]]:
                    _check_number(key, heading[key])
                yield heading, record
                games += 1
    except WRONG as error:
        said = printable(str(error))
        raise RecordError(f"{source} is damaged after {games} games: {said}") from None


# What is raised where a line is none of a game's
WRONG = (*(compression.ZstdError, ValueError, KeyError, TypeError, AttributeError, RecursionError),)


def _check_number(key: str, value: Any) -> None:
    """Raises ValueError unless a heading may have this value: else no game could be set up by it,
    or found."""
    if key not in CHANCES:
        _whole(key, value, MOST)
    elif type(value) not in (int, float) or not 0 <= value <= 1:
        raise ValueError(f"{key}: {shown(value)} should be a number from 0 to 1")


def with_evaluations(games: list[Game], new: list[Game]) -> bytes:
    """The bytes of a file with all these games: those of training first, each check of values after
    the game that it followed, whenever its process was done; then those of evaluation, where `new`
    ones take the place of others with the same headings."""
    training = [game for game in games if game[0]["kind"] != EVALUATION]
    training.sort(key=lambda game: (game[0]["episode"], game[0]["kind"] == VALUES))
    evaluated = {
        tuple(game[0][name] for name in KEYS[EVALUATION]): game
        for game in [*games, *new]
        if game[0]["kind"] == EVALUATION
    }
    rows = [*training, *(evaluated[key] for key in sorted(evaluated))]
    return b"".join(encode(rows[at : at + FRAME]) for at in range(0, len(rows), FRAME))


def read_file(folder: Path, torn: bool = False) -> list[Game]:
    """All that a run's folder has on record; with `torn`, of a damaged file what comes before the
    damage, since a process may have been killed while it wrote.

    Raises RecordError if there is no file or, unless `torn`, it is damaged.
    """
    path, games = folder / FILE, []
    try:
        for game in read(read_bytes(path), path):
            games.append(game)
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}") from None
    except RecordError:
        if not torn:
            raise
    return games


def digest(record: EpisodeRecord) -> str:
    """Eight hexadecimal digits that tell an episode from others."""
    idle = record.idle_frames.to_bytes(1 if record.idle_frames < 256 else 2)
    return hashlib.sha256(idle + bytes(record.actions)).hexdigest()[:8]


def settings(params: Parameters, heading: Heading) -> Parameters:
    """The parameters of a game with this heading in a run with `params`."""
    changes: dict[str, Any] = {
        key: heading[key] for key in ("difficulty", "sticky_actions") if key in heading
    }
    return params.model_copy(update=changes)


def as_trained(params: Parameters, games: list[Game]) -> list[Game]:
    """Those of some games that evaluate as `params` train and evaluate."""
    return [
        (heading, record)
        for heading, record in games
        if heading["kind"] == EVALUATION
        and heading["epsilon"] == params.evaluation_epsilon
        and settings(params, heading) == params
    ]


def begin(params: Parameters, record: EpisodeRecord) -> tuple[AtariEnv, np.ndarray]:
    """The game before its first action, and its first image, uint8 [84, 84].

    Raises RecordError if the cartridge has no such action or difficulty, if a game never begins as
    late, or if actions are sticky and the record does not say when.
    """
    if record.idle_frames > params.noop_max:
        raise RecordError(f"no game begins after {record.idle_frames} idle frames")
    try:
        game = make_env(params)
    except ValueError as error:
        raise RecordError(str(error)) from None
    if record.actions and max(record.actions) >= len(game.actions):
        raise RecordError(f"{params.game} has no action {max(record.actions)}")
    if (record.rng is None) != (params.sticky_actions == 0):
        raise RecordError(
            f"sticky_actions is {params.sticky_actions}, and the record has "
            f"{'none' if record.rng is None else 'some'} of the chance that they need"
        )
    image, _ = game.reset(options={"record": record})
    return game, image


def replay(params: Parameters, record: EpisodeRecord) -> Iterator[AtariEnv]:
    """The game before its first action, and after each. Raises RecordError as `begin` does."""
    game, _ = begin(params, record)
    yield game
    for action in record.actions:
        game.step(action)
        yield game
