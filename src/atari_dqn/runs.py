"""A run's folder: what training leaves behind, and reading it back as tidy tables.

    runs/<experiment>/<agent>/seed-<n>/
        params.yaml         every parameter, resolved
        episodes.csv        a row a training game (training.Episode); the same bytes every time
        timing.csv          episode, seconds of training so far; not reproducible
        values.csv          a row every 100 games: predicted and realised values
                            (evaluation.ValueCheck)
        evaluations.csv     a row a game of greedy play (evaluation.PlayedGame)
        model.safetensors   the online network, float16
        snapshots/          the same after the games that `snapshot_games` names
        status.json         state, episodes_done, episodes
        provenance.json     commit, versions, processor, wall-clock, resumes

Checkpoints are working state and live elsewhere (`state_folder`); they hold the logs too, so that
a run resumes even where its folder was lost.
"""

import json
import os
import platform
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from filelock import FileLock, Timeout
from tqdm import tqdm

from atari_dqn import checkpoints, evaluation, params
from atari_dqn.agents import AGENTS
from atari_dqn.evaluation import PlayedGame, ValueCheck
from atari_dqn.params import TRAINING_VERSION, ParameterError, Parameters
from atari_dqn.training import Episode, Trainer, prepare_process

CHECKPOINT_SECONDS = 900.0  # training time between checkpoints
COMPLETE, RUNNING, INTERRUPTED, FAILED = "complete", "running", "interrupted", "failed"
MISSING, STALE = "missing", "stale"
VERSIONED = ("torch", "numpy", "ale-py", "gymnasium", "opencv-python-headless", "zstandard")
LOGS = {
    "episodes.csv": [field.name for field in fields(Episode)],
    "timing.csv": ["episode", "seconds"],
    "values.csv": [field.name for field in fields(ValueCheck)],
}
VALUES_PERIOD = 100  # games between rows of values.csv


class RunError(RuntimeError):
    """A run that cannot be trained; the message is one line, fit to be shown to a user."""


def project_root() -> Path:
    """The folder with pyproject.toml at or above the working folder, else the package's own."""
    for folder in (Path.cwd(), *Path.cwd().parents, *Path(__file__).parents):
        if (folder / "pyproject.toml").exists() and (folder / "params").is_dir():
            return folder
    raise RunError("no project folder (pyproject.toml and params/) at or above the working folder")


def results_folder(profile: str, results: Path | str | None = None) -> Path:
    """Where results go: `results`, or the project's own folder for a profile's."""
    if results is not None:
        return Path(results)
    folder = project_root() / "results"
    return folder if profile == "full" else folder / profile


