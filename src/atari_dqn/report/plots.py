"""Every plot, in one style: colour-blind safe, told apart by line style too.

An agent has one colour and one kind of line in all figures and videos (`STYLES`), and no other
thing has one of these colours: settings, and stages of one agent, are shades of another
(`shades`). What a person and random moves score is dotted and grey everywhere (`references`).
"""

import textwrap
from collections import deque
from collections.abc import Mapping
from itertools import cycle, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
import seaborn as sns
from matplotlib import font_manager
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from scipy import stats

from atari_dqn import params
from atari_dqn.analysis.statistics import cluster_interval, trailing_mean
from atari_dqn.analysis.study import FEW_OPENINGS, spelled
from atari_dqn.envs import SIZE, AtariEnv
from atari_dqn.games import GAMES, GameFacts
from atari_dqn.report.interactive import BESIDE, named

Colour = tuple[float, float, float]


class Style(NamedTuple):
    """How an agent is drawn."""

    colour: Colour
    line: Any  # matplotlib's line style


_LINES = ("-", (0, (4, 1.2)), (0, (1.2, 1)), (0, (4, 1, 1, 1)))
STYLES = {
    name: Style(colour, line)
    for name, colour, line in zip(
        params.AGENT_NAMES, cycle(sns.color_palette("colorblind")), cycle(_LINES), strict=False
    )
}
WIDTH = 6.3  # inches; the text's width on paper
TALLEST = 9.0  # inches, of a figure as wide as the text: a page holds it and its caption
INK, SOFT = "0.2", BESIDE
FONT = "Libertinus Serif"  # the PDF's
FONTS = Path(__file__).parent / "fonts"
SOURCE, PUBLISHED = "source report", "Dopamine"  # whose points stand beside our curves
OURS = "ours over the same games"
FADING = 0.4  # the power of a share of time that a map's colour follows, so that short stays show
SEEDS_OF_A_BAND = 3  # from so many on, an interval over seeds says something


def style() -> None:
    """Sets the style of all figures, and makes their bytes reproducible."""
    if FONT not in font_manager.fontManager.get_font_names():
        for file in sorted(FONTS.glob("*.otf")):
            font_manager.fontManager.addfont(file)
    sns.set_theme(context="paper", style="ticks", font=FONT)
    mpl.rcParams.update(
        {
            "figure.figsize": (WIDTH, 3.2),
            "figure.autolayout": True,  # the constrained layout differs from run to run
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.alpha": 0.3,
            "mathtext.fontset": "custom",
            "mathtext.rm": FONT,
            "mathtext.it": f"{FONT}:italic",
            "mathtext.bf": f"{FONT}:bold",
            "mathtext.cal": f"{FONT}:italic",
            "mathtext.sf": FONT,
            "svg.hashsalt": "atari-dqn",
            "svg.fonttype": "path",
            "legend.frameon": False,
        }
    )


def shades(count: int) -> list[Colour]:
    """Colours of what is no agent, in their order, from light to dark: settings, stages."""
    return sns.light_palette("#6b1740", count + 1)[1:]


def agents_of(table: pd.DataFrame) -> list[str]:
    """The agents in a table, in the order of `AGENT_NAMES`."""
    return [agent for agent in params.AGENT_NAMES if agent in set(table.agent)]


def smoothed(episodes: pd.DataFrame, window: int) -> pd.DataFrame:
    """Adds `mean`, the mean score of the last `window` episodes; episodes before the first go.

    `episodes` holds columns episode, score, agent, seed and, of a sweep or of several experiments,
    variation and experiment.
    """
    keys = [key for key in ("experiment", "variation", "agent", "seed") if key in episodes]
    means = episodes.groupby(keys, sort=False).score.transform(trailing_mean, window)
    return episodes.assign(mean=means).dropna(subset="mean")


