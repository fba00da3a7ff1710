"""Does a stored run come out the same if it is trained again, here, and killed on the way?

    python benchmarks/again.py results/runs/breakout_late/double_dqn/seed-1 [--games 1700]

Trains from nothing with the stored parameters until so many games are played, and is killed with
SIGKILL and continued after `--kills` random games before that. The games' rows, the checks of
values, the records of every game and the snapshots of the weights up to there are then compared
with the stored ones, byte for byte. Adds a line to results/benchmarks/again.csv. Only a run that
the native learner trained from its beginning can come out the same on another processor.
"""

import argparse
import os
import random
import tempfile
import time
from pathlib import Path

import kills
import pandas as pd

from atari_dqn import params
from atari_dqn.runs import records, tables
from atari_dqn.runs.files import project_root
from atari_dqn.runs.run import Run

BETWEEN = 60.0  # seconds of training between two checkpoints


def contents(run: Run, games: int) -> dict[str, object]:
    """What a run has of its first games, by names; that training adds to it makes no difference."""
    found: dict[str, object] = {}
    for name in (tables.EPISODES, tables.VALUES):
        table = tables.read(run.folder, name)
        for row in table[table.episode <= games].to_dict("records") if len(table) else ():
            found[f"{name}, episode {row['episode']}"] = repr(row)
    played = records.read_file(run.folder, torn=True)
    for heading, record in played:
        if heading["kind"] != records.EVALUATION and heading["episode"] <= games:
            found[str(heading)] = records.digest(record)
    for path in run.folder.glob("snapshots/games-*.safetensors"):
        if int(path.stem.removeprefix("games-")) <= games:
            found[path.name] = path.read_bytes()
    return found


def differences(run: Run, other: Run, games: int) -> list[str]:
    one, two = contents(run, games), contents(other, games)
    return [name for name in sorted(one.keys() | two.keys()) if one.get(name) != two.get(name)]


def played(run: Run) -> int:
    path = run.folder / tables.EPISODES
    return max(0, path.read_bytes().count(b"\n") - 1) if path.exists() else 0


def again(run: Run, folder: Path, games: int, times: int, checked: int) -> dict[str, object]:
    """Trains a run's first games again in a folder, and says what came of it."""
    other = Run(run.params, folder)
    began = time.monotonic()
    wanted = contents(run, games).keys()
    for goal in [*sorted(random.sample(range(1, games), times)), games]:
        process = kills.start(folder, run.params, BETWEEN, checked)
        while played(other) < goal and process.poll() is None:
            time.sleep(0.1)
        # what comes of the last game is written after its row: snapshots, and checks of values
        while goal == games and wanted > contents(other, games).keys() and process.poll() is None:
            time.sleep(1)
        process.kill()
        if process.wait() not in (0, -9):
            raise SystemExit(f"the run failed with {process.returncode}")
    before, now = run.provenance()["sessions"], other.provenance()["sessions"]
    return {
        "run": run.name,
        **{name: now[0][name] for name in ("started", "commit", "processor", "learner")},
        "processors_before": "; ".join(dict.fromkeys(one["processor"] for one in before)),
        "learners_before": "; ".join(dict.fromkeys(one["learner"] for one in before)),
        "restarts_before": sum(one["first_episode"] <= games for one in before) - 1,
        "games": games,
        "agent_steps": int(tables.read(run.folder, tables.EPISODES).agent_steps[games - 1]),
        "kills": times,
        "minutes": round((time.monotonic() - began) / 60, 1),
        "compared": len(wanted),
        "different": "; ".join(differences(run, other, games)[:5]) or "none",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("run", type=Path, help="a stored run's folder, .../seed-N")
    parser.add_argument("--games", type=int, default=1700)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    os.environ.pop("ATARI_DQN_STATE", None)  # checkpoints go to the temporary folder
    run = Run(params.stored_parameters(chosen.run), chosen.run.resolve().parents[3])
    with tempfile.TemporaryDirectory() as folder:
        row = again(run, Path(folder), chosen.games, chosen.kills, params.VALUES_PERIOD)
    path = chosen.output / "again.csv"
    pd.DataFrame([row]).to_csv(path, mode="a", header=not path.exists(), index=False)
    print(*(f"{name}: {value}" for name, value in row.items()), sep="\n")
    if row["different"] != "none":
        raise SystemExit("the run came out differently")


if __name__ == "__main__":
    main()
