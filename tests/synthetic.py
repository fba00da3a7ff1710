"""Runs made by hand, stored as training would leave them, and what the report shows of them.

Their numbers are round: a hundred games are an hour, two million frames and 250,000 agent steps.
"""

import copy
import functools
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from atari_dqn import params
from atari_dqn.analysis.study import TITLES as EXPERIMENTS
from atari_dqn.analysis.study import Study
from atari_dqn.envs import EpisodeRecord
from atari_dqn.params import TRAINING_VERSION
from atari_dqn.runs import records, tables, weights
from atari_dqn.runs.run import Run, runs_of

ROOT = Path(__file__).parents[1]
AGENTS = ("dqn", "double_dqn", "dueling_double_dqn")
TITLES = {"dqn": "DQN", "double_dqn": "Double DQN", "dueling_double_dqn": "Dueling Double DQN"}
TOLD_OF = {tables.EPISODES: 1, tables.VALUES: params.VALUE_GAMES, tables.EVALUATIONS: 1}
SESSION = {
    **{"started": "2026-01-02T03:04:05+00:00", "commit": "0" * 40, "processor": "a processor"},
    **{"device": "cpu", "versions": {"ale-py": "0"}},
}
SECONDS, FRAMES, STEPS = 36.0, 20_000, 2_500  # a training game: by the clock, and in its course


@functools.cache
def settings(experiment):
    return params.load(ROOT / "params" / f"{experiment}.yaml")


@functools.cache
def _parameters():
    return Study("full", "nowhere")


def study(results):
    """`Study("full", results)`, without reading the files of parameters again."""
    found = Study.__new__(Study)
    found.sections = {name: copy.copy(one) for name, one in _parameters().sections.items()}
    for section in found.sections.values():
        section.runs = runs_of(section.params, results)
    return found