def learning_curves(
    episodes: pd.DataFrame,
    facts: GameFacts,
    window: int,
    published: dict[str, Any] | None,
    source: pd.DataFrame,
) -> Figure:
    """Mean raw score of the last `window` episodes against episodes, frames and, where `episodes`
    has it, processor time.

    Every seed is a line. Where there are several, their mean against episodes is a bold one, with
    a 95% interval over seeds from `SEEDS_OF_A_BAND` on.

    `episodes` holds columns episode, frames, score, agent, seed and, if processor time is wanted,
    cpu_seconds. `source` are the source report's scores, hollow, and with them ours over the same
    episodes, filled: columns agent, episode, score and window, the episodes that a score is the
    mean of. `published` (scores by agent at `frames`, million) are grey marks; None leaves them and
    `references` out. Both are drawn as far as the curves reach and a little further.
    """
    curves = smoothed(episodes, window)
    curves = curves.assign(frames=curves.frames / 1e6)
    timed = "cpu_seconds" in curves
    if timed:
        curves = curves.assign(hours=curves.cpu_seconds / 3600)
    figure, panels = plt.subplot_mosaic(
        [["episode", "episode"], ["frames", "hours" if timed else "frames"]],
        figsize=(WIDTH, 5.6),
        gridspec_kw={"height_ratios": [2.3, 1]},
    )
    main = panels["episode"]
    for x, axes in panels.items():
        if published:
            references(axes, facts, labelled=axes is main)
        for agent in agents_of(curves):
            _curves_of(axes, curves[curves.agent == agent], agent, str(x), axes is main)
    handles = [
        Line2D([], [], color=STYLES[agent].colour, ls=STYLES[agent].line, lw=2)
        for agent in agents_of(curves)
    ]
    titles = [params.title(agent) for agent in agents_of(curves)]
    for title, inside in _source_points(main, source, episodes).items():
        handles.append(Line2D([], [], ls="none", marker="o", color=SOFT, mfc=inside, mew=1.3))
        titles.append(title)
    main.legend(
        handles, titles, loc="lower left", bbox_to_anchor=(-0.01, 1), ncols=3, fontsize="medium"
    )
    main.set(xlabel="training games", ylabel=f"score, mean of {window} games")
    if timed:
        panels["hours"].set(xlabel="hours of processor time", ylabel="")
    if published:
        _published_points(panels["frames"], published, 1.3 * float(curves.frames.max()))
    panels["frames"].set(xlabel="million frames", ylabel="score")
    for axes in panels.values():
        axes.set_xlim(left=0)
    return figure


def _curves_of(axes: Axes, curves: pd.DataFrame, agent: str, x: str, main: bool) -> None:
    """An agent's curves: of each seed, and in the main panel their mean."""
    title, look = params.title(agent), STYLES[agent]
    shared: dict[str, Any] = {"color": look.colour, "ls": look.line, "solid_capstyle": "round"}
    several = curves.seed.nunique() > 1
    for seed, own in curves.groupby("seed"):
        if main and several:
            named(axes.plot(own[x], own["mean"], lw=0.7, alpha=0.45, **shared)[0], title)
        else:
            name = f"{title}, seed {seed}" if several else title
            (line,) = axes.plot(own[x], own["mean"], lw=2 if main else 1.1, zorder=3, **shared)
            named(line, title, value=name)
    if main and several:
        scores = curves.pivot(index="episode", columns="seed", values="mean").dropna()
        mean = scores.mean(axis=1)  # as far as every seed has come
        (line,) = axes.plot(mean.index, mean, lw=2, zorder=3, **shared)
        named(line, title, value=title)
        if scores.shape[1] >= SEEDS_OF_A_BAND:
            half = stats.t.ppf(0.975, scores.shape[1] - 1) * scores.sem(axis=1)
            band: dict[str, Any] = {"color": look.colour, "alpha": 0.15, "lw": 0}
            named(axes.fill_between(mean.index, mean - half, mean + half, **band), title)


