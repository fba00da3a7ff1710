"""What the records of a run are good for as data: how fast its games are played again, and what an
agent learns that only watches them.

    python benchmarks/records.py results/runs/boxing_final/double_dqn/seed-1 [--updates 50000]

Writes records.json into results/benchmarks/ (games played again per second, with their images and
by the emulator alone), and watching.csv: an agent of the same kind, from new random weights, is
trained on the run's newest transitions, without a game of its own; a row per greedy game along the
way, which only tests it.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from atari_dqn import evaluation
from atari_dqn.agents import AGENTS
from atari_dqn.envs import EpisodeRecord, make_env
from atari_dqn.native import new_learner
from atari_dqn.params import Parameters, stored_parameters
from atari_dqn.runs import dataset, records
from atari_dqn.runs.files import project_root
from atari_dqn.runs.recorder import processor
from atari_dqn.training import prepare_process

GAMES = 20  # to measure the speed with, and greedy ones at every check
TRANSITIONS = 200_000
SEED = 100  # of the weights and of the sampling; not that of any run
CHECKS = 10


def speeds(params: Parameters, games: list[EpisodeRecord]) -> dict[str, Any]:
    """Games per second of processor time, in two ways that take turns."""
    seconds = {"with_images": 0.0, "emulator_alone": 0.0}
    for record in games:
        start = time.process_time()
        dataset.trajectory(params, record)
        seconds["with_images"] += time.process_time() - start
        start = time.process_time()
        env, _ = records.begin(params, record)
        for action in record.actions:
            for _ in range(params.frame_skip):
                env.ale.act(env.actions[action])
        seconds["emulator_alone"] += time.process_time() - start
    steps = sum(len(record.actions) for record in games)
    rates = {name: round(len(games) / spent, 3) for name, spent in seconds.items()}
    return {**rates, "agent_steps_per_game": round(steps / len(games), 1)}


def watch(folder: Path, updates: int) -> Iterator[dict[str, Any]]:
    """Trains on the run's newest transitions; yields a row per greedy game."""
    params = stored_parameters(folder)
    last = pd.read_csv(folder / "episodes.csv").episode.max()
    memory = dataset.rebuilt_memory(folder, int(last), TRANSITIONS, SEED)
    env = make_env(params)
    learner = new_learner(AGENTS[params.agents[0]], len(env.actions), params, seed=SEED)
    for update in range(updates + 1):
        if update % (updates // CHECKS) == 0:
            for game in evaluation.play(learner.q_values, params, GAMES, SEED):
                opening = env.facts.opening(game.record.idle_frames)
                yield {
                    "update": update,
                    "game": game.game,
                    "opening": opening,
                    "score": game.score,
                }
        learner.learn(memory.sample(params.batch_size))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--updates", type=int, default=50_000)
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    if chosen.updates < CHECKS:
        parser.error(f"--updates {chosen.updates}: at least {CHECKS}")
    prepare_process()
    params = stored_parameters(chosen.run)
    games = [
        record
        for heading, record in records.read_file(chosen.run)
        if heading["kind"] == records.TRAINING
    ]
    measured = {
        "experiment": params.experiment,
        "agent": params.agents[0],
        "seed": params.seeds[0],
        "processor": processor(),
        "transitions": TRANSITIONS,
        **speeds(params, games[-GAMES:]),
    }
    (chosen.output / "records.json").write_text(json.dumps(measured, indent=1) + "\n")
    print(measured, flush=True)
    rows = []
    for row in watch(chosen.run, chosen.updates):
        rows.append(row)
        if len(rows) % GAMES == 0:
            newest = np.mean([each["score"] for each in rows[-GAMES:]])
            print(f"{row['update']:,} updates: {newest:.1f}", flush=True)
            pd.DataFrame(rows).to_csv(chosen.output / "watching.csv", index=False)


if __name__ == "__main__":
    main()
