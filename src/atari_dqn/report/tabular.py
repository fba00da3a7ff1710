"""Q-learning with a table, on a world small enough to print every value.

The worked example of the report's section 01 is Gymnasium's CliffWalking (Sutton and Barto, 2018,
example 6.6): 4 rows of 12 cells, numbered row by row. A step costs 1 point; a fall from the cliff
costs 100 and leads back to the start; the game ends at the goal.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import gymnasium
import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from atari_dqn.analysis.statistics import trailing_mean
from atari_dqn.report.plots import SOFT, WIDTH, shades
from atari_dqn.schedules import epsilon_greedy

ROWS, COLUMNS = 4, 12
START, GOAL = 36, 47  # the lower corners; the cells between them are the cliff
SHORTEST = -13  # points; up, eleven times right, down
ARROWS = "↑→↓←"  # the four actions
WINDOW = 20  # games that a point of the learning curve is the mean of


class Transition(NamedTuple):
    """What one step of a game shows."""

    s_tm1: int
    a_tm1: int
    r_t: float
    s_t: int
    over: bool  # the game ended with this step


def update(q: np.ndarray, seen: Transition, alpha: float, gamma: float) -> None:
    """Q-learning's step (Watkins and Dayan, 1992, equation 1), in place. q: [states, actions]."""
    value_t = 0.0 if seen.over else q[seen.s_t].max()
    target = seen.r_t + gamma * value_t
    q[seen.s_tm1, seen.a_tm1] += alpha * (target - q[seen.s_tm1, seen.a_tm1])


def cliff() -> gymnasium.Env:
    """The world itself, without Gymnasium's checks, which would take most of the time."""
    return gymnasium.make("CliffWalking-v1").unwrapped


def learn(
    epsilon: Callable[[int], float], games: int, seed: int, alpha: float = 0.5, gamma: float = 1.0
) -> tuple[np.ndarray, list[float]]:
    """Q-learning for some games, in each of which `epsilon(game)` of the actions are random.

    Returns the table, float [48, 4], and the points of every game.
    """
    world, rng = cliff(), np.random.default_rng(seed)
    q, scores = np.zeros((ROWS * COLUMNS, len(ARROWS))), []
    for game in range(games):
        s_tm1, _ = world.reset(seed=seed)
        over, score = False, 0.0
        while not over:
            a_tm1 = int(epsilon_greedy(q[None, s_tm1], epsilon(game), rng)[0])
            s_t, r_t, over, _, _ = world.step(a_tm1)
            update(q, Transition(s_tm1, a_tm1, r_t, s_t, over), alpha, gamma)
            s_tm1, score = s_t, score + r_t
        scores.append(score)
    return q, scores


def compare(
    schemes: dict[str, Callable[[int], float]], games: int, seeds: Iterable[int]
) -> pd.DataFrame:
    """A row per game of every exploration scheme and seed: exploration, seed, game, score, mean."""
    tables = []
    for name, epsilon in schemes.items():
        for seed in seeds:
            _, scores = learn(epsilon, games, seed)
            table = pd.DataFrame({"game": range(1, games + 1), "score": scores})
            table["mean"] = trailing_mean(table.score, WINDOW)
            tables.append(table.assign(exploration=name, seed=seed))
    return pd.concat(tables, ignore_index=True)


def greedy_path(q: np.ndarray) -> list[int]:
    """The cells that the best actions of the table lead through; cut if they miss the goal."""
    world, cells = cliff(), [START]
    while cells[-1] != GOAL and len(cells) < ROWS * COLUMNS:
        moves = world.P[cells[-1]]  # type: ignore[attr-defined]
        ((_, s_t, _, _),) = moves[int(q[cells[-1]].argmax())]
        cells.append(int(s_t))
    return cells


