"""Every game of a run on record: `games.jsonl.zst`, from which any of them can be played again.

The file is a row of zstandard frames, one a game, each with a checksum of its own; together they
hold a line of JSON a game (`zstd -dc games.jsonl.zst` shows them):

    {"kind": "training", "episode": 12, "idle_frames": 7, "actions": "AKKC..."}
    {"kind": "values", "episode": 100, "game": 3, ...}
    {"kind": "evaluation", "trained_games": 3000, "difficulty": 3, "sticky_actions": 0.0,
     "epsilon": 0.001, "seed": 1, "game": 5, ...}

"values" are the greedy games behind a row of values.csv, "evaluation" those of evaluations.csv.
`actions` has a letter an agent step, A for the cartridge's first action; where actions are sticky,
`rng` is the state of numpy's PCG64 that decides when: [state, inc, has_uint32, uinteger], the first
two as hexadecimal text.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zstandard

from atari_dqn.envs import AtariGame, GameRecord, game_of
from atari_dqn.params import Parameters

FILE = "games.jsonl.zst"
TRAINING, VALUES, EVALUATION = "training", "values", "evaluation"
LEVEL = 19  # of compression: a millisecond a game
CHUNK = 4096  # bytes read at once


class RecordError(RuntimeError):
    """A file of records that cannot be read; the message names it."""


def encode(kind: str, heading: dict[str, Any], record: GameRecord) -> bytes:
    """A game as it stands in the file."""
    values = {"kind": kind, **heading, "idle_frames": record.idle_frames}
    if record.rng is not None:
        values["rng"] = _flat(record.rng)
    values["actions"] = "".join(chr(ord("A") + action) for action in record.actions)
    compressor = zstandard.ZstdCompressor(level=LEVEL, write_checksum=True)
    return compressor.compress(json.dumps(values).encode() + b"\n")


def _flat(rng: dict[str, Any]) -> list[str | int]:
    state, inc = (hex(rng["state"][key]) for key in ("state", "inc"))
    return [state, inc, rng["has_uint32"], rng["uinteger"]]


def _game_record(values: dict[str, Any]) -> GameRecord:
    rng = None
    if "rng" in values:
        state, inc, has_uint32, uinteger = values["rng"]
        rng = {
            "bit_generator": "PCG64",
            "state": {"state": int(state, 16), "inc": int(inc, 16)},
            "has_uint32": has_uint32,
            "uinteger": uinteger,
        }
    actions = bytes(ord(letter) - ord("A") for letter in values["actions"])
    return GameRecord(values["idle_frames"], actions, rng)


def read(data: bytes, source: str) -> Iterator[tuple[dict[str, Any], GameRecord]]:
    """The headings (kind, episode, ...) and records in the bytes of a file, in its order.

    Raises RecordError, which names `source`, at the first game that is damaged.
    """
    games = 0
    try:
        for line in _frames(data):
            heading = json.loads(line)
            record = _game_record(heading)
            for key in ("idle_frames", "rng", "actions"):
                heading.pop(key, None)
            yield heading, record
            games += 1
    except (zstandard.ZstdError, ValueError, KeyError, TypeError) as error:
        raise RecordError(f"{source} is damaged after {games} games: {error}") from None


def _frames(data: bytes) -> Iterator[bytes]:
    """What each zstandard frame holds. Raises ZstdError if one is damaged, ValueError if the last
    one is not whole."""
    frame, content, whole = zstandard.ZstdDecompressor().decompressobj(), b"", True
    for start in range(0, len(data), CHUNK):
        rest = data[start : start + CHUNK]
        while rest:
            content += frame.decompress(rest)
            whole, rest = frame.eof, frame.unused_data
            if whole:
                yield content
                frame, content = zstandard.ZstdDecompressor().decompressobj(), b""
    if not whole:
        raise ValueError("the last game is cut short")


def replaced(data: bytes, kind: str, games: list[tuple[dict[str, Any], GameRecord]]) -> bytes:
    """The bytes of a file, with `games` of a kind added, in the place of those of the same
    heading."""
    new = {json.dumps({"kind": kind, **heading}) for heading, _ in games}
    kept = [
        encode(heading["kind"], {k: v for k, v in heading.items() if k != "kind"}, record)
        for heading, record in read(data, FILE)
        if json.dumps(heading) not in new
    ]
    return b"".join([*kept, *(encode(kind, heading, record) for heading, record in games)])


def evaluated(data: bytes) -> list[tuple[dict[str, Any], GameRecord]]:
    """The evaluation games in the bytes of a file, for `replaced`; as far as it is whole, since a
    process may have been killed while it wrote."""
    found = []
    try:
        for heading, record in read(data, FILE):
            if heading.pop("kind") == EVALUATION:
                found.append((heading, record))
    except RecordError:
        pass
    return found


def read_file(folder: Path) -> list[tuple[dict[str, Any], GameRecord]]:
    """All that a run's folder has on record. Raises RecordError if there is no file or it is
    damaged."""
    path = folder / FILE
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}") from None
    return list(read(data, str(path)))


def settings(params: Parameters, heading: dict[str, Any]) -> Parameters:
    """The parameters of a game with this heading in a run with `params`."""
    changes = {key: heading[key] for key in ("difficulty", "sticky_actions") if key in heading}
    return params.model_copy(update=changes)


def replay(params: Parameters, record: GameRecord) -> Iterator[AtariGame]:
    """The game before its first action, and after each. Raises RecordError if the cartridge has
    no such action."""
    game = game_of(params)
    if record.actions and max(record.actions) >= len(game.actions):
        raise RecordError(f"{params.game} has no action {max(record.actions)}")
    game.reset(options={"record": record})
    yield game
    for action in record.actions:
        game.step(action)
        yield game
