"""The runs that the parameter files ask for: listing them, and training those that are missing."""

import multiprocessing
import os
import signal
import sys
import traceback
from collections import deque
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext
from pathlib import Path
from typing import Any

import pandas as pd
from tqdm import tqdm

from atari_dqn import params, recording, runs
from atari_dqn.params import ParameterError
from atari_dqn.runs import Run, RunError

# The order of training and of the report; experiments that are not listed come last.
ORDER = ("boxing_final", "breakout_final")


def files(profile: str) -> list[Path]:
    """The parameter files of a profile, in the order in which their runs are trained.

    Raises ParameterError on an unknown profile.
    """
    if profile not in params.PROFILES:
        allowed = ", ".join(params.PROFILES)
        raise ParameterError(f"profile: {profile!r} is not allowed: must be one of {allowed}")
    folder = runs.project_root() / "params"
    found = (folder if profile == "full" else folder / profile).glob("*.yaml")
    rank = {name: place for place, name in enumerate(ORDER)}
    return sorted(found, key=lambda path: (rank.get(path.stem, len(rank)), path.stem))


def planned(profile: str, names: list[str], results: Path | None) -> list[Run]:
    """Every run of the named experiments, or of all. Raises ParameterError on an unknown name."""
    available = {path.stem: path for path in files(profile)}
    for name in names:
        if name not in available:
            raise ParameterError(
                f"experiment {name!r} is not allowed: must be one of {', '.join(available)}"
            )
    chosen = [params.load(path) for name, path in available.items() if name in (names or available)]
    folder = runs.results_folder(profile, results)
    return [run for parameters in chosen for run in runs.runs_of(parameters, folder)]


def status(wanted: list[Run]) -> pd.DataFrame:
    """One row a run: experiment, agent, seed, state, games done and wanted, recent mean score."""
    rows = []
    for run in wanted:
        state = run.state()
        episodes = runs.read_table([run], "episodes.csv")
        rows.append(
            {
                "experiment": run.params.experiment,
                "agent": run.agent,
                "seed": run.seed,
                "state": state,
                "games": f"{len(episodes)}/{run.params.episodes}",
                "score": round(episodes.score.tail(100).mean(), 1) if len(episodes) else None,
            }
        )
    return pd.DataFrame(rows)


def train_all(wanted: list[Run], workers: int | None = None) -> list[str]:
    """Trains every run that is not complete, one process a core, in the order given.

    One failing run does not stop the others; returns a line for each that failed. Ctrl-C and
    SIGTERM leave every run resumable and raise KeyboardInterrupt.
    """
    pending = deque(run for run in wanted if run.state() != runs.COMPLETE)
    context = multiprocessing.get_context("spawn")
    bar_lock = context.RLock()
    active: dict[int, _Worker] = {}
    places = list(range(workers or os.cpu_count() or 1))  # lines for progress bars
    failures: list[str] = []

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        while pending or active:
            while pending and places:
                worker = _Worker(context, pending.popleft(), places.pop(0), bar_lock)
                active[worker.process.sentinel] = worker
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
    finally:
        signal.signal(signal.SIGTERM, before)
    return failures


class _Worker:
    """A process that trains one run."""

    def __init__(self, context: SpawnContext, run: Run, place: int, bar_lock: Any):
        self.run, self.place = run, place
        self.receiver, sender = context.Pipe(duplex=False)
        self.process = context.Process(target=_train, args=(run, place, bar_lock, sender))
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


def _train(run: Run, place: int, bar_lock: Any, sender: Connection) -> None:
    """What a worker process does."""
    tqdm.set_lock(bar_lock)
    try:
        recording.train(run, place)
    except KeyboardInterrupt:
        sys.exit(130)
    except RunError as error:
        sender.send(str(error))
        sys.exit(1)
    except Exception as error:
        sender.send(f"{run.name}: {type(error).__name__}: {error}")
        traceback.print_exc()
        sys.exit(1)