def grid_figure(q: np.ndarray) -> Figure:
    """The table as a map: each cell's greatest value and best action. Framed: the greedy path."""
    values, best = q.max(axis=1), q.argmax(axis=1)
    figure, axes = plt.subplots(figsize=(WIDTH, 2.2))
    shown = np.ma.masked_where(np.isin(np.arange(len(q)), range(START + 1, GOAL + 1)), values)
    low, high = shown.min(), shown.max()
    path = shades(2)[-1]
    axes.pcolormesh(
        shown.reshape(ROWS, COLUMNS),
        cmap=sns.light_palette("0.55", as_cmap=True),
        vmin=low,
        vmax=high + (high - low),  # only the lighter half of the palette, that text be legible
        edgecolor="white",
        linewidth=1.5,
    )
    for cell in greedy_path(q):
        row, column = divmod(cell, COLUMNS)
        frame = Rectangle((column + 0.06, row + 0.06), 0.88, 0.88, fill=False, ec=path, lw=1.5)
        axes.add_patch(frame)
    for cell in np.flatnonzero(~shown.mask):
        row, column = divmod(cell, COLUMNS)
        text = f"{ARROWS[best[cell]]}\n{values[cell]:.1f}".replace("-", "−")
        axes.text(column + 0.5, row + 0.5, text, size=8, linespacing=1.3, ha="center", va="center")
    axes.fill_between([1.04, COLUMNS - 1.04], ROWS - 0.96, ROWS - 0.04, color="0.88", lw=0)
    for column, name in ((COLUMNS / 2, "cliff: −100, and back to the start"), (11.5, "goal")):
        axes.text(column, ROWS - 0.5, name, ha="center", va="center")
    axes.text(0.5, ROWS + 0.1, "start", ha="center", va="top")
    axes.set(ylim=(ROWS + 0.4, 0))
    axes.axis("off")
    return figure


def curves_figure(scores: pd.DataFrame) -> Figure:
    """Points while learning, of each exploration scheme: mean and range of its seeds."""
    figure, axes = plt.subplots(figsize=(WIDTH, 2.6))
    shared = {"x": "game", "y": "mean", "hue": "exploration", "style": "exploration"}
    shared["palette"] = shades(scores.exploration.nunique())
    sns.lineplot(scores, **shared, errorbar=("pi", 100), ax=axes)
    axes.axhline(SHORTEST, color=SOFT, lw=0.8, ls=":", label=f"best possible: −{-SHORTEST}")
    axes.set(xlabel="games", ylabel=f"points, mean of {WINDOW} games", ylim=(-150, 0))
    axes.legend(loc="lower right")
    return figure


def overestimation(actions: Iterable[int], samples: int, seed: int = 0) -> pd.DataFrame:
    """What is believed of the best of some actions that are all worth 0.

    Every action has two independent estimates, wrong by normal noise of standard deviation 1. The
    first set selects; the same set, or the second, then says what the selected action is worth
    (van Hasselt, 2010). Columns: actions, evaluated with, believed (mean of the samples).
    """
    rng, rows = np.random.default_rng(seed), []
    for count in actions:
        estimates = rng.standard_normal((2, samples, count))
        selected = estimates[0].argmax(axis=1)[:, None]
        for name, values in zip(("the same estimates", "a second set"), estimates, strict=True):
            believed = np.take_along_axis(values, selected, axis=1).mean()
            rows.append((count, name, believed))
    return pd.DataFrame(rows, columns=["actions", "evaluated with", "believed"])


def overestimation_figure(believed: pd.DataFrame) -> Figure:
    """What is believed of the best action, against the number of actions."""
    figure, axes = plt.subplots(figsize=(WIDTH, 2.4))
    shared = {"hue": "evaluated with", "style": "evaluated with", "markers": True}
    sns.lineplot(believed, x="actions", y="believed", palette=shades(2)[::-1], **shared, ax=axes)
    ticks = {2: "2", 4: "4\nBreakout", 8: "8", 12: "12", 18: "18\nBoxing"}
    axes.set(xlabel="", ylabel="estimated value of the best\naction (true value: 0)")
    axes.set_xticks(list(ticks), [f"{name}" for name in ticks.values()])
    axes.set_xlabel("actions to select from")
    return figure
