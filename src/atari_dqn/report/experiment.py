"""What experiment.ipynb shows: a run while it trains, and beside others when it has."""

import html
import time
from pathlib import Path

import pandas as pd
from IPython.display import Markdown, display
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from atari_dqn import params
from atari_dqn.analysis.study import Section
from atari_dqn.games import GAMES
from atari_dqn.params import ParameterError
from atari_dqn.report import catalogue, outputs, plots, results
from atari_dqn.report.video import play_with_instruments
from atari_dqn.runs import models, plan, recorder, tables
from atari_dqn.runs.files import RunError, project_root
from atari_dqn.runs.run import Run

SECONDS = 5.0  # between two drawings of a run that trains, at least
SHARE = 0.02  # of the time that drawing may take, at most
OWN = "this run"
RECENT = 100  # episodes that scores are the mean of, where there are so many


def show_parameters(run: Run) -> None:
    """Every parameter of a run, with its unit, folded up."""
    text = params.text(run.params)
    summary = f"All parameters of this run ({run.name}), with their units"
    page = f"<details><summary>{summary}</summary><pre>{html.escape(text)}</pre></details>"
    display({"text/html": page, "text/plain": text}, raw=True)


def train(run: Run) -> None:
    """Trains a run, or goes on with it, and shows how far it is. Raises RunError if it is
    interrupted, too: the same call continues."""
    live = Live(run)
    try:
        said = recorder.train(run, position=None, follow=live.update)
    except KeyboardInterrupt:
        live.update(done=True)
        raise RunError(
            f"interrupted after {len(tables.of_runs([run], tables.EPISODES)):,} games, which are "
            "saved; this cell goes on when it is run again"
        ) from None
    live.update(done=True)
    live.say(said)


class Live:
    """A line and a learning curve that are drawn again as a run goes on."""

    def __init__(self, run: Run):
        self.run = run
        self.line = display(Markdown(f"{run.name} begins"), display_id=True)
        self.curve = display(Markdown(""), display_id=True)
        self.due = 0.0
        self.first: tuple[float, int] | None = None  # when following began, and the episodes then
        self.evaluated = -1  # games of the final evaluation, once the last training game has ended

    def say(self, text: str) -> None:
        self.line.update(Markdown(text))

    def update(self, done: bool = False) -> None:
        """Draws the run as it is, if it has not just been drawn."""
        began = time.monotonic()
        if not done and self.run.status()["episodes_done"] >= self.run.params.episodes:
            self.evaluated += 1
        if began < self.due and not done:
            return
        episodes = tables.of_runs([self.run], tables.EPISODES)
        self.first = self.first or (began, len(episodes))
        if len(episodes):
            figure = _curve(episodes, self.run)
            self.curve.update(figure)
            plt.close(figure)
        self.say(self._progress(episodes, began))
        now = time.monotonic()
        self.due = now + max(SECONDS, (now - began) / SHARE)

    def _progress(self, episodes: pd.DataFrame, now: float) -> str:
        count, wanted = len(episodes), self.run.params.episodes
        said = [f"**{self.run.name}**: {count:,} of {wanted:,} games"]
        if count:
            window = min(RECENT, count)
            mean = episodes.score.tail(window).mean()
            said.append(f"mean score {_number(mean, '.1f')} (last {window})")
        if count >= wanted:
            games = len(params.conditions(self.run.params)) * self.run.params.evaluation_games
            played = min(max(0, self.evaluated), games)  # a run that continues is told once more
            said.append(f"{played} of {games:,} games of the final evaluation")
            return ", ".join(said)
        since, before = self.first or (now, count)
        if count > before:
            left = (wanted - count) * (now - since) / (count - before)
            said.append(f"about {_duration(left)} left, and the evaluation")
        return ", ".join(said)


