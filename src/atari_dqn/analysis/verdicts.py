"""Verdicts: what the stored runs say on a claim, with the evidence.

A verdict follows from a 95% interval of a mean, or of the difference of two: it is for the claim if
the whole interval lies on the claim's side of zero, against it if it lies on the other, unclear if
the interval holds zero, and open while a run that the claim is about has not got as far. (Of
intervals made in this way, about 95 of 100 hold the mean of endlessly many such episodes.)

The words say how much that means. From three seeds on each side, the interval is over seeds
(Welch's t: with so few, a bootstrap of seeds is too narrow), and a claim about an agent is
"supported" or "contradicted". With fewer, the interval is over blocks of 50 training episodes,
those of the same episodes paired, or over checks of greedy play: it tells how steady a difference
is within these runs and nothing about other seeds, and so does the word. Greedy episodes of
finished runs are compared likewise, or episode by episode (Welch's t); of episodes that repeat one
another, which few openings and hardly any chance bring about, only one counts as evidence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd

from atari_dqn import params
from atari_dqn.analysis.statistics import (
    BLOCK,
    blocks,
    by_cluster,
    cluster_interval,
    probability_of_improvement,
    series_interval,
    stratified_interval,
    student_interval,
    welch_interval,
)
from atari_dqn.analysis.study import Section, Study
from atari_dqn.games import GAMES
from atari_dqn.runs.run import as_trained

DQN, DOUBLE, DUELING = "dqn", "double_dqn", "dueling_double_dqn"
SEEDS = 3  # from which an interval is over seeds


class Outcome(Enum):
    """What runs say of a claim: in words for few seeds, and for `SEEDS` and more."""

    YES = ("in these runs: yes", "supported")
    NO = ("in these runs: no", "contradicted")
    UNCLEAR = ("in these runs: unclear", "inconclusive")
    OPEN = ("open", "open")
    UNTESTED = ("not tested", "not tested")


@dataclass(frozen=True)
class Verdict:
    """`evidence` is a sentence of computed numbers; `seeds` is how many it rests on, on the side
    that has fewer; `waits` are the experiments that it waits for."""

    outcome: Outcome
    evidence: str
    seeds: int = 1
    waits: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """The outcome in words."""
        return self.outcome.value[self.seeds >= SEEDS]


def all_of(verdicts: list[Verdict]) -> Verdict:
    """A claim of several parts stands if every part does, and falls with any of them."""
    outcomes = [verdict.outcome for verdict in verdicts]
    ranked = (Outcome.NO, Outcome.OPEN, Outcome.UNCLEAR, Outcome.YES)
    worst = next(outcome for outcome in ranked if outcome in outcomes)
    kept = [verdict for verdict in verdicts if worst != Outcome.OPEN or verdict.outcome == worst]
    said = [*dict.fromkeys(verdict.evidence for verdict in kept if not verdict.waits)]
    waits = tuple(dict.fromkeys(name for verdict in kept for name in verdict.waits))
    if waits:  # what is there may change the picture, but for a no
        said.append(_waiting(waits) + ", which cannot change this" * (worst == Outcome.NO))
    fewest = min(verdict.seeds for verdict in verdicts)
    most = max(verdict.seeds for verdict in verdicts if verdict.outcome == worst)
    seeds = most if worst == Outcome.NO else fewest
    return Verdict(worst, "; ".join(said), seeds, () if len(said) > 1 else waits)


def _waiting(experiments: Sequence[str]) -> str:
    return f"waiting for {' and '.join(experiments)}"


Rule = Callable[[float, float], Outcome]  # what an interval of a difference says of a claim


def more_by(margin: float) -> Rule:
    """The rule for "more, by more than `margin`"."""

    def rule(low: float, high: float) -> Outcome:
        if low > margin:
            return Outcome.YES
        return Outcome.NO if high < margin else Outcome.UNCLEAR

    return rule


MORE = more_by(0.0)


def apart(margin: float) -> Rule:
    """The rule for "another, by more than `margin` up or down"."""

    def rule(low: float, high: float) -> Outcome:
        if low > margin or high < -margin:
            return Outcome.YES
        return Outcome.NO if -margin < low and high < margin else Outcome.UNCLEAR

    return rule


@dataclass(frozen=True)
class Mean:
    """A mean training score, and its 95% interval."""

    mean: float
    low: float
    high: float
    seeds: int

    def __float__(self) -> float:
        return self.mean

    def __str__(self) -> str:
        return f"{self.mean:.1f} ({self.low:.1f} to {self.high:.1f})"


def mean_score(section: Section, agent: str, first: int, last: int) -> Mean | None:
    """The mean of an agent's training episodes `first` to `last`; None while a seed lacks any."""
    scores = section.scores(agent, first, last)
    if not _enough(section, scores):
        return None
    if len(scores) >= SEEDS:
        low, high = student_interval(scores.mean(axis=1))
    else:
        low, high = series_interval(blocks(scores.mean(axis=0)))
    return Mean(float(scores.mean()), low, high, len(scores))


