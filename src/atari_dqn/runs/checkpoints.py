"""Saving a run's whole state so that it can be resumed bit for bit.

A checkpoint is a folder that appears at once (written beside, then renamed) and holds

    arrays.safetensors   every array and tensor
    *.bin                long lists of byte strings, one after the other
    state.json           everything else, with references to the above
    manifest.json        SHA-256 of the other files, written last

The two newest are kept. No pickle is ever written or read.
"""

import hashlib
import json
import os
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from atari_dqn.runs.files import RunError

KEPT = 2  # checkpoints: the newest, and the one before it in case the newest is damaged


class CheckpointError(RunError):
    """No checkpoint can be written or read; the message says which file and why."""


def save(folder: Path, state: dict[str, Any]) -> None:
    """Writes a new checkpoint into `folder`, which no other process may be writing to.

    Raises CheckpointError if it cannot be written; earlier checkpoints are then untouched.
    """
    try:
        for left in folder.glob("tmp-*"):  # by a process that was killed
            shutil.rmtree(left)
        found = _found(folder)
        number = int(found[-1].name.removeprefix("checkpoint-")) + 1 if found else 1
        final = folder / f"checkpoint-{number:06d}"
        temporary = folder / f"tmp-{number:06d}"
        temporary.mkdir(parents=True)
    except OSError as error:
        raise CheckpointError(f"cannot write to {folder}: {error.strerror}") from error
    try:
        _write(temporary, state)
        temporary.rename(final)
        _sync(folder)
        for old in _found(folder)[:-KEPT]:
            shutil.rmtree(old)
    except (OSError, SafetensorError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise CheckpointError(f"cannot write the checkpoint {final}: {reason}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def exist(folder: Path) -> bool:
    """Whether any checkpoint is in `folder`."""
    return bool(_found(folder))


def load(folder: Path) -> dict[str, Any] | None:
    """The state in the newest undamaged checkpoint of `folder`, or None if there never was one.

    A damaged checkpoint is set aside as damaged-* with a warning. Raises CheckpointError if all
    are damaged, or if one cannot be read now but may be whole.
    """
    for checkpoint in reversed(_found(folder)):
        try:
            return _read(checkpoint)
        except (FileNotFoundError, ValueError, KeyError, SafetensorError) as error:
            warnings.warn(f"{checkpoint} is damaged ({error}); passed over", stacklevel=2)
            aside = folder / checkpoint.name.replace("checkpoint", "damaged")
            shutil.rmtree(aside, ignore_errors=True)
            checkpoint.rename(aside)
        except OSError as error:  # no permission, too many open files: it may be whole
            raise CheckpointError(
                f"cannot read {checkpoint}: {error.strerror}; if that stays so, delete it to go on "
                "from the one before"
            ) from error
    if any(folder.glob("damaged-*")):
        raise CheckpointError(
            f"every checkpoint in {folder} is damaged; `restore` makes one of what is stored, or "
            "delete the folder to start again"
        )
    return None


def _found(folder: Path) -> list[Path]:
    """The checkpoints in a folder, the newest last."""
    return sorted(folder.glob("checkpoint-*"))


def _write(folder: Path, state: dict[str, Any]) -> None:
    arrays: dict[str, np.ndarray] = {}
    chunks: dict[str, list[bytes]] = {}
    rest = _split(state, "", arrays, chunks)
    digests = {file: _write_file(folder / file, parts) for file, parts in chunks.items()}
    save_file(arrays, folder / "arrays.safetensors")
    digests["arrays.safetensors"] = _digest(folder / "arrays.safetensors")
    digests["state.json"] = _write_file(folder / "state.json", [json.dumps(rest).encode()])
    _write_file(folder / "manifest.json", [json.dumps(digests, indent=1).encode()])
    _sync(folder / "arrays.safetensors")
    _sync(folder)


# Not functions within those that call them: one that calls itself would be a ring of references,
# and hold every array of the checkpoint until the garbage collector comes by, which it seldom does.
def _split(
    value: Any, name: str, arrays: dict[str, np.ndarray], chunks: dict[str, list[bytes]]
) -> Any:
    """What of a value JSON can hold, with references to the rest, which goes to `arrays` and, by
    the names of files, to `chunks`."""
    if isinstance(value, dict):
        return {key: _split(part, f"{name}.{key}", arrays, chunks) for key, part in value.items()}
    if isinstance(value, bytes):
        arrays[name] = np.frombuffer(value, np.uint8)
        return {"$bytes": name}
    if hasattr(value, "detach"):  # a tensor, without importing torch to tell
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        # not np.ascontiguousarray, which makes a vector of a scalar
        arrays[name] = value.copy(order="C")
        return {"$array": name}
    if isinstance(value, list) and value and isinstance(value[0], bytes):
        file = f"{name.strip('.')}.bin"
        arrays[name], chunks[file] = np.array([len(part) for part in value], np.int64), value
        return {"$chunks": name, "$file": file}
    if isinstance(value, list):
        return [_split(each, f"{name}.{place}", arrays, chunks) for place, each in enumerate(value)]
    return value


def _join(value: Any, arrays: dict[str, np.ndarray], folder: Path) -> Any:
    """The value of which `_split` made this, with what it refers to."""
    if isinstance(value, list):
        return [_join(part, arrays, folder) for part in value]
    if not isinstance(value, dict):
        return value
    if "$bytes" in value:
        return arrays[value["$bytes"]].tobytes()
    if "$array" in value:
        return arrays[value["$array"]]
    if "$chunks" in value:
        with (folder / value["$file"]).open("rb") as file:
            return [file.read(size) for size in arrays[value["$chunks"]].tolist()]
    return {key: _join(part, arrays, folder) for key, part in value.items()}


def _read(folder: Path) -> dict[str, Any]:
    manifest = json.loads((folder / "manifest.json").read_bytes())
    if not {"arrays.safetensors", "state.json"} <= manifest.keys():
        raise ValueError("manifest.json does not name all files")
    for file, digest in manifest.items():
        if _digest(folder / file) != digest:
            raise ValueError(f"{file} does not match its checksum")
    arrays = load_file(folder / "arrays.safetensors")
    return _join(json.loads((folder / "state.json").read_bytes()), arrays, folder)


def _write_file(path: Path, parts: list[bytes]) -> str:
    """Writes and syncs a file; returns its SHA-256."""
    with path.open("wb") as file:
        file.writelines(parts)
        file.flush()
        os.fsync(file.fileno())
    return _digest(path)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
