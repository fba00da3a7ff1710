"""The figures and tables that every section about an experiment has."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from atari_dqn import params
from atari_dqn.analysis import summaries
from atari_dqn.analysis.statistics import (
    MILESTONES,
    cluster_interval,
    scores_at_milestones,
)
from atari_dqn.analysis.study import (
    FEW_OPENINGS,
    FRAMES_PER_MINUTE,
    Section,
    Study,
    data,
    openings,
    spelled,
)
from atari_dqn.games import KNOCK_OUT
from atari_dqn.params import HELD_OUT_STATES, VALUE_GAMES, VALUES_PERIOD
from atari_dqn.report import plots
from atari_dqn.report.interactive import switches
from atari_dqn.report.outputs import (
    fixed,
    show_absent,
    show_figure,
    show_placeholders,
    show_table,
    show_text,
    varying,
)
from atari_dqn.runs import records, robustness, styles
from atari_dqn.runs.styles import AGENT


def show_curves(section: Section) -> None:
    """The learning curves of the section's runs, as far as they have come."""
    label, window, facts = f"fig-{section.slug}-curves", section.curve_window, section.facts
    if section.episodes.empty:
        show_placeholders(label)
        return
    if section.episodes.episode.max() < window:
        show_absent(
            label,
            f"A learning curve, of means of {window} games, follows after that many games.",
        )
        return
    source = source_points(section)
    episodes = timed_episodes(section)
    figure = plots.learning_curves(episodes, facts, window, published_points(section), source)
    caption = [
        f"{section.title}: raw score while training, with exploration, against games"
        f"{' and frames' if section.on_gpu else ', frames and processor time (on one core)'}; "
        "each point is "
        f"the mean of the last {window} games ({section.counted()}). Without sticky actions."
    ]
    seeds = section.episodes.groupby("agent").seed.nunique().max()
    if seeds >= plots.SEEDS_OF_A_BAND:
        caption.append("Thin: seeds; bold: their mean, with its 95% interval (Student's t).")
    drawn = switches(figure)
    if plots.SOURCE in drawn:
        caption.append(
            f"Circles: means of the last {section.milestone_window:,} games, hollow the source "
            "report's, filled ours."
        )
    if section.default_difficulty:
        caption.append("Dotted: a human tester and random play.")
        if plots.PUBLISHED in drawn:
            caption.append(
                "Grey marks: published agents of Dopamine, trained with sticky actions "
                "(@sec-published)."
            )
    show_figure(
        figure,
        label=label,
        caption=" ".join(caption),
        alt=f"Learning curves of the agents in {facts.title}: mean score against training "
        f"games{' and frames' if section.on_gpu else ', frames and processor time'}.",
        data=section.origin + "episodes.csv and timing.csv",
    )


def timed_episodes(section: Section) -> pd.DataFrame:
    """Its training games, with their processor time if all of it is of one core: a GPU's is not."""
    return section.episodes.drop(columns=["cpu_seconds"] * section.on_gpu)


def published_points(section: Section) -> dict[str, Any] | None:
    """Scores of agents of the literature by name, and under "frames" where they stand; None of a
    difficulty that nobody has published."""
    if not section.default_difficulty:
        return None
    published = data("published")
    return {"frames": published["frames"], **published.get(section.params.game, {})}


def source_points(section: Section) -> pd.DataFrame:
    """The source report's scores at the milestones of an experiment as long as its own: columns
    agent, episode, score and window, the episodes that it is the mean of; empty where it has none
    of an agent of the section."""
    source, rows = data("source_report"), []
    if section.milestones == MILESTONES:
        for agent, scores in source.get(section.params.experiment, {}).items():
            if agent in section.params.agents:
                points = zip(source["milestones"], scores, strict=True)
                rows += [(agent, *point, section.milestone_window) for point in points]
    return pd.DataFrame(rows, columns=["agent", "episode", "score", "window"])


