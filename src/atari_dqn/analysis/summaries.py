"""Sentences of the report that are computed: what the stored runs have shown so far."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from atari_dqn import params
from atari_dqn.analysis.claims import FINDINGS, Claim, findings
from atari_dqn.analysis.statistics import (
    BLOCK,
    MILESTONES,
    blocks,
    cluster_interval,
    coverage,
    iqm,
    likeness,
    series_interval,
    stratified_interval,
    trailing_mean,
    welch_interval,
)
from atari_dqn.analysis.study import FRAMES_PER_MINUTE, Section, Study, data
from atari_dqn.analysis.verdicts import (
    SEEDS,
    Mean,
    Outcome,
    last_episodes,
    mean_score,
    milestone_episodes,
)
from atari_dqn.games import KNOCK_OUT

EARLY = 500  # episodes, before which an agent still acts mostly at random
RECENT = 100  # episodes, of which the score of a run in progress is the mean
SOME = 3  # checks, from which on they have an interval
NEWEST = 10  # checks of values: an untrained network's errors say nothing about it when trained
UNJUDGED = [*Outcome.OPEN.value, *Outcome.UNTESTED.value]


@dataclass(frozen=True)
class Score:
    """What an agent scores while training: the one number that the report calls its score."""

    mean: float  # points, over the last `window` episodes, the mean of its seeds
    window: int
    episodes: int  # that it has played; of several seeds, the one that has played fewest

    def __float__(self) -> float:
        return self.mean


def score(section: Section, agent: str) -> Score | None:
    """An agent's score: of finished runs the mean of as many training episodes as the source report
    takes (500 of 3,000), of others that of the last 100. Seeds in their early episodes do not
    count; None if all are, or there are none."""
    if section.episodes.empty:
        return None
    own = section.episodes[section.episodes.agent == agent]
    runs = [run for _, run in own.groupby("seed")]
    ready = [run for run in runs if len(run) >= min(EARLY, section.params.episodes)]
    if not ready:
        return None
    fewest = min(len(run) for run in ready)
    finished = len(ready) == len(section.params.seeds) and fewest >= section.params.episodes
    window = _window(section, finished)
    return Score(float(np.mean([run.score.tail(window).mean() for run in ready])), window, fewest)


def _window(section: Section, finished: bool) -> int:
    """How many episodes a score is the mean of."""
    return section.milestone_window if finished else min(RECENT, section.params.episodes)


@dataclass(frozen=True)
class Standings:
    """What the agents of an experiment score over the same training episodes."""

    first: int
    last: int
    means: dict[str, float]  # points, by the agents' titles, the best first


def standings(section: Section) -> Standings | None:
    """The finished agents, or if there is none, all that have a score, over the last episodes that
    each of these has played."""
    found = {agent: score(section, agent) for agent in section.params.agents}
    there = {agent: one for agent, one in found.items() if one is not None}
    if not there:
        return None
    planned = section.params.episodes
    there = {agent: one for agent, one in there.items() if one.episodes >= planned} or there
    last = min(one.episodes for one in there.values())
    first = last - min(one.window for one in there.values()) + 1
    means = {params.title(agent): section.scores(agent, first, last).mean() for agent in there}
    return Standings(first, last, dict(sorted(means.items(), key=lambda pair: -pair[1])))


def headline(study: Study) -> str:
    """One paragraph: how far the runs are, and how the claims stand."""
    section, verdicts = study["boxing_final"], findings(study).verdict
    if (found := standings(section)) is None:
        played, planned = _played(study)
        text = f"Training has only begun: {played:,} of {planned:,} planned games are played."
    else:
        text = _scored(section, found)
    testable, judged = _judged(verdicts)
    claims = (
        f"Of the source report's {len(verdicts)} claims about training, the planned runs can test "
        f"{testable}"
    )
    if judged.empty:
        claims += "; none has been judged yet."
    else:
        counted = ", ".join(f"{number} \u201c{word}\u201d" for word, number in judged.items())
        verb = "has" if judged.sum() == 1 else "have"
        so_far = " so far" if judged.sum() < testable else ""
        claims += f"; {judged.sum()} {verb} been judged{so_far} ({counted})."
    return f"**{text}** {claims}"


def _scored(section: Section, found: Standings) -> str:
    """What the agents of an experiment score, between the best, a human and random play."""
    facts = section.facts
    (best, top), *others = found.means.items()
    said = [f"{best} scores {top:.1f} points per game"]
    said += [f"{agent} {mean:.1f}" for agent, mean in others]
    each = " each" * bool(others)
    return (
        f"After {found.last:,} games of {facts.title}{each}, {_in_a_row(said)} (mean of the "
        f"last {found.last - found.first + 1} games; best possible {KNOCK_OUT}; one human tester "
        f"{facts.human:g}; random play {facts.random:g})."
    )


def _in_a_row(said: list[str]) -> str:
    """Several things in words: "one, two and three"."""
    return " and ".join(filter(None, (", ".join(said[:-1]), said[-1])))


def _judged(verdicts: pd.Series) -> tuple[int, pd.Series]:
    """How many claims runs can judge, and how many have each of the verdicts that say something."""
    testable = int((~verdicts.isin(Outcome.UNTESTED.value)).sum())
    return testable, verdicts[~verdicts.isin(UNJUDGED)].value_counts()


def _played(study: Study) -> tuple[int, int]:
    """Training episodes of all experiments: stored, and planned."""
    sections = study.sections.values()
    planned = sum(len(each.runs) * each.params.episodes for each in sections)
    return sum(len(each.episodes) for each in sections), planned


def scores(study: Study) -> pd.DataFrame:
    """A row per agent with the final settings of each game: its mean score over the games up to the
    last milestone that it has reached, the source report's there, and its evaluation."""
    rows, source = [], data("source_report")
    for section in (study["boxing_final"], study["breakout_final"]):
        whole = section.params.episodes == MILESTONES[-1]
        for agent in section.params.agents:
            row: dict[str, Any] = {"game": section.facts.title, "agent": params.title(agent)}
            row |= dict.fromkeys(("training games", "our score", "source report's", "evaluated"))
            for number in range(len(MILESTONES), 0, -1):
                first, last = milestone_episodes(section, number)
                if len(ours := section.scores(agent, first, last)):
                    row |= {"training games": f"{first:,} to {last:,}", "our score": ours.mean()}
                    if whole:
                        row["source report's"] = source[section.params.experiment][agent][
                            number - 1
                        ]
                    break
            if len(played := section.evaluations):
                row["evaluated"] = played[played.agent == agent].score.mean()
            rows.append(row)
    numbers = dict.fromkeys(("our score", "source report's", "evaluated"), float)
    return pd.DataFrame(rows).astype(numbers)


