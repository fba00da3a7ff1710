"""The videos that the report shows: of which runs, which games, and what their captions say."""

from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from torch import nn

from atari_dqn import params
from atari_dqn.agents import AGENTS
from atari_dqn.analysis.study import Section
from atari_dqn.games import KNOCK_OUT
from atari_dqn.networks import DuelingNetwork
from atari_dqn.report import heat
from atari_dqn.report.outputs import show_absent, show_placeholders, show_video
from atari_dqn.report.video import Video, play_with_instruments, side_by_side
from atari_dqn.runs import models
from atari_dqn.runs.files import write_atomically
from atari_dqn.runs.models import load_model, stored_agent
from atari_dqn.runs.run import Run

LATE = 3  # times the training games of an early model make a late one
GAME = 0  # the number of the evaluation game that is recorded, where nothing decides otherwise
# What is drawn beside and below the pictures
MIND = (
    "[Beside it: what the network sees, and a bar for the value of each action, relative to the "
    "mean of all; the chosen one is coloured.]{.page}"
)
TRACE = (
    "[Below each picture: the value of the best action over the last seconds, with white triangles "
    "above it for points scored and grey ones below it for points conceded.]{.page}"
)
TRACE_PAPER = (
    "[Below the pictures: the value of the best action (max Q){}, with a thin line at each "
    "picture.]{{.paper}}"
)
STATE = ", or of the state (V(s)) if the network has a stream for it"
# What lies over the pictures of a video with a layer of heat
HEAT = (
    "[The switch makes the picture grey and lays over it]{{.page}}[Over the pictures, made grey,]"
    "{{.paper}} how steeply the values change with the brightness of each pixel of the newest "
    "image [@wang2016], a little smoothed; orange: the value of the state, blue: the advantage of "
    "the best action, each on one scale throughout. The maps of @{} show what changes when a place "
    "is blurred; a slope tells of a change too small to be seen, of one pixel by itself."
)
ALT = "A video of {}: the game, what the network sees, the value of every action and the score."


def _network(run: Run, games: int) -> nn.Module:
    return load_model(models.stored(run)[games], run.params)


def _scored(video: Video) -> str:
    *first, last = (f"{game.score:g}" for game in video.games)
    listed = f"{', '.join(first)} and {last}" if first else last
    return f"{listed} points".replace("-", "−")


def _trace(*networks: nn.Module) -> str:
    """What is drawn below the pictures of games that these play."""
    dueling = any(isinstance(network, DuelingNetwork) for network in networks)
    return f"{TRACE} {TRACE_PAPER.format(STATE if dueling else '')}"


def _newest(section: Section) -> list[tuple[Run, int]]:
    """The runs that have a model, with the games behind the newest."""
    return [(run, max(found)) for run in section.usable if (found := models.stored(run))]


def show_best(section: Section, label: str, seconds: int) -> None:
    """The first seconds of a game by the run that scored best of late."""
    stored = [(run, games) for run, games in _newest(section) if games]
    if not stored:
        show_placeholders(label)
        return
    recent = section.episodes.groupby(["agent", "seed"]).tail(100)
    means = recent.groupby(["agent", "seed"]).score.mean()
    run, games = max(stored, key=lambda item: means[item[0].agent, item[0].seed])
    network = _network(run, games)
    title = f"{params.title(run.agent)}, {games:,} games"
    video = play_with_instruments(network, run.params, title, run.seed, GAME, (None, seconds))
    show_video(
        video,
        label=label,
        caption=f"{params.title(run.agent)} after {games:,} training games: the first {seconds} "
        f"seconds of a game that ends with {_scored(video)}. {MIND} {_trace(network)}",
        alt=ALT.format(section.facts.title),
        data=str(run.name),
    )


def show_early_and_late(section: Section, label: str) -> None:
    """The same agent on the same game, early in its training and late."""
    for run in section.usable:
        stored = models.stored(run)
        if len(stored) > 1 and max(stored) >= LATE * min(stored):
            break
    else:
        show_placeholders(label)
        return
    chosen = (min(stored), max(stored))
    contestants = {f"{games:,} games": (_network(run, games), run.params) for games in chosen}
    video = side_by_side(contestants, run.seed, GAME, seconds=(None, 30))
    show_video(
        video,
        label=label,
        caption=f"{params.title(run.agent)} after {chosen[0]:,} and {chosen[1]:,} training games, "
        f"on the same game: the first 30 seconds. The games end with {_scored(video)}. "
        f"{_trace(*(network for network, _ in contestants.values()))}",
        alt=ALT.format(f"one agent twice in {section.facts.title}, early and late"),
        data=run.name,
    )


