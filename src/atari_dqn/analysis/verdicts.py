"""Verdicts: what the stored runs say on a claim, with the evidence.

A verdict follows from a 95% interval of a mean, or of the difference of two: `supported` if the
whole interval lies on the claim's side of zero, `contradicted` if it lies on the other,
`inconclusive` if it holds zero, `open` while a run that the claim is about has not got as far.

The interval is over seeds (Welch's t) where both sides have three or more. With fewer it is over
blocks of 50 training games, of which those of two runs that hold the same games are paired: it
then says how steady the difference is within these runs, and nothing about other seeds. Greedy
games of finished runs are compared likewise, or game by game (Welch's t); of games that repeat one
another, which few openings and hardly any chance bring about, only one counts as evidence.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from atari_dqn import params
from atari_dqn.analysis.statistics import (
    BLOCK,
    blocks,
    series_interval,
    student_interval,
    welch_interval,
)
from atari_dqn.analysis.study import Section, Study

SUPPORTED, CONTRADICTED = "supported", "contradicted"
INCONCLUSIVE, NOT_YET = "inconclusive", "open"
DQN, DOUBLE, DUELING = "dqn", "double_dqn", "dueling_double_dqn"
SEEDS = 3  # from which an interval is over seeds


@dataclass(frozen=True)
class Verdict:
    """`evidence` is a sentence of computed numbers."""

    verdict: str
    evidence: str


def all_of(verdicts: list[Verdict]) -> Verdict:
    """A claim of several parts stands if every part does, and falls with any of them."""
    kinds = [verdict.verdict for verdict in verdicts]
    ranked = (CONTRADICTED, NOT_YET, INCONCLUSIVE, SUPPORTED)
    worst = next(kind for kind in ranked if kind in kinds)
    evidence = dict.fromkeys(
        verdict.evidence
        for verdict in verdicts
        if worst != NOT_YET or verdict.verdict == NOT_YET  # what is there may change the picture
    )
    return Verdict(worst, "; ".join(evidence))


def exceeds(section: Section, agent: str, first: int, last: int, score: float) -> Verdict:
    """That an agent's games `first` to `last` score more than `score` on average."""
    scores = section.scores(agent, first, last)
    if not _enough(section, scores):
        return _not_yet(section)
    if len(scores) >= SEEDS:
        low, high = student_interval(scores.mean(axis=1))
    else:
        low, high = series_interval(blocks(scores.mean(axis=0)))
    said = f"{params.title(agent)} {scores.mean():.1f} ({low:.1f} to {high:.1f})"
    return Verdict(_side(low - score, high - score), f"{said} against {score:g}")


def compare_scores(
    sections: tuple[Section, Section],
    agents: tuple[str, str],
    first: int,
    last: int,
    margin: float = 0.0,
    gain: bool = False,
) -> Verdict:
    """That the first of two agents, each in its section, scores more in games `first` to `last`,
    by more than `margin`. With `gain`, what each scores above its own first 50 games, which
    are then left out; `first` must be 1."""
    scores = [
        section.scores(agent, first, last) for section, agent in zip(sections, agents, strict=True)
    ]
    if not all(map(_enough, sections, scores)):
        return _not_yet(*dict.fromkeys(sections))
    doubt = 0.0  # of the first games' means, points: half an interval
    if gain:
        begins = [found[:, :BLOCK] for found in scores]
        errors = [np.var(begin) / begin.size for begin in begins]
        doubt = 1.96 * float(np.sqrt(sum(errors)))
        scores = [
            found[:, BLOCK:] - begin.mean(axis=1, keepdims=True)
            for found, begin in zip(scores, begins, strict=True)
        ]
    one, other = scores
    if min(len(one), len(other)) >= SEEDS:
        low, high = welch_interval(one.mean(axis=1), other.mean(axis=1))
    else:
        low, high = series_interval(blocks(one.mean(axis=0) - other.mean(axis=0)))
        middle, half = (low + high) / 2, float(np.hypot((high - low) / 2, doubt))
        low, high = middle - half, middle + half
    means = _against(sections, agents, [found.mean() for found in scores])
    return Verdict(
        _side(low - margin, high - margin), f"{means}, difference {low:.1f} to {high:.1f}"
    )


def _against(sections: tuple[Section, Section], agents: tuple[str, str], means: list[float]) -> str:
    """The two sides of a comparison, by what tells them apart."""
    names = [params.title(agent) for agent in agents]
    if agents[0] == agents[1]:
        names = [f"`{section.params.experiment}`" for section in sections]
        names[0] = f"{params.title(agents[0])}: {names[0]}"
    return " against ".join(f"{name} {mean:.1f}" for name, mean in zip(names, means, strict=True))


def _enough(section: Section, scores: np.ndarray) -> bool:
    """Whether all seeds have played the games [seeds, games], and there are blocks for a line."""
    return len(scores) == len(section.params.seeds) and scores.shape[1] >= 3 * BLOCK


