"""How an agent boxes, read from the console's memory: near or far, and what it gives and takes."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from torch import nn

from atari_dqn import evaluation, runs
from atari_dqn.evaluation import Table
from atari_dqn.exhibits import hold_places, show_table
from atari_dqn.params import Parameters
from atari_dqn.ramtrace import BOXERS, points
from atari_dqn.sections import Section

GAMES = 4  # whole games that each model plays
FRAMES_A_MINUTE = 60 * 60


def measure(network: nn.Module, params: Parameters, games: int, seed: int) -> dict[str, float]:
    """Means over greedy games: the boxers' distance (pixels), and points a minute of play."""
    agent, computer = BOXERS.values()
    distances: list[float] = []
    scores: dict[int, tuple[int, int]] = {}  # of each game, both boxers', as they were last seen

    def watch(table: Table) -> None:
        memory = table.emulator.ram().tolist()
        offset = (memory[agent.x] - memory[computer.x], memory[agent.y] - memory[computer.y])
        distances.append(float(np.hypot(*offset)))
        scores[table.game] = (points(memory[agent.score]), points(memory[computer.score]))

    for _ in evaluation.play(network, params, games, seed, watch):
        pass
    minutes = len(distances) * params.frame_skip / FRAMES_A_MINUTE
    scored, conceded = np.sum(list(scores.values()), axis=0)
    return {
        "distance": float(np.mean(distances)),
        "scored": float(scored / minutes),
        "conceded": float(conceded / minutes),
    }


def show(sections: Iterable[Section], label: str) -> None:
    """A row for the newest model of every run in `sections`, and one for random play."""
    rows: list[dict[str, Any]] = []
    for section in sections:
        for run in section.usable:
            models = run.models()
            if not models:
                continue
            newest = max(models)
            network = evaluation.load_model(models[newest], run.params)
            if not rows:
                guessing = run.params.model_copy(update={"evaluation_epsilon": 1.0})
                rows.append(_row("random play", np.nan, 0, network, guessing, run.seed))
            gamma = run.params.gamma
            rows.append(_row(runs.title(run.agent), gamma, newest, network, run.params, run.seed))
    if not rows:
        hold_places(label)
        return
    show_table(
        pd.DataFrame(rows),
        label=label,
        caption=f"How the agents box, in {GAMES} greedy games each: the mean distance of the two "
        "boxers in pixels, and the points a minute that the agent scores and concedes, from the "
        "console's memory (@tbl-punches).",
    )


def _row(
    who: str, gamma: float, trained: int, network: nn.Module, params: Parameters, seed: int
) -> dict[str, Any]:
    found = measure(network, params, GAMES, seed)
    return {
        "agent": who,
        "discount": "–" if np.isnan(gamma) else f"{gamma:g}",
        "games of training": trained,
        **{name: round(value, 1) for name, value in found.items()},
    }
