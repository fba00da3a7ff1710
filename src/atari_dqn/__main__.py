"""The command line: python -m atari_dqn.

Each command imports what it needs, since PyTorch and all that draws take seconds.
"""

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import urlsplit

import typer

from atari_dqn import params
from atari_dqn.games import GAMES
from atari_dqn.params import ParameterError
from atari_dqn.runs.files import RunError, model_file, results_folder, write_atomically

if TYPE_CHECKING:
    from atari_dqn.runs.run import Run

app = typer.Typer(
    help="Train, evaluate and report on Deep Q-Networks that play Atari Boxing and Breakout.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
)
experiments_app = typer.Typer(
    help="See and train the runs that the parameter files ask for.", no_args_is_help=True
)
app.add_typer(experiments_app, name="experiments")

Results = Annotated[
    Path | None,
    typer.Option(help="Results folder; by default results/, or results/PROFILE/ of a profile."),
]
Profile = Annotated[str, typer.Option(help=f"One of {', '.join(params.PROFILES)}.")]
Restart = Annotated[
    bool,
    typer.Option(
        "--restart",
        help="Begin runs again that cannot be continued here (stale, or without their checkpoint); "
        "what is stored of them is kept beside.",
    ),
]
Names = Annotated[list[str] | None, typer.Argument(help="Experiments; all if none is named.")]


@contextmanager
def _interruptible() -> Iterator[None]:
    """Says that Ctrl-C did no harm."""
    try:
        yield
    except KeyboardInterrupt:
        print("interrupted; the same command continues", file=sys.stderr)
        raise typer.Exit(130) from None


def _back_up(wanted: "list[Run]") -> None:
    for run in wanted:
        aside = run.back_up()
        if aside is not None:
            print(f"{run.name} begins again; what was stored of it is kept in {aside}")


@contextmanager
def _followed(run: "Run", tensorboard: bool) -> Iterator[Callable[[], None]]:
    """What is to be called whenever a run has got on: for TensorBoard, or for nobody."""
    if not tensorboard:
        yield lambda: None
        return
    from atari_dqn.report.tensorboard import Board

    with closing(Board(run)) as board:
        yield board.update


@app.command()
def train(
    params_file: Annotated[Path, typer.Argument(help="An experiment's YAML file, see params/.")],
    agent: Annotated[
        str | None, typer.Option(help=f"Only this one: {', '.join(params.AGENT_NAMES)}.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Only this one; may be a new one.")] = None,
    results: Results = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a parameter; may be repeated."),
    ] = None,
    restart: Restart = False,
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Let TensorBoard follow: writes RUN/tensorboard/.")
    ] = False,
) -> None:
    """Train the runs of one experiment, or continue them; what is complete stays as it is.

    With --set the runs go to a folder of their own, never into the experiment's.
    """
    if tensorboard and find_spec("tensorboard") is None:
        raise ParameterError(
            "--tensorboard: that package is not installed; pip install -e .[tensorboard] adds it"
        )
    overrides = params.parse_overrides(set_ or [])
    chosen = params.pick(params.load(params_file, overrides), agent, seed)

    from atari_dqn.runs.run import runs_of

    wanted = runs_of(chosen, results_folder(chosen.profile, results))
    _back_up(wanted if restart else [])
    for folder in dict.fromkeys(run.folder.parents[1] for run in wanted):
        # before imports that take seconds
        print(f"results go to {params.printable(str(folder))}", file=sys.stderr)

    from atari_dqn.runs import recorder

    with _interruptible():
        for run in wanted:
            with _followed(run, tensorboard) as follow:
                print(recorder.train(run, follow=follow))


RunFolder = Annotated[Path, typer.Argument(help="A stored run's folder, .../seed-N.")]
Difficulty = Annotated[
    int | None, typer.Option(help="Switches: 1 slows the agent, 2 its rival, 3 both.")
]
Sticky = Annotated[
    float | None, typer.Option(help="Probability that the console repeats an action.")
]
Epsilon = Annotated[float | None, typer.Option(help="Probability of a random action.")]


@app.command()
def evaluate(
    run_dir: Annotated[Path, typer.Argument(help="A finished run's folder, .../seed-N.")],
    games: Annotated[
        int | None, typer.Option(min=1, max=params.MOST, help="By default the run's own.")
    ] = None,
    difficulty: Difficulty = None,
    sticky: Sticky = None,
    epsilon: Epsilon = None,
    video: Annotated[
        Path | None,
        typer.Option(help="Make a video of the first game, with the values of its actions."),
    ] = None,
) -> None:
    """Play whole games with a run's published model and store them in its evaluations.csv."""
    _writable(video)
    given = _conditions(run_dir, difficulty, sticky, epsilon)
    print(f"playing with {model_file(run_dir)}", file=sys.stderr)

    from atari_dqn.runs import evaluations

    played = evaluations.evaluate(run_dir, given, games)
    if video is not None:
        from atari_dqn.report import videos

        videos.write_game(run_dir, given, video)
    said = [f"{len(played)} game{'s' * (len(played) > 1)}: mean score {played.score.mean():.1f}"]
    facts = GAMES[params.stored_parameters(run_dir).game]
    if isfinite(facts.wins_at):
        said.append(f"{played.won.sum()} won")
    if facts.score_cells is not None:
        said.append(f"{(played.knockout == 1).sum()} by knock-out")
    print(", ".join(said))


