"""Training a run: playing and learning until the last game, and writing all of it down."""

import hashlib
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from atari_dqn import evaluation, params
from atari_dqn.agents import AGENTS, Learner
from atari_dqn.evaluation import ValueCheck
from atari_dqn.native import NativeLearner, new_learner
from atari_dqn.params import TRAINING_VERSION
from atari_dqn.runs import checkpoints, records
from atari_dqn.runs.evaluations import store_evaluation
from atari_dqn.runs.files import RunError, evaluations_lock, read_bytes, write_atomically
from atari_dqn.runs.models import initial_weights, load_model, model_bytes
from atari_dqn.runs.run import (
    COMPLETE,
    FAILED,
    INTERRUPTED,
    MISSING,
    RESTART,
    RUNNING,
    STALE,
    Run,
)
from atari_dqn.runs.value_checks import ValueChecks
from atari_dqn.training import Episode, Trainer, prepare_process

CHECKPOINT_SECONDS = 900.0  # training time between checkpoints
VERSIONED = ("torch", "numpy", "ale-py", "gymnasium", "opencv-python-headless", "zstandard")
LOGS = {
    "episodes.csv": Episode.columns(),
    "timing.csv": ["episode", "seconds", "cpu_seconds"],
    "values.csv": [field.name for field in fields(ValueCheck)],
}


def train(
    run: Run,
    position: int | None = 0,
    asked_to_stop: Callable[[], bool] | None = None,
    patience: float = 1.0,
    follow: Callable[[], None] = lambda: None,
) -> str:
    """Trains a run to its end, resuming it if it was interrupted; returns what happened.

    SIGTERM and Ctrl-C (outside the main thread, where no signal arrives: `asked_to_stop`) save a
    checkpoint, leave the run `interrupted` and raise KeyboardInterrupt. `position` is the progress
    bar's line, None for no bar; `patience` the seconds to wait for a process that is about to let
    the run go; `follow` is called when the tables are as of the checkpoint, after every game, those
    of the final evaluation too, and at the end.
    Raises RunError if the stored run does not match, ParameterError if it cannot be trained here.
    """
    prepare_process()
    if run.state() == MISSING and not checkpoints.exist(run.state_folder):
        # Raises what the run's own learner would, before there is a folder that nothing goes into
        new_learner(AGENTS[run.agent], 18, run.params, run.seed, initial_weights(run))
    with run.lock(patience=patience):
        before = run.state()
        if before == STALE:
            raise RunError(
                f"{run.folder} holds a run that no longer matches: {'; '.join(run.changes())}; "
                f"{RESTART}"
            )
        if before == COMPLETE:
            follow()
            return f"{run.name} is complete: {run.status()['episodes_done']} games"
        recorder = Recorder(run)
        if recorder.episodes:
            tqdm.write(f"{run.name} continues after {recorder.episodes} games")
        try:
            with stop_signals() as signalled:
                stopped = asked_to_stop or signalled
                follow()
                _play_and_learn(recorder, stopped, position, follow)
                recorder.finish(stopped, position, follow)
        except KeyboardInterrupt:
            recorder.write_provenance()
            recorder.write_status(INTERRUPTED)
            raise
        except Exception as error:
            with suppress(RunError):  # a full disk must not hide the error itself
                recorder.write_status(FAILED, error=f"{type(error).__name__}: {error}")
            if isinstance(error, FloatingPointError):
                raise RunError(f"{run.name}: {error} (its last checkpoint is kept)") from None
            raise
        finally:
            recorder.close()
        follow()
        return f"{run.name} is complete: {recorder.episodes} games"


