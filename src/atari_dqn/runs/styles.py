"""How an agent plays along its training: the greedy episodes of its checks, played again from their
records, and what the console's memory says in every step.

Cells as Anand et al. (2019, AtariARI) annotate them, but for the arms' and the ball's speed, which
are measured (tests/test_ram.py, tests/test_styles.py).
"""

from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from atari_dqn.envs import EpisodeRecord
from atari_dqn.games import GAMES
from atari_dqn.params import Parameters
from atari_dqn.runs import records, tables
from atari_dqn.runs.files import write_atomically
from atari_dqn.runs.run import Run

EXPERIMENTS = ("boxing_low_gamma", "boxing_final", "boxing_high_gamma", "breakout_late")
AGENT = "dueling_double_dqn"  # that is trained with every discount

ARMS = (55, 57)  # memory cells: how far each of the agent's arms is out, 0 to 72
OUT = 24  # from where on a punch is counted: an arm is farther out for longer than a step lasts
STRUCK = 41  # what both arms are set to by a blow that the agent takes
REACH = 30  # pixels to the side, and up or down, beyond which no punch lands (results/benchmarks/
# punches.csv)

BALL = (99, 101)  # memory cells: x and y of the ball, in pixels
SPEED = 103  # memory cell: whole pixels per frame that the ball goes down, as a signed byte
COURT = (57, 200)  # the ball's x at the left wall and at the right; beneath the paddle it goes on
WALL = 46  # the ball's y below which it is above all bricks
LOW = 150  # the ball's y beyond which nothing but the paddle returns it


@dataclass(frozen=True)
class Style:
    """One greedy episode, a row of a run's file of styles: what it holds in every game."""

    episode: int  # training episodes finished before it
    game: int  # its number among the greedy episodes
    digest: str  # of its record: whether it is the same episode still
    frames: int  # emulator frames
    score: float  # points


@dataclass(frozen=True)
class Boxing(Style):
    """What it holds in Boxing besides."""

    scored: float  # points of the agent alone
    conceded: float  # points of its rival
    punches: int  # that the agent threw, landed or not
    reach: float  # share of the steps in which a punch could have landed
    distance: float  # pixels between the boxers, mean over the steps


@dataclass(frozen=True)
class Breakout(Style):
    """What it holds in Breakout besides."""

    returned_slow: int  # balls that the paddle returned, of 1 or 1.5 pixels per frame up or down,
    returned_medium: int  # of 2,
    returned_fast: int  # and of 3, the most that there is
    lost_slow: int  # balls that it missed, likewise
    lost_medium: int
    lost_fast: int
    lost_left: int  # the same balls, by the third of the court in which they were lost
    lost_middle: int
    lost_right: int
    tunnel: int  # 1 if a ball came above the wall, else 0
    above: float  # points scored in steps with the ball above the wall


def measure(run: Run) -> None:
    """Brings a run's file of styles up to date with its records; what is in it is not played
    again. Raises RecordError if the records cannot be read, RunError if the file is damaged."""
    name, style_of = tables.STYLES[run.params.game], MEASURED[run.params.game]
    stored = tables.read_file(run.styles, name)
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
            rows.append(known.get(key) or astuple(style_of(run.params, *key, record)))
    finally:  # an interruption costs no more than the episode that was being played
        table = pd.DataFrame(rows, columns=[*tables.COLUMNS[name]])
        run.styles.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(run.styles, table.to_csv(index=False).encode())


def _boxing(
    params: Parameters, episode: int, game: int, digest: str, record: EpisodeRecord
) -> Boxing:
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
    return Boxing(
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


def _breakout(
    params: Parameters, episode: int, game: int, digest: str, record: EpisodeRecord
) -> Breakout:
    memories, scores, lives = [], [], []
    for env in records.replay(params, record):
        memories.append(env.ram())
        scores.append(env.score)
        lives.append(env.lives)
    memory = np.array(memories)  # [moments, cells]
    x, y = memory[:, BALL[0]].astype(int), memory[:, BALL[1]]
    down = memory[:, SPEED].view(np.int8)
    returned = (down[:-1] > 0) & (down[1:] < 0) & (y[1:] > LOW)  # in the step after each moment
    lost = np.diff(lives) < 0
    places = np.clip(x[:-1][lost], *COURT) - COURT[0]
    thirds = places * 3 // (COURT[1] - COURT[0] + 1)
    above = (y > 0) & (y < WALL)  # y is 0 while no ball is in play
    points = np.diff(scores)[above[:-1] | above[1:]].sum()
    balls: dict[str, Any] = {}
    for happened, which in (("returned", returned), ("lost", lost)):
        for speed, name in enumerate(tables.SPEEDS, 1):  # whole pixels per frame
            balls[f"{happened}_{name}"] = int((down[:-1][which] == speed).sum())
    for third, name in enumerate(tables.THIRDS):
        balls[f"lost_{name}"] = int((thirds == third).sum())
    tunnel = int(above.any())
    heading = Style(episode, game, digest, env.frames, env.score)
    return Breakout(**vars(heading), tunnel=tunnel, above=float(points), **balls)


MEASURED = {"boxing": _boxing, "breakout": _breakout}  # by game