def _source_points(axes: Axes, source: pd.DataFrame, episodes: pd.DataFrame) -> dict[str, str]:
    """Draws the source report's scores of the agents in `episodes`, a little further than these
    reach, and ours over the same episodes. Returns what is drawn, and how a legend's mark is
    filled."""
    kinds = {}
    there = source.episode <= 1.3 * episodes.episode.max()
    shown = source[there & source.agent.isin(episodes.agent)].dropna(subset="score")
    for agent, theirs in shown.groupby("agent", sort=False):
        scores = episodes[episodes.agent == agent].pivot(
            index="episode", columns="seed", values="score"
        )
        ours = {
            last: scores.loc[last - window + 1 : last].mean().mean()
            for last, window in zip(theirs.episode, theirs.window, strict=True)
            if last in scores.index
        }
        title, colour = params.title(str(agent)), STYLES[str(agent)].colour
        how: dict[str, Any] = {"zorder": 4, "clip_on": False, "color": colour, "mew": 1.4, "ms": 6}
        (points,) = axes.plot(theirs.episode, theirs.score, "o", mfc="white", **how)
        named(points, title, SOURCE, value=f"{title}, {SOURCE}")
        kinds[SOURCE] = "white"
        if ours:
            (points,) = axes.plot(list(ours), list(ours.values()), "o", **how)
            named(points, title, SOURCE, value=f"{title}, {OURS}")
            kinds[OURS] = SOFT
    return kinds


def _published_points(axes: Axes, published: dict[str, Any], reach: float) -> None:
    """Draws other people's agents up to a number of frames."""
    agents = {name: scores for name, scores in published.items() if name != "frames"}
    handles = []
    for marker, (name, scores) in zip("sD^", agents.items(), strict=False):
        at = [
            (frames, score)
            for frames, score in zip(published["frames"], scores, strict=True)
            if score is not None and frames <= reach
        ]
        if at:
            how: dict[str, Any] = {
                "ls": "none",
                "marker": marker,
                "ms": 4,
                "mfc": "none",
                "color": SOFT,
            }
            handles += axes.plot(*zip(*at, strict=True), **how)
            named(handles[-1], PUBLISHED, value=f"{name}, {PUBLISHED}")
    if handles:
        names = [str(handle.get_label()).partition(f", {PUBLISHED}")[0] for handle in handles]
        axes.legend(  # outside, where it hides no curve
            handles, names, fontsize="x-small", loc="lower left", bbox_to_anchor=(-0.02, 0.98),
            ncols=len(handles), handletextpad=0.1, columnspacing=1,
        )  # fmt: skip


def references(axes: Axes, facts: GameFacts, labelled: bool, upright: bool = False) -> None:
    """Lines at what a human tester and random play score; `upright` where scores lie on x."""
    draw = axes.axvline if upright else axes.axhline
    # the human's name where curves are still low
    for score, name, side in ((facts.human, "human", 0), (facts.random, "random play", 1)):
        draw(score, color=SOFT, lw=1, ls=":", zorder=1)
        if not labelled:
            continue
        at: tuple[float, float]
        how: dict[str, Any] = {"textcoords": "offset points", "color": INK, "fontsize": "small"}
        text = f"{name} {score:g}"
        if upright:
            at, how["xycoords"] = (score, 1), ("data", "axes fraction")
            how |= {"xytext": (0, 2), "ha": "right" if side else "left", "va": "bottom"}
        else:
            at, how["xycoords"] = (side, score), ("axes fraction", "data")
            if side:  # beside the panel: within it, a curve that has learned nothing lies there
                text = text.replace(" ", "\n", 1)
                how |= {"xytext": (4, 0), "ha": "left", "va": "center"}
            else:
                how |= {"xytext": (2, 2), "ha": "left", "va": "bottom", "zorder": 5}
                how["path_effects"] = [withStroke(linewidth=2.5, foreground="white")]
            axes.margins(y=0.09)  # room for the human's name
        axes.annotate(text, at, **how)


