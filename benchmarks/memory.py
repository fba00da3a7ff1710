"""What a million remembered transitions cost: resident memory, and the time to store and sample.

    python benchmarks/memory.py [--transitions 1000000]

Fills the replay memory with real games of random play, each game in a process of its own, and
writes memory.csv into results/benchmarks/: a row for every tenth, with the growth of the process's
resident memory, bytes an image, milliseconds to store a vector step of eight games, and
milliseconds to sample and unpack a batch of 32.
"""

import argparse
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
import psutil

from atari_dqn.envs import VectorEnv
from atari_dqn.params import Parameters
from atari_dqn.replay import ReplayMemory
from atari_dqn.runs.files import project_root
from atari_dqn.training import prepare_process

GAMES = ("boxing", "breakout")
BATCH, SAMPLES = 32, 200


def fill(game: str, transitions: int) -> list[dict[str, object]]:
    """Plays until the memory holds that many transitions; a row for every tenth."""
    prepare_process()
    parameters = Parameters(experiment="memory", game=game, replay_capacity=transitions)
    seeds = np.random.SeedSequence(0).spawn(2)
    process = psutil.Process()
    games = VectorEnv(parameters, seeds[0])
    before = process.memory_info().rss
    memory = ReplayMemory(
        *(transitions, parameters.environments, parameters.frame_stack),
        *(parameters.gamma, seeds[1]),
    )
    idle = np.zeros(parameters.environments)
    memory.append(games.planes[-1], idle, idle, idle, idle)  # the games' first images
    rng, rows, storing, vector_steps = np.random.default_rng(0), [], 0.0, 0
    tenth = transitions // parameters.environments // 10
    for number in range(1, 10 * tenth + 1):
        actions = rng.integers(games.actions, size=parameters.environments)
        step = games.step(actions)
        start = time.perf_counter()
        memory.append(step.images, step.ages, actions, step.rewards, step.terminated)
        storing, vector_steps = storing + time.perf_counter() - start, vector_steps + 1
        if number % tenth:
            continue
        start = time.perf_counter()
        for _ in range(SAMPLES):
            memory.sample(BATCH)
        sampling = (time.perf_counter() - start) / SAMPLES
        rows.append(
            {
                "game": game,
                "transitions": number * parameters.environments,
                "resident_megabytes": round((process.memory_info().rss - before) / 1e6, 1),
                "bytes_per_image": round(float(memory.frames.size.sum()) / (number * 8), 1),
                "store_ms": round(storing / vector_steps * 1e3, 3),
                "sample_ms": round(sampling * 1e3, 3),
            }
        )
        print(rows[-1], flush=True)
        storing, vector_steps = 0.0, 0
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transitions", type=int, default=1_000_000)
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    # A second game in the same process would seem to need less: it gets what the first gave back.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        filled = pool.map(fill, GAMES, [chosen.transitions] * len(GAMES))
        rows = [row for game_rows in filled for row in game_rows]
    chosen.output.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(chosen.output / "memory.csv", index=False)


if __name__ == "__main__":
    main()
