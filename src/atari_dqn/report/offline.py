"""A run's records as data: what they hold, how fast they are played again, and what an agent learns
that only watches them (`benchmarks/records.py`)."""

import json

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt

from atari_dqn import params
from atari_dqn.analysis.statistics import cluster_interval
from atari_dqn.analysis.study import Section, Study
from atari_dqn.report import plots
from atari_dqn.report.outputs import show_absent, show_figure, show_text
from atari_dqn.runs import records
from atari_dqn.runs.files import project_root

FOLDER = "results/benchmarks"
WINDOW = 20  # games


def show_size(study: Study) -> None:
    """How much play is stored, and in how little room."""
    runs = study.stored
    tables = [section.episodes for section in study.sections.values() if len(section.episodes)]
    if not tables:
        return
    played = pd.concat(tables)
    frames = played.groupby(["variation", "agent", "seed", "experiment"]).frames.max().sum()
    size = sum((run.folder / records.FILE).stat().st_size for run in runs)
    show_text(
        f"The {len(runs)} stored runs hold {len(played):,} training games of "
        f"{frames / 1e6:,.1f} million frames, {frames / 3600 / 60:,.0f} hours of television at 60 "
        f"frames per second, and with them every greedy game, in {size / 1e6:.1f} MB: "
        f"{8 * size / (frames / 4):.1f} bits per agent step of training."
    )


def play_again(game: dict, difficulty: int = 0) -> int:
    """The score of a recorded game of Boxing, a line of `games.jsonl.zst`."""
    from ale_py import ALEInterface, roms

    ale = ALEInterface()
    ale.setFloat("repeat_action_probability", 0.0)
    ale.loadROM(roms.get_rom_path("boxing"))
    ale.setDifficulty(difficulty)
    ale.reset_game()
    actions = ale.getMinimalActionSet()
    score = sum(ale.act(0) for _ in range(game["idle_frames"]))
    for letter in game["actions"]:
        action = actions[ord(letter) - ord("A")]
        score += sum(ale.act(action) for _ in range(4))
    return score


def show_speed() -> None:
    """How fast recorded games are played again."""
    path = project_root() / FOLDER / "records.json"
    if not path.exists():
        return
    measured = json.loads(path.read_text())
    steps = measured["agent_steps_per_game"]
    with_images, alone = (measured[name] for name in ("with_images", "emulator_alone"))
    show_text(
        f"One core ({measured['processor']}) replays {with_images:.1f} games per second "
        f"({with_images * steps:,.0f} agent steps) including the images that the agent saw; the "
        f"emulator alone makes {alone:.1f} ({alone * steps:,.0f})."
    )


def show_watching(section: Section) -> None:
    """Greedy scores of an agent that learns from another one's games, without playing."""
    label, folder = "fig-watching", project_root() / FOLDER
    path = folder / "watching.csv"
    if not path.exists():
        show_absent(label, "`python benchmarks/records.py RUN` has not been run.")
        return
    measured = json.loads((folder / "records.json").read_text())
    games = pd.read_csv(path)
    checks = games.groupby("update").score
    low, high = np.array(
        [cluster_interval(check.score, check.opening) for _, check in games.groupby("update")]
    ).T
    agent = params.title(measured["agent"])
    look = plots.STYLES[measured["agent"]]
    figure, axes = plt.subplots(figsize=(plots.WIDTH, 2.8))
    plots.references(axes, section.facts, labelled=True)
    updates = checks.mean().index / 1000
    axes.plot(updates, checks.mean(), color=look.colour, ls=look.line, lw=2)
    axes.fill_between(updates, low, high, color=look.colour, alpha=0.15, lw=0)
    axes.set(xlabel="thousand updates", ylabel="score, greedy", xlim=(0, updates.max()))
    show_figure(
        figure,
        label=label,
        caption=f"A {agent} from new random weights that learns from the newest "
        f"{measured['transitions']:,} transitions of the {agent} of "
        f"`{measured['experiment']}` and never plays itself: mean of "
        f"{len(games) // games['update'].nunique()} greedy games, with its 95% interval over their "
        "openings. "
        "Dotted: a human tester and random play.",
        alt="The score of an agent that only watches, against its updates.",
        data=f"{FOLDER}/watching.csv",
    )
    last = games["update"].max()
    own, watched = _played(section, measured, last)
    checked = ""
    if not section.values.empty:
        greedy = _of_player(section.values, measured)
        greedy = greedy[greedy.episode <= own.episode.max()].tail(1)
        checked = "".join(
            f" In its own greedy games after game {row.episode:,} it scored {row.score:.1f}."
            for row in greedy.itertuples()
        )
    scored, at_random = own.score.mean(), own.epsilon.mean()
    show_text(
        f"After {last:,} updates it scores {checks.mean().iloc[-1]:.1f} (95% interval "
        f"{low[-1]:.1f} to {high[-1]:.1f}). The agent that played had scored {scored:.1f} in the "
        f"{WINDOW} games up to its own update {last:,}, with {at_random:.0%} of its actions "
        f"random.{checked} The games that are watched score {watched.score.mean():.1f} on "
        "average."
    )


def _of_player(table: pd.DataFrame, measured: dict) -> pd.DataFrame:
    """The rows of the run that is watched."""
    return table[(table.agent == measured["agent"]) & (table.seed == measured["seed"])]


def _played(section: Section, measured: dict, updates: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The last games of the one that played up to so many updates, and those whose transitions are
    watched."""
    played, params = _of_player(section.episodes, measured), section.params
    then = played.agent_steps <= params.learning_starts + updates * params.update_period
    first = played.agent_steps.max() - measured["transitions"]
    return played[then].tail(WINDOW), played[played.agent_steps > first]