def comparison(
    episodes: pd.DataFrame,
    facts: GameFacts,
    window: int,
    by: str,
    source: pd.DataFrame | None = None,
    main: str | None = None,
) -> Figure:
    """Mean score of the last `window` episodes against episodes, a line for each `by`: agents,
    or settings in their order, by `variation` or by the `label` of `study.comparable`. `source` are
    scores of the source report (columns episode and score), drawn a little further than the curves
    reach; `main` is the line that the others are there to be compared with."""
    curves = smoothed(episodes, window)
    figure, axes = plt.subplots(figsize=(WIDTH, 3.4))
    names = list(dict.fromkeys(curves[by]))
    looks = dict(zip(names, map(Style, shades(len(names)), cycle(_LINES)), strict=False))
    references(axes, facts, labelled=True)
    handles = []
    for name in names:
        look, title = (STYLES[name], params.title(name)) if by == "agent" else (looks[name], name)
        mean = curves[curves[by] == name].groupby("episode")["mean"].mean()
        if name == main:
            look = Style(mpl.colors.to_rgb(INK), "-")
        width = 2.6 if name == main else 1.8
        handles += axes.plot(mean.index, mean, color=look.colour, ls=look.line, lw=width)
        named(handles[-1], title, value=title)
    if source is not None:
        near = source[source.episode <= 1.3 * episodes.episode.max()].dropna(subset="score")
        if len(near):
            how: dict[str, Any] = {
                "mfc": "white",
                "color": INK,
                "mew": 1.4,
                "ms": 6,
                "clip_on": False,
            }
            handles += axes.plot(near.episode, near.score, "o", **how)
            named(handles[-1], SOURCE, value=SOURCE)
    longest = max((len(str(handle.get_label())) for handle in handles), default=0)
    columns = max(1, min(4, 90 // (longest + 8)))  # about 90 letters go into the figure's width
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(-0.01, 1), ncols=columns)
    averaged = f"score, mean of {window} games" if window > 1 else "score"
    axes.set(xlabel="training games", ylabel=averaged)
    return figure


def small_multiples(
    variations: pd.DataFrame, unchanged: pd.DataFrame, agent: str, window: int
) -> Figure:
    """A panel for each change of a setting: its curve, and in each the one of the unchanged
    set-up. Both tables hold columns episode, score, agent and seed; `variations` also variation."""
    curves, base = smoothed(variations, window), unchanged
    if not unchanged.empty:
        base = smoothed(unchanged, window).groupby("episode")["mean"].mean()
    names = list(dict.fromkeys(curves.variation))
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure, panels = plt.subplots(
        rows, columns, figsize=(WIDTH, 0.5 + 1.35 * rows), sharex=True, sharey=True, squeeze=False
    )
    look, colour = STYLES[agent], shades(2)[-1]
    handles = [Line2D([], [], color=colour, lw=1.3)]
    handles.append(Line2D([], [], color=look.colour, ls=look.line, lw=2.2))
    for place, axes in enumerate(panels.flat):
        if place >= len(names):
            axes.set_visible(False)
            continue
        if not unchanged.empty:
            how: dict[str, Any] = {"color": look.colour, "ls": look.line, "lw": 2.2}
            named(axes.plot(base.index, base, **how)[0], "unchanged", value="unchanged")
        mean = curves[curves.variation == names[place]].groupby("episode")["mean"].mean()
        (line,) = axes.plot(mean.index, mean, color=colour, lw=1.3)
        title = spelled(names[place])
        named(line, "with the change", value=title)
        axes.set_title(textwrap.fill(title, 22), fontsize="small", loc="left")
        axes.tick_params(labelbottom=place + columns >= len(names))  # nothing below it
    figure.supxlabel("training games", fontsize="medium", y=0.01)
    figure.supylabel(f"score, mean of {window} games", fontsize="medium", x=0.015)
    titles = ["with the change", "unchanged"][: 1 + (not unchanged.empty)]
    figure.legend(handles[: len(titles)], titles, loc="upper left", ncols=2)
    figure.tight_layout(rect=(0.01, 0, 1, 1 - 0.28 / figure.get_figheight()))
    return figure


def drawable(checks: pd.DataFrame) -> pd.DataFrame:
    """Those of the agents with two checks at the least: one makes no line."""
    if checks.empty:
        return checks
    return checks[checks.groupby("agent").episode.transform("nunique") > 1]


def value_errors(values: pd.DataFrame) -> Figure:
    """Predicted values of the states of greedy episodes (dots in the agent's colour), what was
    realised (grey circles) and, shaded, how far the one lies above the other, against training
    episodes; as a pale line the predictions for states that stay the same.

    `values` holds columns episode, predicted, realised, held_out_q and agent
    (`evaluation.ValueCheck`).
    """
    values = drawable(values)
    agents = agents_of(values)
    figure, panels = plt.subplots(
        1, len(agents), sharex=True, sharey=True, figsize=(WIDTH, 2.5), squeeze=False
    )
    for axes, agent in zip(panels[0], agents, strict=True):
        columns = ["predicted", "realised", "held_out_q"]
        own = values[values.agent == agent].groupby("episode")[columns].mean()
        colour, line = STYLES[agent]
        over = own.predicted > own.realised
        shade = {"color": colour, "alpha": 0.15, "lw": 0, "interpolate": True}
        axes.fill_between(own.index, own.predicted, own.realised, where=over, **shade)
        dots = {"marker": "o", "ms": 4}
        for column, name, how in (
            (
                "held_out_q",
                "prediction for fixed random states",
                {"color": colour, "lw": 1, "alpha": 0.6},
            ),
            ("realised", "what followed", {"color": SOFT, "lw": 1, "mfc": "white", **dots}),
            ("predicted", "predicted", {"color": colour, "ls": line, "lw": 1.6, **dots}),
        ):
            named(axes.plot(own.index, own[column], **how)[0], name, value=name)
        axes.set(xlabel="training games", ylabel="value of a state")
        axes.set_title(params.title(agent), fontsize="medium", loc="left")
        axes.label_outer()
    return figure


def styles_along(styles: pd.DataFrame, measures: dict[str, str]) -> Figure:
    """How agents play against training episodes, a panel for each measure, three in a row, by
    their columns in `Section.styles`."""
    styles, rows = drawable(styles), len(measures) // 3
    figure, panels = plt.subplots(rows, 3, sharex=True, figsize=(WIDTH, 0.5 + 1.6 * rows))
    for axes, (column, title) in zip(panels.flat, measures.items(), strict=True):
        for agent in agents_of(styles):
            own = styles[styles.agent == agent].groupby("episode")[column].mean()
            name, (colour, line) = params.title(agent), STYLES[agent]
            (drawn,) = axes.plot(own.index, own, color=colour, ls=line, lw=1.6)
            named(drawn, name, value=name)
        axes.set_title(textwrap.fill(title, 34), fontsize="small", loc="left")
        axes.set(ylim=(0, None), xlim=(0, None))
    for axes in panels[-1]:
        axes.set_xlabel("training games")
    titles = [params.title(agent) for agent in agents_of(styles)]
    figure.legend(
        panels.flat[0].get_lines(), titles, loc="upper left", ncols=3, bbox_to_anchor=(0.06, 1.0)
    )
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.25 / figure.get_figheight()))
    return figure


