"""How agents box, from their greedy games: near or far, and what they give and take."""

from collections.abc import Iterable
from typing import Any

import pandas as pd

from atari_dqn import runs
from atari_dqn.exhibits import show_absent, show_table
from atari_dqn.sections import Section
from atari_dqn.statistics import with_interval


def show(sections: Iterable[Section], label: str) -> None:
    """A row an evaluated run: points scored and conceded a minute, and the boxers' distance."""
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
                ("scored_a_minute", "points scored"),
                ("conceded_a_minute", "points conceded"),
                ("distance", "distance (pixels)"),
            ):
                row[name] = with_interval(games[column].to_numpy())
            rows.append(row)
    if not rows:
        show_absent(label, "A table of play styles follows when an agent has been evaluated.")
        return
    show_table(
        pd.DataFrame(rows),
        label=label,
        caption="How the agents box in the greedy games of their evaluation: points a minute, and "
        "the mean distance of the two boxers, with bootstrap intervals over games.",
    )