@dataclass(frozen=True)
class Run:
    """One agent trained from one seed; `params` lists just these two."""

    params: Parameters
    results: Path

    @property
    def agent(self) -> str:
        return self.params.agents[0]

    @property
    def seed(self) -> int:
        return self.params.seeds[0]

    @property
    def name(self) -> str:
        return f"{self.params.experiment}/{self.agent}/seed-{self.seed}"

    @property
    def folder(self) -> Path:
        return self.results / "runs" / self.name

    @property
    def state_folder(self) -> Path:
        """Where checkpoints live: $ATARI_DQN_STATE, by default within the results folder."""
        root = os.environ.get("ATARI_DQN_STATE") or self.results / "state"
        version = f"{self.params.identity()[:8]}-v{TRAINING_VERSION}"
        return Path(root) / self.params.profile / f"{self.name}-{version}"

    def state(self) -> str:
        """complete, running, interrupted, failed, missing or stale."""
        if not (self.folder / "status.json").exists():
            return MISSING
        if self.changes():
            return STALE
        status = self.status()
        if status["state"] == COMPLETE and status["episodes_done"] < self.params.episodes:
            return INTERRUPTED  # complete once, and more games are wanted now
        if status["state"] == RUNNING and not self._locked():
            return INTERRUPTED  # killed without a chance to say so
        return status["state"]

    def status(self) -> dict[str, Any]:
        return json.loads((self.folder / "status.json").read_bytes())

    def changes(self) -> list[str]:
        """How the stored run differs from what `params` ask for now; empty if it matches."""
        provenance = json.loads((self.folder / "provenance.json").read_bytes())
        changes = []
        if provenance["training_version"] != TRAINING_VERSION:
            was = provenance["training_version"]
            changes.append(f"training version {was}, now {TRAINING_VERSION}")
        if provenance["identity"] != self.params.identity():
            stored = params.read_values(self.folder / "params.yaml")
            wanted = self.params.model_dump(exclude=params.NOT_TRAINING)
            changes += [
                f"{key} was {stored.get(key)!r}, now {value!r}"
                for key, value in wanted.items()
                if stored.get(key) != value
            ]
        return changes

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Held while the run is trained; raises RunError if another process holds it."""
        self.state_folder.mkdir(parents=True, exist_ok=True)
        try:
            with FileLock(self.state_folder / "lock", timeout=1):
                yield
        except Timeout:
            raise RunError(f"{self.name} is being trained by another process") from None

    def _locked(self) -> bool:
        try:
            with FileLock(self.state_folder / "lock", timeout=0):
                return False
        except (Timeout, OSError):
            return (self.state_folder / "lock").exists()


def runs_of(parameters: Parameters, results: Path) -> list[Run]:
    """A run for every agent and seed of an experiment."""
    return [
        Run(params.pick(parameters, agent, seed), results)
        for seed in parameters.seeds
        for agent in parameters.agents
    ]


def train(run: Run, position: int = 0) -> str:
    """Trains a run to its end, resuming it if it was interrupted; returns what happened.

    SIGTERM and Ctrl-C save a checkpoint, leave the run `interrupted` and raise KeyboardInterrupt.
    `position` is the progress bar's line. Raises RunError if the stored run does not match.
    """
    prepare_process()
    with run.lock():
        before = run.state()
        if before == STALE:
            raise RunError(
                f"{run.folder} holds a run that no longer matches: {'; '.join(run.changes())}; "
                "move it away to train anew"
            )
        if before == COMPLETE:
            return f"{run.name} is complete: {run.status()['episodes_done']} games"
        recorder = _Recorder(run)
        try:
            with _stop_signals() as stopped:
                _play_and_learn(recorder, stopped, position)
                recorder.finish(stopped)
        except KeyboardInterrupt:
            recorder.write_status(INTERRUPTED)
            raise
        except Exception as error:
            recorder.write_status(FAILED, error=f"{type(error).__name__}: {error}")
            raise
        return f"{run.name} is complete: {recorder.episodes} games"


def _play_and_learn(recorder: "_Recorder", stopped: Callable[[], bool], position: int) -> None:
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
        mininterval=2,
        dynamic_ncols=True,
    ) as bar:
        for episode in recorder.trainer.run():
            if episode is not None:
                recorder.log(episode)
                bar.update()
            recorder.show(bar, episode)
            done = recorder.episodes >= run.params.episodes
            if done or stopped() or recorder.checkpoint_due():
                recorder.save()
            if stopped():
                raise KeyboardInterrupt
            if done:
                return


class _Recorder:
    """Writes what a trainer does into the run's folder, and resumes both together."""

    def __init__(self, run: Run):
        self.run = run
        self.trainer = Trainer(run.params, run.agent, run.seed)
        self.episodes, self.seconds, self.resumes = 0, 0.0, 0
        self.scores: list[float] = []
        saved = checkpoints.load(run.state_folder)
        run.folder.mkdir(parents=True, exist_ok=True)
        if saved is None:
            written = {name: ",".join(header) + "\n" for name, header in LOGS.items()}
        else:
            self.trainer.set_state(saved["trainer"])
            self.episodes, self.seconds = saved["episodes"], saved["seconds"]
            self.resumes = saved["resumes"] + 1
            self.scores = saved["scores"]
            written = saved["written"]
        self.files = {}
        for name in LOGS:  # what was logged after the checkpoint will be logged again
            path = run.folder / name
            path.write_text(written[name], encoding="utf-8")
            self.files[name] = path.open("a", encoding="utf-8")
        self.snapshots: dict[str, bytes] = saved["snapshots"] if saved else {}
        for name, data in self.snapshots.items():
            self._write_snapshot(name, data)
        params.dump(run.params, run.folder / "params.yaml")
        self.clock = time.monotonic()
        self.saved_at = self.shown_at = self.seconds
        self.shown_steps = self.trainer.agent_steps
        self.write_provenance()
        self.write_status(RUNNING)

    def now(self) -> float:
        """Seconds of training so far, all sessions."""
        return self.seconds + time.monotonic() - self.clock

    def log(self, episode: Episode) -> None:
        self.episodes = episode.episode
        self._append("episodes.csv", _row(episode))
        self._append("timing.csv", f"{episode.episode},{self.now():.1f}")
        if episode.episode % VALUES_PERIOD == 0:
            self._check_values()
        if episode.episode in self.run.params.snapshot_games:
            self._take_snapshot()
        self.scores = [*self.scores[-99:], episode.score]
        self.write_status(RUNNING)

    def _check_values(self) -> None:
        network, parameters = self.trainer.learner.online, self.run.params
        check = evaluation.check_values(
            network, parameters, self.held_out, self.episodes, self.run.seed
        )
        self._append("values.csv", _row(check))

    @cached_property
    def held_out(self) -> np.ndarray:
        return evaluation.held_out_states(self.run.params)

    def _take_snapshot(self) -> None:
        name = f"games-{self.episodes:05d}.safetensors"
        self.snapshots[name] = evaluation.model_bytes(self.trainer.learner.online)
        self._write_snapshot(name, self.snapshots[name])

    def _write_snapshot(self, name: str, data: bytes) -> None:
        (self.run.folder / "snapshots").mkdir(exist_ok=True)
        (self.run.folder / "snapshots" / name).write_bytes(data)

    def _append(self, name: str, row: str) -> None:
        self.files[name].write(row + "\n")
        self.files[name].flush()

    def show(self, bar: tqdm, episode: Episode | None) -> None:
        """Every few seconds: the mean score of the last games, and the speed."""
        now = self.now()
        if now - self.shown_at < 2:
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
        state = {
            "trainer": self.trainer.get_state(),
            "episodes": self.episodes,
            "seconds": self.seconds,
            "resumes": self.resumes,
            "scores": self.scores,
            "written": {name: (self.run.folder / name).read_text("utf-8") for name in LOGS},
            "snapshots": self.snapshots,
        }
        checkpoints.save(self.run.state_folder, self.trainer.agent_steps, state)
        self.saved_at = self.now()

    def finish(self, stopped: Callable[[], bool]) -> None:
        """Publishes the model, plays the final evaluation and marks the run complete."""
        folder, parameters = self.run.folder, self.run.params
        path = folder / "model.safetensors"
        path.write_bytes(evaluation.model_bytes(self.trainer.learner.online))
        network = evaluation.load_model(path, parameters)
        played = []
        games = evaluation.play(network, parameters, parameters.evaluation_games, self.run.seed)
        for game in tqdm(
            games, total=parameters.evaluation_games, desc="evaluating", leave=False, mininterval=2
        ):
            played.append(game)
            if stopped():
                raise KeyboardInterrupt
        store_evaluation(folder, played)
        self.write_provenance()
        self.write_status(COMPLETE)

    def write_status(self, state: str, **more: Any) -> None:
        status = {
            "state": state,
            "episodes_done": self.episodes,
            "episodes": self.run.params.episodes,
            **more,
        }
        write_atomically(self.run.folder / "status.json", json.dumps(status, indent=1) + "\n")

    def write_provenance(self) -> None:
        provenance = {
            "commit": _commit(),
            "training_version": TRAINING_VERSION,
            "identity": self.run.params.identity(),
            "python": platform.python_version(),
            "versions": {name: version(name) for name in VERSIONED},
            "processor": _processor(),
            "cores": os.cpu_count(),
            "threads": torch.get_num_threads(),
            "device": str(self.trainer.learner.device),
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "agent_steps": self.trainer.agent_steps,
            "updates": self.trainer.learner.updates,
            "wall_clock_seconds": round(self.now(), 1),
            "resumes": self.resumes,
        }
        text = json.dumps(provenance, indent=1) + "\n"
        write_atomically(self.run.folder / "provenance.json", text)


