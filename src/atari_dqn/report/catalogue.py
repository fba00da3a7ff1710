"""The list of all stored agents, for people who come for the weights: README.md in the results
folder, with scores, files, and a video of each agent's newest greedy play."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from atari_dqn import params
from atari_dqn.games import GAMES
from atari_dqn.report.notebook import as_code
from atari_dqn.report.video import television
from atari_dqn.runs import models, plan, records, tables
from atari_dqn.runs.files import project_root, write_atomically
from atari_dqn.runs.run import Run, as_trained

RECENT = 100  # training episodes that a score is the mean of
HEAD = """# The stored agents

Made from the stored runs by `make report`. *Training* is the mean score of the last {recent}
training games, with exploration; *greedy*, that of the newest greedy games, with their number
and the training games before them, and the video shows the first of these. The weights are
float16, as of the run's last checkpoint; [a few lines of PyTorch]({lines}#weights-for-others)
load them. `replay` shows any other game of the records.

"""
NONE = "–"


@dataclass(frozen=True)
class Greedy:
    """The newest greedy episodes of a run, played as it was trained."""

    heading: dict[str, Any]  # what all of them say on record
    trained: int  # training episodes before them
    episodes: int
    score: float  # points, mean


def write(profile: str, stored: Path, folder: Path) -> None:
    """Writes README.md, and the videos that it links and that are not there yet, into the results
    `folder`, of the runs whose copies are in `stored`; names those that are damaged. Raises
    RecordError if a run's records cannot be read."""
    rows = []
    for run in plan.stored(profile, [], stored):
        if (run.folder / "model.safetensors").exists():
            greedy = greedy_play(run)
            video = _video(run, greedy, folder) if greedy else None
            rows.append(_row(run, greedy) | {"video": _link("mp4", video)})
    table = pd.DataFrame(rows).to_markdown(index=False, disable_numparse=True)
    lines = Path(os.path.relpath(project_root() / "README.md", folder)).as_posix()
    text = HEAD.format(recent=RECENT, lines=lines) + (table if rows else "None yet.") + "\n"
    for said in plan.damaged(profile, [], stored):
        text += f"\nLeft out, since it cannot be read: {as_code(said, stored)}\n"
    write_atomically(folder / "README.md", text.encode())


def _row(run: Run, greedy: Greedy | None) -> dict[str, str]:
    scores = tables.of_runs([run], tables.EPISODES).score.tail(RECENT)
    files = Path("runs") / run.name
    trained = models.trained_games(run.folder / "model.safetensors")
    return {
        "experiment": run.title,
        "game": GAMES[run.params.game].title,
        "agent": params.title(run.agent),
        "seed": str(run.seed),
        "training games": f"{trained:,} of {run.params.episodes:,}",
        "training": _points(scores.mean()) if len(scores) else NONE,
        "greedy": f"{_points(greedy.score)} ({greedy.episodes} games, after {greedy.trained:,})"
        if greedy
        else NONE,
        "weights": _link("model", files / "model.safetensors"),
        "records": _link("games", files / records.FILE),
    }


def _points(score: float) -> str:
    return f"{score:.1f}".replace("-", "−")


def _link(text: str, path: Path | None) -> str:
    return f"[{text}]({path.as_posix()})" if path else NONE


def greedy_play(run: Run) -> Greedy | None:
    """The evaluation of a finished run, or else the last check along its training, if any."""
    evaluated, p = tables.read(run.folder, tables.EVALUATIONS), run.params
    played_as = {
        "difficulty": p.difficulty,
        "sticky_actions": p.sticky_actions,
        "epsilon": p.evaluation_epsilon,
    }
    evaluated = as_trained(evaluated, p)
    if len(evaluated):
        trained = int(evaluated.trained_games.max())
        scores = evaluated[evaluated.trained_games == trained].score
        heading = {"kind": records.EVALUATION, "trained_games": trained, **played_as}
        return Greedy(heading, trained, len(scores), scores.mean())
    checks = tables.read(run.folder, tables.VALUES)
    if len(checks):
        trained = int(checks.episode.iloc[-1])
        heading = {"kind": records.VALUES, "episode": trained}
        return Greedy(heading, trained, params.VALUE_GAMES, checks.score.iloc[-1])
    return None


def _video(run: Run, greedy: Greedy, folder: Path) -> Path | None:
    """The path in `folder` of a video of the first of the greedy episodes, made if it is not there,
    in the place of one of another episode; None if the episode is not on record."""
    games = [
        (heading["game"], record)
        for heading, record in records.read_file(run.folder, torn=True)
        if greedy.heading.items() <= heading.items()
    ]
    if not games:
        return None
    _, record = min(games, key=lambda game: game[0])
    path = Path("videos") / run.name / f"{greedy.trained:05d}-{records.digest(record)}.mp4"
    made = folder / path
    if not made.exists():
        made.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(made, television(records.replay(run.params, record)))
    for other in set(made.parent.glob("*.mp4")) - {made}:
        other.unlink()
    return path
