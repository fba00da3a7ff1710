"""Where results are, reading a file there, and writing one: readers see the old one or the new
one."""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import BinaryIO

from filelock import FileLock

from atari_dqn.params import ParameterError, check_profile, shown


class RunError(RuntimeError):
    """Something about stored runs that a user can mend; the message is fit to be shown as it is."""


def project_root() -> Path:
    """The folder with pyproject.toml at or above the working folder, else the package's own."""
    for folder in (Path.cwd(), *Path.cwd().parents, *Path(__file__).parents):
        if (folder / "pyproject.toml").exists() and (folder / "params").is_dir():
            return folder
    raise RunError("no project folder (pyproject.toml and params/) at or above the working folder")


def results_folder(profile: str, results: Path | str | None = None) -> Path:
    """Where results go: `results`, or the project's own folder for a profile's. Raises
    ParameterError on an unknown profile, or if there can be no such folder."""
    check_profile(profile)
    if results is not None:
        if not (isinstance(results, str | Path) and str(results).isprintable()):
            raise ParameterError(f"results: {shown(results)} is not allowed: must be a folder")
        folder = Path(results)
        there = next(path for path in (folder, *folder.parents, Path()) if path.exists())
        if not there.is_dir():
            raise ParameterError(f"results: {str(folder)!r} is not allowed: {there} is no folder")
        return folder
    folder = project_root() / "results"
    return folder if profile == "full" else folder / profile


def model_file(folder: Path) -> Path:
    """The weights of a stored run. Raises ParameterError if there are none."""
    path = folder / "model.safetensors"
    if not folder.is_dir():
        raise ParameterError(f"{folder}: there is no such folder; a run's is .../seed-N")
    if not path.exists():
        raise ParameterError(
            f"{folder}: no model.safetensors here; a run's folder (.../seed-N) has one from its "
            "first checkpoint on"
        )
    return path


def evaluations_lock(folder: Path) -> AbstractContextManager:
    """To be held while evaluations or records are written, or read together: a run may train, or
    end, while another process evaluates it. Nobody changes a folder that cannot be written to."""
    if not os.access(folder, os.W_OK):
        return nullcontext()
    return FileLock(folder / ".evaluations.lock")


def check_regular(path: Path) -> None:
    """Raises RunError if something other than a file stands in a file's place: a folder, or a pipe,
    which may never say a word."""
    if path.exists() and not path.is_file():
        raise RunError(f"{path}: must be a regular file")


def read_bytes(path: Path) -> bytes:
    """What a file holds. Raises RunError if it is none, OSError if it cannot be read."""
    check_regular(path)
    return path.read_bytes()


def write_atomically(path: Path, data: bytes | Callable[[BinaryIO], None]) -> None:
    """Writes bytes, or what a function writes to an open file: readers see the old file or the new
    one, never a part."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("wb") as file:
            if callable(data):
                data(file)
            else:
                file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise RunError(f"cannot write {path}: {error.strerror}") from error
        raise