def show_milestones(section: Section) -> None:
    """The mean score of the last games at each milestone that a run has reached, and the source
    report's."""
    label = f"tbl-{section.slug}-milestones"
    milestones = section.milestones
    if section.episodes.empty:
        show_placeholders(label)
        return
    if section.episodes.episode.max() < milestones[0]:
        show_absent(
            label, f"A table of mean scores follows after the first {milestones[0]:,} games."
        )
        return
    ours = scores_at_milestones(
        section.episodes, milestones, section.milestone_window
    ).reset_index()
    ours["seed"] = [f"ours, seed {seed}" for seed in ours.seed]
    tables = [ours]
    source = data("source_report")
    theirs = source.get(section.params.experiment, {}) if milestones == MILESTONES else {}
    for agent, scores in theirs.items():
        row = dict(zip(source["milestones"], scores, strict=True))
        tables.append(pd.DataFrame([{"agent": agent, "seed": "source report", **row}]))
    table = pd.concat(tables).sort_values("agent", key=_rank, kind="stable").astype({"seed": str})
    table[list(milestones)] = table[list(milestones)].astype(float)
    table["agent"] = table.agent.map(params.title)
    facts = section.facts
    show_table(
        table.rename(columns={"seed": "whose"}),
        label=label,
        caption=f"{section.title}: mean raw score of the last {section.milestone_window:,} games "
        "at each milestone. Columns: games played."
        + f" Human {facts.human:g}, random play {facts.random:g} [@dqnzoo2020]."
        * section.default_difficulty,
    )


def show_scores(study: Study) -> None:
    """The agents with the final settings of both games, in one table."""
    table = summaries.scores(study)
    if table["our score"].isna().all():
        show_placeholders("tbl-scores")
        return
    game = table.game.where(~table.game.duplicated(), "")
    facts = [study[name].facts for name in ("boxing_final", "breakout_final")]
    people = " and ".join(f"{one.human:g} in {one.title}" for one in facts)
    show_table(
        table.assign(game=game),
        label="tbl-scores",
        caption="Points per game while training, with exploration (the mean of the training games "
        "given, at most the last 500), the source report's over the same games, and ours evaluated "
        f"after training, without. A human tester scores {people} [@dqnzoo2020].",
        decimals=1,
    )


def show_beside(section: Section, reference: Section) -> None:
    """Training scores beside those of another experiment over the same games."""
    label, rows = f"tbl-{section.slug}-beside", []
    last = section.params.episodes
    spans = [(1, 50), (51, 500), *((first, first + 499) for first in range(501, last, 500))]
    for agent in section.params.agents:
        for each in (section, reference):
            means = {
                f"{first:,} to {end:,}": scores.mean() if scores.size else np.nan
                for first, end in spans
                for scores in [each.scores(agent, first, end)]
            }
            if not all(np.isnan(mean) for mean in means.values()):
                rows.append({"agent": params.title(agent), "runs": each.title, **means})
    if not any(row["runs"] == section.title for row in rows):
        show_placeholders(label)
        return
    show_table(
        pd.DataFrame(rows),
        label=label,
        caption=f"{section.title} beside {reference.title}: mean score over the same training "
        "games, with exploration. Columns: games.",
        decimals=1,
    )


def show_endings(section: Section) -> None:
    """How the games of the last milestones ended: the share of knock-outs, and how fast points
    came."""
    label, table = f"tbl-{section.slug}-endings", summaries.endings(section)
    if table.empty:
        show_placeholders(label)
        return
    table["agent"] = table.agent.map(params.title)
    show_table(
        varying(table, "seed"),
        label=label,
        caption=f"{section.title}: how games ended and how fast points came, over the last "
        f"{section.milestone_window:,} games before each milestone. Columns: games played.",
        decimals=0,
    )


def _rank(agents: pd.Series) -> pd.Series:
    return agents.map({name: place for place, name in enumerate(params.AGENT_NAMES)})


