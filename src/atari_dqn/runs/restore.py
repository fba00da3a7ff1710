"""Going on with a run whose checkpoint is lost: a new one is made of what the run's folder holds.

A checkpoint is hundreds of megabytes and no result, so a clone has none. Nearly all of it follows
from the results: counters and tables stand in them, the replay memory is what the recorded games
show when they are played again, and the online network is the published model. The rest is made
anew:

    Adam's moments       averaged over batches of that memory, while the weights stand still
    target network       a copy of the online one
    games under way      dropped, and others begun; the random generators have new seeds

So the run goes on as it might have gone, not bit for bit as it would have; its provenance says so.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from atari_dqn.params import ParameterError, stored_parameters
from atari_dqn.runs import checkpoints, dataset, records, tables
from atari_dqn.runs.files import RunError, model_file
from atari_dqn.runs.models import read_model, trained_games
from atari_dqn.runs.recorder import LOGS
from atari_dqn.runs.run import STALE, Run
from atari_dqn.training import Trainer, prepare_process

# Adam's slower average forgets all but 1/e of itself in 1 / (1 - 0.999) = 1,000 updates; after five
# times as many, less than a hundredth of it is left of where it began.
MOMENT_UPDATES = 5_000


def restore(folder: Path) -> int:
    """Makes a checkpoint for the stored run in `folder`; returns after how many games it goes on.

    The folder itself stays as it is. Takes about 15 minutes for a full memory. Raises RunError if
    the run has a checkpoint, is being trained, or does not hold all that is needed, and
    ParameterError if `folder` is none that a run is trained in.
    """
    prepare_process()
    path = model_file(folder)
    place = Path(os.path.abspath(folder))  # links are not followed: the state is found by the name
    run = Run(stored_parameters(folder), Path(*place.parts[:-4]))
    if run.folder != place:
        raise ParameterError(f"{folder}: {run.name} is not trained here but in runs/{run.name}")
    with run.lock():
        if run.state() == STALE:
            raise RunError(f"{run.name} cannot go on: {'; '.join(run.changes())}")
        if checkpoints.exist(run.state_folder):
            raise RunError(f"{run.name} has a checkpoint in {run.state_folder}: train goes on")
        checkpoints.save(run.state_folder, _state(run, path))
    return trained_games(path)


def _state(run: Run, model: Path) -> dict[str, Any]:
    """What `Recorder.save` saves. Raises RunError if something is missing or damaged."""
    if said := tables.damage(run):
        raise RunError(said)
    for name in LOGS:
        if not (run.folder / name).exists():
            raise RunError(f"{run.folder / name} is missing")
    games = trained_games(model)  # the tables of a run that was killed go on from there
    played = tables.read(run.folder, tables.EPISODES)[:games]
    timing = tables.read(run.folder, tables.TIMING)[:games]
    on_record = [game for game in records.read_file(run.folder, torn=True) if _within(game, games)]
    recorded = sum(heading["kind"] == records.TRAINING for heading, _ in on_record)
    if not 0 < games == len(played) == len(timing) == recorded:
        raise RunError(
            f"{model} is of {games} games; {tables.EPISODES} has {len(played)} of them, "
            f"{tables.TIMING} {len(timing)} and {records.FILE} {recorded}"
        )
    *earlier, newest = run.provenance()["sessions"]
    return {
        "trainer": _trainer(run, played, read_model(model)).get_state(),
        "episodes": games,
        "seconds": float(timing.seconds.iloc[-1]),
        "cpu_seconds": float(timing.cpu_seconds.iloc[-1]),
        "sessions": [*earlier, {**newest, "restored_after": games}],
        "scores": played.score.tail(100).astype(float).tolist(),
        "written": {
            **{name: _cut(run.folder, name, games) for name in LOGS},
            records.FILE: records.with_evaluations(on_record, []),
        },
        "snapshots": {
            each.name: each.read_bytes()
            for each in sorted(run.folder.glob("snapshots/*.safetensors"))
            if trained_games(each) <= games
        },
    }


def _within(game: records.Game, games: int) -> bool:
    """Whether it is of training, or of the checks beside it, up to that of so many games."""
    heading, _ = game
    return heading["kind"] != records.EVALUATION and heading["episode"] <= games


def _cut(folder: Path, name: str, games: int) -> bytes:
    """A table's header, and its rows up to that of so many games."""
    rows = sum(tables.read(folder, name)["episode"] <= games)
    return b"".join((folder / name).read_bytes().splitlines(keepends=True)[: 1 + rows])


def _trainer(run: Run, played: pd.DataFrame, weights: dict[str, torch.Tensor]) -> Trainer:
    """As it was after the games in `played`, as far as can be told."""
    newest = played.iloc[-1]
    seed = np.random.SeedSequence([run.seed, len(played)]).generate_state(1)[0]
    trainer = Trainer(run.params, run.agent, int(seed))
    trainer.episodes, trainer.frames = len(played), int(newest.frames)
    # those of games that were under way have been learned from too
    trainer.agent_steps = max(int(newest.agent_steps), run.provenance()["agent_steps"])
    trainer.means = (float(newest.loss), float(newest.mean_q))

    dataset.fill(trainer.memory, run.folder, len(played))
    idle = np.zeros(run.params.environments)
    trainer.memory.append(trainer.envs.planes[-1], idle, idle, idle, idle)  # as a run begins

    trainer.learner.set_weights(weights)
    state = trainer.learner.get_state()
    trainer.learner.set_state({**state, "target": state["online"]})
    steps = trainer.agent_steps - run.params.learning_starts
    updates = max(0, steps // run.params.update_period)
    if updates:
        trainer.learner.set_state(_with_moments(trainer, updates))
    return trainer


def _with_moments(trainer: Trainer, updates: int) -> dict[str, Any]:
    """The learner's state after so many updates, with Adam's moments at the present weights."""
    learner = trainer.learner
    learner.set_learning_rate(0.0)
    count = min(updates, MOMENT_UPDATES)
    for _ in tqdm(range(count), "Adam's moments", leave=False, unit=" updates", disable=None):
        learner.learn(trainer.memory.sample(trainer.params.batch_size))
    state = learner.get_state()
    # A step says how far the averages are from their beginning at zero: `count` updates, or so many
    # that it no longer matters.
    moments = {
        name: torch.tensor(float(updates)) if name.endswith(".step") else value
        for name, value in state["moments"].items()
    }
    return {**state, "moments": moments, "updates": updates}
