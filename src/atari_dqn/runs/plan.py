"""The runs that the parameter files ask for, and how far they have come."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from atari_dqn import params
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.runs import checkpoints, tables
from atari_dqn.runs.files import RunError, project_root, results_folder
from atari_dqn.runs.run import COMPLETE, FAILED, INTERRUPTED, STALE, Run, runs_of

# The order of training and of the report; experiments that are not listed come last.
ORDER = (
    *("boxing_final", "breakout_final", "breakout_late", "boxing_expert", "boxing_early"),
    *("breakout_early", "boxing_low_gamma", "boxing_high_gamma", "boxing_transfer"),
    *("boxing_sensitivity", "boxing_transfer_controls", "boxing_hardest"),
    *("boxing_multi_step", "breakout_multi_step"),
)
WAITING = "waiting"  # what `status` says of a run whose source is not complete
DAMAGED = "damaged"  # and of one whose files cannot be read
PACE_GAMES = 100  # of the last games, by which the time left is told


def files(profile: str) -> list[Path]:
    """The parameter files of a profile, in the order in which their runs are trained.

    Raises ParameterError on an unknown profile.
    """
    params.check_profile(profile)
    folder = project_root() / "params"
    found = (folder if profile == "full" else folder / profile).glob("*.yaml")
    rank = {name: place for place, name in enumerate(ORDER)}
    return sorted(found, key=lambda path: (rank.get(path.stem, len(rank)), path.stem))


def file(name: str, profile: str) -> Path:
    """The parameter file of an experiment. Raises ParameterError if there is none."""
    available = {path.stem: path for path in files(profile)}
    if name not in available:
        why = params.hint(name, available)
        raise ParameterError(f"experiment {params.shown(name)} is not allowed: {why}")
    return available[name]


def planned(
    profile: str, names: list[str], results: Path | str | None
) -> tuple[list[Run], list[str]]:
    """Every run of the named experiments, in that order, or of all; and of all, a line for each
    whose file is bad, which stops no other.

    Raises ParameterError if that of a named one is, or if there is none of that name.
    """
    chosen = [file(name, profile) for name in dict.fromkeys(names)] or files(profile)
    wanted: list[Run] = []
    refused: list[str] = []
    for path in chosen:
        try:
            wanted += _runs(path, profile, results_folder(profile, results))
        except ParameterError as error:
            if names:
                raise
            refused.append(str(error))
    return wanted, refused


def _runs(path: Path, profile: str, folder: Path) -> list[Run]:
    """The runs that a file asks for. Raises ParameterError, also if one is to start from another
    experiment's model that is neither stored nor planned."""
    found = runs_of(params.load(path), folder)
    for run in found:
        source = run.params.initial_weights
        if source and not (folder / "runs" / source).exists():
            available = [path.stem for path in files(profile)]
            if source not in available:
                raise ParameterError(
                    f"{path}: initial_weights: {source!r} is not allowed: no such run is stored "
                    f"in {folder / 'runs'}, and no such experiment is in params/; "
                    + params.hint(source, available)
                )
    return found


def known(
    profile: str, names: list[str], results: Path | str | None
) -> tuple[list[Run], list[str]]:
    """Every run there is to see, of the named experiments or of all: those that the files ask for,
    and then the stored ones that no file asks for (with changed parameters, which are their
    `variation`; of other seeds; of an experiment without a file). And a line for each file that
    cannot be read.

    Raises ParameterError on a name of nothing, or if the file of a named one is bad.
    """
    everything, refused = planned(profile, [], results)
    folder = results_folder(profile, results)
    others, damaged = _besides(profile, names, folder, {run.folder for run in everything})
    if names:
        of_files = {path.stem for path in files(profile)}
        without = {run.experiment for run in others} - of_files
        asked = [name for name in names if name not in without]
        everything, refused = planned(profile, asked, results) if asked else ([], [])
    return everything + others, refused + damaged


def _besides(
    profile: str, names: list[str], folder: Path, asked_for: set[Path]
) -> tuple[list[Run], list[str]]:
    """The stored runs whose folders are not among those asked for, in the experiments' order, and
    a line for each whose parameters cannot be read."""
    found, damaged = [], []
    for path in sorted((folder / "runs").glob(f"*/*/seed-*/{params.STORED}")):
        experiment, _, change = path.parents[2].name.partition("+")
        elsewhere = path.parent in asked_for or "." in path.parent.name  # kept aside
        if elsewhere or (names and experiment not in names):
            continue
        try:
            stored = params.stored_parameters(path.parent)
            run = Run(stored, folder, _changes(stored, profile) if change else "")
        except ParameterError as error:
            damaged.append(str(error))
            continue
        if run.folder == path.parent and stored.profile == profile:  # else it is a copy
            found.append(run)
    order = [path.stem for path in files(profile)]
    order += [run.experiment for run in found]
    found.sort(key=lambda run: order.index(run.experiment))
    return found, damaged


