"""Sentences of the report that are computed: what the stored runs have shown so far."""

import pandas as pd

from atari_dqn import runs
from atari_dqn.claims import FINDINGS, findings
from atari_dqn.sections import Section, Study
from atari_dqn.statistics import trailing_mean
from atari_dqn.verdicts import NOT_YET

EARLY = 500  # games, before which an agent still acts mostly at random
RECENT = 100  # games, of which a run's present score is the mean


def headline(study: Study) -> str:
    """One paragraph: how far the runs are, and how the claims stand."""
    section = study["boxing_final"]
    judged = findings(study).verdict.value_counts()
    done = judged.drop(NOT_YET, errors="ignore")
    games, means = _recent(section)
    if games < min(EARLY, section.params.episodes):
        played, planned = _played(study)
        text = f"Training has only begun: {played:,} of {planned:,} planned games are played."
    else:
        level = "above" if means.iloc[0] > section.facts.human else "below"
        text = (
            f"After {games:,} games of Boxing the agent with the most points so far, "
            f"{means.index[0]}, scores {means.iloc[0]:.1f} a game while still exploring, {level} "
            f"the human reference of {section.facts.human:g} (random play: "
            f"{section.facts.random:g})."
        )
    claims = f"{judged.sum()} claims of the source report that runs can judge"
    if done.empty:
        return f"**{text}** Of {claims}, none is judged yet."
    counted = ", ".join(f"{number} {verdict}" for verdict, number in done.items())
    return f"**{text}** Of {claims}, {done.sum()} are judged so far ({counted})."


def _recent(section: Section) -> tuple[int, pd.Series]:
    """How many games all agents that have begun have played, and each one's mean score over the
    last `RECENT` of these, the best first; 0 games and no scores if too few are played."""
    episodes = section.episodes
    if episodes.empty:
        return 0, pd.Series(dtype=float)
    games = int(episodes.groupby(["agent", "seed"]).episode.max().min())
    if games < min(RECENT, section.params.episodes):
        return 0, pd.Series(dtype=float)
    recent = episodes[episodes.episode.between(games - RECENT + 1, games)]
    means = recent.groupby("agent").score.mean().sort_values(ascending=False)
    return games, means.rename(index=runs.title)


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
        if games < min(EARLY, section.params.episodes):
            continue
        scores = ", ".join(f"{agent} {mean:.1f}" for agent, mean in means.items())
        text = f"In {section.facts.title}, mean scores over the last {min(RECENT, games)} of "
        text += f"{games:,} games are {scores} (human {section.facts.human:g})."
        missing = [runs.title(agent) for agent in section.params.agents]
        missing = [agent for agent in missing if agent not in means]
        if missing:
            text += f" {' and '.join(missing)} {'has' if len(missing) == 1 else 'have'} not begun."
        said.append(text)
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
            f"points in Boxing: {means.index[0]}, mean of {min(RECENT, games)} training games",
        )
        if games
        else ("–", f"points in Boxing: not all agents begun have played {RECENT} games"),
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
            own = section.values
            checks = own[(own.agent == agent) & (own.seed == seed)] if not own.empty else own
            lines.append(f"- {runs.title(str(agent))}{seeds}{_progress(section, games, checks)}.")
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


def _progress(section: Section, games: pd.DataFrame, checks: pd.DataFrame) -> str:
    """How a run has gone: where it stands, when it passed the human score, how steady it was, and
    what it scores without random moves."""
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
    if len(above):
        text += f"; the mean of {window} games first passed the human {human:g} after game "
        text += f"{above.index[0]:,}"
    fall = (means.cummax() - means).max()
    text += f"; the largest drop of that mean so far is {fall:.1f} points"
    if not checks.empty:
        last = checks.iloc[-1]
        text += f". Playing greedily after {last.episode:,.0f} games, it scored {last.score:.1f} "
        text += "(four games)"
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
