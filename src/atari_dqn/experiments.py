"""The runs that the parameter files ask for: listing them, and training those that are missing."""

import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext
from pathlib import Path

import numpy as np
import pandas as pd

from atari_dqn import checkpoints, params, recording, runs
from atari_dqn.checkpoints import CheckpointError
from atari_dqn.params import ParameterError
from atari_dqn.runs import Run, RunError

# The order of training and of the report; experiments that are not listed come last.
ORDER = (
    *("boxing_final", "breakout_final", "breakout_late", "boxing_expert", "boxing_early"),
    *("breakout_early", "boxing_low_gamma", "boxing_high_gamma", "boxing_transfer"),
    *("boxing_sensitivity", "boxing_transfer_controls"),
)
KNOWN = (RunError, CheckpointError, ParameterError)  # whose messages say what to do
WAITING = "waiting"  # what `status` says of a run whose source is not complete
DAMAGED = "damaged"  # and of one whose files cannot be read
PACE_GAMES = 100  # of the last games, by which the time left is told


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
    """Every run of the named experiments, in that order, or of all.

    Raises ParameterError on an unknown name, also of an experiment to start from.
    """
    available = {path.stem: path for path in files(profile)}
    for name in names:
        if name not in available:
            raise ParameterError(
                f"experiment {name!r} is not allowed: must be one of {', '.join(available)}"
            )
    chosen = [params.load(available[name]) for name in dict.fromkeys(names or available)]
    folder = runs.results_folder(profile, results)
    wanted = [run for parameters in chosen for run in runs.runs_of(parameters, folder)]
    for run in wanted:
        source = run.params.initial_weights
        if source and source not in available and not (folder / "runs" / source).exists():
            raise ParameterError(
                f"{run.params.experiment}: initial_weights: {source!r} is not allowed: must be "
                f"stored in {folder / 'runs'} or one of {', '.join(available)}"
            )
    return wanted


def status(wanted: list[Run]) -> pd.DataFrame:
    """One row a run: experiment (and variation), agent, seed, state, games (done), episodes
    (wanted), score (mean of the last 100 games), hours_left (of one core, at the pace of the last
    100 games; of a run that has none, at the mean pace of the game's other runs; else nan)."""
    rows = []
    for run in wanted:
        try:
            state, stale = _said(run), run.state() == runs.STALE
        except RunError as error:
            state, stale = f"{DAMAGED} ({error})", False
        episodes = runs.read_table([] if stale else [run], "episodes.csv")
        recent = episodes.tail(PACE_GAMES)
        rows.append(
            {
                "experiment": _title(run),
                "agent": run.agent,
                "seed": run.seed,
                "state": state,
                "games": len(episodes),
                "episodes": run.params.episodes,
                "score": recent.score.mean() if len(episodes) else np.nan,
                "game": run.params.game,
                "pace": np.nan if stale else _pace(run),
            }
        )
    table = pd.DataFrame(rows)
    pace = table.pace.fillna(table.groupby("game").pace.transform("mean"))
    table["hours_left"] = (table.episodes - table.games).clip(lower=0) * pace / 3600
    table.loc[table.state == runs.COMPLETE, "hours_left"] = 0.0
    return table.drop(columns=["game", "pace"])


def _said(run: Run) -> str:
    """A run's state, and what stands in its way. Raises RunError if what is stored is damaged."""
    state, source = run.state(), run.waits_for()
    if source is not None:
        return f"{WAITING} for {source.params.experiment}"
    if state in (runs.INTERRUPTED, runs.FAILED) and not checkpoints.exist(run.state_folder):
        return f"{state} (no checkpoint here: --anew)"
    if state == runs.FAILED:
        return f"{state} ({run.status().get('error', 'no reason stored')})"
    return state


def _title(run: Run) -> str:
    experiment = run.params.experiment.partition("+")[0]
    return f"{experiment}: {run.variation}" if run.variation else experiment


def _pace(run: Run) -> float:
    """Seconds a game took of late; nan if too few have been played to tell."""
    timing = runs.read_table([run], "timing.csv").tail(PACE_GAMES + 1)
    if len(timing) < 2:
        return np.nan
    return (timing.seconds.iloc[-1] - timing.seconds.iloc[0]) / (len(timing) - 1)


def summary(table: pd.DataFrame) -> str:
    """The totals of a `status` table in one line."""
    states = table.state.str.split().str[0].value_counts()  # "waiting for ..." is one
    done, all_games = table[["games", "episodes"]].min(axis=1).sum(), table.episodes.sum()
    hours, unknown = table.hours_left.sum(), table.hours_left.isna().sum()
    left = f"{hours:,.1f} core-hours left"
    if unknown:
        left += f", and {unknown} runs whose pace is not known yet"
    listed = ", ".join(f"{count} {state}" for state, count in states.items())
    share = f"{done:,} of {all_games:,} games ({done / all_games:.0%})"
    return f"{len(table)} runs: {listed}; {share}; about {left}"


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
            failures.append(told(run, error))
    for run in wanted:
        state, source = states[run.name], run.source()
        begins_with = states.get(source.name) if source is not None else None
        if state == runs.STALE:
            failures.append(
                f"{run.folder} holds a run that no longer matches: {'; '.join(run.changes())}; "
                "--anew keeps it elsewhere and begins again"
            )
        elif state == runs.MISSING and begins_with == runs.STALE:
            failures.append(f"{run.name} starts from {source.name}, which is stale")
        elif state not in (runs.COMPLETE, DAMAGED):
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
    """Trains every run that is not complete, one process a core, in the order given.

    A run that starts from another's model waits for it. One failing run does not stop the others;
    returns a line for each that failed or had to wait in vain. Ctrl-C and SIGTERM leave every run
    resumable and raise KeyboardInterrupt.
    """
    pending, failures = startable(wanted)
    context = multiprocessing.get_context("spawn")
    active: dict[int, _Worker] = {}
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
    try:
        recording.train(run, place)
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        sender.send(told(run, error))
        if not isinstance(error, KNOWN):
            traceback.print_exc()
        sys.exit(1)


def told(run: Run, error: BaseException) -> str:
    """What went wrong with a run, in a line that names it."""
    text = str(error) if isinstance(error, KNOWN) else f"{type(error).__name__}: {error}"
    return text if run.name in text else f"{run.name}: {text}"