def conclusion(study: Study) -> str:
    """What can be said before there is a score, and how the agents compare over several seeds, if
    there are some; else empty."""
    said = []
    if not any(standings(study[name]) for name in ("boxing_final", "breakout_final")):
        played, planned = _played(study)
        said.append(
            f"With {played / planned:.1%} of the planned games played, no agent can be called "
            "the better one yet. What stands already does not depend on them: what the literature "
            "says (@tbl-literature), how the two games work (@sec-games), where the source report "
            "leaves a choice open (@tbl-deviations), and what training costs (@sec-speed)."
        )
    if together := over_seeds(study):
        said.append(together)
    return "\n\n".join(said)


def duration(section: Section) -> str:
    """How many games an experiment's agents are trained for, and the processor hours they have
    taken; empty without runs."""
    if section.episodes.empty:
        return ""
    last = section.episodes.groupby(["agent", "seed"], sort=False).tail(1)
    said = [
        f"{params.title(str(row.agent))} played {row.episode:,} games in "
        f"{row.cpu_seconds / 3600:.1f} hours"
        for row in last.itertuples()
    ]
    return (
        f"An agent is trained for {section.params.episodes:,} games, the source report's number. "
        f"In {section.facts.title} {_in_a_row(said)} of one core's time, on different processors "
        "(@tbl-provenance)."
    )