def exceeds(section: Section, agent: str, first: int, last: int, score: float) -> Verdict:
    """That an agent's episodes `first` to `last` score more than `score` on average."""
    found = mean_score(section, agent, first, last)
    if found is None:
        return _not_yet(section)
    said = f"{params.title(agent)} {found} against {score:g}"
    return Verdict(more_by(score)(found.low, found.high), said, found.seeds)


def compare_scores(
    sections: tuple[Section, Section],
    agents: tuple[str, str],
    first: int,
    last: int,
    rule: Rule = MORE,
    gain: bool = False,
) -> Verdict:
    """How the scores of two agents, each in its section, differ in episodes `first` to `last`; by
    default, that the first scores more. With `gain`, what each scores above its own first 50
    episodes, which are then left out; `first` must be 1."""
    scores = [
        section.scores(agent, first, last) for section, agent in zip(sections, agents, strict=True)
    ]
    if not all(map(_enough, sections, scores)):
        return _not_yet(*dict.fromkeys(sections))
    doubt = 0.0  # of the first episodes' means, points: half an interval
    if gain:
        begins = [found[:, :BLOCK] for found in scores]
        errors = [np.var(begin) / begin.size for begin in begins]
        doubt = 1.96 * float(np.sqrt(sum(errors)))
        scores = [
            found[:, BLOCK:] - begin.mean(axis=1, keepdims=True)
            for found, begin in zip(scores, begins, strict=True)
        ]
    one, other = scores
    seeds = min(len(one), len(other))
    low, high = _difference(blocks(one), blocks(other))
    if seeds < SEEDS:
        middle, half = (low + high) / 2, float(np.hypot((high - low) / 2, doubt))
        low, high = middle - half, middle + half
    means = _against(sections, agents, [found.mean() for found in scores])
    said = f"{means}, difference {low:.1f} to {high:.1f}"
    if seeds >= SEEDS:
        said += f"; {_improvement(one.mean(axis=1), other.mean(axis=1))}"
    return Verdict(rule(low, high), said, seeds)


