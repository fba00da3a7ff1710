"""What a whole training process costs with a memory that is nearly empty, and with a full one.

    python benchmarks/whole_run.py [--transitions 100000 1000000] [--steps 8000]

For each size, the Double DQN of params/boxing_final.yaml, one thread, in a process of its own: its
replay memory is filled with real games of random play (20,000 transitions of them, over and over),
without learning; then agent steps of
`Trainer.run`, learning included, are timed, and so is writing a checkpoint of the whole trainer
(median of three). Another process goes on from it, which times its loading. Writes whole_run.csv
into results/benchmarks/; resident_megabytes is the most that either process ever held. Checkpoints
go to TMPDIR, which should be on a disk.
"""

import argparse
import multiprocessing
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from atari_dqn import params
from atari_dqn.params import Parameters
from atari_dqn.runs import checkpoints, recorder
from atari_dqn.runs.files import project_root
from atari_dqn.training import Trainer, prepare_process

WARM_UP = 800  # agent steps that are not timed
SAVES = 3
PLAYED = 20_000  # transitions of real games that a memory is filled with


def fill(trainer: Trainer, transitions: int) -> None:
    """Random play until the memory holds that many transitions, from some point on the same games
    over and over. The trainer's own count of agent steps stays 0: updates are due by it, and must
    not pile up."""
    envs, memory = trainer.envs, trainer.memory
    rng, played = np.random.default_rng(0), []
    wanted = transitions // memory.streams - 1  # the trainer has stored the first images
    for _ in range(min(wanted, PLAYED // memory.streams)):
        actions = rng.integers(envs.actions, size=memory.streams)
        step = envs.step(actions)
        played.append((step.images.copy(), step.ages, actions, step.rewards, step.terminated))
        memory.append(*played[-1])
    images, ages, *rest = played[0]
    again = [(images, np.zeros_like(ages), *rest), *played[1:]]  # games that begin there
    for number in range(len(played), wanted):
        memory.append(*again[number % len(again)])


def train(
    parameters: Parameters, transitions: int, timed: int, folder: Path
) -> dict[str, float | int]:
    """Trains beside a memory of that size, and leaves checkpoints in `folder`."""
    prepare_process()
    trainer = Trainer(parameters, parameters.agents[0], seed=1)
    fill(trainer, transitions)
    stored = len(trainer.memory)
    steps = trainer.run()
    while trainer.agent_steps < WARM_UP:
        next(steps)
    before, start = trainer.agent_steps, time.perf_counter()
    while trainer.agent_steps < before + timed:
        next(steps)
    speed = (trainer.agent_steps - before) / (time.perf_counter() - start)
    if trainer.learner.updates != trainer.agent_steps // parameters.update_period:
        raise SystemExit("the updates made are not those that a run makes")
    saving = []
    for _ in range(SAVES):
        start = time.perf_counter()
        checkpoints.save(folder, {"trainer": trainer.get_state()})
        saving.append(time.perf_counter() - start)
    newest = max(folder.glob("checkpoint-*"))
    seconds = float(np.median(saving))
    return {
        "transitions": stored,
        "steps_per_second": round(speed, 1),
        "checkpoint_seconds": round(seconds, 2),
        "checkpoint_megabytes": round(sum(f.stat().st_size for f in newest.iterdir()) / 1e6, 1),
        "checkpoint_share_of_time": round(seconds / (recorder.CHECKPOINT_SECONDS + seconds), 4),
        "resident_megabytes": round(recorder.peak_memory() / 1e6, 1),
    }


def resume(parameters: Parameters, folder: Path) -> dict[str, float]:
    """Goes on from the newest checkpoint, in the order in which a run does."""
    prepare_process()
    start = time.perf_counter()
    saved = checkpoints.load(folder)
    loading = time.perf_counter() - start
    assert saved is not None
    trainer = Trainer(parameters, parameters.agents[0], seed=1)  # a new run's start costs it too
    start = time.perf_counter()
    trainer.set_state(saved["trainer"])
    loading += time.perf_counter() - start
    next(trainer.run())
    return {
        "load_seconds": round(loading, 2),
        "resident_megabytes": round(recorder.peak_memory() / 1e6, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transitions", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--steps", type=int, default=8000, help="agent steps timed")
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    # Learning from the first step: what a run stores before it, `fill` has stored.
    changes = {"agents": ["double_dqn"], "learning_starts": 0, "device": "cpu"}
    parameters = params.load(project_root() / "params" / "boxing_final.yaml", changes)
    context = multiprocessing.get_context("spawn")
    rows = []
    # a process a task, since the peak of its memory is a process's whole life's
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        for transitions in chosen.transitions:
            with tempfile.TemporaryDirectory() as temporary:
                folder = Path(temporary)
                trained = pool.submit(train, parameters, transitions, chosen.steps, folder).result()
                resumed = pool.submit(resume, parameters, folder).result()
            peak = max(trained["resident_megabytes"], resumed["resident_megabytes"])
            rows.append({**trained, **resumed, "resident_megabytes": peak})
            print(rows[-1], flush=True)
    chosen.output.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).assign(processor=recorder.processor()).to_csv(
        chosen.output / "whole_run.csv", index=False
    )


if __name__ == "__main__":
    main()