def show_evaluations(section: Section) -> None:
    """The scores of the evaluation games of every finished run, played as it was trained."""
    label, p = f"fig-{section.slug}-evaluation", section.params
    if section.evaluations.empty:
        if not section.episodes.empty:
            show_text("*No agent has been evaluated yet.*")
        show_placeholders(label)
        return
    games = section.evaluations.groupby(["agent", "seed"]).size().min()
    show_figure(
        plots.score_distributions(
            section.evaluations, section.facts if section.default_difficulty else None
        ),
        label=label,
        caption=f"{section.title}: scores of the evaluation games "
        f"({games} per run; {p.evaluation_epsilon:.1%} of the actions are random). Diamonds: the "
        "mean of each run, with its 95% interval (Student's t) over openings if these are many.",
        alt=f"Dots for each agent's evaluation scores in {section.facts.title}, and their means.",
        data=section.origin + "evaluations.csv",
    )


def show_conditions(section: Section) -> None:
    """The evaluation of every finished run, as it was trained and otherwise, beside random play."""
    label, p = f"tbl-{section.slug}-evaluation", section.params
    played, guessed = section.all_evaluations, section.random_play
    if len(played):
        played = played[played.epsilon == p.evaluation_epsilon]
    if played.empty:
        show_placeholders(label)
        return
    played = played.assign(agent=played.agent.map(params.title))
    if len(guessed):  # of no run
        played = pd.concat([played, guessed.assign(agent="random play", seed=-1, trained_games=-1)])
    keys = ["agent", "seed", "trained_games", "difficulty", "sticky_actions"]
    names = ["agent", "seed", "training games", "difficulty", "sticky"]
    rows = [
        dict(zip(names, key, strict=True)) | _summary(section, games)
        for key, games in played.groupby(keys, sort=False)
    ]
    table = pd.DataFrame(rows)
    for name in ("seed", "training games"):
        table[name] = table[name].astype("Int64").where(table[name] >= 0)
    table["sticky"] = table.sticky.map("{:g}".format)
    trained = " and ".join(f"{games:,}" for games in table["training games"].dropna().unique())
    apart = [STICKY] if (table.sticky != "0").any() else []
    if len(guessed):
        apart.append("for random play")
    show_table(
        varying(table, *names[1:]),
        label=label,
        caption=f"{section.title}: evaluation games after {trained} games of training, which was "
        f"at difficulty {p.difficulty} with a probability of sticky actions of "
        f"{p.sticky_actions:g}. "
        f"{_about_intervals(section, *apart)}",
        decimals=1,
    )


def show_discounts(sections: list[Section], agent: str, label: str) -> None:
    """One agent's curves with different discounts."""
    curves = [
        section.episodes[section.episodes.agent == agent].assign(
            variation=f"discount {section.params.gamma:g}"
        )
        for section in sections
        if agent in set(section.episodes.get("agent", []))
    ]
    window, facts = sections[0].curve_window, sections[0].facts
    curves = [curve for curve in curves if len(curve) >= window]
    if len(curves) < 2:
        show_absent(
            label, "Curves of several discounts will appear once two of them have been trained."
        )
        return
    show_figure(
        plots.comparison(pd.concat(curves), facts, window, "variation"),
        label=label,
        caption=f"{facts.title}: {params.title(agent)} with different discounts; mean raw score of "
        f"the last {window} training games.",
        alt="Learning curves of one agent with different discounts.",
        data=", ".join(section.origin for section in sections),
    )


def _interval(games: pd.DataFrame) -> str:
    """Of the mean score of games (columns score and opening); a dash for a single opening, and of
    few openings, all of which are played, the range of their means."""
    if games.opening.nunique() < 2:
        return "–"
    if games.opening.nunique() <= FEW_OPENINGS:
        means = games.groupby("opening").score.mean()
        return f"range {means.min():.1f} to {means.max():.1f}"
    return "{:.1f} to {:.1f}".format(*cluster_interval(games.score, games.opening))