def over_seeds(study: Study) -> str:
    """A sentence on the agents' final scores in both games over all seeds: interquartile means with
    stratified bootstrap intervals (Agarwal et al., 2021). Empty with fewer than three seeds, or
    while one is unfinished."""
    sections = [study[name] for name in ("boxing_final", "breakout_final")]
    if any(len(each.params.seeds) < SEEDS or not each.complete for each in sections):
        return ""
    said = []
    for agent in sections[0].params.agents:
        groups = [_normalised(section, agent) for section in sections]
        low, high = stratified_interval(iqm, *groups)
        said.append(f"{params.title(agent)} {iqm(*groups):.2f} ({low:.2f} to {high:.2f})")
    return (
        "Over both games and all seeds, the interquartile means of the final scores are "
        f"{', '.join(said)}, where 0 is random play and 1 a human."
    )


def _normalised(section: Section, agent: str) -> np.ndarray:
    """Each seed's final score, where 0 is random play and 1 a human: float64 [seeds]."""
    scores, facts = section.scores(agent, *last_episodes(section)), section.facts
    return (scores.mean(axis=1) - facts.random) / (facts.human - facts.random)


def head_start(study: Study, experiment: str, base: str) -> str:
    """A sentence on how much more random play scores at an experiment's difficulty than at that of
    another; empty until it has been evaluated at both."""
    sections = study[experiment], study[base]
    means, said = [], []
    for section in sections:
        difficulty = section.params.difficulty
        played = pd.concat([each.random_play_at(difficulty) for each in sections])
        if len(played) < 2:
            return ""
        low, high = cluster_interval(played.score, played.opening)
        means.append(played.score.mean())
        said.append(f"{means[-1]:.1f} ({low:.1f} to {high:.1f}) at difficulty {difficulty}")
    gap = round(means[0], 1) - round(means[1], 1)  # of what is said
    where = "higher" if gap > 0 else "lower"
    start = f"so an agent that knows nothing yet starts {abs(gap):.1f} points {where}"
    return f"Random play scores {' and '.join(said)}, {start}."


def board(study: Study) -> str:
    """The verdicts at a glance: a division of class `board` with one of class `tile` per claim,
    and of its verdict's class. Claims of which there is nothing to see yet share a line below."""
    tiles, others = [], dict[Outcome, list[int]]()
    for number, claim in enumerate(FINDINGS, start=1):
        found, scores = claim.judge(study), _numbers(study, claim)
        if found.verdict in UNJUDGED and not (scores and PENDING not in scores):
            others.setdefault(found.outcome, []).append(number)
            continue
        lines = [f"**{number}** {claim.short}.", scores, f"@{claim.section}"]
        kind = f'.{found.outcome.name.lower()} verdict="{found.verdict}"'
        tiles.append(f"::: {{.tile {kind}}}\n" + "\n\n".join(filter(None, lines)) + "\n:::")
    said = "; ".join(
        f"{word} {_listed(others[outcome])}"
        for outcome, word in ((Outcome.OPEN, "open"), (Outcome.UNTESTED, "not tested"))
        if outcome in others
    )
    board = "::: {.board}\n" + "\n\n".join(tiles) + "\n:::" if tiles else ""
    rest = f"Claims of @tbl-findings without a tile: {said}." if said else ""
    return "\n\n".join(filter(None, (board, rest)))


