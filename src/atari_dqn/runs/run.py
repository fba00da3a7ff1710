"""A run's folder: what training leaves behind (`tables` reads the tables among it).

    runs/<experiment>/<agent>/seed-<n>/
        params.yaml         every parameter, resolved
        episodes.csv        a row per training game (training.Episode); the same bytes every time
        timing.csv          episode; seconds of training so far, by the clock and of the
                            processor; not reproducible
        values.csv          a row every 100 games: predicted and realised values
                            (evaluation.ValueCheck)
        evaluations.csv     a row per game of greedy play (evaluation.EvaluationEpisode, and the
                            games of training behind the model)
        games.jsonl.zst     what every game of these tables can be played again from (`records`)
        model.safetensors   the online network, float16, as of the last checkpoint
        snapshots/          the same after the games that `snapshot_games` names
        status.json         state, episodes_done, episodes
        provenance.json     commit, versions, processor, wall-clock, resumes
        tensorboard/        what TensorBoard shows of all this, if it was asked for; no result

Checkpoints are working state and live elsewhere (`state_folder`); they hold the logs too, so that
a run resumes even where its folder was lost.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from atari_dqn import params
from atari_dqn.params import TRAINING_VERSION, ParameterError, Parameters, shown, stored_parameters
from atari_dqn.runs import checkpoints
from atari_dqn.runs.files import RunError, read_bytes

if TYPE_CHECKING:  # it takes half a second to import
    import pandas as pd

COMPLETE, RUNNING, INTERRUPTED, FAILED = "complete", "running", "interrupted", "failed"
MISSING, STALE = "missing", "stale"
# What everybody reads of these files
SAYS: dict[str, dict[str, type]] = {
    "status.json": {"state": str, "episodes_done": int},
    "provenance.json": {
        **{"training_version": int, "identity": str, "agent_steps": int, "resumes": int},
        "sessions": list,
    },
}
# And of each of the sessions
SESSION: dict[str, type] = {
    **{"started": str, "commit": str, "processor": str, "device": str, "versions": dict},
}
MOST_SAID = 10**15  # no run counts as far
MAY_SAY: dict[str, type] = {"peak_memory_megabytes": float, "restored_after": int}
RESTART = "--restart (make: RESTART=1) begins again, and keeps what is stored in a folder beside"


@dataclass(frozen=True)
class Run:
    """One agent trained from one seed; `params` lists just these two."""

    params: Parameters
    results: Path
    variation: str = ""  # what it changes of its experiment, if it does

    def __post_init__(self) -> None:
        source = self.params.initial_weights
        if source == self.params.experiment:
            raise ParameterError(
                f"{self.name}: initial_weights: {source!r} is not allowed: "
                "a run cannot start from its own model"
            )

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
    def experiment(self) -> str:
        """The name of the experiment that it is of, or that it changes."""
        return self.params.experiment.partition("+")[0]

    @property
    def title(self) -> str:
        """The experiment's name for people: "boxing_final", "boxing_final: gamma 0.5"."""
        return f"{self.experiment}: {self.variation}" if self.variation else self.experiment

    @property
    def folder(self) -> Path:
        return self.results / "runs" / self.name

    @property
    def styles(self) -> Path:
        """What `styles.measure` finds in the run's records: a file beside the runs, which are left
        as training wrote them."""
        return self.results / "styles" / f"{self.name}.csv"

    @property
    def robustness(self) -> Path:
        """What `robustness.measure` finds, likewise."""
        return self.results / "robustness" / f"{self.name}.csv"

    @property
    def state_folder(self) -> Path:
        """Where checkpoints live: $ATARI_DQN_STATE, by default within the results folder."""
        root = os.environ.get("ATARI_DQN_STATE") or self.results / "state"
        version = f"{self.params.identity()[:8]}-v{TRAINING_VERSION}"
        return Path(root) / self.params.profile / f"{self.name}-{version}"

    def state(self) -> str:
        """complete, running, interrupted, failed, missing or stale."""
        if not (self.folder / "status.json").exists():
            return RUNNING if self.folder.exists() and self._locked() else MISSING
        if self.changes():
            return STALE
        status = self.status()
        if status["state"] == COMPLETE and status["episodes_done"] < self.params.episodes:
            return INTERRUPTED  # complete once, and more games are wanted now
        if status["state"] == RUNNING and not self._locked():
            return INTERRUPTED  # killed without a chance to say so
        return status["state"]

    def source(self) -> "Run | None":
        """The run whose model this one starts from, if any; as it is stored, if it is."""
        if not self.params.initial_weights:
            return None
        like = self.params.model_copy(
            update={"experiment": self.params.initial_weights, "initial_weights": ""}
        )
        path = Run(like, self.results).folder / "params.yaml"
        stored = stored_parameters(path.parent) if path.exists() else like
        return Run(stored, self.results)

    def waits_for(self) -> "Run | None":
        """The run that must be complete before this one can start, if it is not."""
        source = self.source()
        if source is None or source.state() == COMPLETE or self.state() != MISSING:
            return None
        return source

    def status(self) -> dict[str, Any]:
        """What status.json holds. Raises RunError if it is damaged, as `provenance` does."""
        return stored_json(self.folder, "status.json")

    def provenance(self) -> dict[str, Any]:
        """Where the stored run comes from."""
        return stored_json(self.folder, "provenance.json")

    def changes(self) -> list[str]:
        """How the stored run differs from what `params` ask for now; empty if it matches."""
        provenance, changes = self.provenance(), []
        if provenance["training_version"] != TRAINING_VERSION:
            was = provenance["training_version"]
            changes.append(f"training version {was}, now {TRAINING_VERSION}")
        if provenance["identity"] != self.params.identity():
            stored = params.read_values(self.folder / "params.yaml")
            wanted = self.params.model_dump(exclude=params.NOT_TRAINING)
            different = [
                f"{key} was {stored.get(key)!r}, now {value!r}"
                for key, value in wanted.items()
                if stored.get(key) != value
            ]
            changes += different or ["identity"]
        source, began_with = self.source(), provenance["sessions"][0].get("initial_weights")
        if source is not None and began_with and source.state() == COMPLETE:
            model = read_bytes(source.folder / "model.safetensors")
            if hashlib.sha256(model).hexdigest() != began_with:
                changes.append(f"{source.name} has another model now")
        return changes

    @contextmanager
    def lock(self, *folders: Path, patience: float = 1.0) -> Iterator[None]:
        """Held while the run is trained; raises RunError if another process holds it and does not
        let go within `patience` seconds.

        Both its folders are locked, since either may be shared without the other, or `folders`.
        """
        try:
            with ExitStack() as stack:
                for folder in folders or (self.folder, self.state_folder):
                    folder.mkdir(parents=True, exist_ok=True)
                    stack.enter_context(FileLock(folder / ".lock", timeout=patience))
                yield
        except Timeout:
            raise RunError(f"{self.name} is being trained by another process") from None

    def back_up(self) -> Path | None:
        """Moves what is stored of a run that cannot be continued here, because it is stale or has
        no checkpoint that is whole, and its checkpoints, to folders beside their own; returns
        where the first went, None if nothing was moved.
        """
        state, stored = self.state(), [self.folder, self.state_folder]
        if state in (COMPLETE, RUNNING) or not any(map(_contents, stored)):
            return None
        if state != STALE and checkpoints.exist(self.state_folder):
            return None
        with self.lock():
            if self.state() == COMPLETE:
                return None  # by now
            # The checkpoints first: left behind, they would be the new run's, whose parameters
            # are the same.
            moved = [_move_away(folder) for folder in reversed(stored) if _contents(folder)]
            return moved[-1]

    def _locked(self) -> bool:
        try:
            with FileLock(self.folder / ".lock", timeout=0):
                return False
        except Timeout:
            return True
        except OSError:  # a folder that cannot be written to: nobody trains there
            return False