def show_side_by_side(section: Section, label: str) -> None:
    """Every agent's newest model on the same game."""
    newest = {run.agent: (run, games) for run, games in reversed(_newest(section))}
    if len(newest) < 2:
        show_placeholders(label)
        return
    contestants = {
        f"{params.title(agent)}, {games:,}": (_network(run, games), run.params)
        for agent, (run, games) in ((name, newest[name]) for name in AGENTS if name in newest)
    }
    seed = next(iter(newest.values()))[0].seed
    video = side_by_side(contestants, seed, GAME, seconds=(None, 30))
    show_video(
        video,
        label=label,
        caption="The agents on the same game, each with its latest weights; the number is that of "
        f"its training games. The first 30 seconds: the games end with {_scored(video)}. "
        f"{_trace(*(network for network, _ in contestants.values()))}",
        alt=ALT.format(f"the agents side by side in {section.facts.title}"),
        data=section.origin,
    )


def show_knockout(section: Section, label: str) -> None:
    """The last seconds of the first evaluation game that was won by knock-out by the agent that
    evaluates best of those that won so."""
    table = section.evaluations
    won = pd.DataFrame()
    if not table.empty:
        means = table.groupby(["agent", "seed"]).score.transform("mean")
        best_first = table.assign(mean=means).sort_values("mean", ascending=False, kind="stable")
        won = best_first[best_first.knockout == 1]
    if won.empty:
        show_placeholders(label)
        return
    stored = {
        (run.agent, run.seed, games) for run in section.usable for games in models.stored(run)
    }
    keys = list(zip(won.agent, won.seed, won.trained_games, strict=True))
    shown = [place for place, key in enumerate(keys) if key in stored]
    if not shown:
        show_absent(
            label, "A video of a knock-out follows: those so far are of weights replaced since."
        )
        return
    game = won.iloc[shown[0]]
    run = next(run for run in section.runs if (run.agent, run.seed) == (game.agent, game.seed))
    games = int(game.trained_games)
    title = f"{params.title(run.agent)}, {games:,} games"
    network, number = _network(run, games), int(game.game)
    video = play_with_instruments(network, run.params, title, run.seed, number, (-15, None))
    show_video(
        video,
        label=label,
        caption=f"A knock-out by {params.title(run.agent)} after {games:,} training games: the "
        f"last 15 seconds of evaluation game {number}, which ends with a score of "
        f"{_scored(video)}: {KNOCK_OUT} less the rival's. {MIND} "
        f"{_trace(network)}",
        alt=ALT.format("a knock-out"),
        data=run.name,
    )


def show_heat(section: Section, label: str, seconds: int) -> None:
    """The first seconds of the first evaluation game of the agent that evaluates best, with a
    layer of what its values depend on."""
    scores = section.evaluations
    means = {} if scores.empty else scores.groupby(["agent", "seed"]).score.mean().to_dict()
    evaluated = [one for one in _newest(section) if (one[0].agent, one[0].seed) in means]
    if not evaluated:
        show_placeholders(label)
        return
    run, games = max(evaluated, key=lambda one: means[one[0].agent, one[0].seed])
    network = _network(run, games)
    title = f"{params.title(run.agent)}, {games:,} games"
    layer = partial(heat.light, network)
    video = play_with_instruments(
        network, run.params, title, run.seed, GAME, (None, seconds), layer
    )
    show_video(
        video,
        label=label,
        caption=f"{params.title(run.agent)} after {games:,} training games: the first {seconds} "
        f"seconds of a game that ends with {_scored(video)}. "
        f"{MIND} {_trace(network)} {HEAT.format(f'fig-{section.slug}-saliency')}",
        alt=ALT.format(f"{section.facts.title} with a layer of heat, where the network looks"),
        data=run.name,
        layer="heat",
    )


def write_game(folder: Path, overrides: dict[str, Any], path: Path) -> None:
    """Makes a video of the first evaluation game of a stored run's model, with `overrides` of its
    parameters; raises what `models.stored_agent` does, or RunError if `path` cannot be written."""
    network, parameters = stored_agent(folder, overrides)
    title, seed = params.title(parameters.agents[0]), parameters.seeds[0]
    video = play_with_instruments(network, parameters, title, seed, game=0)
    write_atomically(path, video.mp4)
