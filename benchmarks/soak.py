"""Does a run that is killed under load, for as long as one likes, leave the files of one that was
not; and does its process hold no more memory in the end than in the beginning?

    python benchmarks/soak.py [--minutes 60] [--kills 20] [--load 2]

A real run of Boxing, whose games are cut short, is trained twice: undisturbed, for about a third of
the time, since what follows takes longer; and killed with SIGKILL at random moments beside `--load`
other processes that keep the cores busy. The files of both, and their last checkpoints, are then
compared byte for byte, but for what the clock decides (timing.csv, provenance.json). Adds a line to
results/benchmarks/soak.csv, in which `megabytes_1` to `megabytes_4` are the most that the
undisturbed process held in each quarter of its time.
"""

import argparse
import os
import random
import subprocess
import tempfile
import time
from contextlib import suppress
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import kills
import numpy as np
import pandas as pd
import psutil

from atari_dqn.params import Parameters
from atari_dqn.runs import checkpoints
from atari_dqn.runs.files import project_root
from atari_dqn.runs.processes import end_with_parent
from atari_dqn.runs.run import Run

PILOT = Parameters(
    experiment="soak",
    profile="smoke",
    agents=["double_dqn"],
    episodes=16,  # which tell how many can be played in the time
    max_game_frames=1200,
    replay_capacity=4000,  # transitions; written over from the fourteenth game on
    learning_starts=800,
    target_update_period=100,
    evaluation_games=8,
    snapshot_games=[1, 10, 100, 1000, 10_000],
)
BETWEEN = 5.0  # seconds of training between two checkpoints
BY_THE_CLOCK = {"timing.csv", "provenance.json", "seconds", "cpu_seconds", "sessions"}


def watch(process: subprocess.Popen, seconds: float = float("inf")) -> list[float]:
    """The megabytes that a process holds, now and then, until it ends or is killed after a time."""
    end, seen, held = time.monotonic() + seconds, psutil.Process(process.pid), []
    while process.poll() is None and time.monotonic() < end:
        with suppress(psutil.Error):  # it has just ended
            held.append(seen.memory_info().rss / 1e6)
        time.sleep(0.05)
    process.kill()  # which one that has ended does not notice
    if process.wait() not in (0, -9):
        raise SystemExit(f"the run failed with {process.returncode}")
    return held


def keep_busy() -> None:
    end_with_parent()
    while True:
        sum(range(10_000))


def contents(run: Run) -> dict[str, object]:
    """What the clock does not decide: files by their names, and the parts of the checkpoint."""
    saved = checkpoints.load(run.state_folder)
    assert saved is not None
    found = {f"checkpoint: {name}": part for name, part in saved.items()}
    found["checkpoint: written"] = {**saved["written"], "timing.csv": b""}
    for path in run.folder.rglob("[!.]*"):
        if path.is_file():
            found[str(path.relative_to(run.folder))] = path.read_bytes()
    return {name: part for name, part in found.items() if name.split()[-1] not in BY_THE_CLOCK}


def differences(run: Run, other: Run) -> list[str]:
    """The names of files and of parts of the checkpoint that are not the same in both."""
    one, two = contents(run), contents(other)
    names = sorted(one.keys() | two.keys())
    return [name for name in names if not kills.same(one.get(name), two.get(name))]


def soak(pilot: Parameters, folder: Path, seconds: float, times: int, busy: int) -> dict:
    """Trains twice, for about so many seconds in all, and says what came of it."""
    began = time.monotonic()
    watch(kills.start(folder / "pilot", pilot, BETWEEN))
    games = int(pilot.episodes * seconds / 3 / (time.monotonic() - began))
    parameters = pilot.model_copy(update={"episodes": max(pilot.episodes, games)})
    whole, killed = (Run(parameters, folder / name) for name in ("whole", "killed"))
    began = time.monotonic()
    held = watch(kills.start(whole.results, parameters, BETWEEN))
    took, felt = time.monotonic() - began, 0
    for _ in range(busy):
        get_context("spawn").Process(target=keep_busy, daemon=True).start()
    for before, now in pairwise([0.0, *sorted(random.uniform(0, took) for _ in range(times))]):
        process = kills.start(killed.results, parameters, BETWEEN)
        watch(process, now - before)
        felt += process.returncode != 0  # it may have ended before
    watch(kills.start(killed.results, parameters, BETWEEN))
    first, most = whole.provenance()["sessions"][0], np.array_split(held, 4)
    return {
        **{name: first[name] for name in ("started", "commit", "processor", "learner")},
        **{"minutes": seconds / 60, "games": parameters.episodes},
        **{"updates": whole.provenance()["updates"], "kills": felt, "busy_beside": busy},
        "files": sum(not name.startswith("checkpoint: ") for name in contents(whole)),
        "different": "; ".join(differences(whole, killed)) or "none",
        **{f"megabytes_{quarter}": round(max(each)) for quarter, each in enumerate(most, 1)},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--load", type=int, default=os.cpu_count(), help="busy processes beside")
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    os.environ.pop("ATARI_DQN_STATE", None)  # checkpoints go to the temporary folder
    with tempfile.TemporaryDirectory() as folder:
        row = soak(PILOT, Path(folder), chosen.minutes * 60, chosen.kills, chosen.load)
    path = chosen.output / "soak.csv"
    pd.DataFrame([row]).to_csv(path, mode="a", header=not path.exists(), index=False)
    print(*(f"{name}: {value}" for name, value in row.items()), sep="\n")
    if row["different"] != "none":
        raise SystemExit("a killed run ended differently")


if __name__ == "__main__":
    main()
