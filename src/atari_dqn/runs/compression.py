"""The file of a run's records as bytes: zstandard frames, each with a checksum. What is written in
them is known to `records`."""

from collections.abc import Iterator
from pathlib import Path

import zstandard
from zstandard import ZstdError

from atari_dqn.runs.files import RunError

FILE = "games.jsonl.zst"
LEVEL = 19  # of compression: a millisecond per game
CHUNK = 4096  # bytes read at once


def encode(content: bytes) -> bytes:
    """A frame that holds `content`."""
    return zstandard.ZstdCompressor(level=LEVEL, write_checksum=True).compress(content)


def decode(data: bytes) -> Iterator[bytes]:
    """What each frame holds. Raises ZstdError if one is damaged, ValueError if the last one is not
    whole."""
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


def check(folder: Path, torn: bool = False) -> None:
    """Raises RunError if a run's folder has such a file and it is damaged; with `torn`, the last
    frame may lack its end, as while a process writes it."""
    path = folder / FILE
    try:
        for _ in decode(path.read_bytes() if path.exists() else b""):
            pass
    except ZstdError as error:
        raise RunError(f"{path} is damaged: {error}") from None
    except ValueError as error:
        if not torn:
            raise RunError(f"{path} is damaged: {error}") from None
