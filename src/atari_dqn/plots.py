"""Every figure, in one style: colour-blind safe, told apart by line style too, vector graphics."""

import matplotlib as mpl
import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from atari_dqn.agents import AGENTS
from atari_dqn.envs import GAMES, AtariGame, GameFacts
from atari_dqn.statistics import trailing_mean

_COLOURS = sns.color_palette("colorblind")
COLOURS = {"dqn": _COLOURS[0], "double_dqn": _COLOURS[1], "dueling_double_dqn": _COLOURS[2]}
DASHES = {"dqn": "", "double_dqn": (4, 1.5), "dueling_double_dqn": (1, 1)}
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


def learning_curves(episodes: pd.DataFrame, facts: GameFacts, window: int) -> Figure:
    """Mean raw score of the last `window` games against games played.

    Every seed is a thin line and the mean over seeds a bold one. `episodes` holds columns episode,
    score, agent and seed.
    """
    curves = episodes.assign(
        mean=episodes.groupby(["agent", "seed"], sort=False)
        .score.apply(lambda scores: trailing_mean(scores, window))
        .to_numpy()
    ).dropna(subset="mean")
    figure, axes = plt.subplots()
    shared = {"x": "episode", "y": "mean", "hue": "agent", "style": "agent"}
    shared |= {"palette": COLOURS, "dashes": DASHES, "ax": axes}
    if episodes.seed.nunique() > 1:
        thin = {"units": "seed", "estimator": None, "lw": 0.6, "alpha": 0.5, "legend": False}
        sns.lineplot(curves, **thin, **shared)
    reached = curves.groupby(["agent", "seed"]).episode.max().groupby("agent").min()
    curves = curves[curves.episode <= curves.agent.map(reached)]  # by every seed of the agent
    sns.lineplot(curves, errorbar=None, lw=1.6, **shared)
    for score, name in ((facts.human, "human"), (facts.random, "random play")):
        axes.axhline(score, color="0.45", lw=0.8, ls=":")
        axes.annotate(
            f"{name} {score:g}",
            (1, score),
            xycoords=("axes fraction", "data"),
            xytext=(-2, 2),
            textcoords="offset points",
            ha="right",
            va="bottom",
            color="0.35",
            fontsize="small",
        )
    axes.set(xlabel="games played", ylabel=f"score, mean of {window} games")
    handles, names = axes.get_legend_handles_labels()
    titles = [AGENTS[name].title for name in names]
    axes.legend(handles, titles, loc="lower left", bbox_to_anchor=(0, 1), ncols=len(titles))
    return figure


def score_distributions(evaluations: pd.DataFrame) -> Figure:
    """The scores of the evaluation games, one strip and box an agent."""
    figure, axes = plt.subplots(figsize=(WIDTH, 2.4))
    shared = {"data": evaluations, "x": "score", "y": "agent", "hue": "agent", "palette": COLOURS}
    shared |= {"order": [agent for agent in AGENTS if agent in set(evaluations.agent)], "ax": axes}
    sns.boxplot(**shared, width=0.5, fliersize=0, boxprops={"alpha": 0.35}, legend=False)
    np.random.seed(0)  # noqa: NPY002 (seaborn draws its jitter from the global generator)
    sns.stripplot(**shared, size=2.5, jitter=0.18, legend=False)
    axes.set(xlabel="score of a game", ylabel="")
    axes.set_yticks(axes.get_yticks(), [AGENTS[name].title for name in shared["order"]])
    return figure


def preprocessing(games: list[str]) -> Figure:
    """The television's picture of each game, and an observation's four images, oldest first."""
    size = (WIDTH, 1.75 * len(games))
    widths = {"width_ratios": [1.1, 1, 1, 1, 1]}
    figure, rows = plt.subplots(len(games), 5, figsize=size, gridspec_kw=widths)
    for axes, name in zip(rows, games, strict=True):
        game = AtariGame(name)
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
