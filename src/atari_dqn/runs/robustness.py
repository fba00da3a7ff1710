"""Does an agent know its game, or a sequence of moves? Greedy games under conditions that it has
never met:

    sequence    the moves of its best evaluation game, made blindly in every other opening
    mirrored    left and right exchanged, in what it sees and in what it does
    field       the same, but in what it sees only in the ring, or between the walls
    bar_moved   a black bar at one edge of the screen, where there is one, seen at the other
    bar_gone    the same bar not seen at all
    scoreboard  score and clock, or lives, as in the first picture, in what it sees

Sticky actions, the third such condition, are a part of every final evaluation.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, fields
from functools import partial
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from tqdm import tqdm

from atari_dqn.envs import SIZE, AtariEnv, EpisodeRecord, make_env
from atari_dqn.games import GAMES
from atari_dqn.params import Parameters
from atari_dqn.runs import records, tables
from atari_dqn.runs.files import write_atomically
from atari_dqn.runs.run import COMPLETE, Run, as_trained

if TYPE_CHECKING:
    from atari_dqn.evaluation import Player

EXPERIMENTS = ("boxing_final", "breakout_final")  # whose agents are put to it
SEQUENCE, MIRRORED, FIELD, SCOREBOARD = "sequence", "mirrored", "field", "scoreboard"
BAR_MOVED, BAR_GONE = "bar_moved", "bar_gone"


@dataclass(frozen=True)
class Trial:
    """One game, a row of a run's file."""

    condition: str
    game: int  # of "sequence" the opening: the fewest idle frames that lead to it
    score: float  # points
    length: int  # agent steps
    trained_games: int  # behind the model


def measure(run: Run) -> None:
    """Plays a complete run's model under each condition that the run's file does not have yet, or
    not all games of, for this model. Raises RunError or RecordError if model or records cannot be
    read."""
    if run.state() != COMPLETE:
        return
    from atari_dqn.runs import models  # here: the report's tables are read without PyTorch

    model = run.folder / "model.safetensors"
    trained = models.trained_games(model)
    stored = tables.trials(run)
    columns = [field.name for field in fields(Trial)]
    table = (
        stored[stored.trained_games == trained] if len(stored) else pd.DataFrame(columns=columns)
    )
    conditions = {SEQUENCE: _sequence(run, trained)}
    conditions |= {name: _changed(run, trained, name) for name in views(run.params)}
    missing = [trials for name, trials in conditions.items() if name not in set(table.condition)]
    if not missing:
        return
    rows = [astuple(trial) for trials in missing for trial in trials]
    table = pd.DataFrame([*table.itertuples(index=False, name=None), *rows], columns=columns)
    run.robustness.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(run.robustness, table.to_csv(index=False).encode())


def _sequence(run: Run, trained: int) -> Iterator[Trial]:
    best = best_game(run, trained)
    facts = GAMES[run.params.game]
    shortest = {facts.opening(idle): idle for idle in range(run.params.noop_max, 0, -1)}
    shortest.pop(facts.opening(best.idle_frames), None)  # without no-op starts there is but one
    for idle in tqdm(sorted(shortest.values()), desc=f"blind games of {run.name}", mininterval=2):
        env, _ = records.begin(run.params, EpisodeRecord(idle, best.actions, None))
        play_blindly(env, best.actions)
        yield Trial(SEQUENCE, idle, env.score, env.length, trained)


def repeated_openings(run: Run, games: int, steps: int) -> float:
    """The share of a run's last training games that begin, by their opening and so many agent
    steps, exactly as another of them does. Raises RecordError if the records cannot be read."""
    recorded = [
        record
        for heading, record in records.read_file(run.folder, torn=True)
        if heading["kind"] == records.TRAINING
    ]
    opening = GAMES[run.params.game].opening
    openings = [
        (opening(record.idle_frames), record.actions[:steps]) for record in recorded[-games:]
    ]
    counts = Counter(openings)
    return sum(counts[opening] > 1 for opening in openings) / len(openings)


