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

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from atari_dqn.params import ParameterError, stored_parameters
from atari_dqn.runs import checkpoints, records, tables
from atari_dqn.runs.dataset import rebuilt_memory
from atari_dqn.runs.files import RunError, model_file
from atari_dqn.runs.models import read_model, trained_games
from atari_dqn.runs.recorder import LOGS, session
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
    run = Run(stored_parameters(folder), folder.resolve().parents[3])
    if run.folder != folder.resolve():
        raise ParameterError(f"{folder}: {run.name} is trained in {run.folder}")
    with run.lock():
        if run.state() == STALE:
            raise RunError(f"{run.name} cannot go on: {'; '.join(run.changes())}")
        if checkpoints.exist(run.state_folder):
            raise RunError(f"{run.name} has a checkpoint in {run.state_folder}: train goes on")
        games = trained_games(path)
        if said := tables.damage(run):
            raise RunError(said)
        played = tables.read(folder, tables.EPISODES)[:games]
        on_record = [game for game in records.read_file(folder) if _within(game, games)]
        recorded = sum(heading["kind"] == records.TRAINING for heading, _ in on_record)
        if not games == len(played) == recorded > 0:
            raise RunError(
                f"{path} is of {games} games; {tables.EPISODES} has {len(played)} of them and "
                f"{records.FILE} {recorded}"
            )
        trainer = _trainer(run, played, path)
        timing = tables.read(folder, tables.TIMING).iloc[games - 1]
        checkpoints.save(
            run.state_folder,
            {
                "trainer": trainer.get_state(),
                "episodes": games,
                "seconds": float(timing.seconds),
                "cpu_seconds": float(timing.cpu_seconds),
                "sessions": [
                    *run.provenance()["sessions"],
                    {**session(games + 1, trainer.learner), "restored": True},
                ],
                "scores": played.score.tail(100).astype(float).tolist(),
                "written": {
                    **{name: _cut(folder, name, games) for name in LOGS},
                    records.FILE: records.with_evaluations(on_record, []),
                },
                "snapshots": {
                    each.name: each.read_bytes()
                    for each in sorted(folder.glob("snapshots/*.safetensors"))
                    if trained_games(each) <= games
                },
            },
        )
    return games


def _within(game: records.Game, games: int) -> bool:
    """Whether it is of training, or of the checks beside it, up to that of so many games."""
    heading, _ = game
    return heading["kind"] != records.EVALUATION and heading["episode"] <= games


def _cut(folder: Path, name: str, games: int) -> bytes:
    """A table's header, and its rows up to that of so many games."""
    rows = int((tables.read(folder, name).episode <= games).sum())
    return b"".join((folder / name).read_bytes().splitlines(keepends=True)[: 1 + rows])


def _trainer(run: Run, played: pd.DataFrame, model: Path) -> Trainer:
    """As it was after the games in `played`, as far as can be told."""
    newest = played.iloc[-1]
    sequence, memory_sequence = np.random.SeedSequence([run.seed, len(played)]).spawn(2)
    trainer = Trainer(run.params, run.agent, int(sequence.generate_state(1)[0]))
    trainer.agent_steps, trainer.frames = int(newest.agent_steps), int(newest.frames)
    trainer.episodes = len(played)
    trainer.means = (float(newest.loss), float(newest.mean_q))
    memory = rebuilt_memory(
        run.folder,
        len(played),
        run.params.replay_capacity,
        memory_sequence,
        run.params.environments,
    )
    trainer.memory.set_state(memory.get_state())
    idle = np.zeros(run.params.environments)
    trainer.memory.append(trainer.envs.planes[-1], idle, idle, idle, idle)  # as a run begins

    trainer.learner.set_weights(read_model(model))
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
    moments = {
        name: torch.tensor(float(updates)) if name.endswith(".step") else value
        for name, value in state["moments"].items()
    }
    return {**state, "moments": moments, "updates": updates}
