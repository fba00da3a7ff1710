"""What the source report claims, held against the stored runs: a verdict with its evidence each.

A comparison is of mean scores of training games, with a bootstrap interval of the difference:
`supported` if the whole interval lies on the claim's side of zero, `contradicted` if it lies on
the other, `inconclusive` if it holds zero, `open` while a run that the claim is about has not got
as far. Games of one run follow one another while its agent changes, so that whole blocks of them
are resampled; the intervals say nothing about other seeds.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from atari_dqn import runs
from atari_dqn.agents import AGENTS
from atari_dqn.sections import Section, Study
from atari_dqn.statistics import BLOCK, blocks, difference, interval

SUPPORTED, CONTRADICTED = "supported", "contradicted"
INCONCLUSIVE, NOT_YET = "inconclusive", "open"
DQN, DOUBLE, DUELING = AGENTS
REFINED = [DOUBLE, DUELING]


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


def above(section: Section, agent: str, first: int, last: int, score: float) -> Verdict:
    """That an agent's games `first` to `last` score more than `score` on average."""
    scores = section.scores(agent, first, last)
    if len(scores) < 2 * BLOCK:
        return _not_yet(section)
    low, high = interval(blocks(scores.to_numpy()))
    said = f"{runs.title(agent)} {scores.mean():.1f} ({low:.1f} to {high:.1f})"
    return Verdict(_side(low - score, high - score), f"{said} against {score:g}")


def better(
    sections: tuple[Section, Section], agents: tuple[str, str], first: int, last: int
) -> Verdict:
    """That the first of two agents, each in its section, scores more in games `first` to `last`."""
    scores = []
    for section, agent in zip(sections, agents, strict=True):
        scores.append(section.scores(agent, first, last))
        if len(scores[-1]) < 2 * BLOCK:
            return _not_yet(section)
    low, high = difference(*(blocks(found.to_numpy()) for found in scores))
    means = " against ".join(
        f"{runs.title(agent)} {found.mean():.1f}"
        for agent, found in zip(agents, scores, strict=True)
    )
    if agents[0] == agents[1]:
        names = [section.params.experiment for section in sections]
        means = f"{runs.title(agents[0])}: {names[0]} {scores[0].mean():.1f} against {names[1]} "
        means += f"{scores[1].mean():.1f}"
    return Verdict(_side(low, high), f"{means}, difference {low:.1f} to {high:.1f}")


def _not_yet(section: Section) -> Verdict:
    return Verdict(NOT_YET, f"`{section.params.experiment}`: {section.share:.0%} of its games")


def _side(low: float, high: float) -> str:
    if low > 0:
        return SUPPORTED
    return CONTRADICTED if high < 0 else INCONCLUSIVE


def _last(section: Section) -> tuple[int, int]:
    """The games that a final score is the mean of."""
    episodes = section.params.episodes
    return episodes - section.mark_window + 1, episodes


def _mark(section: Section, number: int) -> tuple[int, int]:
    """The games up to the `number`-th mark (1 to 6)."""
    return (number - 1) * section.mark_window + 1, number * section.mark_window


def human_level(
    study: Study, experiment: str, agents: list[str] | None = None, mark: int = 6
) -> Verdict:
    """The agents of an experiment, by default all, exceed the human reference at a mark."""
    section = study[experiment]
    return all_of(
        [
            above(section, agent, *_mark(section, mark), section.facts.human)
            for agent in agents or section.params.agents
        ]
    )


def ordered(study: Study, experiment: str, best: str, others: list[str], mark: int) -> Verdict:
    """One agent is better than each of the others at a mark."""
    section = study[experiment]
    games = _mark(section, mark)
    return all_of([better((section, section), (best, other), *games) for other in others])


def between(study: Study, first: str, second: str, mark: int | None = None) -> list[Verdict]:
    """That an agent scores more in the first experiment than in the second, up to a mark or at the
    last games of the shorter one: a verdict for every agent."""
    pair = (study[first], study[second])
    games = _last(min(pair, key=lambda section: section.params.episodes))
    if mark is not None:
        games = _mark(pair[0], mark)
    agents = [agent for agent in pair[0].params.agents if agent in pair[1].params.agents]
    if not agents:  # as in the small profiles, which do not train all
        return [Verdict(NOT_YET, "no agent is trained both ways")]
    return [better(pair, (agent, agent), *games) for agent in agents]


