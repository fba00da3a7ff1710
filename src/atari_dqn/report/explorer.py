"""Looking into stored agents in JupyterLab: any stored game, step by step, and played on.

`Explorer` is what notebooks/explore.ipynb shows; what it can do is in playthrough.py, and here are
its buttons.
"""

import asyncio
import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import ipywidgets as widgets
from ipyevents import Event
from IPython.display import display
from matplotlib import pyplot as plt

from atari_dqn import params
from atari_dqn.analysis.study import Section
from atari_dqn.evaluation import EpisodeInProgress
from atari_dqn.params import Parameters
from atari_dqn.report import plots, results
from atari_dqn.report.playthrough import (
    DOWN,
    FIRE,
    LEFT,
    RIGHT,
    UP,
    Playthrough,
    action_of,
    picture,
)
from atari_dqn.report.video import Critic
from atari_dqn.runs import audit, models, records
from atari_dqn.runs.files import RunError
from atari_dqn.runs.records import EVALUATION, TRAINING, VALUES, Heading

KEYS = {  # by what the browser calls them (KeyboardEvent.code)
    "ArrowUp": UP,
    "KeyW": UP,
    "ArrowDown": DOWN,
    "KeyS": DOWN,
    "ArrowLeft": LEFT,
    "KeyA": LEFT,
    "ArrowRight": RIGHT,
    "KeyD": RIGHT,
    "Space": FIRE,
    "Enter": FIRE,
}
NEW = "new"  # a game that nobody has played yet
KINDS = {
    "training game": TRAINING,
    "greedy check": VALUES,
    "final evaluation": EVALUATION,
    "new greedy game": NEW,
}
UNCHANGED = "as it is"


class StoredAgents:
    """The agents whose models are in a results folder. Raises RunError if there is none."""

    def __init__(self, results: Path):
        self.folders: dict[tuple[str, str, int], Path] = {}  # by experiment, agent and seed
        for path in sorted((results / "runs").glob("*/*/seed-*/model.safetensors")):
            folder = path.parent
            seed = int(folder.name.removeprefix("seed-"))
            self.folders[folder.parent.parent.name, folder.parent.name, seed] = folder
        if not self.folders:
            raise RunError(f"{results / 'runs'} has no stored agent; `make train` makes one")

    def choices(self, *chosen: str | int) -> list[Any]:
        """What can be chosen next: experiments; an experiment's agents; an agent's seeds."""
        count = len(chosen)
        found = (key[count] for key in self.folders if key[:count] == chosen)
        return list(dict.fromkeys(found))


def new_record(parameters: Parameters, number: int) -> records.EpisodeRecord:
    """How evaluation game `number` of a run begins."""
    episode = EpisodeInProgress(parameters)
    episode.start(number, parameters.seeds[0])
    return episode.env.played()


def _fill(dropdown: widgets.Dropdown, options: list[Any]) -> None:
    """Offers other options; what was chosen stays so if it can, else it is the first."""
    before = dropdown.value
    values = [option[1] if isinstance(option, tuple) else option for option in options]
    dropdown.options = options
    dropdown.value = before if before in values else values[0]