def style_map(styles: pd.DataFrame, measures: tuple[str, str], checks: int) -> Figure:
    """Each agent's way over its training on a map of two measures (columns of `Section.styles`),
    each point the mean of so many checks in a row; hollow where it begins, filled where it ends.
    Where `styles` has a column variation, the ways of one agent's variations."""
    if "variation" in styles:
        names = list(styles.variation.unique())
        colours = dict(zip(names, shades(len(names)), strict=True))
        looks = {name: (name, colour, "-") for name, colour in colours.items()}
    else:
        looks = {agent: (params.title(agent), *STYLES[agent]) for agent in agents_of(styles)}
    figure, axes = plt.subplots(figsize=(WIDTH, 3.4))
    for key, (name, colour, line) in looks.items():
        own = styles[styles["variation" if "variation" in styles else "agent"] == key]
        way = own.groupby("episode")[list(measures)].mean().rolling(checks).mean().dropna()
        (drawn,) = axes.plot(*way.to_numpy().T, color=colour, ls=line, lw=1.2, label=name)
        named(drawn, name, value=name)
        for end, face in ((0, "white"), (-1, colour)):
            axes.plot(*way.iloc[end], "o", ms=7, color=colour, markerfacecolor=face)
    labels = {
        "distance": "distance of the boxers (pixels)",
        "conceded_per_minute": "points conceded per minute",
    }
    axes.set(xlabel=labels[measures[0]], ylabel=labels[measures[1]])
    axes.legend()
    return figure


