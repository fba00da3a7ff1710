"""Evaluating a stored run: its model plays, and its folder remembers the games."""

import os
from pathlib import Path
from typing import Any

import pandas as pd
from tqdm import tqdm

from atari_dqn import evaluation
from atari_dqn.evaluation import EvaluationEpisode
from atari_dqn.runs import models, records, tables
from atari_dqn.runs.files import RunError, evaluations_lock, write_atomically
from atari_dqn.training import prepare_process


def evaluate(folder: Path, overrides: dict[str, Any], games: int | None = None) -> pd.DataFrame:
    """Plays a stored run's model, stores the games in its evaluations.csv and returns them.

    `overrides` replace parameters of the run (difficulty, sticky_actions, evaluation_epsilon).
    Raises RunError, RecordError or ParameterError on bad input.
    """
    prepare_process()
    network, parameters = models.stored_agent(folder, overrides)
    if not os.access(folder, os.W_OK):
        raise RunError(f"{folder} cannot be written to, and is where the games are stored")
    # Lest games are played that cannot be added to a damaged file
    tables.read(folder, tables.EVALUATIONS)
    if (folder / records.FILE).exists():
        records.read_file(folder)
    games = games or parameters.evaluation_games
    seed, trained = parameters.seeds[0], models.trained_games(folder / "model.safetensors")
    player = evaluation.player_of(network, parameters)
    playing = evaluation.play(player, parameters, games, seed)
    played = list(tqdm(playing, total=games, desc="evaluating", unit="game", mininterval=2))
    store_evaluation(folder, played, trained)
    table = pd.DataFrame([game.row() for game in played])
    return table.sort_values("game", ignore_index=True)


def store_evaluation(folder: Path, played: list[EvaluationEpisode], trained_games: int) -> None:
    """Adds games of a model, after so many games of training, to evaluations.csv and to the games
    on record, in the place of the same games of the same model and settings."""
    path, recorded = folder / tables.EVALUATIONS, folder / records.FILE
    table = pd.DataFrame([game.row() for game in played])
    table["trained_games"] = trained_games
    with evaluations_lock(folder):
        if path.exists():
            table = pd.concat([tables.read(folder, tables.EVALUATIONS), table])
        table = table.drop_duplicates([*tables.SETTINGS, "game"], keep="last")
        before = records.read_file(folder) if recorded.exists() else []
        games = [(_heading(game, trained_games), game.record) for game in played]
        write_atomically(recorded, records.with_evaluations(before, games))
        table = table.sort_values([*tables.SETTINGS, "game"])
        write_atomically(path, table.to_csv(index=False).encode())


def _heading(game: EvaluationEpisode, trained_games: int) -> records.Heading:
    """What tells a game from all others of its run."""
    settings = ("difficulty", "sticky_actions", "epsilon", "seed", "game")
    named = {key: getattr(game, key) for key in settings}
    return {"kind": records.EVALUATION, "trained_games": trained_games, **named}
