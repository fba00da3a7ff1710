"""Training on a Dask cluster: the same runs, on machines of its scheduler's choice.

A worker trains a run in a folder of its own and sends it back whole when it is complete. Where the
workers share a $ATARI_DQN_STATE, a run whose worker is lost resumes on another from its last
checkpoint; where they do not, it starts again.
"""

import hashlib
import json
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import Client, Future, as_completed, get_worker
from distributed.core import Status
from tqdm import tqdm

from atari_dqn import params
from atari_dqn.params import TRAINING_VERSION
from atari_dqn.runs.files import RunError, write_atomically
from atari_dqn.runs.run import Run
from atari_dqn.runs.scheduler import (
    error_line,
    left_waiting,
    startable,
    stopping_on_sigterm,
    take_ready,
)

CONNECT_SECONDS, STOP_POLL_SECONDS = 20, 2
HANDOVER_SECONDS = 120  # for which a run waits until the worker that had it before lets it go


def train_all(wanted: list[Run], scheduler: str) -> list[str]:
    """Trains every run that is not complete on the cluster of the `scheduler` at tcp://host:port.

    One failing run does not stop the others; returns a line for each that failed. Ctrl-C and
    SIGTERM make the workers save and stop, and raise KeyboardInterrupt. Raises RunError if no
    scheduler answers.
    """
    try:
        client = Client(scheduler, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise RunError(f"--scheduler {scheduler!r}: no Dask scheduler answers ({error})") from None
    pending, failures = startable(wanted)
    with client, stopping_on_sigterm():
        return failures + _train_all(client, pending)


def _train_all(client: Client, pending: list[Run]) -> list[str]:
    active: dict[Future, tuple[Run, ExitStack]] = {}
    finished = as_completed()
    failures: list[str] = []

    def submit_ready() -> None:
        while run := take_ready(pending, [run for run, _ in active.values()]):
            with ExitStack() as stack:
                try:
                    stack.enter_context(run.lock(run.folder))  # no other runner here takes it too
                except RunError as error:
                    failures.append(str(error))
                    continue
                values, files = run.params.model_dump(), _files(run)
                future = client.submit(_train, values, files, TRAINING_VERSION, key=_key(run))
                active[future] = run, stack.pop_all()
                finished.add(future)

    try:
        submit_ready()
        while active:
            future = next(finished)
            run, lock = active.pop(future)
            with lock:
                failures += _outcome(run, future)
            submit_ready()
    finally:
        client.cancel(list(active))  # their workers notice, save and stop
        for _, lock in active.values():
            lock.close()
    return failures + left_waiting(pending)


def _key(run: Run) -> str:
    """A second client that wants the very same run shares the task."""
    values = json.dumps([TRAINING_VERSION, run.params.model_dump()], sort_keys=True)
    return f"{run.name}-{hashlib.sha256(values.encode()).hexdigest()[:12]}"


def _files(run: Run) -> dict[str, bytes]:
    """What is stored of a run and of the one that it starts from, if any: a worker that cannot
    continue it must know, and what it sends back replaces what is here."""
    source = run.source()
    begun = {} if source is None else _read(source.folder, run.results)
    return begun | _read(run.folder, run.results)


def _read(folder: Path, root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def _outcome(run: Run, future: Future) -> list[str]:
    """Stores what came back; a line on what went wrong, if anything did."""
    if future.status == "cancelled":
        return [f"{run.name}: the scheduler was lost"]
    if future.status == "error":
        return [error_line(run, future.exception())]
    try:
        _store(run, future.result())
    except (OSError, RunError) as error:
        return [f"{run.name} is complete, but cannot be stored: {error}"]
    tqdm.write(f"{run.name} is complete")
    return []


def _store(run: Run, files: dict[str, bytes]) -> None:
    """Puts a complete run into the results folder, its status last."""
    for name in sorted(files, key=lambda name: name.endswith("status.json")):
        path = run.results / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, files[name])


def _train(values: dict[str, Any], files: dict[str, bytes], version: int) -> dict[str, bytes]:
    """What a worker does with a run; returns the finished run's files."""
    from atari_dqn.runs import recorder  # here: who only sends runs needs no PyTorch

    worker = get_worker()
    if worker.state.nthreads > 1:
        raise RunError("a run needs a process of its own: start the workers with --nthreads 1")
    if version != TRAINING_VERSION:
        raise RunError(
            f"this worker has training version {TRAINING_VERSION}, the runner has {version}"
        )
    with TemporaryDirectory(dir=worker.local_directory) as folder:
        run = Run(params.parse(values, "cluster"), Path(folder))
        for name, data in files.items():
            path = run.results / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        try:
            recorder.train(run, asked_to_stop=_Unwanted(), patience=HANDOVER_SECONDS)
        except KeyboardInterrupt:
            raise RunError(f"{run.name} was stopped") from None
        return _read(run.folder, run.results)


class _Unwanted:
    """Whether this worker's task was cancelled, or the worker is shutting down; asked in its
    thread, a look every few seconds."""

    def __init__(self) -> None:
        self.worker, self.key = get_worker(), get_worker().get_current_task()
        self.asked_at, self.answer = 0.0, False

    def __call__(self) -> bool:
        now = time.monotonic()
        if not self.answer and now - self.asked_at >= STOP_POLL_SECONDS:
            task = self.worker.state.tasks.get(self.key)
            wanted = task is not None and task.state != "cancelled"
            alive = self.worker.status in (Status.running, Status.paused)
            self.answer, self.asked_at = not (wanted and alive), now
        return self.answer