def store(results, experiment, agent, scores, seed=1, variation="", epsilon=0.22, **provenance):
    """A run's folder with the given scores, in place of what it may hold."""
    variants = params.variants(settings(experiment))
    chosen = variants[variation or experiment]
    run = Run(params.pick(chosen, agent, seed), results, variation)
    if run.folder.exists():
        shutil.rmtree(run.folder)
    run.folder.mkdir(parents=True)
    games = np.arange(1, len(scores) + 1)
    table = {"episode": games, "agent_steps": games * STEPS, "frames": games * FRAMES}
    table |= {"score": scores, "length": STEPS, "epsilon": epsilon, "loss": 0.01, "mean_q": 1.0}
    pd.DataFrame(table).to_csv(run.folder / "episodes.csv", index=False)
    timing = {"episode": games, "seconds": games * SECONDS, "cpu_seconds": games * SECONDS / 9}
    pd.DataFrame(timing).to_csv(run.folder / "timing.csv", index=False)
    few = {"evaluation_games": 1, "evaluation_difficulties": [], "evaluation_stickiness": []}
    (run.folder / "params.yaml").write_text(params.text(run.params.model_copy(update=few)))
    if len(scores) >= run.params.episodes:  # it is complete, and has what such a run has
        (run.folder / "model.safetensors").write_bytes(weights.pack({}, len(scores)))
        check(run, np.zeros(len(scores) // 100))
        evaluate(run, 1, trained=len(scores))
    record(run)
    state = "complete" if len(scores) >= run.params.episodes else "interrupted"
    status = {"state": state, "episodes_done": len(scores), "episodes": run.params.episodes}
    (run.folder / "status.json").write_text(json.dumps(status))
    known = {"training_version": TRAINING_VERSION, "identity": run.params.identity()}
    sessions = [{**SESSION, **given} for given in provenance.pop("sessions", [{}])]
    known |= {"sessions": sessions, "resumes": 0, "agent_steps": STEPS * len(scores)}
    (run.folder / "provenance.json").write_text(json.dumps(known | provenance))
    return run


def record(run, *played):
    """Gives a run the games that are `played` on record, after as many as its tables tell of, which
    are of no model of its own."""
    games = 0
    for name, each in TOLD_OF.items():
        if (path := run.folder / name).exists():
            games += each * (path.read_bytes().count(b"\n") - 1)
    firsts = range(0, games, records.FRAME)
    frames = [_frame(first, min(first + records.FRAME, games)) for first in firsts]
    (run.folder / records.FILE).write_bytes(b"".join(frames) + records.encode([*played]))


@functools.cache
def _frame(first, end):
    heading = {**dict.fromkeys(records.KEYS[records.EVALUATION], 0), "kind": records.EVALUATION}
    none = EpisodeRecord(0, b"", None)
    return records.encode([({**heading, "game": game}, none) for game in range(first, end)])


def standing_out(mean, games, by=100.0):
    """Scores of the given mean, of which the first and the last lie `by` above the others' level:
    a mean over games that begin or end one too early or too late is another number."""
    scores = np.full(games, mean - 2 * by / games)
    scores[[0, -1]] += by
    return scores


def window(first, last, mean, outside, **more):
    """Scores of games that are `mean` on average from `first` to `last`, and far off outside."""
    return windows({(first, last): mean}, outside, **more)


def windows(means, outside, after=10):
    """Scores with a mean from a first to a last game each, far off outside, and some games more."""
    scores = np.full(max(last for _, last in means) + after, float(outside))
    for (first, last), mean in means.items():
        scores[first - 1 : last] = standing_out(mean, last - first + 1)
    return scores


SPREAD = ("score", "scored", "conceded", "distance")  # columns that differ from game to game


def evaluate(run, games=40, trained=None, add=False, **columns):
    """Gives a run an evaluation of greedy games, whose columns have the given means; `add` leaves
    those that it has. Of a model of fewer games than the run is to have, it is one in progress."""
    rng, spread = np.random.default_rng(1), np.linspace(-1, 1, games)
    columns = {"score": 20.0, "scored": 30.0, "conceded": 10.0, "distance": 40.0} | columns
    for name in SPREAD:
        columns[name] = columns[name] + rng.permutation(spread)
    settings = {"difficulty": run.params.difficulty, "sticky_actions": 0.0, "epsilon": 0.001}
    settings |= {"won": columns["score"] > 0, "knockout": 0, "length": 1800, "frames": 7200}
    settings |= {"seed": run.seed, "trained_games": trained or run.params.episodes}
    table, path = pd.DataFrame(settings | columns), run.folder / "evaluations.csv"
    put_evaluations(path, pd.concat([pd.read_csv(path), table] if add else [table]))
    record(run)
    if trained and trained < run.params.episodes:
        status = json.loads((run.folder / "status.json").read_text()) | {"state": "interrupted"}
        (run.folder / "status.json").write_text(json.dumps(status))


def put_evaluations(path, table):
    """Writes evaluation games as a run does: in order, and numbered under the same settings."""
    table = table.sort_values([*tables.SETTINGS], kind="stable")
    table["game"] = table.groupby([*tables.SETTINGS]).cumcount()
    table[[*tables.COLUMNS[tables.EVALUATIONS]]].to_csv(path, index=False)


def check(run, score, predicted=1.0, realised=1.0, held_out=1.0):
    """Gives a run its greedy scores, and its values, after every hundred games."""
    games = 100 * np.arange(1, len(score) + 1)
    table = {"episode": games, "held_out_q": held_out, "predicted": predicted}
    table = pd.DataFrame({**table, "realised": realised, "score": score})
    table.to_csv(run.folder / "values.csv", index=False)
    record(run)


def style(run, score, greedy=params.VALUE_GAMES, **columns):
    """Gives a run the styles of its greedy episodes after every hundred episodes of training; a
    column is a value per check, and in Breakout 1 where it is not given. An episode lasts two
    minutes."""
    count, name = len(score), tables.STYLES[run.params.game]
    columns = {"score": score, "frames": 7200, "digest": "0", **columns}
    boxing = {"scored": 30.0, "conceded": 10.0, "punches": 60, "reach": 0.5, "distance": 40.0}
    boxing |= {"blows": 24, "doubles": 6, "ropes": 0.2, "rival_ropes": 0.4}
    columns = {**dict.fromkeys(tables.COLUMNS[name], 1), **boxing, **columns}
    table = pd.DataFrame(columns | {"episode": 100 * np.arange(1, count + 1)})
    run.styles.parent.mkdir(parents=True, exist_ok=True)
    table = table.loc[table.index.repeat(greedy)].assign(game=np.tile(np.arange(greedy), count))
    table[[*tables.COLUMNS[name]]].to_csv(run.styles, index=False)


NUMBER = r"[-−]?\d[\d,]*(?:\.\d+)?"


def numbers(text):
    """The numbers in a text, in their order."""
    return [float(one.replace(",", "").replace("−", "-")) for one in re.findall(NUMBER, text)]


def by_name(text):
    """A text with the experiments' names, in backticks, in place of their titles."""
    for name, title in sorted(EXPERIMENTS.items(), key=lambda item: -len(item[1])):
        text = text.replace(title, f"`{name}`")
    return text


def facts(text):
    """The agents, experiments and numbers in a text, in their order, whatever words are between."""
    text = by_name(text)
    names = "|".join(sorted(TITLES.values(), key=len, reverse=True))
    found = re.findall(rf"{names}|`\w+`|{NUMBER}", text.replace("−", "-"))
    return [one if one[-1] in "`N" else float(one.replace(",", "")) for one in found]


def lines_of(axes, style=None):
    """The lines of an axes that have points, in the order of drawing: (xs, ys) each; `style`
    chooses among "-", "--" and ":"."""
    return [
        (list(line.get_xdata()), list(line.get_ydata()))
        for line in axes.get_lines()
        if len(line.get_xdata()) and style in (None, line.get_linestyle())
    ]


def named_lines(axes):
    """{name in the legend: [(xs, ys), ...]} of an axes' lines, by their colours."""
    legend = axes.get_legend()
    names = [text.get_text() for text in legend.get_texts()]
    found = {}
    for name, handle in zip(names, legend.legend_handles, strict=True):
        found[name] = [
            (list(line.get_xdata()), list(line.get_ydata()))
            for line in axes.get_lines()
            if len(line.get_xdata()) and line.get_color() == handle.get_color()
        ]
    return found


class Shown:
    """What the notebooks' cells have displayed: texts, and tables, figures and captions by label.
    A table is a list of rows, {column: cell}, as it is printed."""

    def __init__(self):
        self.texts, self.tables, self.figures, self.captions = [], {}, {}, {}

    def display(self, thing, metadata=None, raw=False):
        if isinstance(thing, Figure):
            (meta,) = metadata.values()
            self.figures[meta["label"]], self.captions[meta["label"]] = thing, meta["caption"]
            return
        text = (metadata or {}).get("text/markdown", {}).get("report", str(thing))
        if not text:
            return  # a caption for JupyterLab, which the report takes from the figure
        self.texts.append(text)
        if text.startswith("|"):
            lines, caption = text.rsplit("\n\n: ", 1)
            head, _, *rows = (
                [cell.strip() for cell in line.split("|")[1:-1]] for line in lines.splitlines()
            )
            label = re.search(r"{#([\w-]+)}$", caption)[1]
            self.tables[label] = [dict(zip(head, row, strict=True)) for row in rows]
            self.captions[label] = caption