def _changes(changed: Parameters, profile: str) -> str:
    """How the parameters of a stored run differ from those of its experiment's file: "gamma 0.5,
    batch size 64"; the hash in their name if that cannot be told."""
    name, _, digest = changed.experiment.partition("+")
    try:
        base = params.load(file(name, profile))
    except ParameterError:  # no file, or a bad one, which `planned` tells
        return f"+{digest}"
    same = (params.NOT_VARIANT - {"episodes"}) | params.EVALUATED_BESIDES
    different = [
        f"{key.replace('_', ' ')} {value if isinstance(value, str) else json.dumps(value)}"
        for key, value in changed.model_dump(exclude=same).items()
        if value != getattr(base, key)
    ]
    return ", ".join(different) or f"+{digest}"  # the file says the same by now


def stored(profile: str, names: list[str], results: Path | str | None = None) -> list[Run]:
    """Those of the `known` runs of which something is stored. What cannot be read is left out, and
    `damaged` names it."""
    runs, _ = known(profile, names, results)
    return [run for run in runs if _is_stored(run) and not tables.damage(run)]


def damaged(profile: str, names: list[str], results: Path | str | None = None) -> list[str]:
    """A line for each of the stored runs that cannot be read."""
    runs, refused = known(profile, names, results)
    return refused + [said for run in runs if _is_stored(run) and (said := tables.damage(run))]


def _is_stored(run: Run) -> bool:
    return (run.folder / params.STORED).exists()


def status(wanted: list[Run]) -> pd.DataFrame:
    """One row per run: experiment (and variation), agent, seed, state, games (done), episodes
    (wanted), score (mean of the last 100 games), hours_left (of one core, at the pace of the last
    100 games; of a run that has none, at the mean pace of the game's other runs; else nan)."""
    rows = []
    for run in wanted:
        stale = False
        try:
            state, stale = _said(run), run.state() == STALE
            damage = "" if stale else tables.damage(run)
        except (RunError, ParameterError) as error:
            damage = str(error)
        if damage:
            state = f"{DAMAGED} ({damage})"
        readable = [] if stale or damage else [run]
        episodes = tables.of_runs(readable, tables.EPISODES)
        recent = episodes.tail(PACE_GAMES)
        rows.append(
            {
                "experiment": run.title,
                "agent": run.agent,
                "seed": run.seed,
                "state": state,
                "games": len(episodes),
                "episodes": run.params.episodes,
                "score": recent.score.mean() if len(episodes) else np.nan,
                "game": run.params.game,
                "longest": run.params.max_game_frames,
                "pace": _pace(run) if readable else np.nan,
            }
        )
    table = pd.DataFrame(rows)
    pace = table.pace.fillna(table.groupby(["game", "longest"]).pace.transform("mean"))
    table["hours_left"] = (table.episodes - table.games).clip(lower=0) * pace / 3600
    table.loc[table.state == COMPLETE, "hours_left"] = 0.0
    return table.drop(columns=["game", "longest", "pace"])


def _said(run: Run) -> str:
    """A run's state, and what stands in its way. Raises RunError if what is stored is damaged."""
    state, source = run.state(), run.waits_for()
    if source is not None:
        return f"{WAITING} for {source.params.experiment}"
    if state in (INTERRUPTED, FAILED) and not checkpoints.exist(run.state_folder):
        return f"{state} (no checkpoint here: restore or --restart)"
    if state == FAILED:
        return params.printable(f"{state} ({run.status().get('error', 'no reason stored')})")
    return state


def _pace(run: Run) -> float:
    """Seconds a game took of late; nan if too few have been played to tell."""
    timing = tables.read(run.folder, tables.TIMING).tail(PACE_GAMES + 1)
    if len(timing) < 2:
        return np.nan
    return (timing.seconds.iloc[-1] - timing.seconds.iloc[0]) / (len(timing) - 1)


def summary(table: pd.DataFrame) -> str:
    """The totals of a `status` table in one line."""
    states = table.state.str.split().str[0].value_counts()  # "waiting for ..." is one
    done, all_games = table[["games", "episodes"]].min(axis=1).sum(), table.episodes.sum()
    listed = ", ".join(f"{count} {state}" for state, count in states.items())
    share = f"{done:,} of {all_games:,} games ({done / all_games:.0%})"
    return f"{_count(len(table))}: {listed}; {share}; {_left(table)}"


def _left(table: pd.DataFrame) -> str:
    unknown, known = table[table.hours_left.isna()], table[table.hours_left > 0]
    if unknown.empty and known.empty:
        return "nothing left to train"
    if known.empty:
        return "how long it takes shows when the first games have been played"
    hours = f"about {known.hours_left.sum():,.1f} core-hours left"
    if unknown.empty:
        return hours
    whose = _count(len(unknown), "other run")
    return f"{hours}, and {whose} whose pace is not known yet"


def _count(number: int, what: str = "run") -> str:
    return f"{number} {what}{'s' * (number != 1)}"