def _listed(numbers: list[int]) -> str:
    """Rising numbers in words: "1, 3 to 5"; two in a row are no range."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return ", ".join(
        f"{part[0]} to {part[-1]}" if len(part) > 2 else ", ".join(map(str, part)) for part in parts
    )


PENDING = "Ours: pending"


def _numbers(study: Study, claim: Claim) -> str:
    """The source report's scores that a claim is about, as far as it gives them, and ours, with
    intervals if they are over seeds; empty if it gives none, or our runs are not as long as its
    own."""
    agents, games = ({score[place] for score in claim.scores} for place in (1, 0))
    theirs, ours, reached = [], [], False
    for experiment, agent, milestone in claim.scores:
        section = study[experiment]
        if section.params.episodes != MILESTONES[-1]:
            return ""
        named = f"{params.title(agent)} " * (len(agents) > 1)
        named = f"{section.facts.title} " * (len(games) > 1) + named
        if agent in (given := data("source_report")[experiment]):
            theirs.append(f"{named}{given[agent][milestone - 1]:.1f}")
        found = mean_score(section, agent, *milestone_episodes(section, milestone))
        ours.append(f"{named}{_over_seeds(found)}")
        reached |= found is not None
    if not theirs:
        return ""
    here = f"Ours: {', '.join(ours)}" if reached else PENDING
    return f"Source: {', '.join(theirs)}. {here}."


def _over_seeds(found: Mean | None) -> str:
    """A mean, with its interval if that is over seeds: of fewer it would say how steady a run is,
    and be taken for how sure the mean."""
    if found is None:
        return "–"
    return str(found) if found.seeds >= SEEDS else f"{found.mean:.1f}"


def neighbours(study: Study) -> str:
    """A sentence on how much successive blocks of training episodes resemble one another in the
    stored runs, and how far the intervals are to be trusted then."""
    found = []  # (likeness, blocks) of each stretch
    for section in study.sections.values():
        window = section.milestone_window
        if section.episodes.empty or window < 3 * BLOCK:
            continue
        for _, run in section.episodes.groupby(["variation", "agent", "seed"]):
            for last in range(window, len(run) + 1, window):
                means = blocks(run.score.to_numpy()[last - window : last])
                found.append((likeness(means), len(means)))
    if not found:
        return ""
    middle = float(np.median([alike for alike, _ in found]))
    most, number = max(found, key=lambda stretch: (stretch[0], -stretch[1]))
    fewest = min(count for _, count in found)
    ceiling, more = "", ""
    if np.isclose(most, 1 - 2 / number):
        ceiling = f", the most that {number} blocks can show"
        more = ", or in fewer if the true correlation is higher"
    return (
        f"How alike are neighbouring blocks of {BLOCK} training games? In "
        f"{len(found)} stretches of our runs the correlation has a median of {middle:.2f}. In "
        "simulations of such stretches a 95% interval then holds the true mean in "
        f"{coverage(middle, fewest):.0%} of cases ({fewest} blocks). The highest value is "
        f"{most:.2f}{ceiling}; there a 95% interval holds it in {coverage(most, number):.0%} of "
        f"cases ({number} blocks){more}."
    )


def reading(study: Study, experiment: str) -> str:
    """What an experiment has shown: a line per run, and the verdicts on the claims about it.

    Empty where nothing can be said yet.
    """
    section = study[experiment]
    lines = []
    if not section.episodes.empty:
        for (agent, seed), played in section.episodes.groupby(["agent", "seed"], sort=False):
            seeds = f", seed {seed}" if len(section.params.seeds) > 1 else ""
            greedy = [_of(table, agent, seed) for table in (section.evaluations, section.values)]
            said = _progress(section, played) + _without_exploring(*greedy)
            lines.append(f"- {params.title(str(agent))}{seeds}{said}.")
    waiting: list[int] = []
    untested: list[str] = []
    for number, claim in enumerate(FINDINGS, start=1):
        if experiment not in claim.experiments:
            continue
        found = claim.judge(study)
        said = f"- Claim {number} of @tbl-findings, \u201c{claim.text}\u201d: *{found.verdict}*."
        if found.outcome == Outcome.OPEN:
            waiting.append(number)
        else:
            (untested if found.outcome == Outcome.UNTESTED else lines).append(said)
    if not lines:
        return ""
    lines += untested
    if waiting:
        noun, verb = ("Claims", "are") if len(waiting) > 1 else ("Claim", "is")
        lines.append(f"- {noun} {_listed(waiting)} of @tbl-findings {verb} still open.")
    head = "**Findings:**" if section.complete else "**Findings so far:**"
    return f"{head}\n\n" + "\n".join(lines)


def _of(table: pd.DataFrame, agent: object, seed: object) -> pd.DataFrame:
    """The rows of one run."""
    return table if table.empty else table[(table.agent == agent) & (table.seed == seed)]


def _progress(section: Section, played: pd.DataFrame) -> str:
    """How a run has gone: where it stands, when it passed the human score, how steady it was."""
    number, human = int(played.episode.max()), section.facts.human
    finished = number >= section.params.episodes
    scores, window = played.set_index("episode").score, _window(section, finished)
    if number < window:
        return f" has played {number:,} games, too few for a mean of {window:,}"
    text = (
        f" scores {scores.tail(window).mean():.1f} points per game over the last {window:,} of "
        f"{number:,} games, with {played.epsilon.iloc[-1]:.0%} random actions"
    )
    recent = min(RECENT, section.params.episodes)
    means = trailing_mean(scores, recent).dropna()
    above = means[means > human]
    if len(above) and section.default_difficulty:
        text += f"; the mean of {recent} games first passed the human {human:g} after game "
        text += f"{above.index[0]:,}"
    fall = (means.cummax() - means).max()
    so_far = "" if finished else " so far"
    return (
        f"{text}; the largest drop{so_far} of the mean of {recent} games from its earlier peak was "
        f"{fall:.1f} points"
    )


def _without_exploring(evaluated: pd.DataFrame, checks: pd.DataFrame) -> str:
    """What a run scores without random moves: in its evaluation, or, if that is long ago, in the
    few greedy episodes along the way."""
    tried = 0 if evaluated.empty else int(evaluated.trained_games.max())
    checked = 0 if checks.empty else int(checks.episode.max())
    if not tried and not checked:
        return ""
    if tried and tried >= checked - RECENT:
        return (
            f". Evaluated after {tried:,} training games, it scored {evaluated.score.mean():.1f} "
            f"({len(evaluated)} evaluation games)"
        )
    return (
        f". In the latest check ({params.VALUE_GAMES} greedy games after game {checked:,}) it "
        f"scored {checks.score.iloc[-1]:.1f}"
    )


def endings(section: Section) -> pd.DataFrame:
    """How games end that a knock-out can cut short, up to each milestone that a run has reached:
    columns agent, seed, measure, and the milestones. Empty for other games."""
    full, tables = section.facts.full_frames, []
    if full is None or section.episodes.empty:
        return pd.DataFrame()
    for (agent, seed), run in section.episodes.groupby(["agent", "seed"], sort=False):
        games = run.assign(frames=run.frames.diff().fillna(run.frames))  # of each, not so far
        found = {
            last: _ending(games.iloc[last - section.milestone_window : last], full)
            for last in section.milestones
            if last <= len(run)
        }
        if found:
            table = pd.DataFrame(found).rename_axis("measure").reset_index()
            tables.append(table.assign(agent=agent, seed=seed))
    if not tables:
        return pd.DataFrame()
    both = pd.concat(tables, ignore_index=True)
    return both[
        ["agent", "seed", "measure", *(last for last in section.milestones if last in both)]
    ]


def _ending(games: pd.DataFrame, full: int) -> pd.Series:
    """How games (columns score and frames) end of which a full one has `full` frames."""
    won = (games.frames < full) & (games.score > 0)
    minutes = games.frames.sum() / FRAMES_PER_MINUTE
    return pd.Series(
        {
            "won by knock-out, %": 100 * won.mean(),
            "seconds per game": 60 * minutes / len(games),
            "net points per minute": games.score.sum() / minutes,
        }
    )


STYLE_MEASURES = {  # of `Section.styles`, by game
    "boxing": {
        "distance": "distance of the boxers (pixels)",
        "within_reach": "time within reach (%)",
        "punches_per_minute": "punches thrown per minute",
        "blows_per_minute": "punches landed per minute",
        "points_per_punch": "points scored per punch",
        "scored_per_minute": "points scored per minute",
        "conceded_per_minute": "points conceded per minute",
        "two_points": "blows for two points (% of those that score)",
        "knock_outs": "games won by knock-out (%)",
        "to_knock_out": "seconds to a knock-out",
        "at_ropes": "agent at the ropes (% of the time)",
        "rival_at_ropes": "rival at the ropes (% of the time)",
    },
    "breakout": {
        "slow": "slow balls returned (%)",
        "medium": "faster balls returned (%)",
        "fast": "fastest balls returned (%)",
        "sides": "lost at the sides (% of the balls lost)",
        "tunnels": "games with a tunnel (%)",
        "above": "points scored above the wall, per game",
    },
}
CHECKS = 5  # of greedy play, at either end of training, that are compared


def style_changes(section: Section) -> pd.DataFrame:
    """What changes in how agents play, from their first checks of greedy play to their last:
    columns agent, seed, measure (of `Section.styles`), first, last, the 95% interval of the change
    (low, high; Welch's, over checks, cut where the measure can go no further) and half_way: the
    training episodes after which the measure, smoothed over as many checks, has first gone half of
    its way; none where the interval holds zero, or where there is none. A mean is nan of fewer than
    two checks that have the measure."""
    rows: list[dict[str, object]] = []
    if section.styles.empty:
        return pd.DataFrame(rows)
    for (agent, seed), own in section.styles.groupby(["agent", "seed"], sort=False):
        measures = STYLE_MEASURES[section.params.game]
        checks = own.groupby("episode")[list(measures)].mean()
        if len(checks) < 2 * CHECKS:
            continue
        for measure in measures:
            series = checks[measure]
            first, last = series.iloc[:CHECKS].dropna(), series.iloc[-CHECKS:].dropna()
            ends = [_over_checks(own, measure, end.index) for end in (first, last)]
            low, high = np.nan, np.nan  # nothing to compare, such as fast balls at the beginning
            if not np.isnan(ends).any():
                low, high = welch_interval(last.to_numpy(), first.to_numpy())
            clear = low > 0 or high < 0
            most = 100 - ends[0] if "%" in measures[measure] else np.inf  # it can still go up
            low, high = max(low, -ends[0]), min(high, most)
            smooth = series.dropna().rolling(CHECKS, center=True).mean()
            way = (smooth - ends[0]) / (ends[1] - ends[0] or np.nan) >= 0.5
            rows.append(
                {
                    "agent": agent,
                    "seed": seed,
                    "measure": measure,
                    "first": ends[0],
                    "last": ends[1],
                    "low": low,
                    "high": high,
                    "half_way": int(way.idxmax()) if clear and way.any() else None,
                }
            )
    return pd.DataFrame(rows)


def _over_checks(games: pd.DataFrame, measure: str, checks: pd.Index) -> float:
    """The mean of a measure over the games of some checks, or over their balls where it is a share
    of these; nan of fewer than two checks."""
    games = games[games.episode.isin(checks)]
    weights = games.get(f"{measure}_of")
    return float(np.average(games[measure], weights=weights)) if len(checks) > 1 else np.nan


def values_reading(section: Section) -> str:
    """How far each agent's predicted values have been from what followed, with an interval over
    checks from three of them on; empty without checks."""
    said: list[str] = []
    if section.values.empty:
        return ""
    for (agent, seed), checks in section.values.groupby(["agent", "seed"], sort=False):
        seeds = f", seed {seed}" if len(section.params.seeds) > 1 else ""
        newest = checks.tail(NEWEST)
        last, errors = newest.iloc[-1], (newest.predicted - newest.realised).to_numpy()
        error = errors.mean()
        number = f"its last {len(newest)} checks" if len(newest) > 1 else "its only check"
        if len(newest) >= SOME:
            low, high = series_interval(errors)
            number += f" (95% interval of predicted less realised: {low:.1f} to {high:.1f})"
        said.append(
            f"{params.title(str(agent))}{seeds} predicts {abs(error):.1f} "
            f"{'more' if error >= 0 else 'less'} than follows, on average over {number}, and "
            f"{last.predicted:.1f} against {last.realised:.1f} at the last, after "
            f"{last.episode:,.0f} games"
        )
    return f"{'; '.join(said)}."


OBJECTIVES = {
    "Explore the concepts and methods of reinforcement learning": "@sec-background",
    "Understand the algorithms: architecture, training, mathematics": "@sec-design",
    "Build deep networks, losses and hyper-parameter tuning in PyTorch": (
        "@sec-networks, @sec-sensitivity"
    ),
    "Train agents in Gymnasium's environments": "@sec-results",
    "Evaluate: learning curves, convergence, interpretation": "@sec-findings",
    "Document and communicate": "this report; @sec-repeat",
}


def objectives() -> pd.DataFrame:
    """The source report's six learning objectives, and the sections that address them."""
    return pd.DataFrame(
        {"objective": OBJECTIVES.keys(), "where this study addresses it": OBJECTIVES.values()}
    )