def places(stays: Mapping[str, Mapping[int, np.ndarray]]) -> Figure:
    """Where the agent and its rival stand: a row per agent, and for each of two checks, by the
    episodes before them, the share of the time [the two, x, y] in cells of equal size."""
    figure, panels = plt.subplots(
        len(stays), 4, squeeze=False, figsize=(WIDTH, 0.3 + 1.15 * len(stays))
    )
    most = max(part.max() for checks in stays.values() for part in checks.values())
    shade = sns.light_palette("#6b1740", as_cmap=True)
    for row, (agent, checks) in zip(panels, stays.items(), strict=True):
        maps = [
            (f"{who}, {episode:,} games", part)
            for episode, both in checks.items()
            for who, part in zip(("agent", "rival"), both, strict=True)
        ]
        for axes, (title, part) in zip(row, maps, strict=True):
            how = {"edgecolors": "face", "linewidth": 0.1}  # else thin lines show between cells
            axes.pcolormesh(part.T, cmap=shade, norm=PowerNorm(FADING, vmin=0, vmax=most), **how)
            axes.set(xticks=[], yticks=[], aspect=4 / 7)
            axes.invert_yaxis()  # as on the television
            axes.set_title(title, fontsize="small")
        row[0].set_ylabel(params.title(agent).replace("Double", "\nDouble"), fontsize="small")
    return figure


def score_distributions(evaluations: pd.DataFrame, facts: GameFacts | None) -> Figure:
    """The scores of the evaluation episodes, a row of dots per agent, with each run's mean and the
    95% interval of it over openings, unless these are few; `facts` None leaves `references` out."""
    agents = agents_of(evaluations)
    figure, axes = plt.subplots(figsize=(WIDTH, 0.9 + 0.65 * len(agents)))
    rng = np.random.default_rng(0)
    for place, agent in enumerate(agents):
        runs = evaluations[evaluations.agent == agent].groupby("seed")
        for row, (_, run) in enumerate(runs):
            y = place + 0.62 * ((row + 0.5) / len(runs) - 0.5)  # a lane per run
            scores, spread = run.score.to_numpy(float), 0.2 / len(runs)
            heights = y + rng.uniform(-spread, spread, len(scores))
            dots: dict[str, Any] = {
                "ms": 3.2,
                "alpha": 0.4,
                "mew": 0,
                "color": STYLES[agent].colour,
            }
            axes.plot(scores, heights, "o", **dots)
            mean = scores.mean()
            if run.opening.nunique() > FEW_OPENINGS:
                spread_of_mean = cluster_interval(scores, run.opening.to_numpy())
                axes.plot(spread_of_mean, [y, y], color=INK, lw=2.2, solid_capstyle="butt")
            axes.plot(mean, y, "D", ms=6, color=STYLES[agent].colour, mec=INK, mew=1.2, zorder=4)
            how: dict[str, Any] = {
                "textcoords": "offset points",
                "ha": "center",
                "va": "bottom",
                "color": INK,
            }
            halo = [withStroke(linewidth=2.5, foreground="white")]
            axes.annotate(f"{mean:.1f}", (mean, y), (0, 6), path_effects=halo, zorder=5, **how)
    if facts:
        references(axes, facts, labelled=True, upright=True)
    axes.set(xlabel="score of a game", ylabel="", ylim=(len(agents) - 0.4, -0.6))
    axes.set_yticks(range(len(agents)), [params.title(name) for name in agents])
    axes.grid(False, axis="y")
    axes.tick_params(axis="y", length=0)
    return figure


class _Watched(AtariEnv):
    """Keeps the television's pictures of the latest step, uint8 [210, 160, 3] each."""

    def __init__(self, game: str):
        super().__init__(game)
        self.pictures: deque[np.ndarray] = deque(maxlen=self.frame_skip)

    def _act(self, action: int) -> float:
        points = super()._act(action)
        self.pictures.append(self.render())
        return points

    def maximum(self) -> np.ndarray:
        """The grey screen that the latest image was made from, uint8 [210, 160]."""
        return self._screens[0]