def _about_intervals(section: Section, *apart: str) -> str:
    """What `_interval` gives, as captions tell it; `apart` are the rows in which no two games are
    alike."""
    where = " and ".join(apart)
    if section.facts.idle_cycle is None:
        said = "Each opening with all of its games counts once in a 95% interval"
        said += f"; {where}, each game does" * bool(apart)
    else:
        said = "A range is that of the openings' means"
        said += f"; {where}, it is a 95% interval over games" * bool(apart)
    return f"{said}. Nothing follows for other seeds."


def _summary(section: Section, games: pd.DataFrame) -> dict:
    """Mean score, interval, and in Boxing the shares of wins and of knock-outs, and how long the
    agent needs for one."""
    heading = "95% interval" if section.facts.idle_cycle is None else "95% interval, or range"
    row = {"games": len(games), "mean score": games.score.mean(), heading: _interval(games)}
    if section.facts.score_cells is not None:
        row["won"] = f"{games.won.mean():.0%}"
        knocked_out = games[games.knockout == 1]
        row["by knock-out"] = f"{len(knocked_out) / len(games):.0%}"
        row["seconds to knock-out"] = "–"
        if len(knocked_out):
            row["seconds to knock-out"] = (
                f"{60 * knocked_out.frames.mean() / FRAMES_PER_MINUTE:.0f}"
            )
    return row


def show_values(section: Section) -> None:
    """Predicted against realised values: what overestimation is measured by."""
    label = f"fig-{section.slug}-values"
    if plots.drawable(section.values).empty:
        # in a chapter of several badges, so the reason stands here
        title = section.facts.title
        show_absent(
            label,
            f"Values for {title} will appear here once there are any; they are checked every "
            f"{VALUES_PERIOD} training games.",
        )
        return
    penalty = section.params.life_loss_penalty
    lives = f", less {penalty:g} for a lost life" * bool(penalty)
    show_figure(
        plots.value_errors(section.values),
        label=label,
        caption=f"{section.title}: the value that the "
        f"network predicts for the states of {VALUE_GAMES} greedy games (dots), and the "
        f"discounted return that followed them, in rewards as the agent learns from them{lives} "
        f"(grey circles), every {VALUES_PERIOD} training games. Shaded: the network overestimates. "
        f"A point is {VALUE_GAMES} games, so single dips mean little. Pale line: the prediction "
        f"for {HELD_OUT_STATES} states of random play that stay the same: if it drifts upwards "
        "while play does not improve, the network has begun to overestimate.",
        alt="Predicted and realised values of states against training games, one panel per agent.",
        data=section.origin + "values.csv",
    )


def show_variations(section: Section, reference: Section, agent: str) -> None:
    """The curves of a sweep beside the same games of the unchanged set-up, and their table."""
    figure, table = f"fig-{section.slug}-curves", f"tbl-{section.slug}"
    games, window = section.params.episodes, section.curve_window
    sweep = section.episodes
    if sweep.empty or sweep.episode.max() < window:
        show_placeholders(figure, table)
        return
    unchanged = reference.episodes
    if not unchanged.empty:
        unchanged = unchanged[(unchanged.agent == agent) & (unchanged.episode <= games)]
    show_figure(
        plots.small_multiples(sweep, unchanged, agent, window),
        label=figure,
        caption=f"{section.title}: one change per panel, "
        f"{params.title(agent)}, beside the unchanged set-up; mean raw score of the last {window} "
        f"training games ({section.counted()}).",
        alt="A panel per change with two learning curves: with the change, and unchanged.",
        data=section.origin + "episodes.csv",
    )
    if not unchanged.empty:
        sweep = pd.concat([unchanged.assign(variation="unchanged"), sweep])
    last = sweep[sweep.episode > sweep.groupby("variation").episode.transform("max") - window]
    evaluated = section.evaluations
    greedy = {} if evaluated.empty else evaluated.groupby("variation").score.mean().to_dict()
    rows = [
        {
            "variation": spelled(str(name)),
            "games": int(found.episode.max()),
            "hours": found.seconds.max() / 3600,
            f"mean of the last {window} games": found.score.mean(),
            "evaluation": greedy.get(name, np.nan),
        }
        for name, found in last.groupby("variation", sort=False)
        if len(found) > 1
    ]
    if not rows:
        show_absent(table, "No variation has played enough games for a mean.")
        return
    show_table(
        pd.DataFrame(rows),
        label=table,
        caption=f"{section.title}: wall-clock hours on "
        "one core, training scores with exploration, and the mean of the greedy games of a "
        "finished run.",
        decimals=1,
    )