def _play_and_learn(
    recorder: "Recorder",
    stopped: Callable[[], bool],
    position: int | None,
    follow: Callable[[], None],
) -> None:
    """Trains until the last game; leaves a checkpoint of the end."""
    run = recorder.run
    if recorder.episodes >= run.params.episodes:
        return
    with tqdm(
        total=run.params.episodes,
        initial=recorder.episodes,
        desc=run.name,
        unit="game",
        position=position,
        disable=position is None,
        mininterval=2,
        dynamic_ncols=True,
    ) as bar:
        for episode in recorder.trainer.run():
            if episode is not None:
                recorder.log(episode)
                follow()
                bar.update()
            done = recorder.episodes >= run.params.episodes
            stop = stopped()
            recorder.show(bar, done)
            if done or stop or recorder.checkpoint_due():
                recorder.save()
                recorder.publish()
                recorder.write_provenance()
            if stop:
                raise KeyboardInterrupt
            if done:
                return


class Recorder:
    """Writes what a trainer does into the run's folder, and resumes both together."""

    def __init__(self, run: Run):
        self.run = run
        self.checks = ValueChecks(run.params, run.seed)
        saved = checkpoints.load(run.state_folder)
        initial = initial_weights(run) if saved is None else None
        self.trainer = Trainer(run.params, run.agent, run.seed, initial)
        self.episodes, self.seconds, self.cpu_seconds = 0, 0.0, 0.0
        self.scores: list[float] = []
        self.snapshots: dict[str, bytes] = {}
        self.sessions: list[dict[str, Any]] = []
        if saved is None:
            self._refuse_to_overwrite()
            written = {name: (",".join(header) + "\n").encode() for name, header in LOGS.items()}
            self.recorded = b""
        else:
            self.trainer.set_state(saved["trainer"])
            self.episodes, self.seconds = saved["episodes"], saved["seconds"]
            self.cpu_seconds = saved["cpu_seconds"]
            self.scores, self.snapshots = saved["scores"], saved["snapshots"]
            self.sessions = saved["sessions"]
            written = saved["written"]
            self.recorded = written[records.FILE]
        with evaluations_lock(run.folder):  # what came after the checkpoint will come again
            for name in LOGS:
                write_atomically(run.folder / name, written[name])
            self._restore_records()
        self.files = {name: (run.folder / name).open("ab") for name in LOGS}
        for name, data in self.snapshots.items():
            self._write_snapshot(name, data)
        write_atomically(run.folder / params.STORED, params.text(run.params).encode())
        self.clock, self.cpu_clock = time.monotonic(), time.process_time()
        self.saved_at = self.shown_at = self.seconds
        self.shown_steps = self.trainer.agent_steps
        self.sessions.append(_session(self.episodes + 1, self.trainer.learner))
        if initial is not None and (source := run.source()):
            model = (source.folder / "model.safetensors").read_bytes()
            self.sessions[-1]["initial_weights"] = hashlib.sha256(model).hexdigest()
        self._compare_sessions()
        self.write_provenance()
        self.write_status(RUNNING)
        if saved is None:
            self.save()  # so that stored games without a checkpoint are always a loss of state

    def _restore_records(self) -> None:
        """As of the checkpoint, but for evaluations, which are no part of it: they may have been
        added since, and their table stays too."""
        path, data = self.run.folder / records.FILE, self.recorded
        there = records.read_file(self.run.folder, torn=True) if path.exists() else []
        if any(heading["kind"] == records.EVALUATION for heading, _ in there):
            data = records.with_evaluations(list(records.read(data, path)), there)
        write_atomically(path, data)

    def _refuse_to_overwrite(self) -> None:
        """Raises RunError if games are stored that cannot be continued."""
        path = self.run.folder / "episodes.csv"
        games = read_bytes(path).count(b"\n") - 1 if path.exists() else 0
        if games > 0:
            raise RunError(
                f"{self.run.folder} holds {games} games, but their checkpoint is not in "
                f"{self.run.state_folder}; `python -m atari_dqn restore {self.run.folder}` makes "
                f"it again, {RESTART}"
            )

    def _compare_sessions(self) -> None:
        """Warns if this machine is not the one that the run began on."""
        first, now = self.sessions[0], self.sessions[-1]
        decisive = ["learner", "versions", "threads", "device"]
        if self.trainer.learner.kind == "torch":  # whose kernels differ from processor to processor
            decisive.append("processor")
        for key in decisive:
            if key in first and first[key] != now[key]:
                warnings.warn(
                    f"{self.run.name} began with {key} {first[key]} and goes on with {now[key]}: "
                    "it will not be bit for bit the uninterrupted run",
                    stacklevel=2,
                )

    def close(self) -> None:
        self.checks.close()
        for file in self.files.values():
            with suppress(OSError):  # a row that could not be written has been reported
                file.close()

    def now(self) -> float:
        """Seconds of training so far, across resumes."""
        return self.seconds + time.monotonic() - self.clock

    def cpu_now(self) -> float:
        """Seconds of a processor's time that this process has trained so far, likewise; those of
        further emulator processes do not count."""
        return self.cpu_seconds + time.process_time() - self.cpu_clock

    def log(self, episode: Episode) -> None:
        self.episodes = episode.episode
        heading = {"kind": records.TRAINING, "episode": episode.episode}
        self._record([(heading, episode.record)])
        self._append("episodes.csv", _row(episode, Episode.columns()))
        self._append("timing.csv", f"{episode.episode},{self.now():.1f},{self.cpu_now():.1f}")
        if episode.episode % params.VALUES_PERIOD == 0:
            self.checks.ask(self.trainer.learner, episode.episode)
        self._write_checks()
        if episode.episode in self.run.params.snapshot_games:
            self._take_snapshot()
        self.scores = [*self.scores[-99:], episode.score]
        self.write_status(RUNNING)

    def _write_checks(self, wait: bool = False) -> None:
        for check, games in self.checks.finished(wait):
            heading = {"kind": records.VALUES, "episode": check.episode}
            self._record([({**heading, "game": game.game}, game.record) for game in games])
            self._append("values.csv", _row(check, LOGS["values.csv"]))

    def _take_snapshot(self) -> None:
        name = f"games-{self.episodes:05d}.safetensors"
        self.snapshots[name] = model_bytes(self.trainer.learner.weights(), self.episodes)
        self._write_snapshot(name, self.snapshots[name])

    def _write_snapshot(self, name: str, data: bytes) -> None:
        (self.run.folder / "snapshots").mkdir(exist_ok=True)
        write_atomically(self.run.folder / "snapshots" / name, data)

    def _record(self, games: list[records.Game]) -> None:
        """Adds games to those on record, before a table has them: no row is without its record."""
        path, data = self.run.folder / records.FILE, records.encode(games)
        self.recorded += data
        try:
            with evaluations_lock(self.run.folder), path.open("ab") as file:
                file.write(data)
        except OSError as error:
            raise RunError(f"cannot write {path}: {error.strerror}") from error

    def _append(self, name: str, row: str) -> None:
        try:
            self.files[name].write(row.encode() + b"\n")
            self.files[name].flush()
        except OSError as error:
            path = self.run.folder / name
            raise RunError(f"cannot write {path}: {error.strerror}") from error

    def show(self, bar: tqdm, done: bool) -> None:
        """Every few seconds, and at the end: the mean score of the last games, and the speed."""
        now = self.now()
        if now - self.shown_at < 2 and not done:
            return
        steps = self.trainer.agent_steps
        speed = (steps - self.shown_steps) / (now - self.shown_at)
        self.shown_at, self.shown_steps = now, steps
        score = f"{np.mean(self.scores):.1f}" if self.scores else "-"
        bar.set_postfix_str(f"score {score}, {speed:.0f} steps/s, {steps:,} steps")

    def checkpoint_due(self) -> bool:
        return self.now() - self.saved_at >= CHECKPOINT_SECONDS

    def save(self) -> None:
        self.seconds, self.clock = self.now(), time.monotonic()
        self.cpu_seconds, self.cpu_clock = self.cpu_now(), time.process_time()
        self._write_checks(wait=True)
        self._note_memory()
        state = {
            "trainer": self.trainer.get_state(),
            "episodes": self.episodes,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "sessions": self.sessions,
            "scores": self.scores,
            "written": {
                **{name: (self.run.folder / name).read_bytes() for name in LOGS},
                records.FILE: self.recorded,
            },
            "snapshots": self.snapshots,
        }
        checkpoints.save(self.run.state_folder, state)
        self.saved_at = self.now()

    def finish(
        self, stopped: Callable[[], bool], position: int | None, follow: Callable[[], None]
    ) -> None:
        """Publishes the model, plays the final evaluation and marks the run complete."""
        folder, parameters = self.run.folder, self.run.params
        if not self.trainer.learner.updates:
            warnings.warn(
                f"{self.run.name} has learned nothing: its {self.episodes} games are "
                f"{self.trainer.agent_steps:,} agent steps, and learning_starts is "
                f"{parameters.learning_starts:,}",
                stacklevel=2,
            )
        path = self.publish()
        player = evaluation.player_of(load_model(path, parameters), parameters)
        settings, games = params.conditions(parameters), parameters.evaluation_games
        played = []
        with tqdm(
            total=len(settings) * games,
            desc="evaluating",
            leave=False,
            position=position,
            disable=position is None,
            mininterval=2,
        ) as bar:
            for setting in settings:
                for game in evaluation.play(player, setting, games, self.run.seed):
                    played.append(game)
                    bar.update()
                    follow()
                    if stopped():
                        raise KeyboardInterrupt
        store_evaluation(folder, played, self.episodes)
        self.write_provenance()
        self.write_status(COMPLETE)

    def publish(self) -> Path:
        """Writes the model as it is now, for anyone to play with."""
        path = self.run.folder / "model.safetensors"
        write_atomically(path, model_bytes(self.trainer.learner.weights(), self.episodes))
        return path

    def write_status(self, state: str, **more: Any) -> None:
        status = {
            "state": state,
            "episodes_done": self.episodes,
            "episodes": self.run.params.episodes,
            **more,
        }
        text = json.dumps(status, indent=1) + "\n"
        write_atomically(self.run.folder / "status.json", text.encode())

    def write_provenance(self) -> None:
        """Where the run comes from: every stretch of training that has gone into it."""
        self._note_memory()
        provenance = {
            "training_version": TRAINING_VERSION,
            "identity": self.run.params.identity(),
            "device": str(self.trainer.learner.device),
            "learner": self.trainer.learner.kind,
            "agent_steps": self.trainer.agent_steps,
            "updates": self.trainer.learner.updates,
            "wall_clock_seconds": round(self.now(), 1),
            "cpu_seconds": round(self.cpu_now(), 1),
            "resumes": len(self.sessions) - 1,
            "sessions": self.sessions,
        }
        text = json.dumps(provenance, indent=1) + "\n"
        write_atomically(self.run.folder / "provenance.json", text.encode())

    def _note_memory(self) -> None:
        self.sessions[-1]["peak_memory_megabytes"] = round(peak_memory() / 1e6, 1)


