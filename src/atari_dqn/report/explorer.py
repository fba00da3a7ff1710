"""Looking into stored agents in JupyterLab: any stored game, step by step, and played on.

`Explorer` and `Curves` are what notebooks/explore.ipynb shows: the buttons. What can be done with a
game is in playthrough.py.
"""

import asyncio
import io
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

import ipywidgets as widgets
import numpy as np
from ipyevents import Event
from IPython.display import Image, display
from matplotlib import pyplot as plt

from atari_dqn import params
from atari_dqn.analysis.study import Section
from atari_dqn.evaluation import EpisodeInProgress
from atari_dqn.params import ParameterError
from atari_dqn.report import notebook, plots, results
from atari_dqn.report.outputs import show_text
from atari_dqn.report.playthrough import (
    DOWN,
    FIRE,
    LEFT,
    RIGHT,
    UP,
    Playthrough,
    action_of,
    picture,
    png,
)
from atari_dqn.report.video import Critic, words
from atari_dqn.runs import models, plan, records
from atari_dqn.runs.files import RunError, results_folder
from atari_dqn.runs.records import EVALUATION, TRAINING, VALUES, RecordError

KEYS = {  # by what the browser calls them (KeyboardEvent.code)
    "ArrowUp": UP,
    "ArrowDown": DOWN,
    "ArrowLeft": LEFT,
    "ArrowRight": RIGHT,
    "Space": FIRE,
}
NEW = "new"  # a game that nobody has played yet
KINDS = {
    "training": TRAINING,
    "greedy check": VALUES,
    "evaluation": EVALUATION,
    "new, greedy": NEW,
}
UNCHANGED = "unchanged"  # None would be no choice to a drop-down list
RECORDED_LIKE_NEW = 10_000  # numbers that a new game may have
SPACED = "2px 16px 2px 2px"

Key = tuple[str, str, int]  # experiment, and what was changed of it; agent; seed


def interactive(wanted: bool | None) -> bool:
    """Whether to show widgets; by default where somebody can use them, which is in a notebook that
    a Jupyter server has opened, and not under papermill or nbconvert."""
    return "JPY_SESSION_NAME" in os.environ if wanted is None else wanted


class StoredAgents:
    """The agents whose models are stored, also those of changed parameters; `damaged` names the
    runs that cannot be read. Raises RunError if there is none."""

    def __init__(self, profile: str, results: Path | str | None):
        self.folders: dict[Key, Path] = {
            (run.title, run.agent, run.seed): run.folder
            for run in plan.stored(profile, [], results)
            if (run.folder / "model.safetensors").exists()
        }
        self.damaged = plan.damaged(profile, [], results)
        if not self.folders:
            folder = results_folder(profile, results) / "runs"
            besides = "".join(f"; left out: {said}" for said in self.damaged)
            raise RunError(f"no agent is stored in {folder}; `make train` makes one{besides}")

    def choices(self, *chosen: str | int) -> list[Any]:
        """What can be chosen next: experiments; an experiment's agents; an agent's seeds."""
        count = len(chosen)
        found = (key[count] for key in self.folders if key[:count] == chosen)
        return list(dict.fromkeys(found))

    def critic(self, key: Key, games: int) -> Critic:
        """An agent as it was after so many training games."""
        folder = self.folders[key]
        parameters = params.stored_parameters(folder)
        return Critic(models.load_model(models.in_folder(folder)[games], parameters), parameters)


def new_record(parameters: params.Parameters, number: int) -> records.EpisodeRecord:
    """How evaluation game `number` of a run begins."""
    episode = EpisodeInProgress(parameters)
    episode.start(number, parameters.seeds[0])
    return episode.env.played()


def _fill(dropdown: widgets.Dropdown, options: list[tuple[str, Any]]) -> None:
    """Offers other options; what was chosen stays so if it can, else it is the first."""
    before, values = dropdown.value, [value for _, value in options]
    dropdown.options = options
    dropdown.value = before if before in values else values[0]


def _same(values: list[Any]) -> list[tuple[str, Any]]:
    return [(str(value), value) for value in values]


def _dropdown(description: str) -> widgets.Dropdown:
    layout = widgets.Layout(width="auto", margin=SPACED)
    style = {"description_width": "initial"}
    return widgets.Dropdown(description=description, layout=layout, style=style)


