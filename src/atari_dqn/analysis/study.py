"""The stored runs that a section of the report is about."""

import copy
import re
from collections.abc import Callable
from functools import cache, cached_property
from typing import Any

import numpy as np
import pandas as pd
from ruamel.yaml import YAML

from atari_dqn import params
from atari_dqn.analysis.statistics import MILESTONES
from atari_dqn.games import GAMES, KNOCK_OUT, GameFacts
from atari_dqn.params import EVALUATION, Parameters
from atari_dqn.runs import plan, tables
from atari_dqn.runs.files import project_root, results_folder
from atari_dqn.runs.run import (
    COMPLETE,
    INTERRUPTED,
    MISSING,
    RUNNING,
    STALE,
    Run,
    as_trained,
    runs_of,
)

FRAMES_PER_MINUTE = 60 * 60
TITLES = {  # what captions call an experiment
    "boxing_final": "Boxing, final settings",
    "breakout_final": "Breakout, final settings",
    "breakout_late": "Breakout with all preprocessing",
    "breakout_early": "Breakout, first attempt",
    "boxing_early": "Boxing, first attempt",
    "boxing_expert": "Boxing, expert mode",
    "boxing_low_gamma": "Boxing, discount 0.9",
    "boxing_high_gamma": "Boxing, discount 0.995",
    "boxing_transfer": "Boxing, transfer from Breakout",
    "boxing_sensitivity": "Boxing, one change at a time",
    "boxing_transfer_controls": "Boxing, controls of transfer",
    "boxing_hardest": "Boxing, hardest setting",
    "boxing_multi_step": "Boxing, three-step returns",
    "breakout_multi_step": "Breakout, three-step returns",
}


def data(name: str) -> Any:
    """What a file of notebooks/data/ holds."""
    path = project_root() / "notebooks" / "data" / f"{name}.yaml"
    return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))


def spelled(variation: str) -> str:
    """A variation's label as a reader expects it: "learning rate × ¼"."""
    for plain, sign in {" x ": " × ", "1/4": "¼", "1/2": "½"}.items():
        variation = variation.replace(plain, sign)
    return variation


SNAPSHOT = "notebooks/snapshot"  # of the results, within their folder, that a report is made from
FEW_OPENINGS = 4  # as in Breakout: all of them are played, and no other could be


def openings(games: pd.DataFrame, parameters: Parameters) -> list[int]:
    """The openings of evaluation games (columns seed, game, sticky_actions and epsilon), by the
    idle frames that `evaluation.EpisodeInProgress` draws. Games of one opening resemble one
    another: greedy ones differ by their few random moves only. Games with much chance, of sticky
    actions or of random play, resemble none: a negative number each."""
    facts, found = GAMES[parameters.game], []
    for place, game in enumerate(games.itertuples(index=False), start=1):
        if game.sticky_actions > 0 or game.epsilon == 1:
            found.append(-place)
        else:
            idle = _idle_frames(parameters.noop_max, game.seed, game.game)
            found.append(facts.opening(idle))
    return found


