"""What the report's notebooks are about: their parameters, and the stored runs of a section."""

import ast
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from IPython.core.getipython import get_ipython
from ruamel.yaml import YAML

from atari_dqn import experiments, params, runs
from atari_dqn.envs import GAMES, GameFacts
from atari_dqn.exhibits import show_text
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.runs import Run
from atari_dqn.statistics import MARKS

FRAMES_A_MINUTE = 60 * 60


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
    parameter. Raises ParameterError, also for an experiment of several variations.
    """
    values = dict(values)
    agent, seed, results = (values.pop(name, None) for name in ("agent", "seed", "results_dir"))
    resolved = params.resolve(values, runs.project_root() / "params")
    if resolved.variations:
        raise ParameterError(
            f"experiment: {resolved.experiment!r} is not allowed: it has variations, which are "
            "several runs; `python -m atari_dqn train` with its file trains them"
        )
    agent = resolved.agents[0] if agent is None else agent
    seed = resolved.seeds[0] if seed is None else seed
    return Run(params.pick(resolved, agent, seed), runs.results_folder(resolved.profile, results))


def data(name: str) -> Any:
    """What a file of notebooks/data/ holds."""
    path = runs.project_root() / "notebooks" / "data" / f"{name}.yaml"
    return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))


class Section:
    """The runs that one section of the report is about.

    `agents` and `seeds` take the place of the experiment's own. Raises ParameterError on an
    unknown experiment or agent.
    """

    def __init__(
        self,
        experiment: str,
        profile: str,
        results_dir: str | None = None,
        agents: list[str] | None = None,
        seeds: list[int] | None = None,
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
        self.slug = experiment.replace("_", "-")  # what this section's labels hold
        folder = runs.results_folder(profile, results_dir)
        self.runs = runs.runs_of(self.params, folder)
        # How many games a point of a learning curve, and a number at a mark, is the mean of.
        self.curve_window = max(1, self.params.episodes // 30)
        self.mark_window = max(1, self.params.episodes // len(MARKS))

    def train(self) -> None:
        """Trains what is missing. Raises RunError if a run fails."""
        if failures := experiments.train_all(self.runs):
            raise runs.RunError("; ".join(failures))

    @cached_property
    def usable(self) -> list[Run]:
        return [run for run in self.runs if run.state() not in (runs.MISSING, runs.STALE)]

    @cached_property
    def episodes(self) -> pd.DataFrame:
        """A row a training game: `training.Episode`, agent, seed, variation, seconds so far."""
        tables = []
        for run in self.usable:
            table = runs.read_table([run], "episodes.csv")
            timing = runs.read_table([run], "timing.csv")
            if not table.empty:
                tables.append(table.merge(timing[["episode", "seconds"]], "left", "episode"))
        return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()

    @cached_property
    def values(self) -> pd.DataFrame:
        """A row every hundred games: `evaluation.ValueCheck`, agent, seed."""
        return runs.read_table(self.usable, "values.csv")

    @cached_property
    def evaluations(self) -> pd.DataFrame:
        """Those of `all_evaluations` that were played as the experiment trains and evaluates."""
        return self.as_trained(self.all_evaluations)

    def as_trained(self, table: pd.DataFrame) -> pd.DataFrame:
        """The evaluation games in `table` that were played as the experiment trains and
        evaluates."""
        if table.empty:
            return table
        p = self.params
        return table[
            (table.difficulty == p.difficulty)
            & (table.sticky_actions == p.sticky_actions)
            & (table.epsilon == p.evaluation_epsilon)
        ]

    @cached_property
    def stored_evaluations(self) -> pd.DataFrame:
        """A row an evaluation game, of whichever of a run's models and however played."""
        return runs.read_table(self.usable, "evaluations.csv")

    @cached_property
    def all_evaluations(self) -> pd.DataFrame:
        """A row an evaluation game of each run's newest model that was evaluated, at whatever
        difficulty and stickiness."""
        table = self.stored_evaluations
        if table.empty:
            return table
        newest = table.groupby(["experiment", "agent", "seed"]).trained_games.transform("max")
        minutes = table.frames / FRAMES_A_MINUTE
        table = table.assign(conceded_a_minute=table.conceded / minutes)
        return table.assign(scored_a_minute=table.scored / minutes)[table.trained_games == newest]

    @cached_property
    def random_play(self) -> pd.DataFrame:
        """A row an evaluation game of random moves only, at the experiment's difficulty and
        stickiness; the same game counts once, whichever models stood by."""
        table = self.stored_evaluations
        if table.empty:
            return table
        p = self.params
        alike = (table.difficulty == p.difficulty) & (table.sticky_actions == p.sticky_actions)
        return table[alike & (table.epsilon == 1.0)].drop_duplicates(["seed", "game"])

    @property
    def final_evaluations(self) -> pd.DataFrame:
        """Those of `all_evaluations` that are of finished runs."""
        table = self.all_evaluations
        return table if table.empty else table[table.trained_games >= self.params.episodes]

    @property
    def usual(self) -> bool:
        """Whether the game is played as others have played it, so that scores compare."""
        return self.params.difficulty == 0

    @property
    def share(self) -> float:
        """Games played, of those planned."""
        wanted = len(self.runs) * self.params.episodes
        return min(1.0, len(self.episodes) / wanted)

    @property
    def complete(self) -> bool:
        return all(run.state() == runs.COMPLETE for run in self.runs)

    def scores(self, agent: str, first: int, last: int) -> np.ndarray:
        """The scores of training games `first` to `last`, float64 [seeds, games], of the agent's
        seeds that have played that far."""
        if self.episodes.empty:
            return np.empty((0, 0))
        games = self.episodes[self.episodes.agent == agent]
        reached = games.groupby("seed").episode.transform("max") >= last
        wanted = games[reached & games.episode.between(first, last)]
        return wanted.pivot(index="seed", columns="episode", values="score").to_numpy(float)

    @property
    def origin(self) -> str:
        """The files that hold the section's training games, for under a figure."""
        agents = "*" if len(self.params.agents) > 1 else self.params.agents[0]
        name = self.params.experiment + ("+*" if self.params.variations else "")
        return f"results/runs/{name}/{agents}/seed-*/"

    def badge(self) -> None:
        """Says which runs are missing or partial, their share done, and how to finish them."""
        states = [run.state() for run in self.runs]
        complete, name = states.count(runs.COMPLETE), self.params.experiment
        profile = "" if self.params.profile == "full" else f" --profile {self.params.profile}"
        command = f"`python -m atari_dqn experiments run {name}{profile}`"
        games = (
            f"{len(self.runs)} run{'s' * (len(self.runs) > 1)} of {self.params.episodes:,} games"
        )
        if self.episodes.empty:
            text = (
                f"**Not started.** Planned: {games}. {command} trains them; the curves and tables "
            )
            text += "of this experiment follow."
        else:
            share = "less than 1%" if self.share < 0.01 else f"{self.share:.0%}"
            text = (
                f"**{complete} of {len(self.runs)} runs complete**{profile and ' (small runs)'}: "
            )
            text += f"{len(self.episodes):,} games played, {share} of {games}."
            if complete < len(self.runs):
                text += f" {command} finishes them."
        for run, state in zip(self.runs, states, strict=True):
            if state == runs.STALE:
                text += f"\n\n{run.name} is stale ({'; '.join(run.changes())}) and not shown."
        kind = ".badge" if complete == len(self.runs) else ".badge .partial"
        show_text(f"::: {{{kind}}}\n{text}\n:::")

    def counted(self) -> str:
        """How many seeds and games there are, for captions."""
        if self.episodes.empty:
            return "no run stored yet"
        seeds = self.episodes.groupby("agent").seed.nunique()
        low, high = seeds.min(), seeds.max()
        number = f"{low}" if low == high else f"{low} to {high}"
        few = "; indicative only" if low <= 3 else ""
        return f"seeds an agent: {number}; {len(self.episodes):,} training games{few}"


class Study:
    """Experiments of a profile: study["boxing_final"] is its section.

    `names` are those of the experiments; None takes all. `agents` and `seeds` take the place of
    each experiment's own.
    """

    def __init__(
        self,
        profile: str,
        results_dir: str | None = None,
        names: list[str] | None = None,
        agents: list[str] | None = None,
        seeds: list[int] | None = None,
    ):
        if names is None:
            names = [path.stem for path in experiments.files(profile)]
        self.sections = {name: Section(name, profile, results_dir, agents, seeds) for name in names}

    def __getitem__(self, experiment: str) -> Section:
        if experiment not in self.sections:
            raise KeyError(f"{experiment!r} is not among the study's {', '.join(self.sections)}")
        return self.sections[experiment]

    @property
    def runs(self) -> list[Run]:
        return [run for section in self.sections.values() for run in section.runs]