def _conditions(
    run_dir: Path, difficulty: int | None, sticky: float | None, epsilon: float | None
) -> dict[str, Any]:
    """The parameters of a stored run that the command line changes. Raises ParameterError if they
    cannot be, or if the run has no model."""
    chosen = {
        "difficulty": difficulty,
        "sticky_actions": sticky,
        "evaluation_epsilon": epsilon,
    }
    given = {key: value for key, value in chosen.items() if value is not None}
    model_file(run_dir)
    params.stored_parameters(run_dir, given)
    return given


def _writable(path: Path | None, name: str = "--video", suffix: str = ".mp4") -> None:
    if path is not None and (path.suffix != suffix or not path.resolve().parent.is_dir()):
        raise ParameterError(f"{name} {str(path)!r}: expected FILE{suffix} in a folder that exists")


@app.command()
def watch(
    run_dir: RunFolder,
    games: Annotated[int, typer.Option(min=1, max=params.MOST, help="How many.")] = 1,
    difficulty: Difficulty = None,
    sticky: Sticky = None,
    epsilon: Epsilon = None,
    video: Annotated[
        Path | None,
        typer.Option(help="Make a video of what is played; named after the run without a display."),
    ] = None,
) -> None:
    """Watch a run's published model play, in a window; nothing is stored in its folder.

    The games are the first of those that `evaluate` plays.
    """
    _writable(video)
    given = _conditions(run_dir, difficulty, sticky, epsilon)
    print(f"playing with {model_file(run_dir)}", file=sys.stderr)

    from atari_dqn.report.watch import watch

    watch(run_dir, given, games, video)


@app.command()
def replay(
    run_dir: RunFolder,
    episode: Annotated[int, typer.Option(min=1, max=params.MOST, help="The training game.")],
    video: Annotated[Path | None, typer.Option(help="Make a video of it.")] = None,
) -> None:
    """Play a training game again from its record."""
    _writable(video)

    from atari_dqn.runs import audit, records

    parameters = params.stored_parameters(run_dir)
    record = audit.find(run_dir, episode)
    facts = audit.outcome(parameters, record)
    print(
        f"game {episode}: {facts['score']:g} points, {facts['length']:.0f} agent steps, "
        f"{facts['frames']:.0f} frames",
        flush=True,
    )
    if video is not None:
        from atari_dqn.report.video import television

        write_atomically(video, television(records.replay(parameters, record)))


@app.command()
def restore(run_dir: RunFolder) -> None:
    """Make a lost checkpoint again from a run's games, tables and model, to train on from."""
    model_file(run_dir)  # raises before imports that take seconds

    from atari_dqn.runs.restore import restore as restored

    print(f"{run_dir} has a checkpoint of game {restored(run_dir)}; `train` goes on from there")


@app.command()
def export(
    run_dir: RunFolder,
    path: Annotated[Path, typer.Argument(help="The .npz file to write.")],
    first: Annotated[
        int, typer.Option(min=1, max=params.MOST, help="The first training game.")
    ] = 1,
    last: Annotated[int, typer.Option(min=1, max=params.MOST, help="The last one.")] = 10,
) -> None:
    """Write training games as arrays to learn from offline: images, actions, rewards."""
    _writable(path, "path", ".npz")

    from atari_dqn.runs import dataset

    games = dataset.export(run_dir, first, last, path)
    print(f"{path}: {games} game{'s' * (games != 1)}")


def _all_stored(profile: str, results: Path | None) -> tuple[list[Path], list[ParameterError]]:
    """The folders of all stored runs, and why some of them, or their files, cannot be read. Raises
    RunError if there is none."""
    from atari_dqn.runs import plan

    runs, refused = plan.known(profile, [], results)
    found = [run.folder for run in runs if (run.folder / params.STORED).exists()]
    if not found and not refused:
        raise RunError(f"no run is stored in {results_folder(profile, results) / 'runs'}")
    return found, [ParameterError(line) for line in refused]


