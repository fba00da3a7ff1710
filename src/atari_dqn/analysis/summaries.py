"""Sentences of the report that are computed: what the stored runs have shown so far."""

import pandas as pd

from atari_dqn import params
from atari_dqn.analysis.claims import FINDINGS, findings
from atari_dqn.analysis.statistics import MILESTONES, trailing_mean
from atari_dqn.analysis.study import Section, Study, data
from atari_dqn.analysis.verdicts import NOT_YET

EARLY = 500  # games, before which an agent still acts mostly at random
RECENT = 100  # games, of which the present score of a run in progress is the mean


def headline(study: Study) -> str:
    """One paragraph: how far the runs are, and how the claims stand."""
    section = study["boxing_final"]
    judged = findings(study).verdict.value_counts()
    done = judged.drop(NOT_YET, errors="ignore")
    games, means = _recent(section)
    if not games:
        played, planned = _played(study)
        text = f"Training has only begun: {played:,} of {planned:,} planned games are played."
    else:
        best, mean, facts = means.index[0], means.iloc[0], section.facts
        if section.complete:
            text = (
                f"The highest mean score in Boxing over the last {_window(section)} of {games:,} "
                f"training games is that of {best}, {mean:.1f} points"
            )
        else:
            who = f"the agent with the most points so far, {best}," if len(means) > 1 else best
            text = f"After {games:,} games of Boxing {who} scores {mean:.1f} points a game while "
            text += "still exploring"
        level = "above" if mean > facts.human else "below"
        text += f", {level} the human reference of {facts.human:g} (random play: {facts.random:g})."
    claims = f"{judged.sum()} claims of the source report that runs can judge"
    if done.empty:
        return f"**{text}** Of {claims}, none is judged yet."
    counted = ", ".join(f"{number} {verdict}" for verdict, number in done.items())
    so_far = " so far" if NOT_YET in judged else ""
    return f"**{text}** Of {claims}, {done.sum()} are judged{so_far} ({counted})."


def _window(section: Section) -> int:
    """How many games a present score is the mean of: of finished runs as many as the claims are
    about."""
    return section.milestone_window if section.complete else min(RECENT, section.params.episodes)


def _recent(section: Section) -> tuple[int, pd.Series]:
    """How many games all runs have played, but for those in their early games, and each agent's
    mean score over the last of these, the best first. 0 games and no scores if all are early."""
    none, episodes = (0, pd.Series(dtype=float)), section.episodes
    if episodes.empty:
        return none
    played = episodes.groupby(["agent", "seed"]).episode.transform("max")
    ready = played >= min(EARLY, section.params.episodes)
    if not ready.any():
        return none
    games = int(played[ready].min())
    recent = episodes[ready & episodes.episode.between(games - _window(section) + 1, games)]
    means = recent.groupby("agent").score.mean().rename(index=params.title)
    return games, means.sort_values(ascending=False)


def _played(study: Study) -> tuple[int, int]:
    """Training games of all experiments: stored, and planned."""
    sections = study.sections.values()
    planned = sum(len(each.runs) * each.params.episodes for each in sections)
    return sum(len(each.episodes) for each in sections), planned


def conclusion(study: Study) -> str:
    """A sentence a game on how the agents compare, and a list of the claims that are judged."""
    said = []
    for name in ("boxing_final", "breakout_final"):
        section = study[name]
        games, means = _recent(section)
        if not games:
            continue
        scores = ", ".join(f"{agent} {mean:.1f}" for agent, mean in means.items())
        text = f"In {section.facts.title}, mean scores over the last {_window(section)} of "
        text += f"{games:,} games are {scores} (human {section.facts.human:g})."
        played = section.episodes.groupby("agent").episode.max().rename(index=params.title)
        for agent in map(params.title, section.params.agents):
            if agent not in played:
                text += f" {agent} has not begun."
            elif agent not in means:
                text += f" {agent} has played {played[agent]:,} games only."
        said.append(f"{text} {beside_source(section)}".strip())
    if not said:
        played, planned = _played(study)
        said.append(
            f"With {played / planned:.1%} of the planned games played, no agent can be called the "
            "better one yet. What stands already does not depend on them: what the literature "
            "says (@tbl-literature), how the two games work (@sec-games), where the source report "
            "leaves a choice open (@tbl-deviations), and what training costs (@sec-speed)."
        )
    found = findings(study)
    for verdict, rows in found[found.verdict != NOT_YET].groupby("verdict", sort=False):
        said.append(f"*{str(verdict).capitalize()}*: {'; '.join(rows.claim)}.")
    return "\n\n".join(said)


def cards(study: Study) -> str:
    """Four numbers, as a division of class `card`."""
    section = study["boxing_final"]
    judged = findings(study).verdict
    games, means = _recent(section)
    numbers = [
        (
            f"{means.iloc[0]:.1f}",
            f"points in Boxing: {means.index[0]}, mean of {_window(section)} training games",
        )
        if games
        else ("–", f"points in Boxing: no agent has played {EARLY} games"),
        (f"{section.facts.human:g}", "points: a human tester's mean"),
        (f"{_played(study)[0]:,}", "training games stored"),
        (f"{(judged != NOT_YET).sum()} of {len(judged)}", "claims of the source report judged"),
    ]
    cells = "\n".join(f"::: {{}}\n**{number}** {what}\n:::" for number, what in numbers)
    return f":::: {{.card}}\n{cells}\n::::"


