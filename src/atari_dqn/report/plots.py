"""Every figure, in one style: colour-blind safe, told apart by line style too, vector graphics."""

from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from atari_dqn import params
from atari_dqn.analysis.statistics import trailing_mean
from atari_dqn.envs import AtariEnv
from atari_dqn.games import GAMES, GameFacts

_COLOURS = sns.color_palette("colorblind")
COLOURS = dict(zip(params.AGENT_NAMES, cycle(_COLOURS), strict=False))
DASHES = dict(zip(params.AGENT_NAMES, cycle(("", (4, 1.5), (1, 1), (4, 1, 1, 1))), strict=False))
WIDTH = 6.3  # inches; the text's width on paper


def style() -> None:
    """Sets the style of all figures, and makes their bytes reproducible."""
    sns.set_theme(context="paper", style="ticks", font="DejaVu Sans")
    mpl.rcParams.update(
        {
            "figure.figsize": (WIDTH, 3.2),
            "figure.autolayout": True,  # the constrained layout differs from run to run
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.alpha": 0.3,
            "svg.hashsalt": "atari-dqn",
            "svg.fonttype": "path",
            "legend.frameon": False,
        }
    )


def smoothed(episodes: pd.DataFrame, window: int) -> pd.DataFrame:
    """Adds `mean`, the mean score of the last `window` games; games before the first go.

    `episodes` holds columns episode, score, agent, seed and, of a sweep, variation.
    """
    keys = [key for key in ("variation", "agent", "seed") if key in episodes]
    means = episodes.groupby(keys, sort=False).score.transform(trailing_mean, window)
    return episodes.assign(mean=means).dropna(subset="mean")


def learning_curves(
    episodes: pd.DataFrame, facts: GameFacts, window: int, published: dict[str, Any] | None
) -> tuple[Figure, dict[str, Any]]:
    """Mean raw score of the last `window` games against games, frames and hours of training.

    Every seed is a line; where there are several, their mean against games is a bold one.
    `episodes` holds columns episode, frames, seconds, score, agent and seed; `published` (scores
    by agent at `frames`, million) are marks beside them; None leaves them and the human and random
    references out. Returns the figure and what
    `hover_values` says of it.
    """
    curves = smoothed(episodes, window)
    curves = curves.assign(frames=curves.frames / 1e6, hours=curves.seconds / 3600)
    figure, panels = plt.subplot_mosaic(
        [["games", "games"], ["frames", "hours"]],
        figsize=(WIDTH, 4.9),
        gridspec_kw={"height_ratios": [1.5, 1]},
    )
    shared = {"y": "mean", "hue": "agent", "style": "agent", "palette": COLOURS, "dashes": DASHES}
    every = {"units": "seed", "estimator": None, "legend": False}
    several = episodes.seed.nunique() > 1
    width, alpha = (0.6, 0.5) if several else (1.4, 1.0)
    for name, x in (("games", "episode"), ("frames", "frames"), ("hours", "hours")):
        sns.lineplot(curves, x=x, **shared, **every, lw=width, alpha=alpha, ax=panels[name])
        if published:
            _reference_lines(panels[name], facts, named=name == "games")
    reached = curves.groupby(["agent", "seed"]).episode.max().groupby("agent").min()
    common = curves[curves.episode <= curves.agent.map(reached)]  # by every seed of the agent
    games = panels["games"]
    bold = {"errorbar": None, "lw": 1.6 if several else 0.0}
    sns.lineplot(common, x="episode", **shared, **bold, ax=games)
    handles, names = games.get_legend_handles_labels()
    for handle in handles:
        handle.set_linewidth(1.6)  # type: ignore[attr-defined]
    titles = [params.title(name) for name in names]
    games.legend(handles, titles, loc="lower left", bbox_to_anchor=(0, 1), ncols=len(titles))
    games.set(xlabel="games played", ylabel=f"score, mean of {window} games")
    panels["hours"].set(xlabel="hours by the clock", ylabel="")
    if published:
        _published(panels["frames"], published, float(curves.frames.max()))
    panels["frames"].set(xlabel="million frames", ylabel="score")
    means = common.groupby(["agent", "episode"])["mean"].mean()
    lines = {params.title(agent): means[agent] for agent in agents_of(curves)}
    return figure, hover_values(figure, games, lines, "after games:")


def agents_of(table: pd.DataFrame) -> list[str]:
    """The agents in a table, in the order of `AGENT_NAMES`."""
    return [agent for agent in params.AGENT_NAMES if agent in set(table.agent)]


def _reference_lines(axes: Axes, facts: GameFacts, named: bool) -> None:
    # the human score's name where curves are still low
    for score, name, side in ((facts.human, "human", 0), (facts.random, "random play", 1)):
        axes.axhline(score, color="0.45", lw=0.8, ls=":")
        if named:
            axes.annotate(
                f"{name} {score:g}",
                (side, score),
                xycoords=("axes fraction", "data"),
                xytext=(2 - 4 * side, 2),
                textcoords="offset points",
                ha="right" if side else "left",
                va="bottom",
                color="0.35",
                fontsize="small",
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
                zorder=5,
            )