def _number(value: float, form: str) -> str:
    return format(value, form).replace("-", "−")


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _window(episodes: pd.DataFrame) -> int:
    return max(1, min(RECENT, len(episodes) // 5))


def _curve(episodes: pd.DataFrame, run: Run) -> Figure:
    facts = GAMES[run.params.game]
    return plots.comparison(episodes, facts, _window(episodes), "agent")


def _rivals(run: Run) -> dict[str, Run]:
    """The stored runs of the same experiment by what they are called beside this one: those of its
    own profile, and those of full size."""
    found = plan.stored(run.params.profile, [], run.results)
    if run.params.profile != "full":
        found += plan.stored("full", [])
    named = {}
    for each in found:
        same = (each.experiment, each.params.game) == (run.experiment, run.params.game)
        if same and each.folder != run.folder:
            parts = [params.title(each.agent), each.variation, f"seed {each.seed}"]
            if each.params.profile != run.params.profile:
                parts.append("full size")
            named[", ".join(part for part in parts if part)] = each
    return named


def _source(run: Run) -> pd.DataFrame:
    """The source report's scores of a run's agent in its experiment."""
    try:
        section = Section(run.experiment, "full", agents=[run.agent])
    except ParameterError:  # one of somebody's own
        return pd.DataFrame(columns=["agent", "episode", "score", "window"])
    return results.source_points(section)


def _begun(run: Run) -> None:
    if not (run.folder / "model.safetensors").exists():
        raise RunError(f"{run.name} was interrupted before its first game: train it first")


def show_curve(run: Run) -> None:
    """A run's learning curve, beside the stored runs of its experiment, as far as it has come
    itself, and the source report's scores. Raises RunError, as the functions below, if the run has
    no model yet."""
    _begun(run)
    own = tables.of_runs([run], tables.EPISODES)
    window, curves = _window(own), [own.assign(variation=OWN)]
    for name, rival in _rivals(run).items():
        table = tables.of_runs([rival], tables.EPISODES)
        curves.append(table[table.episode <= len(own)].assign(variation=name))
    table = pd.concat(curves, ignore_index=True)
    facts = GAMES[run.params.game]
    outputs.show_figure(
        plots.comparison(table, facts, window, "variation", _source(run), OWN),
        label="fig-curve",
        caption=f"{run.name}, beside the stored runs of its experiment: raw score while training, "
        f"with exploration{f', mean of the last {window} games' if window > 1 else ''}.",
        alt="Learning curves: mean score against training games.",
    )


def show_scores(run: Run) -> None:
    """What a run scores in the end, and what others do."""
    _begun(run)
    rows = [_row(name, each) for name, each in {OWN: run, **_rivals(run)}.items()]
    source = _source(run)
    if len(source):
        last = source.iloc[-1]
        name = f"source report, {params.title(run.agent)}"
        rows.append({"who": name, "games": last.episode, "training": last.score})
    facts = GAMES[run.params.game]
    rows += [
        {"who": "human tester", "greedy": facts.human},
        {"who": "random play", "greedy": facts.random},
    ]
    table = pd.DataFrame(rows, columns=["who", "games", "training", "greedy"])
    table["games"] = [f"{int(each):,}" if pd.notna(each) else "–" for each in table.games]
    outputs.show_table(
        table,
        label="tbl-scores",
        caption=f"Scores in {facts.title}: mean of the last {RECENT} training games, with "
        "exploration, and of the newest greedy games.",
        decimals=1,
    )


def _row(name: str, run: Run) -> dict[str, object]:
    episodes, greedy = tables.of_runs([run], tables.EPISODES), catalogue.greedy_play(run)
    return {
        "who": name,
        "games": len(episodes),
        "training": episodes.score.tail(RECENT).mean(),
        "greedy": greedy.score if greedy else None,
    }


def show_video(run: Run, seconds: int) -> None:
    """The first seconds of a greedy game by a run's newest model."""
    _begun(run)
    games, path = max(models.in_folder(run.folder).items())
    network = models.load_model(path, run.params)
    title = f"{params.title(run.agent)}, {games:,} games"
    video = play_with_instruments(network, run.params, title, run.seed, 0, (None, seconds))
    outputs.show_video(
        video,
        label="vid-game",
        caption=f"{run.name} after {games:,} training games: the first {seconds} seconds of a "
        f"greedy game that ends with {_number(video.games[0].score, 'g')} points.",
        alt="The game, what the network sees, the value of every action, and the score.",
    )


def show_commands(run: Run) -> None:
    """Where a run is, and the commands that repeat it and watch it."""
    folder, python = _short(run.folder), "python -m atari_dqn"
    repeat = f"{python} train {folder}/params.yaml --results again"
    display(
        Markdown(
            f"The run is in `{folder}`. This repeats it from nothing, in a place of its own, bit "
            f"for bit if the learner is the native one:\n\n    ATARI_DQN_STATE=again/state {repeat}"
            f"\n\nand this shows more of its games:\n\n    {python} watch {folder}\n"
        )
    )


def _short(path: Path) -> Path:
    """The same path, from the project's folder where it lies in there."""
    root = project_root()
    return path.relative_to(root) if path.is_relative_to(root) else path
