"""What the report's notebooks call: their parameters, the stored runs, and labelled output.

Figures and tables carry their caption, label and text alternative with them, in the notebook's
own output, from where `report` takes them into HTML and PDF.
"""

import ast
from typing import Any

import pandas as pd
from IPython.core.getipython import get_ipython
from IPython.display import Markdown, display
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib_inline.backend_inline import set_matplotlib_formats

from atari_dqn import experiments, params, plots, runs
from atari_dqn.envs import GAMES, GameFacts
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.runs import Run
from atari_dqn.statistics import MARKS, interval, scores_at_marks


def injected() -> dict[str, Any]:
    """The names that the notebook's parameter cells assign, with their values now.

    The notebook's own cell begins with the line "# Parameters: defaults", the one that papermill
    adds below it with "# Parameters".
    """
    shell = get_ipython()
    assert shell is not None, "sections.injected() is for notebooks"
    names: set[str] = set()
    for source in shell.user_ns["In"]:
        first, _, _ = source.partition("\n")
        if first.startswith("# Parameters: defaults"):
            names.clear()  # run anew, perhaps edited: what was there before does not count
        elif first.strip() != "# Parameters":
            continue
        names |= {
            node.id
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        }
    return {name: shell.user_ns[name] for name in names}


def run_from_notebook(values: dict[str, Any]) -> Run:
    """The run that experiment.ipynb's parameters describe.

    `agent`, `seed` and `results_dir` are the notebook's own; everything else must be a training
    parameter. Raises ParameterError.
    """
    values = dict(values)
    agent, seed, results = (values.pop(name, None) for name in ("agent", "seed", "results_dir"))
    resolved = params.resolve(values, runs.project_root() / "params")
    agent = resolved.agents[0] if agent is None else agent
    seed = resolved.seeds[0] if seed is None else seed
    return Run(params.pick(resolved, agent, seed), runs.results_folder(resolved.profile, results))