def _published(axes: Axes, published: dict[str, Any], reached: float) -> None:
    """Marks of other people's agents, as far as the curves reach and a little further."""
    agents = {name: scores for name, scores in published.items() if name != "frames"}
    for marker, (name, scores) in zip("os^", agents.items(), strict=False):
        at = [
            (frames, score)
            for frames, score in zip(published["frames"], scores, strict=True)
            if score is not None and frames <= 1.3 * reached
        ]
        if at:
            axes.plot(
                *zip(*at, strict=True),
                marker,
                ms=4,
                mfc="none",
                color="0.4",
                label=f"{name}, published",
            )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize="x-small", loc="best", handletextpad=0.2)


def hover_values(
    figure: Figure, axes: Axes, lines: dict[str, pd.Series], x_label: str
) -> dict[str, Any]:
    """What the page needs to show values under the pointer: where the axes lie in the figure
    (shares of its width), their limits, and at most 200 points of every line."""
    figure.canvas.draw()
    box, (x_min, x_max) = axes.get_position(), axes.get_xlim()
    thinned = {name: line.iloc[:: max(1, len(line) // 200)] for name, line in lines.items()}
    return {
        "x_label": x_label,
        "axes": {
            "left": round(box.x0, 4),
            "width": round(box.width, 4),
            "x_min": round(x_min, 4),
            "x_max": round(x_max, 4),
        },
        "curves": [
            {"name": name, "xs": line.index.tolist(), "ys": line.round(2).tolist()}
            for name, line in thinned.items()
            if len(line)
        ],
    }


def comparison(episodes: pd.DataFrame, facts: GameFacts, window: int, by: str) -> Figure:
    """Mean score of the last `window` games against games played, a line for each `by`."""
    curves = smoothed(episodes, window)
    figure, axes = plt.subplots(figsize=(WIDTH, 3.4))
    names = list(dict.fromkeys(curves[by]))
    palette = dict(zip(names, sns.color_palette("colorblind", len(names)), strict=True))
    shared = {"x": "episode", "y": "mean", "hue": by, "style": by, "palette": palette}
    sns.lineplot(curves, **shared, errorbar=None, lw=1.4, ax=axes)
    _reference_lines(axes, facts, named=True)
    axes.set(xlabel="games played", ylabel=f"score, mean of {window} games")
    sns.move_legend(axes, "lower left", bbox_to_anchor=(0, 1), ncols=3, title=None)
    return figure


def value_errors(values: pd.DataFrame) -> Figure:
    """Predicted (solid) and realised values (dashed) of the states of greedy games, and the
    predicted ones of states that stay the same (dotted), against training games.

    `values` holds columns episode, predicted, realised, held_out_q and agent
    (`evaluation.ValueCheck`).
    """
    agents = agents_of(values)
    figure, panels = plt.subplots(1, len(agents), sharey=True, figsize=(WIDTH, 2.3), squeeze=False)
    for axes, agent in zip(panels[0], agents, strict=True):
        own = values[values.agent == agent]
        shared = {"x": "episode", "data": own, "ax": axes, "errorbar": None, "legend": False}
        sns.lineplot(y="predicted", color=COLOURS[agent], lw=1.5, marker="o", ms=3.5, **shared)
        sns.lineplot(y="realised", color="0.35", lw=1.2, ls="--", marker="o", ms=3.5, **shared)
        sns.lineplot(y="held_out_q", color=COLOURS[agent], lw=1.2, ls=":", **shared)
        axes.set(xlabel="games played", ylabel="value of a state")
        axes.set_title(params.title(agent), fontsize="medium", loc="left")
    return figure


def score_distributions(evaluations: pd.DataFrame) -> Figure:
    """The scores of the evaluation games, one strip and box an agent."""
    figure, axes = plt.subplots(figsize=(WIDTH, 2.4))
    shared = {"data": evaluations, "x": "score", "y": "agent", "hue": "agent", "palette": COLOURS}
    shared |= {"order": agents_of(evaluations), "ax": axes}
    sns.boxplot(**shared, width=0.5, fliersize=0, boxprops={"alpha": 0.35}, legend=False)
    np.random.seed(0)  # noqa: NPY002 (seaborn draws its jitter from the global generator)
    sns.stripplot(**shared, size=2.5, jitter=0.18, legend=False)
    axes.set(xlabel="score of a game", ylabel="")
    axes.set_yticks(axes.get_yticks(), [params.title(name) for name in shared["order"]])
    return figure


def preprocessing(games: list[str]) -> Figure:
    """The television's picture of each game, and an observation's four images, oldest first."""
    size = (WIDTH, 1.75 * len(games))
    widths = {"width_ratios": [1.1, 1, 1, 1, 1]}
    figure, rows = plt.subplots(len(games), 5, figsize=size, gridspec_kw=widths)
    for axes, name in zip(rows, games, strict=True):
        game = AtariEnv(name)
        images = [game.reset(seed=1)[0]]
        for action in np.random.default_rng(0).integers(len(game.actions), size=60):
            images.append(game.step(int(action))[0])
        axes[0].imshow(game.render())
        axes[0].set_title(f"{GAMES[name].title}: 160 x 210, colour", fontsize="small", loc="left")
        for place, image in enumerate(images[-4:], start=1):
            axes[place].imshow(image, cmap="gray", vmin=0, vmax=255)
            axes[place].set_title(["84 x 84, grey", "", "", "newest"][place - 1], fontsize="small")
        for panel in axes:
            panel.axis("off")
    return figure