def best_game(run: Run, trained: int) -> EpisodeRecord:
    """The record of the model's evaluation game with the most points, as it was trained; of several
    the first. Raises RecordError if none is on record."""
    games = [
        (heading, record)
        for heading, record in records.as_trained(run.params, records.read_file(run.folder))
        if heading["trained_games"] == trained
    ]
    if not games:
        raise records.RecordError(f"{run.folder} has no evaluation game of its model on record")
    table = as_trained(tables.read(run.folder, tables.EVALUATIONS), run.params)
    table = table[table.trained_games == trained]
    best = table.sort_values("game").set_index("game").score.idxmax()
    return next(record for heading, record in games if heading["game"] == best)


def play_blindly(env: AtariEnv, moves: bytes) -> None:
    """Makes the moves one after the other, and from the first again, until the game is over."""
    for move in cycle(moves):
        _, _, terminated, truncated, _ = env.step(move)
        if terminated or truncated:
            return


def _changed(run: Run, trained: int, condition: str) -> Iterator[Trial]:
    from atari_dqn import evaluation
    from atari_dqn.runs import models

    network = models.load_model(run.folder / "model.safetensors", run.params)
    player = changed(evaluation.player_of(network, run.params), run.params, condition)
    games = run.params.evaluation_games
    playing = evaluation.play(player, run.params, games, run.seed)
    for game in tqdm(playing, total=games, desc=f"{condition}: {run.name}", mininterval=2):
        yield Trial(condition, game.game, game.score, game.length, trained)


def changed(player: "Player", params: Parameters, condition: str) -> "Player":
    """The player under a condition: it sees what the condition's view leaves, and where left is
    right its moves are made the other way round."""
    view = views(params)[condition]
    names = [action.name for action in make_env(params).actions]
    exchange = {"LEFT": "RIGHT", "RIGHT": "LEFT"} if condition in EXCHANGED else {}
    made = [re.sub("LEFT|RIGHT", lambda side: exchange.get(side[0], side[0]), n) for n in names]
    moves = [names.index(name) for name in made]
    return lambda observations: player(view(observations))[:, moves]


# ---- What is seen instead of observations, uint8 [games, height, width, stack] -------------------

View = Callable[[np.ndarray], np.ndarray]
EXCHANGED = (MIRRORED, FIELD)  # in which the moves are, too


def views(params: Parameters) -> dict[str, View]:
    """What is seen under each condition that there is in a game."""
    facts = GAMES[params.game]
    found: dict[str, View] = {
        MIRRORED: lambda observations: observations[:, :, ::-1].copy(),
        SCOREBOARD: _scoreboard_frozen(params),
    }
    if facts.field is not None:
        found[FIELD] = partial(_field_mirrored, *facts.field)
    if facts.bar is not None:
        found |= {
            BAR_MOVED: partial(_bar_moved, facts.bar),
            BAR_GONE: partial(_bar_gone, facts.bar),
        }
    return found


def _field_mirrored(rows: slice, columns: slice, observations: np.ndarray) -> np.ndarray:
    """Only the field, in which alone something moves, is exchanged."""
    seen = observations.copy()
    seen[:, rows, columns] = observations[:, rows, columns][:, :, ::-1]
    return seen


def _bar_moved(bar: slice, observations: np.ndarray) -> np.ndarray:
    seen = observations[:, :, ::-1].copy()
    rest = slice(bar.stop, SIZE - bar.stop)
    seen[:, :, rest] = observations[:, :, rest]
    return seen


def _bar_gone(bar: slice, observations: np.ndarray) -> np.ndarray:
    """In its place is what lies at the other edge, where nothing ever changes."""
    seen = observations.copy()
    seen[:, :, bar] = observations[:, :, ::-1][:, :, bar]
    return seen


def _scoreboard_frozen(params: Parameters) -> View:
    """Score and clock, or lives, are seen as in a game's first picture."""
    rows = GAMES[params.game].scoreboard
    first = make_env(params).reset(seed=0)[0][:rows]

    def view(observations: np.ndarray) -> np.ndarray:
        seen = observations.copy()
        seen[:, :rows] = first[:, :, None]
        return seen

    return view