def _not_yet(*sections: Section) -> Verdict:
    shares = [
        f"`{each.params.experiment}` {_share(each)}" for each in sections if not each.complete
    ]
    said = f"games played: {', '.join(shares)}" if shares else "too few games for an interval"
    return Verdict(NOT_YET, said)


def _share(section: Section) -> str:
    return f"{section.share:.0%}" if section.share >= 0.01 or not section.share else "under 1%"


def _side(low: float, high: float) -> str:
    if low > 0:
        return SUPPORTED
    return CONTRADICTED if high < 0 else INCONCLUSIVE


def _last(section: Section) -> tuple[int, int]:
    """The games that a final score is the mean of."""
    episodes = section.params.episodes
    return episodes - section.milestone_window + 1, episodes


def _milestone(section: Section, number: int) -> tuple[int, int]:
    """The games up to the `number`-th milestone (1 to 6)."""
    return (number - 1) * section.milestone_window + 1, number * section.milestone_window


def human_level(
    study: Study, experiment: str, agents: list[str] | None = None, milestone: int = 6
) -> Verdict:
    """The agents of an experiment, by default all, exceed the human reference at a milestone."""
    section = study[experiment]
    return all_of(
        [
            exceeds(section, agent, *_milestone(section, milestone), section.facts.human)
            for agent in agents or section.params.agents
        ]
    )


def compare_agents(
    study: Study, experiment: str, best: str, others: list[str], milestone: int
) -> Verdict:
    """One agent is better than each of the others at a milestone."""
    section = study[experiment]
    games = _milestone(section, milestone)
    return all_of([compare_scores((section, section), (best, other), *games) for other in others])


def compare_training(
    study: Study, first: str, second: str, milestone: int | None = None, **how: Any
) -> list[Verdict]:
    """That an agent scores more in the first experiment than in the second, up to a milestone of
    the longer one or at the last games of the shorter: a verdict for every agent. `how` is for
    `compare_scores`."""
    pair = (study[first], study[second])
    shorter, longer = sorted(pair, key=lambda section: section.params.episodes)
    games = _last(shorter) if milestone is None else _milestone(longer, milestone)
    return [compare_scores(pair, (agent, agent), *games, **how) for agent in _shared(pair)] or [
        _ALONE
    ]


_ALONE = Verdict(NOT_YET, "no agent is trained both ways")  # as in the small profiles


def _shared(pair: tuple[Section, Section]) -> list[str]:
    return [agent for agent in pair[0].params.agents if agent in pair[1].params.agents]


def compare_evaluations(
    study: Study, first: str, second: str, column: str = "score"
) -> list[Verdict]:
    """That an agent's greedy games after training in the first experiment have more of something
    than those after training in the second: a verdict for every agent."""
    pair = (study[first], study[second])
    verdicts = []
    for agent in _shared(pair):
        games = [_greedy_games(section, agent) for section in pair]
        if any(
            len(found) < 2 or found.seed.nunique() < len(section.params.seeds)
            for section, found in zip(pair, games, strict=True)
        ):
            verdicts.append(_not_yet(*pair))
            continue
        if min(found.seed.nunique() for found in games) >= SEEDS:
            one, other = (found.groupby("seed")[column].mean().to_numpy() for found in games)
            low, high = welch_interval(one, other)
        else:
            one, other = (found[column].to_numpy(float) for found in games)
            low, high = welch_interval(one, other, (_distinct(games[0]), _distinct(games[1])))
        means = _against(pair, (agent, agent), [one.mean(), other.mean()])
        name = column.replace("_", " ")
        said = f"{name}, greedy: {means}, difference {low:.1f} to {high:.1f}"
        verdicts.append(Verdict(_side(low, high), said))
    return verdicts or [_ALONE]


def _greedy_games(section: Section, agent: str) -> pd.DataFrame:
    """The evaluation games of the agent's finished runs, played as it was trained."""
    table = section.as_trained(section.final_evaluations)
    return table if table.empty else table[table.agent == agent]


def _distinct(games: pd.DataFrame) -> int:
    """How many of some evaluation games do not repeat another."""
    return len(games.drop_duplicates(["seed", "score", "length", "distance"]))


def compare_greedy_checks(study: Study, first: str, second: str) -> list[Verdict]:
    """That an agent learns more in the first experiment than in the second: what it scores greedily
    every hundred games, for as long as the shorter one trains, after the same games of training."""
    pair = (study[first], study[second])
    until = min(section.params.episodes for section in pair)
    verdicts = []
    for agent in _shared(pair):
        one, other = (_checks(section, agent, until) for section in pair)
        gaps = (one - other).dropna()
        if len(gaps) < 3:
            verdicts.append(_not_yet(*pair))
            continue
        low, high = series_interval(gaps.to_numpy())
        means = _against(pair, (agent, agent), [one.mean(), other.mean()])
        said = f"greedy games along the way: {means}, difference {low:.1f} to {high:.1f}"
        verdicts.append(Verdict(_side(low, high), said))
    return verdicts or [_ALONE]


