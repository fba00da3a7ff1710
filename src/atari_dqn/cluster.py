"""Training on a Dask cluster: the same runs, on machines of its scheduler's choice.

A worker trains a run in a folder of its own and sends it back whole when it is complete. Where the
workers share a $ATARI_DQN_STATE, a run whose worker is lost resumes on another from its last
checkpoint; where they do not, it starts again.
"""

import time
import uuid
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import Client, Event, Future, as_completed, get_worker
from tqdm import tqdm

from atari_dqn import experiments, params, recording, runs
from atari_dqn.runs import Run, RunError

CONNECT_SECONDS, STOP_POLL_SECONDS = 20, 5


def train_all(wanted: list[Run], scheduler: str) -> list[str]:
    """Trains every run that is not complete on the cluster of the `scheduler` at tcp://host:port.

    One failing run does not stop the others; returns a line for each that failed. Ctrl-C makes the
    workers save and stop, and raises KeyboardInterrupt. Raises RunError if no scheduler answers.
    """
    try:
        client = Client(scheduler, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise RunError(f"--scheduler {scheduler!r}: no Dask scheduler answers ({error})") from None
    with client:
        return _train_all(client, [run for run in wanted if run.state() != runs.COMPLETE])


def _train_all(client: Client, pending: list[Run]) -> list[str]:
    stop = Event(f"stop-{uuid.uuid4().hex}", client)
    active: dict[Future, Run] = {}
    finished = as_completed()
    failures: list[str] = []

    def submit_ready() -> None:
        while run := experiments.take_ready(pending):
            key = f"{run.name}-{run.params.identity()[:8]}"  # a second client's would be this task
            future = client.submit(
                _train, run.params.model_dump(), _inputs(run), stop.name, key=key
            )
            active[future] = run
            finished.add(future)

    try:
        submit_ready()
        while active:
            future = next(finished)
            run = active.pop(future)
            if future.status == "finished":
                _store(run, future.result())
                tqdm.write(f"{run.name} is complete")
            else:
                failures.append(_failure(run, future))
            submit_ready()
    except KeyboardInterrupt:
        stop.set()
        for future in active:
            future.exception()  # waits until its worker has saved
        raise
    return failures + experiments.left_waiting(pending)


def _inputs(run: Run) -> dict[str, bytes]:
    """What the worker needs of the results folder: what is stored of the run, and its source."""
    source = run.source()
    folders = [run.folder] if source is None else [run.folder, source.folder]
    return _read(folders, run.results)


def _read(folders: list[Path], root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes()
        for folder in folders
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith(".")
    }


def _store(run: Run, files: dict[str, bytes]) -> None:
    """Puts a complete run into the results folder, its status last."""
    with run.lock():
        for name in sorted(files, key=lambda name: name.endswith("status.json")):
            path = run.results / name
            path.parent.mkdir(parents=True, exist_ok=True)
            runs.write_atomically(path, files[name])


def _failure(run: Run, future: Future) -> str:
    error = future.exception()
    return str(error) if isinstance(error, RunError) else f"{run.name}: {error!r}"


def _train(values: dict[str, Any], inputs: dict[str, bytes], stop: str) -> dict[str, bytes]:
    """What a worker does with a run; returns the finished run's files."""
    if get_worker().state.nthreads > 1:
        raise RunError("a run needs a process of its own: start the workers with --nthreads 1")
    with TemporaryDirectory() as folder:
        run = Run(params.parse(values, "cluster"), Path(folder))
        for name, data in inputs.items():
            path = run.results / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        try:
            recording.train(run, asked_to_stop=_Poll(Event(stop)))
        except KeyboardInterrupt:
            raise RunError(f"{run.name} was stopped") from None
        return _read([run.folder], run.results)


class _Poll:
    """Whether an event is set, asked of the scheduler every few seconds only."""

    def __init__(self, event: Event):
        self.event, self.asked_at, self.is_set = event, time.monotonic(), False

    def __call__(self) -> bool:
        if not self.is_set and time.monotonic() - self.asked_at >= STOP_POLL_SECONDS:
            self.is_set, self.asked_at = self.event.is_set(), time.monotonic()
        return self.is_set
