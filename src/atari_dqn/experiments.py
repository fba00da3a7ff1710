"""The runs that the parameter files ask for: listing them, and training those that are missing."""

import multiprocessing
import os
import signal
import sys
import traceback
from collections import deque
from multiprocessing.connection import wait
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from atari_dqn import params, runs
from atari_dqn.params import ParameterError
from atari_dqn.runs import Run, RunError

# The order of training and of the report; experiments that are not listed come last.
ORDER = ("boxing_final", "breakout_final")


def files(profile: str) -> list[Path]:
    """The parameter files of a profile, in the order in which their runs are trained."""
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
    workers = workers or os.cpu_count() or 1
    context = multiprocessing.get_context("spawn")
    bar_lock = context.RLock()
    active: dict[int, tuple[multiprocessing.process.BaseProcess, int, Run]] = {}
    places = list(range(workers))  # lines for progress bars
    outcomes = context.SimpleQueue()
    failures: list[str] = []

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        while pending or active:
            while pending and places:
                run, place = pending.popleft(), places.pop(0)
                process = context.Process(target=_worker, args=(run, place, bar_lock, outcomes))
                process.start()
                active[process.sentinel] = (process, place, run)
            for sentinel in wait(list(active)):
                process, place, run = active.pop(sentinel)
                process.join()
                places.append(place)
                failure = None
                while not outcomes.empty():
                    failures.append(failure := outcomes.get())
                if process.exitcode and failure is None:
                    failures.append(f"{run.name}: killed (exit code {process.exitcode})")
    except KeyboardInterrupt:
        for process, _, _ in active.values():
            process.terminate()  # each saves a checkpoint before it ends
        for process, _, _ in active.values():
            process.join()
        raise
    finally:
        signal.signal(signal.SIGTERM, before)
    return failures


def _worker(run: Run, place: int, bar_lock, outcomes) -> None:
    """One run in a process of its own."""
    tqdm.set_lock(bar_lock)
    try:
        runs.train(run, place)
    except KeyboardInterrupt:
        sys.exit(130)
    except RunError as error:
        outcomes.put(str(error))
        sys.exit(1)
    except Exception as error:
        outcomes.put(f"{run.name}: {type(error).__name__}: {error}")
        traceback.print_exc()
        sys.exit(1)
