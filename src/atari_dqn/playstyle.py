"""How agents box, from their greedy games: near or far, and what they give and take."""

from collections.abc import Iterable
from typing import Any

import pandas as pd

from atari_dqn import runs
from atari_dqn.exhibits import show_absent, show_table
from atari_dqn.sections import Section
from atari_dqn.statistics import interval


def show(sections: Iterable[Section], label: str) -> None:
    """A row a finished run: points scored and conceded a game, and the boxers' distance."""
    rows: list[dict[str, Any]] = []
    for section in sections:
        if section.evaluations.empty:
            continue
        for (agent, seed), games in section.evaluations.groupby(["agent", "seed"], sort=False):
            row = {
                "discount": f"{section.params.gamma:g}",
                "agent": runs.title(str(agent)),
                "seed": seed,
                "training games": int(games.trained_games.max()),
            }
            for column, name in (
                ("scored", "points scored"),
                ("conceded", "points conceded"),
                ("distance", "distance (pixels)"),
            ):
                low, high = interval(games[column].to_numpy())
                row[name] = f"{games[column].mean():.1f} ({low:.1f} to {high:.1f})"
            rows.append(row)
    if not rows:
        show_absent(label, "A table of play styles follows when an agent has been evaluated.")
        return
    show_table(
        pd.DataFrame(rows),
        label=label,
        caption="How the agents box in the greedy games of their evaluation: points a game, and "
        "the mean distance of the two boxers, with bootstrap intervals over games.",
    )