def show_learning_style(section: Section) -> None:
    """How the agents play along their training, as the console's memory tells."""
    label, table = f"fig-{section.slug}-style", f"tbl-{section.slug}-style"
    measures = summaries.STYLE_MEASURES[section.params.game]
    if plots.drawable(section.styles).empty:
        show_placeholders(label, table)
        return
    show_figure(
        plots.styles_along(section.styles, measures),
        label=label,
        caption=f"{section.title}: how the agents play along their training, in the {VALUE_GAMES} "
        f"greedy games after every {VALUES_PERIOD} training games: means, read from the console's "
        "memory.",
        alt=f"Panels against training games: {'; '.join(measures.values())}. A line per agent.",
        data=f"results/styles/{section.params.experiment}/",
    )
    changes = summaries.style_changes(section)
    if changes.empty:
        show_absent(table, f"No run has {2 * summaries.CHECKS} checks of greedy play yet.")
        return
    seeded = len(section.params.seeds) > 1
    rows: dict[str, dict[str, str]] = {}
    greatest = changes[["measure", "first", "last"]].groupby("measure").max().max(axis=1)
    for row in changes.itertuples():
        who = params.title(row.agent) + f", seed {row.seed}" * seeded
        rows.setdefault(measures[row.measure], {})[who] = _way(
            row, _decimals(greatest[row.measure])
        )
    show_table(
        pd.DataFrame([{"measure": measure, **ways} for measure, ways in rows.items()]),
        label=table,
        caption=f"{section.title}: what changes in how the agents play: means of the first and of "
        f"the last {summaries.CHECKS} checks of greedy play; in brackets the 95% interval of the "
        "change and after how many training games a measure has gone half of its way. A dash: "
        "fewer than two of these checks have such a thing. Intervals are over checks of one run "
        "(Welch's t; cut where a measure can go no further), not over seeds.",
    )


def _decimals(greatest: float) -> int:
    """How many a row of numbers has that are this great at most, the same for all of them."""
    if not 0 < greatest < 100:  # all are zero, or nan, or large
        return 0
    return 1 if greatest >= 1 else 2


def _way(change: Any, decimals: int) -> str:
    """A change in how an agent plays: its ends, its interval, and when half of it is done."""
    ends = (change.first, change.last)
    said = " → ".join("–" if np.isnan(end) else fixed(end, decimals) for end in ends)
    if np.isnan(change.low):
        return said
    half = "no clear change"
    if not change.low <= 0 <= change.high:
        half = "–" if pd.isna(change.half_way) else f"half after {change.half_way:,.0f} games"
    low, high = (fixed(end, decimals, "+") for end in (change.low, change.high))
    return f"{said} ({low} to {high}; {half})"


WAY = ("distance", "conceded_per_minute")  # what a map of style has to the right and upwards
WAY_SAYS = (
    "from the hollow point to the filled one: distance of the boxers and points conceded per "
    f"minute, each a mean of {summaries.CHECKS} checks of greedy play in a row"
)