class Section:
    """The runs that one section of the report is about.

    `agents` and `seeds` restrict the experiment's own; None takes them all. With `train_missing`
    what is missing is trained first. Raises ParameterError on an unknown experiment or agent.
    """

    def __init__(
        self,
        experiment: str,
        profile: str,
        results_dir: str | None = None,
        agents: list[str] | None = None,
        seeds: list[int] | None = None,
        train_missing: bool = False,
    ):
        found = {path.stem: path for path in experiments.files(profile)}
        if experiment not in found:
            raise ParameterError(
                f"experiment {experiment!r} is not allowed: must be one of {', '.join(found)}"
            )
        chosen = {"agents": agents, "seeds": seeds}
        overrides = {key: value for key, value in chosen.items() if value is not None}
        self.params: Parameters = params.load(found[experiment], overrides)
        self.facts: GameFacts = GAMES[self.params.game]
        self.file = found[experiment].relative_to(runs.project_root())
        folder = runs.results_folder(profile, results_dir)
        self.runs = runs.runs_of(self.params, folder)
        if train_missing:
            failures = experiments.train_all(self.runs)
            if failures:
                raise runs.RunError("; ".join(failures))
        usable = [run for run in self.runs if run.state() not in (runs.MISSING, runs.STALE)]
        self.episodes: pd.DataFrame = runs.read_table(usable, "episodes.csv")
        self.evaluations: pd.DataFrame = self._own(runs.read_table(usable, "evaluations.csv"))
        # How many games a point of a learning curve, and a number at a mark, is the mean of.
        self.curve_window = max(1, self.params.episodes // 30)
        self.mark_window = max(1, self.params.episodes // len(MARKS))

    def _own(self, evaluations: pd.DataFrame) -> pd.DataFrame:
        """Only the games that were played as the experiment trains and evaluates."""
        if evaluations.empty:
            return evaluations
        p = self.params
        return evaluations[
            (evaluations.difficulty == p.difficulty)
            & (evaluations.sticky_actions == p.sticky_actions)
            & (evaluations.epsilon == p.evaluation_epsilon)
        ]

    def badge(self) -> None:
        """Says which runs are missing or partial, their share done, and how to finish them."""
        states = [run.state() for run in self.runs]
        complete = states.count(runs.COMPLETE)
        share = len(self.episodes) / (len(self.runs) * self.params.episodes)
        profile = f" ({self.params.profile} runs)" if self.params.profile != "full" else ""
        text = (
            f"**{complete} of {len(self.runs)} runs complete**{profile}: "
            f"{len(self.episodes):,} games played, {share:.0%} of those planned."
        )
        if self.episodes.empty:
            text += " There is nothing to show yet."
        option = "" if self.params.profile == "full" else f" PROFILE={self.params.profile}"
        for run, state in zip(self.runs, states, strict=True):
            command = f"make train EXPERIMENT={run.params.experiment} AGENT={run.agent} "
            command += f"SEED={run.seed}{option}"
            if state == runs.STALE:
                text += f"\n\n{run.name} is stale ({'; '.join(run.changes())}) and not shown; once "
                text += f"moved away, `{command}` trains it anew."
            elif state != runs.COMPLETE:
                text += f"\n\n{run.name} is {state}; `{command}` finishes it."
        show_text(f"::: {{.badge}}\n{text}\n:::")

    def counted(self) -> str:
        """How many seeds and games there are, for captions."""
        if self.episodes.empty:
            return "no run stored yet"
        seeds = self.episodes.groupby("agent").seed.nunique()
        low, high = seeds.min(), seeds.max()
        number = f"{low}" if low == high else f"{low} to {high}"
        few = "; indicative only" if low <= 3 else ""
        return f"seeds an agent: {number}; {len(self.episodes):,} training games{few}"


def start() -> None:
    """Prepares a notebook: figures in the project's style, as vector graphics."""
    plots.style()
    set_matplotlib_formats("svg", metadata={"Date": None, "Creator": None})


def show_text(markdown: str) -> None:
    """Shows computed text."""
    display(Markdown(markdown))


def show_figure(figure: Figure, label: str, caption: str, alt: str) -> None:
    """Shows a figure with its caption; `label` (fig-...) is what the text refers to."""
    meta = {"label": label, "caption": caption, "alt": alt}
    display(figure, metadata={"image/svg+xml": meta})
    plt.close(figure)


def show_table(table: pd.DataFrame, label: str, caption: str, decimals: int = 2) -> None:
    """Shows a table with its caption; missing numbers are dashes."""
    shown = table.map(lambda cell: f"{cell:.{decimals}f}" if isinstance(cell, float) else cell)
    shown = shown.mask(table.isna(), "–")
    right = tuple("right" if kind.kind in "if" else "left" for kind in table.dtypes)
    text = shown.to_markdown(index=False, disable_numparse=True, colalign=right)
    show_text(f"{text}\n\n: {caption} {{#{label}}}")


def settings(of: list[Parameters]) -> pd.DataFrame:
    """A row a training parameter, with its unit and its value in each experiment.

    Parameters that only other experiments use are left out.
    """
    rare = {"warmup_games", "warmup_learning_rate", "initial_weights", "freeze_convolutions"}
    rare |= {"transferred_layers"} | params.NOT_TRAINING
    shown = [key for key in Parameters.model_fields if key not in rare]
    table = pd.DataFrame(
        {
            "parameter": [f"`{key}`" for key in shown],
            "unit": [Parameters.model_fields[key].description for key in shown],
        }
    )
    for item in of:
        values = (getattr(item, key) for key in shown)
        table[item.experiment] = [
            f"{value:g}" if isinstance(value, float) else str(value) for value in values
        ]
    return table


def show_curves(section: Section) -> None:
    """The learning curves of the section's runs, as far as they have come."""
    window, facts = section.curve_window, section.facts
    if section.episodes.empty or section.episodes.episode.max() < window:
        show_text(f"*No run has played the {window} games that a learning curve begins with.*")
        return
    show_figure(
        plots.learning_curves(section.episodes, facts, window),
        label=f"fig-{section.params.game}-curves",
        caption=f"{facts.title}: raw score while training, with exploration; each point is the "
        f"mean of the last {window} games ({section.counted()}).",
        alt=f"Learning curves of the agents in {facts.title}: mean score against games played.",
    )


def show_marks(section: Section) -> None:
    """The mean score of the last games at each mark that a run has reached."""
    step = section.params.episodes / len(MARKS)
    marks = tuple(dict.fromkeys(round(step * (index + 1)) for index in range(len(MARKS))))
    if section.episodes.empty or section.episodes.episode.max() < marks[0]:
        show_text(f"*No run has reached the first mark, {marks[0]} games.*")
        return
    table = scores_at_marks(section.episodes, marks, section.mark_window).reset_index()
    table["agent"] = table.agent.map(runs.title)
    show_table(
        table,
        label=f"tbl-{section.params.game}-marks",
        caption=f"{section.facts.title}: mean raw score of {section.mark_window} games up to each "
        f"number of games played ({section.counted()}). Human {section.facts.human:g}, random "
        f"play {section.facts.random:g} [@dqnzoo2020].",
    )


def show_evaluations(section: Section) -> None:
    """The evaluation games of every finished run, with an interval over the games played."""
    if section.evaluations.empty:
        show_text("*No run is finished, so none has been evaluated.*")
        return
    games = section.evaluations.groupby(["agent", "seed"]).size().min()
    show_figure(
        plots.score_distributions(section.evaluations),
        label=f"fig-{section.params.game}-evaluation",
        caption=f"{section.facts.title}: scores of the evaluation games ({games} games a run; "
        f"{section.params.evaluation_epsilon:.1%} of the actions are random).",
        alt=f"Box plots of each agent's evaluation scores in {section.facts.title}.",
    )
    rows = []
    for (agent, seed), games in section.evaluations.groupby(["agent", "seed"], sort=False):
        row = {
            "agent": runs.title(agent),
            "seed": seed,
            "games": len(games),
            "mean score": games.score.mean(),
            "95% interval": "–",
        }
        if len(games) > 1:
            low, high = interval(games.score.to_numpy())
            row["95% interval"] = f"{low:.1f} to {high:.1f}"
        if section.facts.knockout_cells is not None:
            row["won"] = f"{games.won.mean():.0%}"
            row["by knock-out"] = f"{(games.knockout == 1).mean():.0%}"
        rows.append(row)
    show_table(
        pd.DataFrame(rows),
        label=f"tbl-{section.params.game}-evaluation",
        caption=f"{section.facts.title}: evaluation games. The interval is over the games of a run "
        "(bootstrap), not over seeds.",
        decimals=1,
    )
