"""Training the runs that are missing, one process per core."""

import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext
from typing import Any

from atari_dqn.params import ParameterError
from atari_dqn.runs.files import RunError
from atari_dqn.runs.plan import DAMAGED
from atari_dqn.runs.processes import end_with_parent
from atari_dqn.runs.run import COMPLETE, MISSING, RESTART, STALE, Run

KNOWN = (RunError, ParameterError)  # whose messages say what to do


def startable(wanted: list[Run]) -> tuple[list[Run], list[str]]:
    """The runs that are to be trained, and a line for each that cannot be: what is stored of it, or
    of the run that it starts from, is damaged or of other settings."""
    states, pending, failures = {}, [], []
    for run in wanted:
        try:
            run.waits_for()  # its source may be damaged
            states[run.name] = run.state()
        except RunError as error:
            states[run.name] = DAMAGED
            failures.append(error_line(run, error))
    for run in wanted:
        state, source = states[run.name], run.source()
        begins_with = states.get(source.name) if source is not None else None
        if state == STALE:
            failures.append(
                f"{run.folder} holds a run that no longer matches: {'; '.join(run.changes())}; "
                f"{RESTART}"
            )
        elif source is not None and state == MISSING and begins_with == STALE:
            failures.append(f"{run.name} starts from {source.name}, which is stale")
        elif state not in (COMPLETE, DAMAGED):
            pending.append(run)
    return pending, failures


def take_ready(pending: list[Run], active: list[Run]) -> Run | None:
    """Takes the first run out of `pending` that waits for no other, and for none that is still to
    be trained or is being trained now."""
    unfinished = {run.name for run in (*pending, *active)}
    for run in pending:
        source = run.source()
        if run.waits_for() is None and (source is None or source.name not in unfinished):
            pending.remove(run)
            return run
    return None


@contextmanager
def stopping_on_sigterm() -> Iterator[None]:
    """Turns SIGTERM into KeyboardInterrupt."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def left_waiting(pending: list[Run]) -> list[str]:
    """A line for each run that could not be started."""
    return [
        f"{run.name} waits for {source.name}, which is {source.state()}"
        for run in pending
        if (source := run.waits_for())
    ]


def train_all(wanted: list[Run], workers: int | None = None) -> list[str]:
    """Trains every run that is not complete, one process per core, in the order given.

    A run that starts from another's model waits for it. One failing run does not stop the others;
    returns a line for each that failed or had to wait in vain. Ctrl-C and SIGTERM leave every run
    resumable and raise KeyboardInterrupt.
    """
    pending, failures = startable(wanted)
    context = multiprocessing.get_context("spawn")
    active: dict[Any, _Worker] = {}  # by the sentinels of their processes
    places = list(range(workers or cores()))  # lines for progress bars
    with stopping_on_sigterm():
        try:
            while True:
                while places and (run := take_ready(pending, [one.run for one in active.values()])):
                    worker = _Worker(context, run, places.pop(0))
                    active[worker.process.sentinel] = worker
                if not active:
                    break
                for sentinel in wait(list(active)):
                    worker = active.pop(sentinel)
                    places.append(worker.place)
                    failures += worker.failure()
        except KeyboardInterrupt:
            for worker in active.values():
                worker.process.terminate()  # each saves a checkpoint before it ends
            for worker in active.values():
                worker.process.join()
            raise
    return failures + left_waiting(pending)


def cores() -> int:
    """The processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Worker:
    """A process that trains one run."""

    def __init__(self, context: SpawnContext, run: Run, place: int):
        self.run, self.place = run, place
        self.receiver, sender = context.Pipe(duplex=False)
        self.process = context.Process(target=_train, args=(run, place, sender))
        # Ctrl-C reaches the whole process group: the parent alone acts on it, and tells the others.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        self.process.start()
        signal.signal(signal.SIGINT, before)
        sender.close()

    def failure(self) -> list[str]:
        """A line on what went wrong with the ended process; none if nothing did."""
        self.process.join()
        if self.process.exitcode == 0:
            return []
        if self.receiver.poll():
            try:
                return [self.receiver.recv()]
            except EOFError:
                pass
        return [f"{self.run.name}: killed (exit code {self.process.exitcode})"]


def _train(run: Run, place: int, sender: Connection) -> None:
    """What a worker process does.

    The bars of several processes share no lock: one that dies while holding it would stop all.
    """
    from atari_dqn.runs import recorder  # here: who only starts the workers needs no PyTorch

    end_with_parent(saving=True)
    try:
        recorder.train(run, place)
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        sender.send(error_line(run, error))
        if not isinstance(error, KNOWN):
            traceback.print_exc()
        sys.exit(1)


def error_line(run: Run, error: BaseException) -> str:
    """What went wrong with a run, in a line that names it."""
    text = str(error) if isinstance(error, KNOWN) else f"{type(error).__name__}: {error}"
    return text if run.name in text else f"{run.name}: {text}"