def overestimation(study: Study, experiment: str) -> Verdict:
    """Double DQN's predictions exceed what it realises by less than DQN's do, in the second half
    of the games; checks of the two at the same game are compared."""
    section = study[experiment]
    gaps = {}
    for agent in (DQN, DOUBLE):
        values = section.values
        own = values[values.agent == agent] if not values.empty else values
        if own.empty or own.episode.max() < section.params.episodes:
            return _not_yet(section)
        late = own[own.episode > section.params.episodes / 2]
        gaps[agent] = (late.predicted - late.realised).to_numpy()
    if len(gaps[DQN]) < 2 or len(gaps[DQN]) != len(gaps[DOUBLE]):
        return _not_yet(section)
    low, high = interval(gaps[DQN] - gaps[DOUBLE])
    said = ", ".join(f"{runs.title(agent)} {gap.mean():+.2f}" for agent, gap in gaps.items())
    return Verdict(
        _side(low, high), f"mean gap of {said}; DQN's is larger by {low:.2f} to {high:.2f}"
    )


def steadier(study: Study, steady: str, unsteady: str, agent: str) -> Verdict:
    """An agent's curve falls back less from its best in the first experiment than in the second,
    over the games of the second: block by block, the best mean so far less the block's own."""
    falls = []
    for name in (steady, unsteady):
        scores = study[name].scores(agent, 1, study[unsteady].params.episodes)
        if len(scores) < 2 * BLOCK:
            return _not_yet(study[name])
        means = blocks(scores.to_numpy())
        falls.append(np.maximum.accumulate(means) - means)
    low, high = difference(falls[1], falls[0])
    said = " against ".join(
        f"{name} {fall.mean():.1f}" for name, fall in zip((steady, unsteady), falls, strict=True)
    )
    return Verdict(
        _side(low, high), f"mean fall from the best: {said}, difference {low:.1f} to {high:.1f}"
    )


def beaten_everywhere(study: Study) -> Verdict:
    """Dueling Double DQN, the most refined agent, wins on average at every difficulty, without
    sticky actions."""
    section = study["boxing_final"]
    games = section.all_evaluations
    if not games.empty:
        games = games[(games.agent == DUELING) & (games.sticky_actions == 0)]
    played = 0 if games.empty else games.difficulty.nunique()
    if played < 4:
        return Verdict(
            NOT_YET,
            f"{runs.title(DUELING)} is evaluated at {played} of 4 difficulties "
            "(`python -m atari_dqn evaluate RUN --difficulty D`)",
        )
    parts = []
    for difficulty, found in games.groupby("difficulty"):
        low, high = interval(found.score.to_numpy())
        said = f"difficulty {difficulty}: {found.score.mean():.1f} ({low:.1f} to {high:.1f})"
        parts.append(Verdict(_side(low, high), said))
    return all_of(parts)


@dataclass(frozen=True)
class Claim:
    """Something the source report says, in our words; `experiments` are those it is about."""

    text: str
    experiments: tuple[str, ...]
    judge: Callable[[Study], Verdict]


def table(claims: tuple[Claim, ...], study: Study) -> pd.DataFrame:
    """A row a claim: what is claimed, the verdict, the evidence."""
    rows = []
    for claim in claims:
        found = claim.judge(study)
        rows.append({"claim": claim.text, "verdict": found.verdict, "evidence": found.evidence})
    return pd.DataFrame(rows)


def negated(verdict: Verdict) -> Verdict:
    """The verdict on the opposite claim."""
    opposite = {SUPPORTED: CONTRADICTED, CONTRADICTED: SUPPORTED}
    return Verdict(opposite.get(verdict.verdict, verdict.verdict), verdict.evidence)