def show_style_map(section: Section) -> None:
    """Where each agent of Boxing goes, from its first check of greedy play to its last, on a map of
    distance and points conceded."""
    label, table = f"fig-{section.slug}-style-map", plots.drawable(section.styles)
    if table.empty or table.episode.nunique() < 2 * summaries.CHECKS:
        show_placeholders(label)
        return
    show_figure(
        plots.style_map(table, WAY, summaries.CHECKS),
        label=label,
        caption=f"{section.title}: each agent's way over its training, {WAY_SAYS}.",
        alt="A path per agent on a map: distance to the right, points conceded upwards.",
        data=f"results/styles/{section.params.experiment}/",
    )


def show_discount_map(sections: Sequence[Section], label: str) -> None:
    """The same of one agent with different discounts, over as many games."""
    ways = [
        section.styles[section.styles.agent == AGENT].assign(
            variation=f"discount {section.params.gamma:g}"
        )
        for section in sections
        if not section.styles.empty
    ]
    ways = [way for way in ways if way.episode.nunique() >= 2 * summaries.CHECKS]
    if len(ways) < 2:
        show_absent(label, "A map will appear once two discounts have been trained for longer.")
        return
    games = min(way.episode.max() for way in ways)
    together = pd.concat([way[way.episode <= games] for way in ways])
    show_figure(
        plots.style_map(together, WAY, summaries.CHECKS),
        label=label,
        caption=f"{params.title(AGENT)} with different discounts: its way over its first "
        f"{games:,} training games, {WAY_SAYS}.",
        alt="A path per discount on a map: distance to the right, points conceded upwards.",
        data=", ".join(f"results/styles/{section.params.experiment}/" for section in sections),
    )


def show_places(section: Section) -> dict[str, dict[int, np.ndarray]]:
    """Where both boxers stand in the first and in the last check of greedy play of each agent;
    returns `styles.stays` of both, by agent and check."""
    label = f"fig-{section.slug}-places"
    found: dict[str, dict[int, np.ndarray]] = {}
    for run in section.usable:
        checks = styles.checks(run)
        if run.seed == section.params.seeds[0] and len(checks) > 1:
            ends = checks[0], checks[-1]
            found[run.agent] = {episode: styles.stays(run, episode) for episode in ends}
    if not found:
        show_placeholders(label)
        return found
    show_figure(
        plots.places(found),
        label=label,
        caption=f"{section.title}: where the agent and its rival spend their time, in "
        f"{styles.MAPPED} greedy games each of an agent's first check and of its last, "
        "seen from above as on the television: the stronger the colour, the longer, on one scale "
        f"that is not proportional (colours follow the share to the power of {plots.FADING:g}).",
        alt="Maps of the ring, a row per agent: the agent and its rival, early and late.",
        data=f"results/runs/{section.params.experiment}/*/*/games.jsonl.zst",
    )
    return found


STICKY = "with sticky actions"
SEEN = {
    robustness.MIRRORED: "left and right exchanged",
    robustness.FIELD: "in the field alone",
    robustness.BAR_MOVED: "black bar moved right",
    robustness.BAR_GONE: "black bar painted over",
}
BLINDLY = "the best game's moves, blindly"
OPENINGS = (500, 100)  # training games, and agent steps from their start, that are compared


