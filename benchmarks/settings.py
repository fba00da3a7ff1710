"""What a setting scores for its processor time: runs that differ in one setting each.

    python benchmarks/settings.py [--minutes 60] [--best-minutes 180]

Every variation in settings.yaml is trained for the same processor time, one process a core, and
plays 50 greedy games after every 20 minutes of it; the two that score best go on. Scores while
training compare at the same epsilon only, which falls with the games finished. Writes settings.csv
(a row an evaluation; the first is random play) and settings_training.csv (a row a training game) to
results/benchmarks/. Checkpoints are kept: the same command continues what was stopped, and more
minutes lengthen it. Single runs: indications.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
from filelock import FileLock
from torch import nn

from atari_dqn import checkpoints, evaluation, params
from atari_dqn.experiments import cores, stopping_on_sigterm
from atari_dqn.params import Parameters
from atari_dqn.recording import processor
from atari_dqn.runs import project_root
from atari_dqn.statistics import interval
from atari_dqn.training import Trainer, prepare_process

GAMES = 50  # of each evaluation
SLICE = 5 * 60.0  # seconds of processor time between checkpoints
SLICES = 4  # between evaluations
BEST = 2  # variations that go on


def measure(label: str, parameters: Parameters, minutes: int, state: Path) -> dict[str, Any]:
    """Trains one variation for that long in all; returns its evaluations and training games."""
    prepare_process()
    folder = _folder(state, label, parameters)
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".lock", timeout=0):
        return _measured(label, parameters, minutes, folder)


def _measured(label: str, parameters: Parameters, minutes: int, folder: Path) -> dict[str, Any]:
    trainer = Trainer(parameters, parameters.agents[0], parameters.seeds[0])
    done: dict[str, Any] = {"label": label, "slices": 0, "evaluations": [], "games": []}
    saved = checkpoints.load(folder)
    if saved is not None:
        trainer.set_state(saved.pop("trainer"))
        done = saved
    while done["slices"] * SLICE < minutes * 60:
        started = time.process_time()
        for episode in trainer.run():
            spent = time.process_time() - started
            if episode is not None:
                seconds = round(done["slices"] * SLICE + spent, 1)
                done["games"].append({"setup": label, "seconds": seconds, **asdict(episode)})
            if spent >= SLICE:
                break
        done["slices"] += 1
        if done["slices"] % SLICES == 0:
            row = evaluate(trainer.learner.online, parameters)
            done["evaluations"].append(
                {
                    "setup": label,
                    "cpu_minutes": done["slices"] * SLICE / 60,
                    "agent_steps": trainer.agent_steps,
                    "updates": trainer.learner.updates,
                    "training_games": trainer.episodes,
                    **row,
                }
            )
        checkpoints.save(folder, {"trainer": trainer.get_state(), **done})
    return done


def _folder(state: Path, label: str, parameters: Parameters) -> Path:
    """Where a variation's checkpoints are: another after every change of what it trains."""
    version = f"{parameters.identity()[:8]}-v{params.TRAINING_VERSION}"
    return state / f"{label.replace(' ', '-')}-{version}"


def evaluate(network: nn.Module, parameters: Parameters) -> dict[str, Any]:
    """Mean score of greedy games with its interval."""
    games = evaluation.play(network, parameters, GAMES, parameters.seeds[0])
    scores = [game.score for game in games]
    low, high = interval(scores)
    score = sum(scores) / GAMES
    figures = {"score": round(score, 2), "low": round(low, 2), "high": round(high, 2)}
    return {"games": GAMES, **figures, "processor": processor()}


def random_play(parameters: Parameters) -> dict[str, Any]:
    """The same evaluation of an agent that only guesses."""
    prepare_process()
    network = Trainer(parameters, parameters.agents[0], parameters.seeds[0]).learner.online
    guessing = parameters.model_copy(update={"evaluation_epsilon": 1.0})
    return {"setup": "random play", **evaluate(network, guessing)}


def best_after(minutes: int, evaluations: pd.DataFrame) -> list[str]:
    """The variations that scored best by then: the mean of two evaluations, as scores still leap
    from one to the next."""
    then = evaluations[evaluations.cpu_minutes <= minutes]
    means = then.groupby("setup", sort=False).tail(2).groupby("setup", sort=False).score.mean()
    return list(means.nlargest(BEST).index)


def arguments() -> argparse.Namespace:
    """The command line. Raises SystemExit where training would not end with an evaluation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=int, default=60, help="processor time of each")
    parser.add_argument("--best-minutes", type=int, default=180, help="of the two best")
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    between = round(SLICES * SLICE / 60)
    for name, minutes in [("minutes", chosen.minutes), ("best-minutes", chosen.best_minutes)]:
        if minutes < between or minutes % between:
            parser.error(f"--{name} {minutes}: a multiple of {between}, the minutes to a score")
    return chosen


def main() -> None:
    chosen = arguments()
    chosen.output.mkdir(parents=True, exist_ok=True)
    setups = params.variants(params.load(Path(__file__).with_name("settings.yaml")))
    state = Path(
        os.environ.get("ATARI_DQN_STATE") or project_root() / "results" / "state", "settings"
    )
    finished: dict[str, dict[str, Any]] = {}

    def collected(key: str) -> pd.DataFrame:
        return pd.DataFrame([row for name in setups for row in finished.get(name, {}).get(key, [])])

    context = multiprocessing.get_context("spawn")
    with stopping_on_sigterm(), ProcessPoolExecutor(cores(), mp_context=context) as pool:
        guessed = pool.submit(random_play, next(iter(setups.values())))

        def train(labels: Iterable[str], minutes: int) -> None:
            jobs = [pool.submit(measure, name, setups[name], minutes, state) for name in labels]
            for job in as_completed(jobs):
                done = job.result()
                finished[done["label"]] = done
                table = pd.concat([pd.DataFrame([guessed.result()]), collected("evaluations")])
                table.to_csv(chosen.output / "settings.csv", index=False)
                collected("games").to_csv(chosen.output / "settings_training.csv", index=False)
                print(pd.DataFrame(done["evaluations"]).to_string(index=False), flush=True)

        try:
            train(setups, chosen.minutes)
            train(best_after(chosen.minutes, collected("evaluations")), chosen.best_minutes)
        except BaseException:  # the pool would finish all that is queued first
            for process in multiprocessing.active_children():
                process.terminate()
            raise


if __name__ == "__main__":
    main()
