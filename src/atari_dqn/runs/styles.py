"""How an agent boxes along its training: the greedy episodes of its checks, played again from their
records."""

from dataclasses import astuple, dataclass, fields

import numpy as np
import pandas as pd
from tqdm import tqdm

from atari_dqn.envs import EpisodeRecord
from atari_dqn.games import GAMES
from atari_dqn.params import Parameters
from atari_dqn.runs import records, tables
from atari_dqn.runs.files import write_atomically
from atari_dqn.runs.run import Run

# The experiments whose styles are compared, and the agent that all of them train; of the final one
# every agent's style is measured
EXPERIMENTS = ("boxing_low_gamma", "boxing_final", "boxing_high_gamma")
AGENT = "dueling_double_dqn"
FINAL = "boxing_final"
ARMS = (55, 57)  # memory cells: how far each of the agent's arms is out, 0 to 72
OUT = 24  # from where on a punch is counted: an arm is farther out for longer than a step lasts
STRUCK = 41  # what both arms are set to by a blow that the agent takes
REACH = 30  # pixels to the side, and up or down, beyond which no punch lands (results/benchmarks/
# punches.csv)


@dataclass(frozen=True)
class Style:
    """One greedy episode, a row of a run's file of styles."""

    episode: int  # training episodes finished before it
    game: int  # its number among the greedy episodes
    digest: str  # of its record: whether it is the same episode still
    frames: int  # emulator frames
    score: float  # points
    scored: float  # points of the agent alone
    conceded: float  # points of its rival
    punches: int  # that the agent threw, landed or not
    reach: float  # share of the steps in which a punch could have landed
    distance: float  # pixels between the boxers, mean over the steps


def measure(run: Run) -> None:
    """Brings a run's file of styles up to date with its records; what is in it is not played
    again. Raises RecordError if the records cannot be read, RunError if the file is damaged."""
    stored = tables.read_file(run.styles, tables.STYLES)
    known = {(row.episode, row.game, row.digest): row for row in stored.itertuples(index=False)}
    greedy = [
        (heading, record)
        for heading, record in records.read_file(run.folder, torn=True)
        if heading["kind"] == records.VALUES
    ]
    rows = []
    try:
        for heading, record in tqdm(greedy, desc=f"styles of {run.name}", mininterval=2):
            key = (heading["episode"], heading["game"], records.digest(record))
            rows.append(known.get(key) or astuple(_style(run.params, *key, record)))
    finally:  # an interruption costs no more than the episode that was being played
        table = pd.DataFrame(rows, columns=[field.name for field in fields(Style)])
        run.styles.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(run.styles, table.to_csv(index=False).encode())


def _style(
    params: Parameters, episode: int, game: int, digest: str, record: EpisodeRecord
) -> Style:
    boxers = np.array(GAMES[params.game].boxers)
    punches, extended, reached, distances = 0, np.zeros(2, bool), [], []
    for env in records.replay(params, record):
        memory = env.ram().astype(int)
        arms = memory[list(ARMS)]
        before, extended = extended, arms > OUT
        if env.length:
            if (arms != STRUCK).any():
                punches += int((extended & ~before).sum())
            gaps = np.abs(memory[boxers[0]] - memory[boxers[1]])
            reached.append(bool((gaps <= REACH).all()))
            distances.append(env.distance())
    scored, conceded = env.points()
    return Style(
        episode,
        game,
        digest,
        env.frames,
        env.score,
        scored,
        conceded,
        punches,
        float(np.mean(reached)),
        float(np.mean(distances)),
    )