def show_views(section: Section) -> None:
    """What a finished agent sees where left and right are exchanged, and what the agents score."""
    label, trials = f"fig-{section.slug}-views", section.robustness
    if trials.empty:
        show_placeholders(label)
        return
    (run, *_) = (run for run in section.usable if run.agent == trials.agent[0])
    record = robustness.best_game(run, int(trials.trained_games[0]))
    game, image = records.begin(run.params, record)
    for action in record.actions[: len(record.actions) // 4]:
        image = game.step(action)[0]
    views = robustness.views(run.params)
    there = {condition: name for condition, name in SEEN.items() if condition in views}
    seen = {"as it is": image} | {
        name: views[condition](image[None, :, :, None])[0, :, :, 0]
        for condition, name in there.items()
    }
    scores = {"as it is": section.evaluations} | {
        name: _under(section, condition) for condition, name in there.items()
    }
    said = {
        name: "\n".join(
            f"{params.title(str(agent))} {mean:.1f}".replace("-", "−")
            for agent, mean in games.groupby("agent", sort=False).score.mean().items()
            if agent in set(trials.agent)
        )
        for name, games in scores.items()
    }
    show_figure(
        plots.views(seen, said),
        label=label,
        caption=f"{section.title}: a moment of a game as it is, and as it is seen in trials of "
        "finished agents (@tbl-"
        + section.slug
        + "-robustness), with their mean scores. Where left "
        "and right are exchanged, so are the actions.",
        alt="Small pictures of one moment of a game, each changed in another way.",
        data=section.origin,
    )


def show_robustness(section: Section) -> None:
    """Finished agents under conditions that they have never met, beside those that they have."""
    label = f"tbl-{section.slug}-robustness"
    if section.robustness.empty or section.final_evaluations.empty:
        show_placeholders(label)
        return
    p, rows = section.params, []
    played = section.final_evaluations
    played = played[(played.difficulty == p.difficulty) & (played.epsilon == p.evaluation_epsilon)]
    conditions = {
        "as trained": played[played.sticky_actions == p.sticky_actions],
        **{
            f"sticky actions, {chance:g}": played[played.sticky_actions == chance]
            for chance in p.evaluation_stickiness
        },
        "scoreboard frozen": _under(section, robustness.SCOREBOARD),
        **{name: _under(section, condition) for condition, name in SEEN.items()},
        BLINDLY: _under(section, robustness.SEQUENCE),
    }
    for agent, seed in played[["agent", "seed"]].drop_duplicates().itertuples(index=False):
        for name, games in conditions.items():
            own = games[(games.agent == agent) & (games.seed == seed)]
            if len(own):
                rows.append(
                    {
                        "agent": params.title(agent),
                        "seed": seed,
                        "condition": name,
                        "games": len(own),
                        "mean score": own.score.mean(),
                        "95% interval": _interval(own),
                    }
                )
    show_table(
        varying(pd.DataFrame(rows), "seed"),
        label=label,
        caption=f"{section.title}: greedy games of finished agents under "
        "conditions that they were trained for (first) and that they were not. A frozen scoreboard "
        "shows score and clock, or lives, as in a game's first picture. The best evaluation game's "
        f"moves are made in every other opening. {_about_intervals(section, STICKY)}",
        decimals=1,
    )
    games, steps = OPENINGS
    said = [
        f"{robustness.repeated_openings(run, games, steps):.0%} for {params.title(run.agent)}"
        for run in section.usable
        if run.robustness.exists()
    ]
    show_text(
        f"The share of the last {games} training games of {section.facts.title} that have their "
        f"first {steps} actions in common with another one is {' and '.join(said)}."
    )


def _under(section: Section, condition: str) -> pd.DataFrame:
    """The games of one condition, and the opening of each."""
    games, p = section.robustness, section.params
    games = games[games.condition == condition]
    if condition == robustness.SEQUENCE:
        return games.assign(opening=games.game)
    drawn = games.assign(sticky_actions=p.sticky_actions, epsilon=p.evaluation_epsilon)
    return games.assign(opening=openings(drawn, p))


def show_transfer(transferred: Section, scratch: Section) -> None:
    """What starting from another game's agent is worth (Taylor and Stone, 2009)."""
    label = "tbl-transfer"
    early, late = scratch.milestone_window, transferred.milestone_window  # as in the claim
    rows = []
    for agent in transferred.params.agents:
        pair = (transferred, scratch)
        ours, theirs = (_curve(section, agent) for section in pair)
        played = min(len(ours), len(theirs))
        if played < max(early, late):
            continue
        gain = ours[:played] - theirs[:played]
        greedy = [_greedy(section, agent, early) for section in pair]
        rows.append(
            {
                "agent": params.title(agent),
                "games": played,
                "early": gain[:early].mean(),
                "early, greedy": greedy[0] - greedy[1],
                "area ratio": gain.sum() / (theirs[:played] + KNOCK_OUT).sum(),
                "at the end": gain[-late:].mean(),
            }
        )
    if not rows:
        if transferred.complete:
            show_absent(label, f"Both runs need {max(early, late)} games to be compared.")
        else:
            show_placeholders(label)
        return
    show_table(
        pd.DataFrame(rows),
        label=label,
        caption=f"{transferred.facts.title}: what the start from Breakout is worth, over the "
        "games that both runs have played. *Early* is the difference in points over the first "
        f"{early} training games, while training and in the greedy games of the checks among "
        f"them ({VALUE_GAMES} per check); *at the end*, that over the last {late} training "
        "games. The area between the two curves is given as a share of the area between the "
        f"curve from scratch and {-KNOCK_OUT} points, the lowest score there is.",
    )


def _greedy(section: Section, agent: str, episodes: int) -> float:
    """Mean score of the greedy episodes during an agent's first training episodes; nan without
    any."""
    values = section.values
    if values.empty:
        return np.nan
    return values[(values.agent == agent) & (values.episode <= episodes)].score.mean()


def _curve(section: Section, agent: str) -> np.ndarray:
    """Mean score of each training game, over seeds that all have played it: float64 [games]."""
    if section.episodes.empty:
        return np.empty(0)
    own = section.episodes[section.episodes.agent == agent]
    reached = own.groupby("seed").episode.max().min()  # by every seed
    return own[own.episode <= reached].groupby("episode").score.mean().to_numpy()


def show_playstyle(sections: Sequence[Section], label: str) -> None:
    """How one agent boxes with different discounts: a row per part of the training and run."""
    tables = {
        section: section.styles[section.styles.agent == AGENT]
        for section in sections
        if not section.styles.empty
    }
    measured = [section for section, table in tables.items() if not table.empty]
    if len(measured) < 2:
        show_absent(
            label,
            "A table of play styles will appear once two discounts have been trained. (Styles are "
            "measured when the report is made, in the greedy games that are on record.)",
        )
        return
    rows = []
    for first in range(1, max(section.params.episodes for section in measured), PART):
        span = range(first, first + PART)
        there = [
            (section, checks)
            for section in sorted(measured, key=lambda section: section.params.gamma)
            if (checks := set(tables[section].episode).intersection(span))
        ]
        shared = set.intersection(*(checks for _, checks in there)) if there else set()
        for section, _ in there:
            part = tables[section][tables[section].episode.isin(shared)]
            if not part.empty:
                rows.append(
                    {
                        "training games": f"{first:,} to {max(shared):,}",
                        "discount": f"{section.params.gamma:g}",
                        "score": part.score.mean(),
                        **{name: part[column].mean() for column, name in STYLE.items()},
                        "within reach": f"{part.reach.mean():.0%}",
                    }
                )
    agent = params.title(AGENT)
    show_table(
        pd.DataFrame(rows),
        label=label,
        caption=f"How {agent} boxes with different discounts, in the greedy games of the checks "
        f"along its training ({VALUE_GAMES} every {VALUES_PERIOD} training games): points and "
        "punches per minute, mean distance of the two boxers in pixels, and the share of the time "
        "in which they stand so near that a punch can land. Each part of the training "
        "counts only the checks that its runs share. Style and skill go together: compare rows of "
        "the same training games, and rows of about the same score.",
        decimals=1,
    )


PART = 500  # training episodes that a row of play styles is the mean of
STYLE = {
    "scored_per_minute": "points scored",
    "conceded_per_minute": "points conceded",
    "punches_per_minute": "punches thrown",
    "distance": "distance",
}