def stored_json(folder: Path, name: str) -> dict[str, Any]:
    """What status.json or provenance.json of a run's folder holds. Raises RunError if it is
    missing, or does not say what every such file says."""
    path = folder / name
    try:
        values = json.loads(read_bytes(path))
        _check_says(values, SAYS[name])
        if values.get("state", COMPLETE) not in (COMPLETE, RUNNING, INTERRUPTED, FAILED):
            raise ValueError(f"state: {shown(values['state'])} is none that a run can be in")
        if name == "provenance.json":
            _check_sessions(values["sessions"])
    except (OSError, ValueError, RecursionError) as error:
        raise RunError(
            f"{path} is missing or damaged ({error}); restore it, or move {folder} away: "
            "a run that has a checkpoint comes back whole"
        ) from None
    return values


def _check_sessions(sessions: list[Any]) -> None:
    """Raises ValueError unless a run's sessions say what everybody reads of them."""
    if not sessions:
        raise ValueError("sessions: there is none, and every run begins with one")
    for session in sessions:
        _check_says(session, SESSION)
        _check_says(session, {key: kind for key, kind in MAY_SAY.items() if key in session})
        _check_says(session["versions"], {"ale-py": str})
        if datetime.fromisoformat(session["started"]).tzinfo is None:
            raise ValueError(f"started: {shown(session['started'])} should say its time zone")


def _check_says(values: Any, kinds: dict[str, type]) -> None:
    """Raises ValueError unless `values` has these keys, with values of these kinds; no number that
    a run stores is negative or infinite."""
    if not isinstance(values, dict):
        raise ValueError(f"{shown(values)} is no mapping")
    for key, kind in kinds.items():
        value = values.get(key)
        if type(value) is not kind:
            raise ValueError(f"{key}: {shown(value)} should be a {kind.__name__}")
        if kind in (int, float) and not 0 <= values[key] <= MOST_SAID:
            raise ValueError(f"{key}: {shown(value)} should be from 0 to {MOST_SAID}")


def _contents(folder: Path) -> list[Path]:
    """What a run's folder holds besides its lock."""
    return [path for path in folder.glob("*") if path.name != ".lock"]


def _move_away(folder: Path) -> Path:
    """Moves what a locked folder holds to the next free <folder>.aside-<n>, and returns that."""
    number = 1
    while (aside := folder.with_name(f"{folder.name}.aside-{number}")).exists():
        number += 1
    aside.mkdir()
    for path in _contents(folder):
        path.rename(aside / path.name)
    return aside


def runs_of(parameters: Parameters, results: Path) -> list[Run]:
    """A run for every variation, seed and agent of an experiment."""
    return [
        Run(params.pick(variant, agent, seed), results, label if parameters.variations else "")
        for label, variant in params.variants(parameters).items()
        for seed in parameters.seeds
        for agent in parameters.agents
    ]


def as_trained(table: "pd.DataFrame", parameters: Parameters) -> "pd.DataFrame":
    """The evaluation games in a table that were played as `parameters` train and evaluate."""
    if table.empty:
        return table
    return table[
        (table.difficulty == parameters.difficulty)
        & (table.sticky_actions == parameters.sticky_actions)
        & (table.epsilon == parameters.evaluation_epsilon)
    ]
