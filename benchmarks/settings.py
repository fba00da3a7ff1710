"""What a setting scores for its processor time: short runs that differ in one setting each.

    python benchmarks/settings.py [--minutes 35]

Every variation in settings.yaml is trained for the same processor time, one process a core, and
then plays 50 greedy games; halfway it plays 50 more. Scores while training do not compare, since
epsilon falls with the games finished. Writes settings.csv (a row an evaluation) and
settings_training.csv (a row a training game) into results/benchmarks/. Single runs: indications.
"""

import argparse
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from atari_dqn import evaluation, params
from atari_dqn.params import Parameters
from atari_dqn.recording import processor
from atari_dqn.runs import project_root
from atari_dqn.statistics import interval
from atari_dqn.training import Trainer, prepare_process

GAMES = 50  # of each evaluation


def measure(label: str, parameters: Parameters, minutes: float) -> tuple[list[dict], list[dict]]:
    """Trains one variation; returns its evaluations and its training games."""
    prepare_process()
    trainer = Trainer(parameters, parameters.agents[0], parameters.seeds[0])
    evaluations: list[dict] = []
    games: list[dict] = []
    spent, started = 0.0, time.process_time()
    for episode in trainer.run():
        now = spent + time.process_time() - started
        if episode is not None:
            games.append({"setup": label, "cpu_seconds": round(now, 1), **asdict(episode)})
        if now >= minutes * 30 * (len(evaluations) + 1):  # half of the time, then all of it
            spent = now
            evaluations.append({"setup": label, **evaluate(trainer, parameters, now)})
            started = time.process_time()
            if len(evaluations) == 2:
                return evaluations, games
    raise AssertionError("training goes on for ever")


def evaluate(trainer: Trainer, parameters: Parameters, now: float) -> dict:
    played = evaluation.play(trainer.learner.online, parameters, GAMES, parameters.seeds[0])
    scores = [game.score for game in played]
    low, high = interval(scores)
    return {
        "cpu_minutes": round(now / 60, 1),
        "agent_steps": trainer.agent_steps,
        "updates": trainer.learner.updates,
        "training_games": trainer.episodes,
        "evaluation_games": GAMES,
        "score": round(sum(scores) / GAMES, 2),
        "low": round(low, 2),
        "high": round(high, 2),
        "processor": processor(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=35, help="processor time of each")
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    chosen.output.mkdir(parents=True, exist_ok=True)
    setups = params.variants(params.load(Path(__file__).with_name("settings.yaml")))
    evaluations: list[dict] = []
    games: list[dict] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=context) as pool:
        jobs = [pool.submit(measure, *setup, chosen.minutes) for setup in setups.items()]
        for job in as_completed(jobs):
            more_evaluations, more_games = job.result()
            evaluations += more_evaluations
            games += more_games
            pd.DataFrame(evaluations).to_csv(chosen.output / "settings.csv", index=False)
            pd.DataFrame(games).to_csv(chosen.output / "settings_training.csv", index=False)
            print(pd.DataFrame(more_evaluations).to_string(index=False), flush=True)


if __name__ == "__main__":
    main()