def preprocessing(games: list[str]) -> Figure:
    """From the frames of an agent step to an observation, with pictures of each game; and from its
    points to a reward."""
    stack, side = 4, 0.77  # images; inches
    high, pitch, gap, shift = side * 210 / 160, 1.3, 0.5, 0.15
    height = pitch * len(games) + 0.95
    figure = plt.figure(figsize=(WIDTH, height), layout="none")
    sheet = figure.add_axes((0, 0, 1, 1))
    sheet.set(xlim=(0, WIDTH), ylim=(0, height))
    sheet.axis("off")

    def show(picture: np.ndarray, x: float, y: float, tall: float) -> None:
        where = (x / WIDTH, y / height, side / WIDTH, tall / height)
        axes = figure.add_axes(where, xticks=[], yticks=[])
        axes.grid(False)
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255, aspect="auto")
        axes.spines[:].set(visible=True, color="white", lw=1)

    def arrow(start: float, end: float, y: float, label: str) -> None:
        how = {"arrowstyle": "-|>", "color": SOFT, "shrinkA": 0, "shrinkB": 0}
        sheet.annotate("", (end, y), (start, y), arrowprops=how)
        sheet.text((start + end) / 2, y + 0.06, label, ha="center", va="bottom", size=8, color=INK)

    frames = (0.32, 0.32 + side + 0.05)
    greatest = frames[1] + side + gap
    small = greatest + side + gap
    stacked = small + side + gap
    for row, name in enumerate(games):
        base = height - 0.42 - pitch * row - high
        middle, lower = base + high / 2, base + (high - side) / 2
        game = _Watched(name)
        images = [game.reset(seed=1)[0]]
        for action in np.random.default_rng(0).integers(len(game.actions), size=60):
            images.append(game.step(int(action))[0])
        for picture, x in zip(list(game.pictures)[-2:], frames, strict=True):
            show(picture, x, base, high)
        show(game.maximum(), greatest, base, high)
        show(images[-1], small, lower, side)
        for place, image in enumerate(images[-stack:]):  # the newest in front
            depth = stack / 2 - 0.5 - place
            show(image, stacked + place * shift, lower + depth * 0.12, side)
        arrow(frames[1] + side + 0.05, greatest - 0.05, middle, "grey,\nmaximum")
        arrow(greatest + side + 0.05, small - 0.05, middle, "resize")
        arrow(small + side + 0.05, stacked - 0.05, middle, "stack")
        sheet.text(0.1, middle, GAMES[name].title, rotation=90, va="center", weight="bold", size=9)
    ends = stacked + side + (stack - 1) * shift
    heads = (
        ((frames[0] + frames[1] + side) / 2, "the last two of four frames"),
        (greatest + side / 2, "grey, 160 × 210"),
        (small + side / 2, f"{SIZE} × {SIZE}"),
        ((stacked + ends) / 2, f"observation: {stack} images"),
    )
    for x, text in heads:
        sheet.text(x, height - 0.2, text, ha="center", va="center", size=9, color=INK)
    lane = 0.3
    places = (heads[0][0], (greatest + small + side) / 2, heads[3][0])
    told = (
        "points of the four\nframes, added up",
        "clipped to\n−1, 0 or 1",
        "reward that is\nlearned from",
    )
    box = {"boxstyle": "round,pad=0.35", "fc": "0.95", "ec": SOFT, "lw": 0.8}
    for x, text in zip(places, told, strict=True):
        sheet.text(x, lane, text, ha="center", va="center", size=9, color=INK, bbox=box)
    for start, end in pairwise(places):
        arrow(start + 0.72, end - 0.6, lane, "")
    return figure


def views(pictures: dict[str, np.ndarray], said: dict[str, str]) -> Figure:
    """Small pictures, uint8 [84, 84], side by side, each with its title and what is said of it."""
    figure, panels = plt.subplots(1, len(pictures), figsize=(WIDTH, WIDTH / len(pictures) + 0.7))
    for axes, (title, picture) in zip(panels, pictures.items(), strict=True):
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255)
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize="small")
        axes.set_xlabel(said[title], fontsize="x-small", color=INK)  # names nearly as wide
    figure.tight_layout()
    return figure