def _session(first_episode: int, learner: Learner | NativeLearner) -> dict[str, Any]:
    """What this stretch of training runs on."""
    return {
        "first_episode": first_episode,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in VERSIONED},
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "device": str(learner.device),
        "learner": learner.kind,
    }


def peak_memory() -> int:
    """The most bytes of memory that this process has held at once."""
    if sys.platform == "linux":  # whose ru_maxrss is inherited from the process that started it
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Turns SIGTERM and Ctrl-C into a flag, so that a step is never cut in two."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {
        number: signal.signal(number, lambda received_now, _: received.append(received_now))
        for number in (signal.SIGTERM, signal.SIGINT)
    }
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _row(values: Episode | ValueCheck, columns: list[str]) -> str:
    return ",".join(_text(getattr(values, name)) for name in columns)


def _text(value: float) -> str:
    """The shortest text that reads back as the same number; whole scores without a point."""
    number = float(value)
    return str(int(number)) if number.is_integer() else repr(number)


def _commit() -> str:
    """The project's git commit, with a + if files differ from it; unknown outside git."""
    git = ["git", "-C", str(Path(__file__).parents[1])]
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True)
        if head.returncode:
            return "unknown"
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", "."], capture_output=True)
    except OSError:
        return "unknown"
    return head.stdout.strip() + ("+" if changed.returncode else "")


def processor() -> str:
    """The name of this machine's processor."""
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
