"""The file of a model: named arrays of float16, after how many games of training they were, and a
checksum of both. What the arrays mean is known to `models`."""

import hashlib
import json
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from atari_dqn.params import MOST, shown
from atari_dqn.runs.files import RunError, check_regular

Arrays = dict[str, np.ndarray]


def pack(half: Arrays, games: int) -> bytes:
    """The contents of a file."""
    about = {"games": games, "sha256": _digest(half, games)}
    return save(half, {"about": json.dumps(about)})  # one entry: safetensors' order is random


def games_of(path: Path) -> int:
    """The training games behind a file. Raises RunError if it cannot be read."""
    return _open(path)[0]


def read(path: Path) -> Arrays:
    """The arrays of a file, float16. Raises RunError if it cannot be read, or is not as it was
    written."""
    games, digest, half = _open(path, whole=True)
    if digest != _digest(half, games):
        raise RunError(f"{path} is damaged: it does not have the checksum that it was written with")
    return half


def files(folder: Path) -> list[Path]:
    """Those of a stored run's folder: snapshots, and the newest model."""
    paths = [*sorted(folder.glob("snapshots/*.safetensors")), folder / "model.safetensors"]
    return [path for path in paths if path.exists()]


def _digest(half: Arrays, games: int) -> str:
    digest = hashlib.sha256(f"{games}\n".encode())
    for name, value in sorted(half.items()):
        digest.update(f"{name} {list(value.shape)} torch.{value.dtype}\n".encode())
        digest.update(value.tobytes())
    return digest.hexdigest()


def _open(path: Path, whole: bool = False) -> tuple[int, str, Arrays]:
    """The games of training, the checksum and, if they are asked for, the arrays."""
    check_regular(path)
    try:
        with safe_open(path, "np") as file:
            about = json.loads((file.metadata() or {})["about"])
            games, half = about["games"], {}
            if type(games) is not int or not 0 <= games <= MOST:
                raise ValueError(f"games: {shown(games)} should be a whole number from 0 on")
            if whole:
                half = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return games, about["sha256"], half
    except KeyError as error:
        raise RunError(f"{path} cannot be read: it does not say its {error}") from None
    except (SafetensorError, OSError, ValueError, TypeError, RecursionError) as error:
        raise RunError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None