class Explorer:
    """A panel to choose a stored game with, to move through it, and to play on.

    `experiment`, `agent` and `seed` are chosen at first, if they are stored.
    """

    def __init__(self, results: Path, *first: str | int):
        self.agents = StoredAgents(results)
        self.games: list[Playthrough] = []
        self.task: asyncio.Task | None = None  # that of a game in progress
        self.pressed: set[str] = set()
        self.offering = False
        narrow = widgets.Layout(width="auto", min_width="8em")

        def dropdown(description: str) -> widgets.Dropdown:
            return widgets.Dropdown(description=description, layout=narrow)

        self.run = [dropdown("experiment"), dropdown("agent"), dropdown("seed")]
        self.checkpoint = dropdown("trained for")
        self.kind = dropdown("game")
        self.number = widgets.BoundedIntText(1, 1, 1, description="number", layout=narrow)
        self.open = widgets.Button(description="open", button_style="primary")
        self.picture = widgets.Image(format="png", layout=widgets.Layout(width="720px"))
        self.facts = widgets.HTML()
        self.moment = widgets.IntSlider(description="step", layout=widgets.Layout(width="620px"))
        self.player = widgets.Play(description="play", interval=67)
        self.difficulty, self.sticky, self.clock = map(
            dropdown, ("difficulty", "stickiness", "clock")
        )
        self.let_play = widgets.Button(description="let the agent play on")
        self.take_over = widgets.Button(description="take over: arrow keys, space")
        self.stop = widgets.Button(description="stop", disabled=True)
        self.other = dropdown("other agent")
        self.compare = widgets.Button(description="let it take over beside")
        for button in (self.let_play, self.take_over, self.compare):
            button.layout.width = "auto"
        self._connect()
        self.panel = widgets.VBox(
            [
                widgets.HBox([*self.run, self.checkpoint]),
                widgets.HBox([self.kind, self.number, self.open]),
                self.picture,
                widgets.HBox([self.player, self.moment]),
                self.facts,
                widgets.HTML("<b>From this step on</b>"),
                widgets.HBox([self.difficulty, self.sticky, self.clock]),
                widgets.HBox([self.let_play, self.take_over, self.stop]),
                widgets.HBox([self.other, self.compare]),
            ]
        )
        for level, choice in enumerate(first):
            if choice in self.run[level].options:
                self.run[level].value = choice
        self.show_game()

    def show(self) -> None:
        """Shows the panel, and its picture to what has no widgets."""
        bundle = self.panel._repr_mimebundle_()
        data = bundle[0] if isinstance(bundle, tuple) else bundle
        display({**data, "image/png": self.picture.value}, raw=True)

    # ---- What is chosen -------------------------------------------------------------------------

    def _connect(self) -> None:
        self._offer(0)
        for level, choice in enumerate(self.run, 1):
            choice.observe(lambda change, level=level: self._offer(level), "value")
        self.kind.observe(lambda change: self._offer_numbers(), "value")
        self.open.on_click(lambda button: self.show_game())
        self.moment.observe(lambda change: self._draw(), "value")
        widgets.jslink((self.player, "value"), (self.moment, "value"))
        self.let_play.on_click(lambda button: self._start(self._agents_choice))
        self.take_over.on_click(lambda button: self._start(self._persons_choice))
        self.stop.on_click(lambda button: self.halt())
        self.compare.on_click(lambda button: self.play_beside())
        watched = ["keydown", "keyup"]
        self.keys = Event(source=self.picture, watched_events=watched, prevent_default_action=True)
        self.keys.on_dom_event(self.key)

    def _offer(self, level: int) -> None:
        """Offers what there is below the choices that have been made."""
        if self.offering:
            return  # called by what is being filled
        self.offering = True
        for choice in self.run[level:]:
            chosen = tuple(each.value for each in self.run[: self.run.index(choice)])
            _fill(choice, self.agents.choices(*chosen))
        self.folder = self.agents.folders[tuple(each.value for each in self.run)]
        self.params = audit.stored_parameters(self.folder)
        self.stored = models.in_folder(self.folder)
        _fill(
            self.checkpoint,
            [(f"{games:,} games", games) for games in sorted(self.stored, reverse=True)],
        )
        games = records.read_file(self.folder, torn=True)
        self.recorded = {
            kind: [game for game in games if game[0]["kind"] == kind] for kind in KINDS.values()
        }
        _fill(
            self.kind,
            [(name, kind) for name, kind in KINDS.items() if self.recorded[kind] or kind == NEW],
        )
        facts = EpisodeInProgress(self.params).env.facts
        _fill(self.difficulty, [UNCHANGED, *facts.difficulties])
        _fill(self.sticky, [UNCHANGED, 0.0, 0.25])
        clocks: list[Any] = [(f"{seconds} s left", seconds) for seconds in (10, 30, 60, 120)]
        _fill(self.clock, [(UNCHANGED, UNCHANGED), *(clocks if facts.clock_cells else [])])
        others = [key for key in self.agents.folders if self._plays_the_same(key)]
        _fill(
            self.other,
            [(f"{params.title(key[1])}, {key[0]}, seed {key[2]}", key) for key in others],
        )
        self.offering = False
        self._offer_numbers()

    def _plays_the_same(self, key: tuple[str, str, int]) -> bool:
        other = audit.stored_parameters(self.agents.folders[key])
        same = ("game", "frame_skip", "frame_stack", "noop_max", "max_game_frames")
        return all(getattr(other, name) == getattr(self.params, name) for name in same)

    def _offer_numbers(self) -> None:
        if self.offering:
            return
        self.number.max = len(self.recorded[self.kind.value]) or 10_000
        self.number.value = min(self.number.value, self.number.max)

    # ---- Games ----------------------------------------------------------------------------------

    def show_game(self) -> None:
        """Opens the game that is chosen."""
        self.halt()
        self.facts.value = "opening…"
        heading: Heading = {}
        parameters, number = self.params, self.number.value
        if self.kind.value == NEW:
            record = new_record(parameters, number)
        else:
            heading, record = self.recorded[self.kind.value][number - 1]
            parameters = records.settings(parameters, heading)
        critic = self._critic(self.folder, self.checkpoint.value)
        game = Playthrough(
            critic, parameters, record, self._title(self.folder, self.checkpoint.value)
        )
        while self.kind.value == NEW and not game.ended:
            game.play(game.best(-1))
        self.games = [game]
        self.about = ", ".join(
            f"{name.replace('_', ' ')} {value:g}"
            for name, value in heading.items()
            if name != "kind"
        )
        self._goto(0)

    def _critic(self, folder: Path, games: int) -> Critic:
        parameters = audit.stored_parameters(folder)
        path = models.in_folder(folder)[games]
        return Critic(models.load_model(path, parameters), parameters)

    @staticmethod
    def _title(folder: Path, games: int) -> str:
        return f"{params.title(folder.parent.name)}, {games:,} games"

    def branch(self, critic: Critic | None = None, title: str | None = None) -> Playthrough:
        """The first game up to the step that is shown, with the settings that are chosen."""
        chosen: dict[str, Any] = {
            "difficulty": self.difficulty.value,
            "sticky_actions": self.sticky.value,
            "clock": self.clock.value,
        }
        given = {name: value for name, value in chosen.items() if value != UNCHANGED}
        return self.games[0].branch(self.now, critic, title, **given)

    @property
    def now(self) -> int:
        """The step of the first game that is shown."""
        return min(self.moment.value, self.games[0].last)

    def play_beside(self) -> None:
        """Lets another agent play the game on from the step that is shown, beside this one."""
        self.halt()
        self.facts.value = "playing…"
        first, moment = self.games[0], self.now
        folder = self.agents.folders[self.other.value]
        games = max(models.in_folder(folder))
        title = self._title(folder, games)
        other = self.branch(self._critic(folder, games), title + " " * (title == first.title))
        while not other.ended:
            other.play(other.best(-1))
        self.games = [first, other]
        self._goto(moment)

    # ---- Playing on -----------------------------------------------------------------------------

    def _start(self, choose: Callable[[Playthrough], int]) -> None:
        self.halt()
        game = self.branch()
        if game.ended:
            return
        self.games = [game]
        self.task = asyncio.get_running_loop().create_task(self.play_on(choose))

    async def play_on(self, choose: Callable[[Playthrough], int]) -> None:
        """Plays to the end, or until it is stopped, as fast as the console does."""
        game = self.games[0]
        self.stop.disabled = False
        try:
            while not game.ended:
                began = time.monotonic()
                game.play(choose(game))
                self._goto(game.last)
                spent = time.monotonic() - began
                await asyncio.sleep(max(0.001, 1 / float(game.recording().rate) - spent))
        finally:
            self.stop.disabled = True

    def halt(self) -> None:
        """Ends playing on; what has been played stays."""
        if self.task is not None:
            self.task.cancel()
            self.task = None

    @staticmethod
    def _agents_choice(game: Playthrough) -> int:
        return game.best(-1)

    def _persons_choice(self, game: Playthrough) -> int:
        return action_of(self.pressed, game.names)

    def key(self, event: dict[str, Any]) -> None:
        """A key has been pressed or let go."""
        part = KEYS.get(event["code"])
        if part is None:
            return
        if event["type"] == "keydown":
            self.pressed.add(part)
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
        if not self.games:
            return
        moment = self.moment.value
        drawn = picture(self.games, moment)
        fast = [cv2.IMWRITE_PNG_COMPRESSION, 1]
        self.picture.value = cv2.imencode(".png", drawn[:, :, ::-1], fast)[1].tobytes()
        self.facts.value = self._facts()

    def _facts(self) -> str:
        """A line about what is seen."""
        game, now = self.games[0], self.now
        said = [self.about] if self.about else []
        said.append(f"step {now:,} of {game.last:,}")
        best = game.names[game.best(now)].lower()
        said.append(f"the network would play {best} (Q {game.q_values[now].max():.2f})")
        if now < game.last:
            said.append(f"played: {game.names[game.actions[now]].lower()}")
        if game.sights[now].places:
            (x, y), (rival_x, rival_y) = game.sights[now].places
            apart = ((x - rival_x) ** 2 + (y - rival_y) ** 2) ** 0.5
            said.append(
                f"white at {x}, {y}, black at {rival_x}, {rival_y}: {apart:.0f} pixels apart"
            )
        return " · ".join(said)