@app.command()
def verify(
    run_dirs: Annotated[
        list[Path] | None,
        typer.Argument(help="Stored runs' folders, .../seed-N; all if none is named."),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            min=1, max=params.MOST, help="How many games of a run, evenly spaced; 20 by default."
        ),
    ] = None,
    everything: Annotated[
        bool,
        typer.Option("--all", help="All games, the greedy ones behind values.csv too: an hour."),
    ] = False,
    results: Results = None,
    profile: Profile = "full",
) -> None:
    """Play games of runs again and compare them with their tables, a line per run.

    Exits with 1 if one is damaged or differs from its records, else with 2 if a file of parameters
    cannot be read; the others are compared all the same.
    """
    if everything and episodes is not None:
        raise ParameterError("--episodes: --all plays every game; leave out one of the two")
    if run_dirs and (results is not None or profile != "full"):
        raise ParameterError("--results, --profile: they choose among all runs; name runs, or none")
    failures: list[int] = []
    if not run_dirs:
        run_dirs, refused = _all_stored(profile, results)
        failures += map(_tell, refused)

    from tqdm import tqdm

    from atari_dqn.runs import audit

    for run_dir in run_dirs:
        checked = audit.verify(run_dir, None if everything else episodes or 20)
        # after a second, in which what cannot be read is refused
        bar = tqdm(checked, desc="verifying", unit="game", mininterval=2, leave=False, delay=1)
        try:
            count = sum(1 for _ in bar)
        except (ParameterError, RunError, OSError) as error:
            failures.append(_tell(error))
        else:
            some = "" if everything else f" of {audit.choice(run_dir):,}"
            games = f"{count:,}{some} game{'s' * (count != 1 or bool(some))}"
            print(f"{run_dir}: {games} played again, all as the tables say")
    if failures:
        raise typer.Exit(min(failures))


@experiments_app.command()
def status(names: Names = None, results: Results = None, profile: Profile = "full") -> None:
    """Show every run: complete, running, interrupted, failed, missing or stale.

    Those that no file asks for, such as runs with changed parameters, come last. Exits with 2 if a
    file cannot be read; what the others hold is shown all the same.
    """
    import pandas as pd
    from tabulate import tabulate

    from atari_dqn.runs import plan

    runs, refused = plan.known(profile, names or [], results)
    if runs:
        table = plan.status(runs)
        shown = pd.DataFrame(
            {
                "experiment": table.experiment,
                "agent": table.agent,
                "seed": table.seed,
                "state": table.state,
                "games": table.games.astype(str) + "/" + table.episodes.astype(str),
                "score": table.score.round(1),
                "hours left": table.hours_left.round(1),
            }
        )
        shown = shown.astype(object).where(shown.notna(), None)
        print(
            tabulate(shown, headers="keys", showindex=False, missingval="-", disable_numparse=[4])
        )
        print(plan.summary(table))
    for line in refused:
        print(f"error: {line}", file=sys.stderr)
    if refused:
        raise typer.Exit(2)


@experiments_app.command()
def run(
    names: Names = None,
    results: Results = None,
    profile: Profile = "full",
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Runs at once; by default one a core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Train on this Dask scheduler's workers."),
    ] = None,
    restart: Restart = False,
) -> None:
    """Train what is missing or interrupted, several runs at once."""
    if scheduler is not None and workers is not None:
        raise ParameterError("--workers: a cluster has its own; leave it out with --scheduler")
    if scheduler is not None and not _is_address(scheduler):
        raise ParameterError(f"--scheduler {params.shown(scheduler)}: expected tcp://HOST:PORT")

    from atari_dqn.runs import plan

    wanted, refused = plan.planned(profile, names or [], results)
    _back_up(wanted if restart else [])
    with _interruptible():
        if scheduler is None:
            from atari_dqn.runs.scheduler import train_all

            failures = train_all(wanted, workers)
        else:
            from atari_dqn.runs import cluster

            failures = cluster.train_all(wanted, scheduler)
    if failures + refused:
        raise RunError("\n".join(failures + refused))


def _is_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
        return bool(parts.scheme and parts.hostname and parts.port)
    except ValueError:  # no such port
        return False


@app.command(name="report")
def report_(profile: Profile = "full", results: Results = None) -> None:
    """Render the report from the stored runs; quick and smoke train their small runs first."""
    params.check_profile(profile)  # before imports that take seconds
    from atari_dqn.report import build

    with _interruptible():
        print(f"report: {build.build(profile, results)}/index.html and report.pdf")


def main() -> None:
    """Runs the command line; what a user can mend is one line on stderr, not a traceback."""
    warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except typer.TyperException as error:  # a wrong command line; without any, the help
        said = error.format_message()
        if not said.startswith("Usage:"):
            said = f"error: {params.printable(said)}"
        print(said, file=sys.stderr)
        sys.exit(2)
    except (ParameterError, RunError, OSError) as error:
        sys.exit(_tell(error))


def _tell(error: Exception) -> int:
    """Says on stderr, in one line, what a user can mend; returns the exit status. Raises an OSError
    of no file again."""
    said = str(error)
    if isinstance(error, OSError):
        if error.filename is None:
            raise error
        said = params.printable(f"{error.filename}: {error.strerror}")
    print(f"error: {said}", file=sys.stderr)
    return 1 if isinstance(error, RunError) else 2


if __name__ == "__main__":
    main()
