"""Units of the last hidden layer that are silent: zero in every state of a game, so without a part
in its values, and without a gradient in its states (Sokar et al., 2023, call them dormant)."""

import numpy as np
import pandas as pd
from torch import nn

from atari_dqn import params
from atari_dqn.analysis.study import Section
from atari_dqn.report.neighbours import features
from atari_dqn.report.outputs import show_placeholders, show_table
from atari_dqn.report.saliency import first_game
from atari_dqn.runs import models


def silent(network: nn.Module, observations: np.ndarray) -> float:
    """Their share in per cent, in observations uint8 [N, 84, 84, S]."""
    return 100 * float((features(network, observations) == 0).all(axis=0).mean())


def show_silent(starts: dict[str, Section]) -> pd.DataFrame:
    """Of every stored network of several experiments in one game, by what they start from; returns
    the table. The game is the first of the first experiment that has been evaluated."""
    first, *_ = starts.values()
    label = f"tbl-{first.slug}-silent"
    rows = list[dict[str, object]]()
    if (game := first_game(first)) is None:
        show_placeholders(label)
        return pd.DataFrame(rows)
    player, seen = game
    runs = [(start, run) for start, section in starts.items() for run in section.usable]
    order = first.params.agents.index
    for start, run in sorted(runs, key=lambda one: order(one[1].agent)):
        heading = {"agent": params.title(run.agent), "start": start}
        if len(first.params.seeds) > 1:
            heading["seed"] = str(run.seed)
        for games, network in models.along_training(run):
            rows.append(heading | {"games": games, "silent, %": silent(network, seen)})
    show_table(
        pd.DataFrame(rows),
        label=label,
        caption="Units of the last hidden layer that are zero in every state of one game, "
        f"{params.title(player.agent)}'s first evaluation game in {first.facts.title}, after so "
        "many training games.",
        decimals=1,
    )
    return pd.DataFrame(rows)
