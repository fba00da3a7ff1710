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

EXPERIMENTS = (
    "boxing_low_gamma",
    "boxing_final",
    "boxing_high_gamma",
    "breakout_late",
    "breakout_final",
)
AGENT = "dueling_double_dqn"  # that is trained with every discount

OUT = 24  # from where on a punch is counted: an arm is farther out for longer than a step lasts
STRUCK = 41  # what both arms are set to by a blow that the agent takes
REACH = 30  # pixels to the side, and up or down, beyond which no punch lands (results/benchmarks/
# punches.csv)
RING = ((30, 109), (3, 87))  # the least and the most of a boxer's x, and of its y, in pixels; the
# very few steps beyond these are by a blow (tests/test_styles.py)
CELL, MAPPED = 4, 10  # pixels of a cell, and games of a check, of a map of the ring
AT_ROPES = 4  # pixels from there: a boxer this near can hardly move further

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
    blows: int  # steps in which the agent scored
    doubles: int  # of these, by two points: from near, with the arm half out
    ropes: float  # share of the steps in which the agent stood at the ropes
    rival_ropes: float  # and its rival


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
    memories, scored = [], []
    for env in records.replay(params, record):
        memories.append(env.ram())
        scored.append(env.points()[0])
    memory = np.array(memories).astype(int)  # [moments, cells]; the first is before any step
    own_arms, _ = GAMES["boxing"].arm_cells or ((), ())
    arms = memory[:, own_arms]
    out = (arms > OUT)[1:] & ~(arms > OUT)[:-1] & (arms != STRUCK).any(axis=1, keepdims=True)[1:]
    agent, rival = places(memory[1:])  # [steps, x and y]
    gaps = np.abs(agent - rival)
    gains = np.diff(scored)
    return Boxing(
        episode,
        game,
        digest,
        env.frames,
        env.score,
        *env.points(),
        punches=int(out.sum()),
        reach=float((gaps <= REACH).all(axis=1).mean()),
        distance=float(np.hypot(*gaps.T).mean()),
        blows=int((gains > 0).sum()),
        doubles=int((gains > 1).sum()),
        ropes=_at_ropes(agent),
        rival_ropes=_at_ropes(rival),
    )


def places(memory: np.ndarray) -> np.ndarray:
    """Where both boxers are in each of some moments: int [the agent and its rival, moments, x and
    y], in pixels, of the console's memory [moments, cells]."""
    return np.stack([memory[:, cells] for cells in GAMES["boxing"].boxers or ()]).astype(int)


def checks(run: Run) -> list[int]:
    """The training episodes after which a run has greedy episodes on record, in their order."""
    games = records.read_file(run.folder, torn=True)
    return sorted({heading["episode"] for heading, _ in games if heading["kind"] == records.VALUES})


def stays(run: Run, episode: int) -> np.ndarray:
    """Where both boxers spend their time in the first `MAPPED` greedy episodes after so many
    training episodes: the share of the steps [the agent and its rival, x, y], in cells of `CELL`
    pixels; what little is beyond the ropes counts for the cell there."""
    played = [
        record
        for heading, record in records.read_file(run.folder, torn=True)
        if heading["kind"] == records.VALUES and heading["episode"] == episode
    ]
    low, high = np.array(RING).T
    cells = (high - low) // CELL
    counts = np.zeros((2, *(cells + 1)))
    for record in played[:MAPPED]:
        memory = np.array([env.ram() for env in records.replay(run.params, record)][1:])
        for count, boxer in zip(counts, places(memory), strict=True):
            np.add.at(count, tuple(np.clip((boxer - low) // CELL, 0, cells).T), 1)
    return counts / counts[0].sum()


def _at_ropes(boxer: np.ndarray) -> float:
    """The share of the moments in which a boxer, [moments, x and y], is at the ropes."""
    (left, right), (top, bottom) = RING
    low = np.array([left, top]) + AT_ROPES
    high = np.array([right, bottom]) - AT_ROPES
    return float(((boxer <= low) | (boxer >= high)).any(axis=1).mean())


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
