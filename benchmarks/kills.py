"""Does a run that is killed again and again end as if it had never been stopped?

    python benchmarks/kills.py [--kills 50]

A small run on the real game checkpoints at every opportunity and is killed with SIGKILL at random
moments, at least `--kills` times, run after run, until its last game is played. Every run's final
checkpoint (weights, optimiser, replay memory, random generators, emulators, counters) and logs are
then compared with those of a run that nobody stopped. Writes kills.csv into results/benchmarks/:
what was going on at each kill, and where the run went on.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from atari_dqn.params import Parameters
from atari_dqn.runs import checkpoints
from atari_dqn.runs.files import project_root
from atari_dqn.runs.run import Run

SMALL = Parameters(
    experiment="kills",
    profile="smoke",
    agents=["double_dqn"],
    episodes=60,
    max_game_frames=200,
    environments=2,
    replay_capacity=400,  # transitions; written over several times
    learning_starts=600,  # agent steps, so that some kills come before it
    batch_size=4,
    target_update_period=7,
    evaluation_games=2,
    snapshot_games=[10, 40],
)
PROGRAM = """
import sys
from pathlib import Path
from atari_dqn import params
from atari_dqn.params import Parameters
from atari_dqn.runs import recorder
from atari_dqn.runs.run import Run
recorder.CHECKPOINT_SECONDS = float(sys.argv[3])
params.VALUES_PERIOD = int(sys.argv[4])
print("ready", flush=True)
parameters = Parameters.model_validate_json(sys.argv[1])
recorder.train(Run(parameters, Path(sys.argv[2])))
"""


def start(
    folder: Path, parameters: Parameters = SMALL, between: float = 0.05, checked: int = 20
) -> subprocess.Popen:
    """A process that trains, with so many seconds between two checkpoints, and games between two
    checks of its values."""
    given = [parameters.model_dump_json(), str(folder), str(between), str(checked)]
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *given],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


def moment(folder: Path) -> dict[str, object]:
    """What a killed run had got to."""
    files = Run(SMALL, folder).state_folder
    writing = any(files.glob("tmp-*"))
    saved = checkpoints.load(files)
    trainer = saved["trainer"] if saved else None
    return {
        "while_writing_a_checkpoint": writing,
        "games": saved["episodes"] if saved else 0,
        "agent_steps": trainer["agent_steps"] if trainer else 0,
        "updates": trainer["learner"]["updates"] if trainer else 0,
        "memory_written_over": trainer is not None
        and trainer["agent_steps"] > SMALL.replay_capacity,
    }


def killed_run(folder: Path, rng: random.Random) -> list[dict[str, object]]:
    """Trains to the end in spite of kills; returns what each of them met."""
    met = []
    while True:
        process = start(folder)
        try:
            process.wait(rng.uniform(0.0, 8.0))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            met.append(moment(folder))
            continue
        if process.returncode:
            raise SystemExit(f"the run failed with {process.returncode}")
        return met


def same(first: object, second: object) -> bool:
    """Whether two states are equal, bit for bit."""
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(first, list) and isinstance(second, list):
        if first and second and isinstance(first[0], bytes) and isinstance(second[0], bytes):
            return b"".join(first) == b"".join(second)  # images; each resume begins a new piece
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return first.dtype == second.dtype and first.tobytes() == second.tobytes()
    return first == second or (first != first and second != second)  # nan is nan


def contents(folder: Path) -> dict[str, object]:
    run = Run(SMALL, folder)
    saved = checkpoints.load(run.state_folder)
    assert saved is not None
    names = ["episodes.csv", "values.csv", "evaluations.csv", "model.safetensors"]
    names += [f"snapshots/games-{games:05d}.safetensors" for games in SMALL.snapshot_games]
    return {
        "trainer": saved["trainer"],
        "files": {name: (run.folder / name).read_bytes() for name in names},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    os.environ.pop("ATARI_DQN_STATE", None)  # checkpoints go to the temporary folder
    rng, rows, number = random.Random(0), [], 0
    with tempfile.TemporaryDirectory() as temporary:
        whole = Path(temporary, "whole")
        start(whole).wait()
        expected = contents(whole)
        commit = Run(SMALL, whole).provenance()["sessions"][0]["commit"]
        while len(rows) < chosen.kills:
            number += 1
            folder = Path(temporary, f"run-{number}")
            began = time.monotonic()
            met = killed_run(folder, rng)
            equal = same(contents(folder), expected)
            rows += [
                {"commit": commit, "run": number, "ended_equal": equal, **each} for each in met
            ]
            seconds = time.monotonic() - began
            print(f"run {number}: {len(met)} kills, equal: {equal}, {seconds:.0f} s", flush=True)
    table = pd.DataFrame(rows)
    chosen.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(chosen.output / "kills.csv", index=False)
    print(table.to_string(index=False))
    if not table.ended_equal.all():
        raise SystemExit("a killed run ended differently")


if __name__ == "__main__":
    main()