def _button(description: str, tooltip: str, **more: Any) -> widgets.Button:
    layout = widgets.Layout(width="auto")
    return widgets.Button(description=description, tooltip=tooltip, layout=layout, **more)


class Explorer:
    """A panel to choose a stored game with, to move through it, and to play on.

    `first`, an experiment, an agent and a seed, is what is chosen at first, as far as it is stored.
    Raises RunError if no agent is.
    """

    def __init__(self, profile: str, results: Path | str | None = None, *first: str | int | None):
        self.agents = StoredAgents(profile, results)
        self.games: list[Playthrough] = []
        self.about = ""  # of the first game
        self.opened: Key = ("", "", 0)  # of the first game
        self.task: asyncio.Task | None = None  # that plays on
        self.pressed: set[str] = set()
        self.tapped: set[str] = set()  # keys pressed since the last step, perhaps let go since
        self.filling = False
        self._build()
        self._connect()
        self._offer(0)
        for level, choice in enumerate(first):
            if choice in [value for _, value in self.run[level].options]:
                self.run[level].value = choice
        self.show_game()
        left_out = [f"left out: {said}" for said in self.agents.damaged]
        self.message.value = "<br>".join(filter(None, [self.message.value, *map(escape, left_out)]))

    def show(self, with_widgets: bool) -> None:
        """Shows the panel, or where nobody could use it, what it shows."""
        if with_widgets:
            display(self.panel)
        else:
            spread = np.ptp(self.games[0].q_values, axis=1)
            self._goto(int(spread.argmax()))  # where it matters most what is played
            display(Image(self.picture.value, format="png"))
            show_text(f"*{self.facts.value}*")

    # ---- The panel ------------------------------------------------------------------------------

    def _build(self) -> None:
        self.run = [_dropdown("experiment"), _dropdown("agent"), _dropdown("seed")]
        self.kind, self.checkpoint = _dropdown("game"), _dropdown("network after")
        self.number = widgets.BoundedIntText(
            *(1, 1, 1), description="number", layout=widgets.Layout(width="9em")
        )
        self.number.style.description_width = "initial"
        self.count = widgets.Label(layout=widgets.Layout(margin=SPACED))
        self.open = _button("open", "shows the game that is chosen", button_style="primary")
        self.message = widgets.HTML(layout=widgets.Layout(min_height="1.5em"))
        self.picture = widgets.Image(format="png", layout=widgets.Layout(width="720px"))
        self.player = widgets.Play(interval=67)
        self.moment = widgets.IntSlider(description="step", layout=widgets.Layout(width="560px"))
        self.facts = widgets.HTML()
        self.difficulty, self.sticky = _dropdown("difficulty"), _dropdown("sticky actions")
        self.clock, self.other = _dropdown("clock"), _dropdown("another agent")
        self.let_play = _button("let the agent play", "plays on, as fast as the console does")
        self.take_over = _button("play yourself", "the arrow keys move, the space bar is FIRE")
        self.stop = _button("stop", "what has been played stays", disabled=True)
        self.compare = _button("let it play beside", "the same game, played on by another agent")
        row = widgets.HBox
        self.panel = widgets.VBox(
            [
                row(self.run),
                row([self.kind, self.number, self.count, self.checkpoint, self.open]),
                self.message,
                self.picture,
                row([self.player, self.moment]),
                self.facts,
                widgets.HTML("<b>From this step on</b>, with other settings if you like:"),
                row([self.difficulty, self.sticky, self.clock]),
                row([self.let_play, self.take_over, self.stop]),
                row([self.other, self.compare]),
            ]
        )

    def _connect(self) -> None:
        for level, choice in enumerate(self.run, 1):
            choice.observe(lambda change, level=level: self._offer(level), "value")
        self.kind.observe(lambda change: self._offer_numbers(), "value")
        self.number.observe(lambda change: self._describe(), "value")
        self.open.on_click(lambda button: self.show_game())
        self.moment.observe(lambda change: self._draw(), "value")
        widgets.jslink((self.player, "value"), (self.moment, "value"))
        self.let_play.on_click(lambda button: self._start(self._agents_choice))
        self.take_over.on_click(lambda button: self._start(self._persons_choice))
        self.stop.on_click(lambda button: self.halt())
        self.compare.on_click(lambda button: self.play_beside())
        self.keys = Event(
            source=self.picture,
            watched_events=["keydown", "keyup", "mouseleave"],
            prevent_default_action=True,
        )
        self.keys.on_dom_event(self.key)

    def _offer(self, level: int) -> None:
        """Offers what there is below the choices that have been made."""
        if self.filling:
            return
        self.filling = True
        for place, choice in enumerate(self.run[level:], level):
            found = self.agents.choices(*(each.value for each in self.run[:place]))
            titles = [params.title(name) if place == 1 else str(name) for name in found]
            _fill(choice, list(zip(titles, found, strict=True)))
        self.key_chosen: Key = tuple(each.value for each in self.run)
        folder = self.agents.folders[self.key_chosen]
        self.params = params.stored_parameters(folder)
        trained = sorted(models.in_folder(folder), reverse=True)
        _fill(self.checkpoint, [(f"{games:,} games", games) for games in trained])
        there = (folder / records.FILE).exists()
        games = records.read_file(folder, torn=True) if there else []
        self.recorded = {
            kind: [game for game in games if game[0]["kind"] == kind] for kind in KINDS.values()
        }
        kinds = [(name, kind) for name, kind in KINDS.items() if self.recorded[kind] or kind == NEW]
        _fill(self.kind, kinds)
        self.filling = False
        self._offer_numbers()

    def _offer_to_play_on(self) -> None:
        """Offers what the opened game can be played on with."""
        facts = self.games[0].episode.env.facts
        unchanged: list[tuple[str, Any]] = [(UNCHANGED, UNCHANGED)]
        _fill(self.difficulty, unchanged + _same([*facts.difficulties]))
        _fill(self.sticky, unchanged + _same([0.0, 0.25]))
        left = [(f"{seconds} s left", seconds) for seconds in (10, 30, 60, 120)]
        _fill(self.clock, unchanged + (left if facts.clock_cells else []))
        others = [key for key in self.agents.folders if self._plays_the_same(key)]
        others.sort(key=lambda key: key == self.opened)  # itself last
        names = [f"{params.title(agent)} ({name}, seed {seed})" for name, agent, seed in others]
        _fill(self.other, list(zip(names, others, strict=True)))

    def _plays_the_same(self, key: Key) -> bool:
        other, ours = params.stored_parameters(self.agents.folders[key]), self.games[0].params
        same = ("game", "frame_skip", "frame_stack")
        return all(getattr(other, name) == getattr(ours, name) for name in same)

    def _offer_numbers(self) -> None:
        """Offers the games of the chosen kind: first the newest one, or of those of the evaluation
        the first that was played as the agent was trained."""
        if self.filling:
            return
        recorded = self.recorded[self.kind.value]
        self.number.max = len(recorded) or RECORDED_LIKE_NEW
        self.number.value = len(recorded) or 1
        for game in records.as_trained(self.params, recorded)[:1]:
            self.number.value = recorded.index(game) + 1
        self._describe()

    def _describe(self) -> None:
        """Says which game the chosen number is."""
        if not self.filling:
            self.count.value = f"of {self.number.max:,}: {_said(self._heading())}"

    def _heading(self) -> dict[str, Any]:
        """Of the game that is chosen."""
        kind, number = self.kind.value, self.number.value
        if kind == NEW:
            return {"kind": NEW, "game": number - 1}
        heading, _ = self.recorded[kind][number - 1]
        return heading

    @contextmanager
    def _busy(self, doing: str) -> Iterator[Callable[[float], None]]:
        """While something takes seconds: says how far it is, and in the end what went wrong."""

        def progress(share: float) -> None:
            self.message.value = f"{doing}: {share:.0%}"

        self.halt()
        progress(0)
        self.open.disabled = self.compare.disabled = True
        try:
            yield progress
        except (ParameterError, RecordError, RunError, OSError) as error:
            self.message.value = str(error)
        else:
            self.message.value = ""
        finally:
            self.open.disabled = self.compare.disabled = False

    # ---- Games ----------------------------------------------------------------------------------

    def show_game(self) -> None:
        """Opens the game that is chosen."""
        key, trained, number = self.key_chosen, self.checkpoint.value, self.number.value
        with self._busy("opening") as progress:
            parameters, heading = self.params, self._heading()
            if self.kind.value == NEW:
                record = new_record(parameters, heading["game"])
            else:
                _, record = self.recorded[self.kind.value][number - 1]
                parameters = records.settings(parameters, heading)
            critic = self.agents.critic(key, trained)
            title = self._title(key, trained)
            game = Playthrough(critic, parameters, record, title, progress=progress)
            if self.kind.value == NEW:
                self._play_out(game, progress)
            self.games, self.about, self.opened = [game], _said(heading), key
            self._offer_to_play_on()
            self._goto(0)

    @staticmethod
    def _title(key: Key, trained: int) -> str:
        return f"{params.title(key[1])}, {trained:,} games"

    def _play_out(self, game: Playthrough, progress: Callable[[float], None]) -> None:
        """Lets the game's network play it to its end."""
        longest = game.episode.env.facts.full_frames or self.params.max_game_frames
        while not game.ended:
            game.play(game.best(-1))
            progress(min(1.0, game.episode.env.frames / longest))

    @property
    def changed(self) -> dict[str, Any]:
        """The settings that are chosen to play on with."""
        chosen = {
            "difficulty": self.difficulty.value,
            "sticky_actions": self.sticky.value,
            "clock": self.clock.value,
        }
        return {name: value for name, value in chosen.items() if value != UNCHANGED}

    def branch(self, critic: Critic | None = None, title: str | None = None) -> Playthrough:
        """The first game up to the step that is shown, with the settings that are chosen."""
        return self.games[0].branch(self.now, critic, title, self.changed)

    @property
    def now(self) -> int:
        """The step of the first game that is shown."""
        return min(self.moment.value, self.games[0].last)

    def play_beside(self) -> None:
        """Lets another agent play the game on from the step that is shown, beside this one."""
        first, now, key = self.games[0], self.now, self.other.value
        with self._busy("playing") as progress:
            trained = max(models.in_folder(self.agents.folders[key]))
            title = self._title(key, trained)
            if title == first.title:  # the same agent, or one of another experiment or seed
                title += " again" if key == self.opened else f" ({key[0]}, seed {key[2]})"
            other = self.branch(self.agents.critic(key, trained), title)
            self._play_out(other, progress)
            self.games = [first, other]
            self._goto(now)

    # ---- Playing on -----------------------------------------------------------------------------

    def _start(self, choose: Callable[[Playthrough], int]) -> None:
        self.halt()
        game = self.branch()
        if game.ended:
            self.message.value = "the game is over: go back to an earlier step"
            return
        who = "by you" if choose == self._persons_choice else "by the agent"
        self.about += f", played on {who} from step {self.now:,}"
        if self.changed:
            settings = (f"{name.replace('_', ' ')} {value}" for name, value in self.changed.items())
            self.about += f" with {', '.join(settings)}"
        self.games = [game]
        self.task = asyncio.get_running_loop().create_task(self.play_on(choose))

    async def play_on(self, choose: Callable[[Playthrough], int]) -> None:
        """Plays to the end, or until it is stopped, as fast as the console does."""
        game, self.stop.disabled = self.games[0], False
        keys = choose == self._persons_choice
        self.message.value = (
            "<b>Keep the mouse on the picture; arrow keys and space</b>" if keys else "playing"
        )
        try:
            while not game.ended:
                began = time.monotonic()
                game.play(choose(game))
                self._goto(game.last)
                spent = time.monotonic() - began
                await asyncio.sleep(max(0.001, 1 / float(game.recording().rate) - spent))
        finally:
            self.stop.disabled, self.message.value = True, ""
            self.pressed.clear()
            self.tapped.clear()

    def halt(self) -> None:
        """Ends playing on; what has been played stays."""
        if self.task is not None:
            self.task.cancel()
            self.task = None

    @staticmethod
    def _agents_choice(game: Playthrough) -> int:
        return game.best(-1)

    def _persons_choice(self, game: Playthrough) -> int:
        held = self.pressed | self.tapped
        self.tapped.clear()
        return action_of(held, game.names)

    def key(self, event: dict[str, Any]) -> None:
        """A key has been pressed or let go, or the mouse has left the picture: then nobody hears
        of keys that are let go."""
        if event["type"] == "mouseleave":
            self.pressed.clear()
            return
        part = KEYS.get(event["code"])
        if part is None:
            return
        if event["type"] == "keydown":
            self.pressed.add(part)
            self.tapped.add(part)
        else:
            self.pressed.discard(part)

    # ---- What is shown --------------------------------------------------------------------------

    def _goto(self, moment: int) -> None:
        last = max(game.last for game in self.games)
        self.player.max = self.moment.max = last
        if self.moment.value == moment:
            self._draw()
        self.moment.value = moment

    def _draw(self) -> None:
        if self.games:
            self.picture.value = png(picture(self.games, self.moment.value))
            self.facts.value = self._facts()

    def _facts(self) -> str:
        """A line about what is seen."""
        game, now = self.games[0], self.now
        said = [f"{self.about}: step {now:,} of {game.last:,}"]
        best = words(game.names[game.best(now)])
        said.append(f"best action {best} (Q {game.q_values[now].max():.2f})")
        if now < game.last:
            said.append(f"played {words(game.names[game.actions[now]])}")
        if places := game.sights[now].places:
            (x, y), (rival_x, rival_y) = places
            apart = ((x - rival_x) ** 2 + (y - rival_y) ** 2) ** 0.5
            said.append(
                f"white at {x}, {y}, black at {rival_x}, {rival_y}, {apart:.0f} pixels apart"
            )
        return "; ".join(said).replace("-", "−")