def _difference(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """95% interval of the difference of two means of float64 [seeds, points in time]: over seeds,
    or, if there are few, over points, those of the same time paired."""
    if min(len(one), len(other)) >= SEEDS:
        return welch_interval(one.mean(axis=1), other.mean(axis=1))
    return series_interval(one.mean(axis=0) - other.mean(axis=0))


def _improvement(one: np.ndarray, other: np.ndarray) -> str:
    """How often a seed of the first agent is above one of the second (Agarwal et al., 2021)."""
    chance = probability_of_improvement(one, other)
    low, high = stratified_interval(probability_of_improvement, one, other)
    return f"probability of improvement {chance:.0%} ({low:.0%} to {high:.0%})"


def _against(sections: tuple[Section, Section], agents: tuple[str, str], means: list[float]) -> str:
    """The two sides of a comparison, by what tells them apart."""
    names = [params.title(agent) for agent in agents]
    if agents[0] == agents[1]:
        names = [f"{section.title}," for section in sections]
        names[0] = f"{params.title(agents[0])}: {names[0]}"
    return " against ".join(f"{name} {mean:.1f}" for name, mean in zip(names, means, strict=True))


def _enough(section: Section, scores: np.ndarray) -> bool:
    """Whether all seeds have played the episodes [seeds, episodes], and there are blocks for a
    line."""
    return len(scores) == len(section.params.seeds) and scores.shape[1] >= 3 * BLOCK


def _not_yet(*sections: Section) -> Verdict:
    waits = [f"{each.title} ({_share(each)} played)" for each in sections if not each.complete]
    said = _waiting(waits) if waits else "too few games for an interval"
    return Verdict(Outcome.OPEN, said, waits=tuple(waits))


def _share(section: Section) -> str:
    return f"{section.share:.0%}" if section.share >= 0.01 or not section.share else "under 1%"


def last_episodes(section: Section) -> tuple[int, int]:
    """The episodes that a final score is the mean of."""
    episodes = section.params.episodes
    return episodes - section.milestone_window + 1, episodes


def milestone_episodes(section: Section, number: int) -> tuple[int, int]:
    """The episodes up to the `number`-th milestone (1 to 6)."""
    return (number - 1) * section.milestone_window + 1, number * section.milestone_window


def human_level(
    study: Study, experiment: str, agents: list[str] | None = None, milestone: int = 6
) -> Verdict:
    """The agents of an experiment, by default all, exceed the human reference at a milestone."""
    section = study[experiment]
    return all_of(
        [
            exceeds(section, agent, *milestone_episodes(section, milestone), section.facts.human)
            for agent in agents or section.params.agents
        ]
    )


def compare_agents(
    study: Study, experiment: str, best: str, others: list[str], milestone: int
) -> Verdict:
    """One agent is better than each of the others at a milestone."""
    section = study[experiment]
    episodes = milestone_episodes(section, milestone)
    return all_of(
        [compare_scores((section, section), (best, other), *episodes) for other in others]
    )


def compare_training(
    study: Study, first: str, second: str, milestone: int | None = None, **how: Any
) -> list[Verdict]:
    """That an agent scores more in the first experiment than in the second, up to a milestone of
    the longer one or at the last episodes of the shorter: a verdict for every agent. `how` is for
    `compare_scores`."""
    pair = (study[first], study[second])
    shorter, longer = sorted(pair, key=lambda section: section.params.episodes)
    episodes = (
        last_episodes(shorter) if milestone is None else milestone_episodes(longer, milestone)
    )
    return [compare_scores(pair, (agent, agent), *episodes, **how) for agent in _shared(pair)] or [
        _ALONE
    ]


_ALONE = Verdict(Outcome.OPEN, "no agent is trained both ways")  # as in the small profiles


def _shared(pair: tuple[Section, Section]) -> list[str]:
    return [agent for agent in pair[0].params.agents if agent in pair[1].params.agents]


def beats_variation(study: Study, experiment: str, sweep: str, variation: str) -> Verdict:
    """The agent of a sweep scores more in its unchanged set-up than with one change, over all
    episodes of the sweep."""
    changed = study[sweep].only(variation)
    if not changed.runs:
        return Verdict(Outcome.OPEN, f"no run of {changed.title}")
    agent, last = changed.params.agents[0], changed.params.episodes
    return compare_scores((study[experiment], changed), (agent, agent), 1, last)


def improves(study: Study, experiment: str, agent: str, until: int, episodes: int) -> Verdict:
    """An agent scores more in the last `episodes` of its training than in as many up to episode
    `until`."""
    section, last = study[experiment], study[experiment].params.episodes
    scores = section.scores(agent, 1, last)
    if not _enough(section, scores) or min(until, last - until, episodes) < 3 * BLOCK:
        return _not_yet(section)
    late, before = scores[:, last - episodes :], scores[:, max(0, until - episodes) : until]
    low, high = _difference(blocks(late), blocks(before))
    said = f"{params.title(agent)} over the last {episodes:,} of {last:,} games, and up to "
    said += f"{until:,}: {late.mean():.1f} against {before.mean():.1f}, difference {low:.1f} to "
    said += f"{high:.1f}"
    return Verdict(MORE(low, high), said, len(scores))


def improves_greedily(
    study: Study, experiment: str, agent: str, until: int, episodes: int
) -> Verdict:
    """An agent's checks of greedy play in the last `episodes` of its training score more than those
    in as many up to episode `until`: what it has learned, and not that it explores less."""
    section, last = study[experiment], study[experiment].params.episodes
    checks = _checks(section.values, section, agent, last, "score")
    after = np.array(checks.columns)
    late = checks.loc[:, after > last - episodes].to_numpy()
    before = checks.loc[:, (after > until - episodes) & (after <= until)].to_numpy()
    if min(late.shape[1], before.shape[1]) < 3:
        return _not_yet(section)
    low, high = _difference(late, before)
    said = f"{params.title(agent)} in greedy games over the last {episodes:,} of {last:,} training "
    said += f"games, and up to {until:,}: {late.mean():.1f} against {before.mean():.1f}, "
    said += f"difference {low:.1f} to {high:.1f}"
    return Verdict(MORE(low, high), said, len(late))


def compare_evaluations(study: Study, first: str, second: str) -> list[Verdict]:
    """That an agent's greedy episodes after training in the first experiment score more than those
    after training in the second: a verdict for every agent."""
    pair = (study[first], study[second])
    verdicts = []
    for agent in _shared(pair):
        played = [_greedy_episodes(section, agent) for section in pair]
        if any(
            found.empty
            or found.opening.nunique() < 2
            or found.seed.nunique() < len(section.params.seeds)
            for section, found in zip(pair, played, strict=True)
        ):
            verdicts.append(_not_yet(*pair))
            continue
        seeds = min(found.seed.nunique() for found in played)
        if seeds >= SEEDS:
            one, other = (found.groupby("seed").score.mean().to_numpy() for found in played)
            low, high = welch_interval(one, other)
        else:
            one, other = (by_cluster(found.score, found.opening) for found in played)
            low, high = welch_interval(one, other)
        means = _against(pair, (agent, agent), [one.mean(), other.mean()])
        said = f"evaluated: {means}, difference {low:.1f} to {high:.1f}"
        verdicts.append(Verdict(MORE(low, high), said, seeds))
    return verdicts or [_ALONE]


def _greedy_episodes(section: Section, agent: str) -> pd.DataFrame:
    """The evaluation episodes of the agent's finished runs, played as it was trained."""
    table = as_trained(section.final_evaluations, section.params)
    return table if table.empty else table[table.agent == agent]


def compare_greedy_checks(study: Study, first: str, second: str) -> list[Verdict]:
    """That an agent learns more in the first experiment than in the second: what it scores greedily
    every hundred episodes, for as long as the shorter one trains, after the same training."""
    pair = (study[first], study[second])
    until = min(section.params.episodes for section in pair)
    verdicts = []
    for agent in _shared(pair):
        one, other = (_checks(section.values, section, agent, until, "score") for section in pair)
        common = one.columns.intersection(other.columns)
        if len(common) < 3:
            verdicts.append(_not_yet(*pair))
            continue
        sides = one[common].to_numpy(), other[common].to_numpy()
        low, high = _difference(*sides)
        means = _against(pair, (agent, agent), [found.mean() for found in sides])
        said = f"greedy games along the way: {means}, difference {low:.1f} to {high:.1f}"
        verdicts.append(Verdict(MORE(low, high), said, min(map(len, sides))))
    return verdicts or [_ALONE]


def _checks(
    table: pd.DataFrame, section: Section, agent: str, until: int, column: str
) -> pd.DataFrame:
    """A column of the checks along an agent's training, a row per seed and a column per episode up
    to `until`; empty until all seeds have played that many."""
    played = section.scores(agent, until, until)
    if table.empty or len(played) < len(section.params.seeds):
        return pd.DataFrame()
    own = table[(table.agent == agent) & (table.episode <= until)]
    return own.groupby(["seed", "episode"])[column].mean().unstack().dropna(axis=1)


SAME_SCORE = 5.0  # points; checks that score no further apart count as of the same skill


def compare_style(study: Study, first: str, second: str, measure: str) -> list[Verdict]:
    """That an agent's boxing has more of `measure` (a column of `Section.styles`) with the settings
    of the first experiment than with those of the second: a verdict for every agent.

    Whatever the settings, an agent that learns to box concedes less and stands elsewhere than
    before: two checkpoints of one run can differ by more than two settings do. So a measure of
    style is one of skill too, and two comparisons must agree. The first is after the same training:
    the checks of greedy play in the second half of the shorter run, beside those of the other run
    after as many episodes. The second is at the same skill: each of these checks beside that check
    of the other run, from any part of its training, whose score is nearest, if it is within
    `SAME_SCORE` points. (Of two agents with the same score, the one that concedes more points
    scores more, too: it takes more risks.) Where hardly any checks score alike, the difference may
    be one of skill alone, and the verdict is unclear.
    """
    pair = (study[first], study[second])
    until = min(section.params.episodes for section in pair)
    verdicts = []
    for agent in _shared(pair):
        tables = [
            [_checks(section.styles, section, agent, until, name) for name in (measure, "score")]
            for section in pair
        ]
        late = [
            episode
            for episode in tables[0][0].columns.intersection(tables[1][0].columns)
            if episode > until / 2
        ]
        if len(late) < 3:
            verdicts.append(_not_measured(*pair))
            continue
        (one, score), (other, other_score) = (
            [table[late].to_numpy() for table in found] for found in tables
        )
        low, high = _difference(one, other)
        means = _against(pair, (agent, agent), [one.mean(), other.mean()])
        said = f"{measure.replace('_', ' ')} after the same training, scoring {score.mean():.1f} "
        said += f"and {other_score.mean():.1f}: {means}, difference {low:.1f} to {high:.1f}"
        trained = Verdict(MORE(low, high), said, min(len(one), len(other)))
        verdicts.append(all_of([trained, _at_same_score(pair, agent, measure, late)]))
    return verdicts or [_ALONE]


def _not_measured(*sections: Section) -> Verdict:
    """What is missing of two experiments' styles: training, or measuring it."""
    if all(section.complete for section in sections):
        return Verdict(Outcome.OPEN, "the styles of their greedy games are not measured yet")
    return _not_yet(*sections)


def _at_same_score(
    pair: tuple[Section, Section], agent: str, measure: str, late: list[int]
) -> Verdict:
    """That an agent's checks after the episodes `late` have more of a measure than those checks of
    the other section that score alike."""
    ours, theirs = (
        section.styles[section.styles.agent == agent]
        .groupby(["seed", "episode"])[[measure, "score"]]
        .mean()
        .reset_index()
        for section in pair
    )
    ours = ours[ours.episode.isin(late)]
    gaps = np.abs(np.subtract.outer(ours.score.to_numpy(), theirs.score.to_numpy()))
    matched = ours.assign(other=theirs[measure].to_numpy()[gaps.argmin(axis=1)])
    matched = matched[gaps.min(axis=1) <= SAME_SCORE]
    seeds = min(ours.seed.nunique(), theirs.seed.nunique())
    if len(matched) < 3 or matched.seed.nunique() < ours.seed.nunique():
        said = f"only {len(matched)} of {len(ours)} checks have one of the same score beside them"
        return Verdict(Outcome.UNCLEAR, said, seeds)
    differences = matched[measure] - matched.other
    if seeds >= SEEDS:
        low, high = student_interval(differences.groupby(matched.seed).mean().to_numpy())
    else:
        low, high = series_interval(differences.groupby(matched.episode).mean().to_numpy())
    said = f"at the same score: {matched[measure].mean():.1f} against {matched.other.mean():.1f}, "
    said += f"difference {low:.1f} to {high:.1f}"
    return Verdict(MORE(low, high), said, seeds)


def overestimation(study: Study, experiment: str) -> Verdict:
    """Double DQN's predictions exceed what it realises by less than DQN's do, in the second half
    of the episodes; checks of the two after the same episodes are compared."""
    section = study[experiment]
    last, values = section.params.episodes, section.values
    if values.empty:
        return _not_yet(section)
    late = values[values.episode > last / 2].assign(gap=values.predicted - values.realised)
    dqn, double = (_checks(late, section, agent, last, "gap") for agent in (DQN, DOUBLE))
    common = dqn.columns.intersection(double.columns)
    if len(common) < 3 or common.max() < last:
        return _not_yet(section)
    sides = dqn[common].to_numpy(), double[common].to_numpy()
    low, high = _difference(*sides)
    said = ", ".join(
        f"{params.title(agent)} {gaps.mean():+.2f}"
        for agent, gaps in zip((DQN, DOUBLE), sides, strict=True)
    )
    returns = " and ".join(
        f"{_checks(late, section, agent, last, 'realised')[common].to_numpy().mean():.2f}"
        for agent in (DQN, DOUBLE)
    )
    return Verdict(
        MORE(low, high),
        f"mean gap of {said}; DQN's is larger by {low:.2f} to {high:.2f} (on returns of {returns})",
        min(map(len, sides)),
    )


def compare_steadiness(
    study: Study, steady: tuple[str, str], unsteady: tuple[str, str], until: int
) -> Verdict:
    """The curve of one (experiment, agent) is smoother than another's, up to episode `until`: how
    far each block of episodes is from the middle of its neighbours (points, squared), less what the
    luck of its episodes explains."""
    sections, rough, levels = (study[steady[0]], study[unsteady[0]]), [], []
    for section, (_, agent) in zip(sections, (steady, unsteady), strict=True):
        scores = section.scores(agent, 1, until)
        if not _enough(section, scores) or scores.shape[1] < 5 * BLOCK:
            return _not_yet(*dict.fromkeys(sections))
        means = blocks(scores)
        whole = scores[:, scores.shape[1] % BLOCK :].reshape(len(scores), -1, BLOCK)
        luck = whole.var(axis=2, ddof=1).mean(axis=1, keepdims=True) / BLOCK  # of a block's mean
        bends = means[:, 1:-1] - (means[:, :-2] + means[:, 2:]) / 2
        rough.append(bends**2 - 1.5 * luck)
        levels.append(f"{scores.mean():.1f}")
    low, high = _difference(rough[1], rough[0])
    roots = [float(np.sqrt(max(found.mean(), 0))) for found in rough]
    said = _against(sections, (steady[1], unsteady[1]), roots)
    return Verdict(
        MORE(low, high),
        f"swings beyond the luck of the games, in points: {said}; difference of their squares "
        f"{low:.1f} to {high:.1f} (mean scores {' and '.join(levels)})",
        min(map(len, rough)),
    )


DIFFICULTIES = len(GAMES["boxing"].difficulties)


def beaten_everywhere(study: Study) -> Verdict:
    """Every final agent wins on average at every difficulty, without sticky actions; all were
    trained at the default. The evidence gives the difficulty at which each scores least."""
    section = study["boxing_final"]
    played = section.final_evaluations
    if not played.empty:
        as_trained = played.epsilon == section.params.evaluation_epsilon
        played = played[(played.sticky_actions == 0) & as_trained]
    if played.empty:
        planned = f"{DIFFICULTIES} difficulties planned"
        said = f"none of the {len(section.params.agents)} agents evaluated yet ({planned})"
        return Verdict(Outcome.OPEN, said)
    verdicts = []
    for agent in section.params.agents:
        own = played[played.agent == agent]
        verdicts.append(_beaten_by(agent, own, len(section.params.seeds)))
    found = all_of(verdicts)
    if found.outcome == Outcome.OPEN:  # what there is says much already
        return replace(found, evidence="; ".join(verdict.evidence for verdict in verdicts))
    hardest = played.groupby("difficulty").score.mean().idxmin()
    said = f"the hardest by these scores is difficulty {hardest}; {found.evidence}"
    return Verdict(found.outcome, said, found.seeds)


def _beaten_by(agent: str, played: pd.DataFrame, planned: int) -> Verdict:
    """An agent wins on average at every difficulty of its evaluation episodes."""
    seeds = pd.Series(dtype=int)
    if not played.empty:
        begun = played.groupby(["difficulty", "seed"]).opening.nunique()
        seeds = begun[begun > 1].groupby("difficulty").size()
    if (tested := int((seeds >= planned).sum())) < DIFFICULTIES:
        said = f"the final {params.title(agent)} is evaluated at {tested} of {DIFFICULTIES} "
        said += "difficulties"
        return Verdict(Outcome.OPEN, f"{said} so far")
    parts = {}
    for difficulty, found in played.groupby("difficulty"):
        if planned >= SEEDS:
            low, high = student_interval(found.groupby("seed").score.mean().to_numpy())
        else:
            low, high = cluster_interval(found.score, found.opening)
        parts[difficulty] = (Mean(found.score.mean(), low, high, planned), MORE(low, high))
    hardest = min(parts, key=lambda difficulty: parts[difficulty][0].mean)
    won = sum(outcome == Outcome.YES for _, outcome in parts.values())
    where = "all difficulties" if won == DIFFICULTIES else f"{won} of {DIFFICULTIES} difficulties"
    said = f"{params.title(agent)} wins at {where}, and scores least at difficulty {hardest}: "
    said += f"{parts[hardest][0]}"
    return all_of([Verdict(outcome, said, planned) for _, outcome in parts.values()])


def negated(verdict: Verdict) -> Verdict:
    """The verdict on the opposite claim."""
    opposite = {Outcome.YES: Outcome.NO, Outcome.NO: Outcome.YES}
    return replace(verdict, outcome=opposite.get(verdict.outcome, verdict.outcome))


def runs_finished(study: Study, names: list[str]) -> Verdict:
    """An aim that is reached when its runs are there, whatever their seeds."""
    sections = [study[name] for name in names]
    planned = [section.planned for section in sections]
    share = np.average([section.share for section in sections], weights=planned)
    done = all(section.complete for section in sections)
    said = "; ".join(f"{section.title}: {_share(section)}" for section in sections)
    said = f"{share:.0%} of the games played ({said})"
    return Verdict(Outcome.YES if done else Outcome.OPEN, said, SEEDS)