# The source report's findings and interpretations (its section 2.1) and what it says along the
# way.
FINDINGS = (
    Claim(
        "All three agents exceed the human score in Boxing after 1,000 games",
        ("boxing_final",),
        lambda study: human_level(study, "boxing_final", mark=2),
    ),
    Claim(
        "Double and Dueling Double DQN end above DQN in Boxing",
        ("boxing_final",),
        lambda study: all_of(
            [ordered(study, "boxing_final", agent, [DQN], 6) for agent in REFINED]
        ),
    ),
    Claim(
        "Dueling Double DQN is the best of the first 500 games in both games",
        ("boxing_final", "breakout_final"),
        lambda study: all_of(
            [
                ordered(study, name, DUELING, [DQN, DOUBLE], 1)
                for name in ("boxing_final", "breakout_final")
            ]
        ),
    ),
    Claim(
        "Double DQN ends highest in Boxing",
        ("boxing_final",),
        lambda study: ordered(study, "boxing_final", DOUBLE, [DQN, DUELING], 6),
    ),
    Claim(
        "Double DQN ends lowest in Breakout",
        ("breakout_final",),
        lambda study: all_of(
            [ordered(study, "breakout_final", agent, [DOUBLE], 6) for agent in (DQN, DUELING)]
        ),
    ),
    Claim(
        "Of the three, only DQN reaches the human score in Breakout",
        ("breakout_final",),
        lambda study: all_of(
            [
                human_level(study, "breakout_final", [DQN]),
                *(negated(human_level(study, "breakout_final", [agent])) for agent in REFINED),
            ]
        ),
    ),
    Claim(
        "Double DQN overestimates less than DQN in Boxing",
        ("boxing_final",),
        lambda study: overestimation(study, "boxing_final"),
    ),
    Claim(
        "DQN is the best of the later Breakout experiment",
        ("breakout_late",),
        lambda study: ordered(study, "breakout_late", DQN, REFINED, 6),
    ),
    Claim(
        "Breakout improves when a lost life costs reward (and batches are larger)",
        ("breakout_final", "breakout_late"),
        lambda study: all_of(between(study, "breakout_final", "breakout_late")),
    ),
    Claim(
        "The early Boxing settings (rate 1e-3, batch 64, floor 0.1) learn less",
        ("boxing_early",),
        lambda study: all_of(between(study, "boxing_final", "boxing_early")),
    ),
    Claim(
        "With them, learning is unstable: the curve falls back further from its best",
        ("boxing_early",),
        lambda study: steadier(study, "boxing_final", "boxing_early", DQN),
    ),
    Claim(
        "A discount of 0.9 plays worse than 0.99",
        ("boxing_low_gamma",),
        lambda study: all_of(between(study, "boxing_final", "boxing_low_gamma")),
    ),
    Claim(
        "A discount of 0.995 plays worse than 0.99",
        ("boxing_high_gamma",),
        lambda study: all_of(between(study, "boxing_final", "boxing_high_gamma")),
    ),
    Claim(
        "All agents learn faster in expert mode (first 500 games)",
        ("boxing_expert",),
        lambda study: all_of(between(study, "boxing_expert", "boxing_final", mark=1)),
    ),
    Claim(
        "Starting from a Breakout agent does not help in Boxing",
        ("boxing_transfer",),
        lambda study: all_of(
            [negated(helps) for helps in between(study, "boxing_transfer", "boxing_final")]
        ),
    ),
    Claim(
        "Preprocessing, and the settings that came with it, improve DQN in Breakout",
        ("breakout_early", "breakout_late"),
        lambda study: all_of(between(study, "breakout_late", "breakout_early")),
    ),
)


def findings(study: Study) -> pd.DataFrame:
    """The verdicts on `FINDINGS`."""
    return table(FINDINGS, study)


# The source report's four goals (its section 2.2), and that of its abstract.
GOALS = (
    Claim(
        "Beat the computer's boxer at every difficulty (its abstract)",
        ("boxing_final",),
        beaten_everywhere,
    ),
    Claim(
        "Human level in Boxing with each agent",
        ("boxing_final",),
        lambda study: human_level(study, "boxing_final"),
    ),
    Claim(
        "Human level in Breakout with each agent",
        ("breakout_final",),
        lambda study: human_level(study, "breakout_final"),
    ),
    Claim(
        "Comparable data for three agents and two games",
        ("boxing_final", "breakout_final"),
        lambda study: _finished(study, ["boxing_final", "breakout_final"]),
    ),
    Claim(
        "How hyper-parameters change performance",
        ("boxing_sensitivity", "boxing_low_gamma", "boxing_high_gamma"),
        lambda study: _finished(
            study, ["boxing_sensitivity", "boxing_low_gamma", "boxing_high_gamma"]
        ),
    ),
    Claim(
        "How well transfer from Breakout to Boxing works",
        ("boxing_transfer", "boxing_transfer_controls"),
        lambda study: _finished(study, ["boxing_transfer", "boxing_transfer_controls"]),
    ),
)
REACHED = {SUPPORTED: "reached", CONTRADICTED: "not reached"}  # what a verdict on a goal is called


def goals(study: Study) -> pd.DataFrame:
    """How far `GOALS` are reached."""
    found = table(GOALS, study).rename(columns={"claim": "goal", "verdict": "state"})
    return found.assign(state=found.state.replace(REACHED))


def _finished(study: Study, names: list[str]) -> Verdict:
    """An aim that is reached when its runs are there."""
    sections = [study[name] for name in names]
    share = np.mean([section.share for section in sections])
    done = all(section.complete for section in sections)
    said = ", ".join(f"{section.params.experiment} {section.share:.0%}" for section in sections)
    return Verdict(SUPPORTED if done else NOT_YET, f"{share:.0%} of the games played ({said})")