@contextmanager
def _stop_signals() -> Iterator[Callable[[], bool]]:
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


def evaluate(
    folder: Path, overrides: dict[str, Any], games: int | None = None, video: Path | None = None
) -> pd.DataFrame:
    """Plays a stored run's model, stores the games in its evaluations.csv and returns them.

    `overrides` replace parameters of the run (difficulty, sticky_actions, evaluation_epsilon).
    With `video`, game 0 is filmed too. Raises RunError or ParameterError on bad input.
    """
    prepare_process()
    if not (folder / "model.safetensors").exists():
        raise RunError(f"{folder}: no model.safetensors here; is this a finished run's folder?")
    values = params.read_values(folder / "params.yaml")
    parameters = params.parse({**values, **overrides}, str(folder / "params.yaml"))
    games = games or parameters.evaluation_games
    network = evaluation.load_model(folder / "model.safetensors", parameters)
    seed = parameters.seeds[0]
    playing = evaluation.play(network, parameters, games, seed)
    played = list(tqdm(playing, total=games, desc="evaluating", unit="game", mininterval=2))
    store_evaluation(folder, played)
    if video is not None:
        evaluation.film(network, parameters, video, 0, seed)
    return pd.DataFrame([asdict(game) for game in played]).sort_values("game", ignore_index=True)