def reading(study: Study, experiment: str) -> str:
    """What an experiment has shown: a line a run, and the verdicts on the claims about it.

    Empty where nothing can be said yet.
    """
    section = study[experiment]
    lines = []
    if not section.episodes.empty:
        for (agent, seed), games in section.episodes.groupby(["agent", "seed"], sort=False):
            seeds = f", seed {seed}" if len(section.params.seeds) > 1 else ""
            greedy = [_of(table, agent, seed) for table in (section.evaluations, section.values)]
            said = _progress(section, games) + _without_exploring(*greedy)
            lines.append(f"- {params.title(str(agent))}{seeds}{said}.")
        if beside := beside_source(section):
            lines.append(f"- {beside}")
    waiting = []
    for number, claim in enumerate(FINDINGS, start=1):
        if experiment not in claim.experiments:
            continue
        found = claim.judge(study)
        if found.verdict == NOT_YET:
            waiting.append(str(number))
        else:
            said = f"{claim.text}. ({found.evidence})"
            lines.append(f"- *{found.verdict.capitalize()}*: claim {number}, {said}")
    if not lines:
        return ""
    if waiting:
        noun, verb = ("claims", "are") if len(waiting) > 1 else ("claim", "is")
        lines.append(f"- Of @tbl-findings, {noun} {', '.join(waiting)} {verb} still open.")
    head = "**What was found:**" if section.complete else "**What was found so far:**"
    return f"{head}\n\n" + "\n".join(lines)


def _of(table: pd.DataFrame, agent: object, seed: object) -> pd.DataFrame:
    """The rows of one run."""
    return table if table.empty else table[(table.agent == agent) & (table.seed == seed)]


def _progress(section: Section, games: pd.DataFrame) -> str:
    """How a run has gone: where it stands, when it passed the human score, how steady it was."""
    window, human = min(RECENT, section.params.episodes), section.facts.human
    number = int(games.episode.max())
    means = trailing_mean(games.set_index("episode").score, window).dropna()
    if means.empty:
        return f" has played {number:,} games, too few for a mean of {window}"
    text = (
        f" scores {means.iloc[-1]:.1f} points a game over the last {window} of {number:,} games, "
        f"{games.epsilon.iloc[-1]:.0%} of its actions being random"
    )
    above = means[means > human]
    if len(above) and section.default_difficulty:
        text += f"; the mean of {window} games first passed the human {human:g} after game "
        text += f"{above.index[0]:,}"
    fall = (means.cummax() - means).max()
    so_far = "" if number >= section.params.episodes else " so far"
    return f"{text}; the largest drop of that mean{so_far} is {fall:.1f} points"


def _without_exploring(evaluated: pd.DataFrame, checks: pd.DataFrame) -> str:
    """What a run scores without random moves: evaluated, or, if that is long ago, in the few greedy
    games along the way."""
    tried = 0 if evaluated.empty else int(evaluated.trained_games.max())
    checked = 0 if checks.empty else int(checks.episode.max())
    if not tried and not checked:
        return ""
    fresh = tried >= checked - RECENT
    count, games = (len(evaluated), tried) if fresh else (params.VALUE_GAMES, checked)
    score = evaluated.score.mean() if fresh else checks.score.iloc[-1]
    return f". Playing {count} games greedily after {games:,} of training, it scored {score:.1f}"


def beside_source(section: Section) -> str:
    """The scores of the source report beside ours, at the last milestone that both have; empty if
    there is none."""
    source, said, less = data("source_report"), [], False
    theirs = source.get(section.params.experiment, {})
    for agent, milestones in theirs.items() if section.params.episodes == MILESTONES[-1] else ():
        for milestone, score in reversed(list(zip(source["marks"], milestones, strict=True))):
            first = milestone - section.milestone_window + 1
            ours = section.scores(agent, first, milestone)
            if score is not None and len(ours):
                games = f"games {first:,} to {milestone:,}"
                said.append(f"{params.title(agent)} {ours.mean():.1f} and {score:.1f} ({games})")
                less |= ours.mean() < score
                break
    if not said:
        return ""
    text = f"Our scores and the source report's, where both are known: {', '.join(said)}."
    if less:
        text += (
            " (It does not say how often its network was updated, which decides how much is "
            f"learned in a game; ours is every {section.params.update_period} agent steps.)"
        )
    return text


def list_of_findings() -> str:
    """The claims as a list, for a reader who has not seen the source report."""
    listed = enumerate(FINDINGS, start=1)
    return "\n".join(f"{number}. {claim.text}." for number, claim in listed)


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
    """The source report's six learning objectives, and the sections that serve them."""
    return pd.DataFrame(
        {"objective": OBJECTIVES.keys(), "where this study serves it": OBJECTIVES.values()}
    )
