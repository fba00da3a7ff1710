"""The runs that the parameter files ask for, and how far they have come."""

from pathlib import Path

import numpy as np
import pandas as pd

from atari_dqn import params
from atari_dqn.params import ParameterError
from atari_dqn.runs import checkpoints
from atari_dqn.runs.files import RunError, project_root, results_folder
from atari_dqn.runs.run import COMPLETE, FAILED, INTERRUPTED, STALE, Run, read_table, runs_of

# The order of training and of the report; experiments that are not listed come last.
ORDER = (
    *("boxing_final", "breakout_final", "breakout_late", "boxing_expert", "boxing_early"),
    *("breakout_early", "boxing_low_gamma", "boxing_high_gamma", "boxing_transfer"),
    *("boxing_sensitivity", "boxing_transfer_controls"),
)
WAITING = "waiting"  # what `status` says of a run whose source is not complete
DAMAGED = "damaged"  # and of one whose files cannot be read
PACE_GAMES = 100  # of the last games, by which the time left is told


def files(profile: str) -> list[Path]:
    """The parameter files of a profile, in the order in which their runs are trained.

    Raises ParameterError on an unknown profile.
    """
    if profile not in params.PROFILES:
        allowed = ", ".join(params.PROFILES)
        raise ParameterError(f"profile: {profile!r} is not allowed: must be one of {allowed}")
    folder = project_root() / "params"
    found = (folder if profile == "full" else folder / profile).glob("*.yaml")
    rank = {name: place for place, name in enumerate(ORDER)}
    return sorted(found, key=lambda path: (rank.get(path.stem, len(rank)), path.stem))


def planned(profile: str, names: list[str], results: Path | None) -> list[Run]:
    """Every run of the named experiments, in that order, or of all.

    Raises ParameterError on an unknown name, also of an experiment to start from.
    """
    available = {path.stem: path for path in files(profile)}
    for name in names:
        if name not in available:
            raise ParameterError(
                f"experiment {name!r} is not allowed: must be one of {', '.join(available)}"
            )
    chosen = [params.load(available[name]) for name in dict.fromkeys(names or available)]
    folder = results_folder(profile, results)
    wanted = [run for parameters in chosen for run in runs_of(parameters, folder)]
    for run in wanted:
        source = run.params.initial_weights
        if source and source not in available and not (folder / "runs" / source).exists():
            raise ParameterError(
                f"{run.params.experiment}: initial_weights: {source!r} is not allowed: must be "
                f"stored in {folder / 'runs'} or one of {', '.join(available)}"
            )
    return wanted


def status(wanted: list[Run]) -> pd.DataFrame:
    """One row per run: experiment (and variation), agent, seed, state, games (done), episodes
    (wanted), score (mean of the last 100 games), hours_left (of one core, at the pace of the last
    100 games; of a run that has none, at the mean pace of the game's other runs; else nan)."""
    rows = []
    for run in wanted:
        try:
            state, stale = _said(run), run.state() == STALE
        except RunError as error:
            state, stale = f"{DAMAGED} ({error})", False
        episodes = read_table([] if stale else [run], "episodes.csv")
        recent = episodes.tail(PACE_GAMES)
        rows.append(
            {
                "experiment": _title(run),
                "agent": run.agent,
                "seed": run.seed,
                "state": state,
                "games": len(episodes),
                "episodes": run.params.episodes,
                "score": recent.score.mean() if len(episodes) else np.nan,
                "game": run.params.game,
                "pace": np.nan if stale else _pace(run),
            }
        )
    table = pd.DataFrame(rows)
    pace = table.pace.fillna(table.groupby("game").pace.transform("mean"))
    table["hours_left"] = (table.episodes - table.games).clip(lower=0) * pace / 3600
    table.loc[table.state == COMPLETE, "hours_left"] = 0.0
    return table.drop(columns=["game", "pace"])


def _said(run: Run) -> str:
    """A run's state, and what stands in its way. Raises RunError if what is stored is damaged."""
    state, source = run.state(), run.waits_for()
    if source is not None:
        return f"{WAITING} for {source.params.experiment}"
    if state in (INTERRUPTED, FAILED) and not checkpoints.exist(run.state_folder):
        return f"{state} (no checkpoint here: --restart)"
    if state == FAILED:
        return f"{state} ({run.status().get('error', 'no reason stored')})"
    return state


def _title(run: Run) -> str:
    experiment = run.params.experiment.partition("+")[0]
    return f"{experiment}: {run.variation}" if run.variation else experiment


def _pace(run: Run) -> float:
    """Seconds a game took of late; nan if too few have been played to tell."""
    timing = read_table([run], "timing.csv").tail(PACE_GAMES + 1)
    if len(timing) < 2:
        return np.nan
    return (timing.seconds.iloc[-1] - timing.seconds.iloc[0]) / (len(timing) - 1)


def summary(table: pd.DataFrame) -> str:
    """The totals of a `status` table in one line."""
    states = table.state.str.split().str[0].value_counts()  # "waiting for ..." is one
    done, all_games = table[["games", "episodes"]].min(axis=1).sum(), table.episodes.sum()
    hours, unknown = table.hours_left.sum(), table.hours_left.isna().sum()
    left = f"{hours:,.1f} core-hours left"
    if unknown:
        left += f", and {unknown} runs whose pace is not known yet"
    listed = ", ".join(f"{count} {state}" for state, count in states.items())
    share = f"{done:,} of {all_games:,} games ({done / all_games:.0%})"
    return f"{len(table)} runs: {listed}; {share}; about {left}"