def _checks(section: Section, agent: str, until: int) -> pd.Series:
    """Greedy scores along an agent's training, by games of it; empty until all seeds have played
    that many."""
    played = section.scores(agent, until, until)
    if section.values.empty or len(played) < len(section.params.seeds):
        return pd.Series(dtype=float)
    own = section.values[(section.values.agent == agent) & (section.values.episode <= until)]
    return own.groupby("episode").score.mean()


def overestimation(study: Study, experiment: str) -> Verdict:
    """Double DQN's predictions exceed what it realises by less than DQN's do, in the second half
    of the games; checks of the two after the same games are compared."""
    section = study[experiment]
    values = section.values
    if values.empty:
        return _not_yet(section)
    late = values[values.episode > section.params.episodes / 2]
    gaps = (late.predicted - late.realised).groupby([late.agent, late.episode]).mean().unstack(0)
    if not {DQN, DOUBLE} <= set(gaps) or gaps.dropna().index.max() < section.params.episodes:
        return _not_yet(section)
    gaps = gaps.dropna()
    if len(gaps) < 3:
        return _not_yet(section)
    low, high = series_interval((gaps[DQN] - gaps[DOUBLE]).to_numpy())
    said = ", ".join(f"{params.title(agent)} {gaps[agent].mean():+.2f}" for agent in (DQN, DOUBLE))
    return Verdict(
        _side(low, high), f"mean gap of {said}; DQN's is larger by {low:.2f} to {high:.2f}"
    )


def compare_steadiness(study: Study, steady: str, unsteady: str, agent: str) -> Verdict:
    """An agent's curve is smoother in the first experiment than in the second, over the games of
    the second: how far each block of games is from the middle of its neighbours (points, squared),
    less what the luck of its games explains."""
    rough = []
    for name in (steady, unsteady):
        scores = study[name].scores(agent, 1, study[unsteady].params.episodes)
        if not _enough(study[name], scores) or scores.shape[1] < 5 * BLOCK:
            return _not_yet(study[steady], study[unsteady])
        curve = scores.mean(axis=0)
        means = blocks(curve)
        whole = curve[len(curve) % BLOCK :].reshape(-1, BLOCK)
        luck = whole.var(axis=1, ddof=1).mean() / BLOCK  # of a block's mean, points squared
        bends = means[1:-1] - (means[:-2] + means[2:]) / 2
        rough.append(bends**2 - 1.5 * luck)
    low, high = series_interval(rough[1] - rough[0])
    said = " against ".join(
        f"`{name}` {np.sqrt(max(found.mean(), 0)):.1f}"
        for name, found in zip((steady, unsteady), rough, strict=True)
    )
    return Verdict(
        _side(low, high),
        f"roughness, points: {said}; difference of their squares {low:.1f} to {high:.1f}",
    )


def beaten_everywhere(study: Study) -> Verdict:
    """Dueling Double DQN, the most refined agent, wins on average at every difficulty, without
    sticky actions; it was trained at the first."""
    section = study["boxing_final"]
    games = section.final_evaluations
    if not games.empty:
        as_trained = games.epsilon == section.params.evaluation_epsilon
        games = games[(games.agent == DUELING) & (games.sticky_actions == 0) & as_trained]
    sizes = pd.Series() if games.empty else games.groupby("difficulty").size()
    played = int((sizes > 1).sum())
    if played < 4:
        return Verdict(
            NOT_YET, f"{params.title(DUELING)} is evaluated at {played} of 4 difficulties so far"
        )
    parts = []
    for difficulty, found in games.groupby("difficulty"):
        by_seed = found.groupby("seed").score.mean().to_numpy()
        if len(by_seed) >= SEEDS:
            low, high = student_interval(by_seed)
        else:
            low, high = student_interval(found.score.to_numpy(), _distinct(found))
        said = f"difficulty {difficulty}: {found.score.mean():.1f} ({low:.1f} to {high:.1f}), "
        said += f"{(found.knockout == 1).mean():.0%} by knock-out"
        parts.append(Verdict(_side(low, high), said))
    return all_of(parts)


def negated(verdict: Verdict) -> Verdict:
    """The verdict on the opposite claim."""
    opposite = {SUPPORTED: CONTRADICTED, CONTRADICTED: SUPPORTED}
    return Verdict(opposite.get(verdict.verdict, verdict.verdict), verdict.evidence)


def runs_finished(study: Study, names: list[str]) -> Verdict:
    """An aim that is reached when its runs are there."""
    sections = [study[name] for name in names]
    share = np.mean([section.share for section in sections])
    done = all(section.complete for section in sections)
    said = ", ".join(f"`{section.params.experiment}` {_share(section)}" for section in sections)
    return Verdict(SUPPORTED if done else NOT_YET, f"{share:.0%} of the games played ({said})")