def _said(heading: dict[str, Any]) -> str:
    """Which game one with this heading is."""
    kind = heading["kind"]
    if kind == TRAINING:
        return f"training game {heading['episode']:,}"
    if kind == VALUES:
        number = heading["game"] % params.VALUE_GAMES + 1
        return f"greedy game {number} after {heading['episode']:,} training games"
    if kind == NEW:
        return f"new game {heading['game'] + 1}"
    return (
        f"evaluation game {heading['game'] + 1} after {heading['trained_games']:,} training games "
        f"(difficulty {heading['difficulty']}, sticky actions {heading['sticky_actions']:g}, "
        f"random actions {heading['epsilon']:g})"
    )


class Curves:
    """A section's learning curves, with what is drawn to choose."""

    def __init__(self, section: Section):
        self.section = section
        longest = int(section.episodes.episode.max())
        window = min(section.curve_window, longest)
        self.window = widgets.IntSlider(
            *(window, 1, max(2, longest // 3)), description="mean of", continuous_update=False
        )
        self.agents = {
            name: widgets.Checkbox(True, description=params.title(name), indent=False)
            for name in dict.fromkeys(section.episodes.agent)
        }
        self.source = widgets.Checkbox(True, description="source report", indent=False)
        self.published = widgets.Checkbox(True, description="other people's", indent=False)
        self.picture = widgets.HTML()
        choices = [self.window, *self.agents.values(), self.source, self.published]
        for each in choices:
            each.observe(lambda change: self.draw(), "value")
            if each is not self.window:
                each.layout = widgets.Layout(width="auto", margin=SPACED)
        self.panel = widgets.VBox([widgets.HBox(choices), self.picture])
        self.draw()

    def draw(self) -> None:
        section, buffer = self.section, io.StringIO()
        wanted = [name for name, box in self.agents.items() if box.value]
        episodes = results.timed_episodes(section)
        episodes = episodes[episodes.agent.isin(wanted)]
        if episodes.empty:
            self.picture.value = "No agent is chosen."
            return
        source = results.source_points(section)
        points = results.published_points(section) if self.published.value else None
        figure = plots.learning_curves(
            episodes,
            section.facts,
            self.window.value,
            points,
            source if self.source.value else source[:0],
        )
        figure.savefig(buffer, format="svg")
        plt.close(figure)
        self.picture.value = buffer.getvalue()


def show_curves(section: Section, with_widgets: bool) -> None:
    """A section's learning curves, with what is drawn to choose where somebody can."""
    if with_widgets and not section.episodes.empty:
        display(Curves(section).panel)
    else:
        notebook.show_badge(section)
        results.show_curves(section)