def store_evaluation(folder: Path, played: list[PlayedGame]) -> None:
    """Adds games to evaluations.csv; earlier ones of the same settings are replaced."""
    path = folder / "evaluations.csv"
    table = pd.DataFrame([asdict(game) for game in played]).sort_values("game")
    settings = ["difficulty", "sticky_actions", "epsilon", "seed"]
    if path.exists():
        earlier = pd.read_csv(path)
        kept = ~(earlier[settings] == table[settings].iloc[0]).all(axis=1)
        if kept.any():
            table = pd.concat([earlier[kept], table])
    write_atomically(path, table.to_csv(index=False))


def write_atomically(path: Path, text: str) -> None:
    """Readers see the old file or the new one, never a part."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def read_table(runs: list[Run], name: str) -> pd.DataFrame:
    """One table of all runs' `name` (episodes.csv, ...), with experiment, agent and seed."""
    tables = [
        pd.read_csv(run.folder / name).assign(
            experiment=run.params.experiment, agent=run.agent, seed=run.seed
        )
        for run in runs
        if (run.folder / name).exists()
    ]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def title(agent: str) -> str:
    """An agent's name as the report writes it."""
    return AGENTS[agent].title


def _row(record: Episode | ValueCheck) -> str:
    return ",".join(_text(getattr(record, field.name)) for field in fields(record))


def _text(value: float) -> str:
    """The shortest text that reads back as the same number; whole scores without a point."""
    number = float(value)
    return str(int(number)) if number.is_integer() else repr(number)


def _commit() -> str:
    """The project's git commit, with a + if files differ from it; unknown outside git."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True)
        if head.returncode:
            return "unknown"
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", "."], capture_output=True)
    except OSError:
        return "unknown"
    return head.stdout.strip() + ("+" if changed.returncode else "")


def _processor() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


__all__ = ["ParameterError", "Run", "RunError", "evaluate", "read_table", "runs_of", "train"]