@cache
def _idle_frames(noop_max: int, seed: int, game: int) -> int:
    stream = np.random.SeedSequence(seed, spawn_key=(EVALUATION, game)).generate_state(2)[0]
    given = np.random.SeedSequence(int(stream)).generate_state(1)[0]  # as Gymnasium seeds a game
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(given))))
    return int(rng.integers(1, noop_max + 1)) if noop_max else 0


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
        chosen = {"agents": agents, "seeds": seeds}
        overrides = {key: value for key, value in chosen.items() if value is not None}
        self.params: Parameters = params.load(plan.file(experiment, profile), overrides)
        self.facts: GameFacts = GAMES[self.params.game]
        self.slug = experiment.replace("_", "-")  # what this section's labels hold
        self.name = f"`{experiment}`"  # what sentences call it
        self.title = TITLES.get(experiment, f"{self.facts.title}, {self.name}")
        folder = results_folder(profile, results_dir)
        self.runs = runs_of(self.params, folder)
        # How many episodes a point of a learning curve, and a number at a milestone, is the mean of
        self.curve_window = max(1, self.params.episodes // 30)
        self.milestone_window = max(1, self.params.episodes // len(MILESTONES))

    @property
    def milestones(self) -> tuple[int, ...]:
        """The numbers of episodes after which scores are compared."""
        step = self.params.episodes / len(MILESTONES)
        return tuple(dict.fromkeys(round(step * (index + 1)) for index in range(len(MILESTONES))))

    def only(self, variation: str) -> "Section":
        """The same of one of the experiment's variations."""
        part = copy.copy(self)
        for name in [
            name for name in vars(part) if isinstance(vars(Section).get(name), cached_property)
        ]:
            delattr(part, name)
        part.runs = [run for run in self.runs if run.variation == variation]
        part.name = f"{self.name} ({spelled(variation)})"
        part.title = f"{self.title} ({spelled(variation)})"
        return part

    @cached_property
    def damaged(self) -> dict[str, str]:
        """What is wrong with those of its runs that cannot be read, by their names; they are left
        out of everything else."""
        return {run.name: said for run in self.runs if (said := tables.damage(run))}

    @property
    def stored(self) -> list[Run]:
        """Those of its runs of which something is stored that can be read."""
        readable = [run for run in self.runs if run.name not in self.damaged]
        return [run for run in readable if run.state() != MISSING]

    @cached_property
    def usable(self) -> list[Run]:
        """Those that are as the experiment's file asks for."""
        return [run for run in self.stored if run.state() != STALE]

    @cached_property
    def on_gpu(self) -> bool:
        """Whether a GPU trained any game of its runs."""
        return any(on_gpu(run) for run in self.usable)

    @cached_property
    def episodes(self) -> pd.DataFrame:
        """A row per training game: `training.Episode`, agent, seed, variation, and the seconds so
        far by the clock and of processor time."""
        found = []
        for run in self.usable:
            table = tables.of_runs([run], tables.EPISODES)
            timing = tables.read(run.folder, tables.TIMING)
            if not table.empty:
                columns = ["episode", "seconds", "cpu_seconds"]
                found.append(table.merge(timing[columns], "left", "episode"))
        return pd.concat(found, ignore_index=True) if found else pd.DataFrame()

    @cached_property
    def values(self) -> pd.DataFrame:
        """A row every hundred games: `evaluation.ValueCheck`, agent, seed."""
        return tables.of_runs(self.usable, tables.VALUES)

    @cached_property
    def evaluations(self) -> pd.DataFrame:
        """Those of `all_evaluations` that were played as the experiment trains and evaluates."""
        return as_trained(self.all_evaluations, self.params)

    @cached_property
    def stored_evaluations(self) -> pd.DataFrame:
        """A row per evaluation game, of whichever of a run's models and however played, and the
        opening that it begins with."""
        table = tables.of_runs(self.usable, tables.EVALUATIONS)
        return table if table.empty else table.assign(opening=openings(table, self.params))

    @cached_property
    def all_evaluations(self) -> pd.DataFrame:
        """A row per evaluation game of each run's newest model that was evaluated, at whatever
        difficulty and stickiness."""
        table = self.stored_evaluations
        if table.empty:
            return table
        newest = table.groupby(["experiment", "agent", "seed"]).trained_games.transform("max")
        return table[table.trained_games == newest]

    @cached_property
    def styles(self) -> pd.DataFrame:
        """How the agents play in the checks of greedy play along their training, a row per greedy
        episode: what `runs.styles` finds, agent, seed, and what follows.

        In Boxing: what it counts per minute and per punch, percent of the time within reach and at
        the ropes, of the blows that score those for two points, 100 for a game won by knock-out,
        and the mean of the seconds that such games of the check lasted. In Breakout: 100 for a game
        with a tunnel and, of all balls of the check that the game is of, the percent of each speed
        that were returned, and of the lost ones that were lost at the sides. (A game goes on until
        balls are lost, so that its own percentages would be too low on average.)

        A column of the name of such a mean and `_of` holds how many balls, or knock-outs, the game
        itself has."""
        if self.params.game not in tables.STYLES:
            return pd.DataFrame()
        table = self._beside(tables.style)
        if table.empty:
            return table
        if self.params.game == "boxing":
            minutes = table.frames / FRAMES_PER_MINUTE
            counted = ("scored", "conceded", "punches", "blows")
            rates = {f"{name}_per_minute": table[name] / minutes for name in counted}
            won = table.scored >= KNOCK_OUT
            check = [table.agent, table.seed, table.episode]
            return table.assign(
                **rates,
                points_per_punch=table.scored / _some(table.punches),
                two_points=100 * table.doubles / _some(table.blows),
                knock_outs=100.0 * won,
                to_knock_out=(60 * minutes).where(won).groupby(check).transform("mean"),
                to_knock_out_of=won.astype(int),
                within_reach=100 * table.reach,
                at_ropes=100 * table.ropes,
                rival_at_ropes=100 * table.rival_ropes,
            )
        parts = {"sides": (table.lost_left + table.lost_right, table.lost_middle)}
        for speed in tables.SPEEDS:
            parts[speed] = table[f"returned_{speed}"], table[f"lost_{speed}"]
        table = table.assign(tunnels=100 * table.tunnel)
        for name, (some, others) in parts.items():
            balls = pd.DataFrame({"some": some, "all": some + others})
            check = balls.groupby([table.agent, table.seed, table.episode]).transform("sum")
            table[name], table[f"{name}_of"] = 100 * check.some / _some(check["all"]), balls["all"]
        return table

    @cached_property
    def robustness(self) -> pd.DataFrame:
        """A row per game of finished agents under conditions that they have never met:
        `runs.robustness.Trial`, agent, seed."""
        return self._beside(tables.trials)

    def _beside(self, read: Callable[[Run], pd.DataFrame]) -> pd.DataFrame:
        """One table of what is read in the runs' files of a kind beside their folders."""
        each = [(run, read(run)) for run in self.usable]
        found = [table.assign(agent=run.agent, seed=run.seed) for run, table in each if len(table)]
        return pd.concat(found, ignore_index=True) if found else pd.DataFrame()

    @property
    def random_play(self) -> pd.DataFrame:
        """`random_play_at` the experiment's difficulty."""
        return self.random_play_at(self.params.difficulty)

    def random_play_at(self, difficulty: int) -> pd.DataFrame:
        """A row per evaluation episode of random moves only, at a difficulty and the experiment's
        stickiness; the same episode counts once, whichever models stood by."""
        table = self.stored_evaluations
        if table.empty:
            return table
        alike = (table.difficulty == difficulty) & (
            table.sticky_actions == self.params.sticky_actions
        )
        return table[alike & (table.epsilon == 1.0)].drop_duplicates(["seed", "game"])

    @property
    def final_evaluations(self) -> pd.DataFrame:
        """Those of `all_evaluations` that are of finished runs."""
        table = self.all_evaluations
        return table if table.empty else table[table.trained_games >= self.params.episodes]

    @property
    def default_difficulty(self) -> bool:
        """Whether the game is played as others have played it, so that scores compare."""
        return self.params.difficulty == 0

    @property
    def planned(self) -> int:
        """Training games of all its runs."""
        return len(self.runs) * self.params.episodes

    @property
    def share(self) -> float:
        """Games played, of those planned."""
        return min(1.0, len(self.episodes) / self.planned)

    @property
    def complete(self) -> bool:
        return not self.damaged and all(run.state() == COMPLETE for run in self.runs)

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

    def counted(self) -> str:
        """How many seeds there are, for a caption, and what follows if they are few."""
        if self.episodes.empty:
            return "no run stored yet"
        seeds = self.episodes.groupby("agent").seed.nunique()
        low, high = seeds.min(), seeds.max()
        number = f"{low}" if low == high else f"{low} to {high}"
        runs = f"{number} run{'s' * bool(high > 1)} per agent"
        return runs if low > 2 else f"{runs}, so no statement about the algorithms"


class Study:
    """Experiments of a profile: study["boxing_final"] is its section.

    `names` are those of the experiments; None takes all that the report is about (`plan.ORDER`).
    `agents` and `seeds` take the place of each experiment's own.
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
            names = [path.stem for path in plan.files(profile) if path.stem in plan.ORDER]
        self.sections = {name: Section(name, profile, results_dir, agents, seeds) for name in names}
        own = results_folder("full").resolve()
        there = results_folder(profile, results_dir).resolve()
        self._whole = agents is None and seeds is None
        self._own = profile == "full" and there in (own, own / SNAPSHOT)

    def __getitem__(self, experiment: str) -> Section:
        if experiment not in self.sections:
            raise KeyError(f"{experiment!r} is not among the study's {', '.join(self.sections)}")
        return self.sections[experiment]

    @property
    def runs(self) -> list[Run]:
        return [run for section in self.sections.values() for run in section.runs]

    @property
    def held(self) -> bool:
        """Whether the numbers in the report's hand-written text must be those of these runs: it is
        about the project's own, at full length, all of them, and none damaged."""
        return self._own and self._whole and not self.damaged

    @property
    def damaged(self) -> dict[str, str]:
        return {
            name: said
            for section in self.sections.values()
            for name, said in section.damaged.items()
        }

    @property
    def stored(self) -> list[Run]:
        return [run for section in self.sections.values() for run in section.stored]


def hours(run: Run) -> float:
    """Hours by the clock, on one core, of the training behind the stored games."""
    return _last(run, tables.TIMING, "seconds") / 3600


def peak_megabytes(run: Run) -> float:
    """The most memory that a process which trained the run has ever held; 0 if none noted it."""
    sessions = run.provenance()["sessions"]
    return max(session.get("peak_memory_megabytes", 0.0) for session in sessions)


def on_gpu(run: Run) -> bool:
    """Whether a GPU trained any of its games, so that its hours are not those of one core."""
    return any(session["device"] != "cpu" for session in run.provenance()["sessions"])


def _machines(sessions: list[dict[str, Any]]) -> str:
    """What trained a run, one after the other, and where its checkpoint was made anew."""
    names = [
        "GPU beside " * (session["device"] != "cpu") + _as_text(_model(str(session["processor"])))
        for session in sessions
    ]
    restored = [
        f"; restored after game {session['restored_after']:,}"
        for session in sessions
        if "restored_after" in session
    ]
    return ", then ".join(dict.fromkeys(names)) + "".join(restored)


def _model(processor: str) -> str:
    """A processor's name without what every such name has: its maker, and that it is one."""
    rest = re.sub(r"\((R|TM)\)|\b(Intel|AMD|CPU|Processor|\d+-Core)\b|@ [\d.]+GHz", "", processor)
    return " ".join(rest.split()) or processor


def _last(run: Run, file: str, column: str) -> float:
    table = tables.read(run.folder, file)
    return 0.0 if table.empty else float(table[column].iloc[-1])


def comparable(runs: list[Run]) -> pd.DataFrame:
    """A row per training game of some runs, of one experiment or of several: `training.Episode`,
    experiment, agent, seed, and `label`, by which a curve tells itself from the others: what is
    not the same of all, of experiment, agent and changes."""
    runs = [run for run in runs if run.state() not in (MISSING, STALE)]
    experiments, agents = {run.experiment for run in runs}, {run.agent for run in runs}
    found = []
    for run in runs:
        parts = {
            run.experiment: len(experiments) > 1,
            params.title(run.agent): len(agents) > 1,
            run.variation: bool(run.variation),
        }
        label = ", ".join(part for part, told in parts.items() if told) or "as in its file"
        found.append(tables.of_runs([run], tables.EPISODES).assign(label=label))
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


def run_table(runs: list[Run]) -> pd.DataFrame:
    """A row per stored run: state, games, agent steps, hours, resumes, commits, hash."""
    rows = []
    for run in runs:
        state = run.state()
        if state == MISSING:
            continue
        stored = run.provenance()
        commits = list(dict.fromkeys(_short(each["commit"]) for each in stored["sessions"]))
        if len(commits) > 2:  # all of them are in its provenance.json
            commits = [commits[0], "…", f"{commits[-1]} ({len(commits)} in all)"]
        training = state in (RUNNING, INTERRUPTED)
        rows.append(
            {
                "experiment": f"`{run.experiment}`{run.title.removeprefix(run.experiment)}",
                "agent": params.title(run.agent),
                "seed": run.seed,
                "state": "unfinished" if training else state,
                "games": f"{run.status()['episodes_done']:,}",
                "agent steps": f"{_last(run, tables.EPISODES, 'agent_steps'):,.0f}",
                "hours": hours(run),
                "resumes": stored["resumes"],
                "trained on": _machines(stored["sessions"]),
                "commits": ", ".join(commits),
                "hash": _code(stored["identity"]),
            }
        )
    columns = ["experiment", "agent", "seed", "state", "games", "agent steps", "hours", "resumes"]
    return pd.DataFrame(rows, columns=[*columns, "trained on", "commits", "hash"])


def _some(counts: pd.Series) -> pd.Series:
    """Counts to divide by: nan for none."""
    return counts.where(counts > 0)


def _short(commit: str) -> str:
    """A commit's first digits, with a + if files differed from it."""
    return _code(commit, "+" * commit.endswith("+"))


def _code(digits: str, more: str = "") -> str:
    """The first eight of some digits in Markdown, whatever else has been put in their place."""
    return f"`{re.sub(r'[^a-z0-9+]', '?', digits[:8])}{more}`"


def _as_text(stored: object) -> str:
    """Something stored as Markdown that shows it as it is: files from elsewhere may hold markup."""
    line = " ".join(str(stored).split())
    return re.sub(r"[^A-Za-z0-9 ().,:/+-]", lambda odd: f"&#{ord(odd[0])};", line)
