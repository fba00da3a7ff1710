"""What the console's own memory tells: which punches score in Boxing, and how a game repeats.

Cells of positions and scores as Anand et al. (2019, AtariARI) annotate them. The arms' cells are
measured: while FIRE is held, an arm goes out by 8 a frame, up to 72 (tests/test_ram.py).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from atari_dqn.envs import AtariEnv
from atari_dqn.games import GAMES, boxing_points
from atari_dqn.report.plots import WIDTH, shades
from atari_dqn.runs.files import project_root

HOLD = 4  # frames that a random action is held, as an agent would
STORED = "results/benchmarks/punches.csv"


class Cells(NamedTuple):
    """Where the memory keeps a boxer."""

    x: int  # pixels, left to right
    y: int  # pixels, top to bottom
    score: int  # points: a decimal digit in each half of the byte, or 0xC0 for a knock-out
    arms: tuple[int, int]  # how far each arm is out, 0 to 72


BOXING = GAMES["boxing"]
assert BOXING.boxers
assert BOXING.score_cells
assert BOXING.arm_cells
BOXERS = {
    name: Cells(*place, score, arms)
    for name, place, score, arms in zip(
        ("agent", "computer"), BOXING.boxers, BOXING.score_cells, BOXING.arm_cells, strict=True
    )
}


class Punch(NamedTuple):
    """A punch that scored; distances and arm as they were a frame before the score changed."""

    game: int
    boxer: str
    points: int
    dx: int  # pixels between the boxers
    dy: int
    arm: int  # of the boxer's two, the one that is farther out


def scoring_punches(games: int, seed: int = 0) -> Iterator[tuple[Punch, np.ndarray]]:
    """Plays games with random actions; yields every punch that scores, of either boxer, and the
    picture at that moment, uint8 [210, 160, 3]."""
    game, rng = AtariEnv("boxing", frame_skip=1), np.random.default_rng(seed)
    agent, computer = BOXERS.values()
    for number in range(games):
        game.reset(seed=seed + number)
        over, before = False, game.ram().tolist()
        while not over:
            if game.length % HOLD == 0:
                action = int(rng.integers(len(game.actions)))
            over = game.step(action)[2]
            after = game.ram().tolist()
            for name, cells in BOXERS.items():
                gained = boxing_points(after[cells.score]) - boxing_points(before[cells.score])
                if gained:
                    dx = abs(before[computer.x] - before[agent.x])
                    dy = abs(before[computer.y] - before[agent.y])
                    arm = max(before[cell] for cell in cells.arms)
                    yield Punch(number, name, gained, dx, dy, arm), game.render()
            before = after


def first_pictures(seed: int = 0) -> dict[int, np.ndarray]:
    """The picture at the agent's first punch for one point and at its first for two, by points."""
    pictures: dict[int, np.ndarray] = {}
    for punch, picture in scoring_punches(1, seed):
        if punch.boxer == "agent":
            pictures.setdefault(punch.points, picture)
        if len(pictures) == 2:
            break
    return pictures


def stored_punches() -> pd.DataFrame:
    """A row per punch (`Punch`), as `benchmarks/punches.py` stored them."""
    return pd.read_csv(project_root() / STORED)


def summary(punches: pd.DataFrame) -> pd.DataFrame:
    """A row per boxer and number of points: how many punches, how far the arm was out, and how
    near the other boxer was."""
    columns = {
        "punches": ("arm", "size"),
        "arm, least": ("arm", "min"),
        "arm, most": ("arm", "max"),
        "horizontal, median": ("dx", "median"),
        "horizontal, most": ("dx", "max"),
        "vertical, median": ("dy", "median"),
    }
    return punches.groupby(["boxer", "points"]).agg(**columns).reset_index()


def frames_figure(pictures: dict[int, np.ndarray]) -> Figure:
    """The television's picture as a punch lands, by the points that it scores."""
    figure, panels = plt.subplots(1, len(pictures), figsize=(WIDTH, 2.6))
    for axes, (gained, picture) in zip(panels, sorted(pictures.items()), strict=True):
        axes.imshow(picture[:, 8:], aspect=4 / 7)  # a television's pixels are wider than high
        axes.set_title(f"{gained} point{'s' * (gained > 1)}", fontsize="medium")
        axes.axis("off")
    return figure


def punches_figure(punches: pd.DataFrame) -> Figure:
    """The punches by how far the arm was out, and by where the other boxer stood."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH, 2.7))
    shared = {"hue": "points", "palette": dict(zip((1, 2), shades(2), strict=True))}
    bins = np.arange(28, 77, 4)
    sns.histplot(punches, x="arm", bins=bins, multiple="layer", ax=left, **shared)
    left.set(xlabel="how far the arm was out (0 to 72)", ylabel="number of punches")
    left.set(yscale="log", xticks=range(32, 73, 8))
    places = punches.groupby(["points", "dx", "dy"]).size().reset_index(name="punches")
    places = places.sort_values("punches", ascending=False)  # small marks above large ones
    sns.scatterplot(
        places,
        x="dx",
        y="dy",
        size="punches",
        sizes=(4, 60),
        alpha=0.7,
        ax=right,
        legend=False,
        **shared,
    )
    right.set(xlabel="horizontal distance (pixels)", ylabel="vertical distance (pixels)")
    return figure


def first_difference(game: str, sticky_actions: float, steps: int) -> int | None:
    """Plays the same random actions in two games that differ in their seeds only.

    Returns the first agent step after which the two memories differ, None if they never do.
    """
    pair = [AtariEnv(game, noop_max=0, sticky_actions=sticky_actions) for _ in range(2)]
    for seed, one in enumerate(pair):
        one.reset(seed=seed)
    actions = np.random.default_rng(0).integers(len(pair[0].actions), size=steps)
    for step, action in enumerate(actions, start=1):
        for one in pair:
            one.step(int(action))
        if (pair[0].ram() != pair[1].ram()).any():
            return step
    return None