class Curves:
    """A section's learning curves, with what is drawn to choose."""

    def __init__(self, section: Section):
        self.section = section
        longest = int(section.episodes.episode.max())
        self.window = widgets.IntSlider(
            min(section.curve_window, longest), 1, max(1, longest // 3), description="mean of"
        )
        names = list(dict.fromkeys(section.episodes.agent))
        self.agents = {
            name: widgets.Checkbox(True, description=params.title(name)) for name in names
        }
        self.source = widgets.Checkbox(True, description="source report")
        self.published = widgets.Checkbox(True, description="Dopamine")
        self.picture = widgets.HTML()
        choices = [self.window, *self.agents.values(), self.source, self.published]
        for each in choices:
            each.indent = False
            each.observe(lambda change: self.draw(), "value")
        self.panel = widgets.VBox([widgets.HBox(choices), self.picture])
        self.draw()

    def draw(self) -> None:
        section, buffer = self.section, io.StringIO()
        wanted = [name for name, box in self.agents.items() if box.value]
        episodes = section.episodes[section.episodes.agent.isin(wanted)]
        if episodes.empty:
            self.picture.value = "Choose an agent."
            return
        source = results.source_points(section)
        points = results.published_points(section) if self.published.value else None
        figure = plots.learning_curves(
            episodes,
            section.facts,
            self.window.value,
            points,
            source[source.agent.isin(wanted)] if self.source.value else source[:0],
        )
        figure.savefig(buffer, format="svg")
        plt.close(figure)
        self.picture.value = buffer.getvalue()

    def show(self) -> None:
        display(self.panel)
