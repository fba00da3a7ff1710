"""The file of a run's records as bytes: zstandard frames, each with a checksum. What is written in
them is known to `records`."""

from collections.abc import Iterator
from pathlib import Path

import zstandard
from zstandard import ZstdError

from atari_dqn.runs.files import RunError, read_bytes

FILE = "games.jsonl.zst"
LEVEL = 19  # of compression: a millisecond per game
CHUNK = 4096  # bytes read at once
LARGEST = 2**26  # bytes that a frame may hold: a hundred games of half an hour have a sixth of it


def encode(content: bytes) -> bytes:
    """A frame that holds `content`."""
    return zstandard.ZstdCompressor(level=LEVEL, write_checksum=True).compress(content)


def decode(data: bytes) -> Iterator[bytes]:
    """What each frame holds. Raises ZstdError if one is damaged, or holds more than any of ours,
    ValueError if the last one is not whole."""
    frame, content, whole = zstandard.ZstdDecompressor().decompressobj(), b"", True
    for start in range(0, len(data), CHUNK):
        rest = data[start : start + CHUNK]
        while rest:
            content += frame.decompress(rest)
            if len(content) > LARGEST:
                raise ZstdError(f"a frame holds more than {LARGEST:,} bytes")
            whole, rest = frame.eof, frame.unused_data
            if whole:
                yield content
                frame, content = zstandard.ZstdDecompressor().decompressobj(), b""
    if not whole:
        raise ValueError("the last game is cut short")


def check(folder: Path, torn: bool = False) -> int:
    """How many lines such a file in a run's folder has, if there is one. Raises RunError if it is
    damaged; with `torn`, the last frame may lack its end, as while a process writes it."""
    path, lines = folder / FILE, 0
    try:
        for content in decode(read_bytes(path) if path.exists() else b""):
            lines += content.count(b"\n")
    except ZstdError as error:
        raise RunError(f"{path} is damaged: {error}") from None
    except ValueError as error:
        if not torn:
            raise RunError(f"{path} is damaged: {error}") from None
    return lines
