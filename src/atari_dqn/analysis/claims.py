"""What the source report claims, in our words: findings, interpretations and goals, each with the
judge that gives its verdict."""

from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd

from atari_dqn.analysis.study import Study
from atari_dqn.analysis.verdicts import (
    CONTRADICTED,
    DOUBLE,
    DQN,
    DUELING,
    SUPPORTED,
    Verdict,
    all_of,
    beaten_everywhere,
    compare_agents,
    compare_evaluations,
    compare_greedy_checks,
    compare_steadiness,
    compare_training,
    human_level,
    negated,
    overestimation,
    runs_finished,
)

REFINED = [DOUBLE, DUELING]
MARGIN = 5.0  # points; less of a gain from transfer is none


@dataclass(frozen=True)
class Claim:
    """Something the source report says, in our words, and the section of it that says so;
    `experiments` are those it is about."""

    text: str
    source: str
    experiments: tuple[str, ...]
    judge: Callable[[Study], Verdict]


def table(claims: tuple[Claim, ...], study: Study) -> pd.DataFrame:
    """A row a claim: its number, what is claimed and where, the verdict, the evidence."""
    rows = []
    for number, claim in enumerate(claims, start=1):
        found = claim.judge(study)
        rows.append(
            {
                "no.": str(number),
                "claim": claim.text,
                "source": claim.source,
                "verdict": found.verdict,
                "evidence": found.evidence,
            }
        )
    return pd.DataFrame(rows)


# The source report's findings and interpretations (its section 2.1) and what it says along the
# way. "Implied": it shows or suggests this without saying so.
FINDINGS = (
    Claim(
        "All three agents exceed the human score in Boxing after 1,000 games",
        "2.1",
        ("boxing_final",),
        lambda study: human_level(study, "boxing_final", milestone=2),
    ),
    Claim(
        "Double and Dueling Double DQN end above DQN in Boxing",
        "2.1",
        ("boxing_final",),
        lambda study: all_of(
            [compare_agents(study, "boxing_final", agent, [DQN], 6) for agent in REFINED]
        ),
    ),
    Claim(
        "Dueling Double DQN is the best of the first 500 games in both games",
        "2.1",
        ("boxing_final", "breakout_final"),
        lambda study: all_of(
            [
                compare_agents(study, name, DUELING, [DQN, DOUBLE], 1)
                for name in ("boxing_final", "breakout_final")
            ]
        ),
    ),
    Claim(
        "Double DQN ends highest in Boxing",
        "2.1",
        ("boxing_final",),
        lambda study: compare_agents(study, "boxing_final", DOUBLE, [DQN, DUELING], 6),
    ),
    Claim(
        "Double DQN ends lowest in Breakout",
        "2.1",
        ("breakout_final",),
        lambda study: all_of(
            [
                compare_agents(study, "breakout_final", agent, [DOUBLE], 6)
                for agent in (DQN, DUELING)
            ]
        ),
    ),
    Claim(
        "Of the three, only DQN reaches the human score in Breakout",
        "2.2",
        ("breakout_final",),
        lambda study: all_of(
            [
                human_level(study, "breakout_final", [DQN]),
                *(negated(human_level(study, "breakout_final", [agent])) for agent in REFINED),
            ]
        ),
    ),
    Claim(
        "Preprocessing, and the settings that came with it, improve DQN in Breakout",
        "3.2.3",
        ("breakout_early", "breakout_late"),
        lambda study: all_of(compare_evaluations(study, "breakout_late", "breakout_early")),
    ),
    Claim(
        "DQN is the best of the later Breakout experiment",
        "3.2.3",
        ("breakout_late",),
        lambda study: compare_agents(study, "breakout_late", DQN, REFINED, 6),
    ),
    Claim(
        "Breakout improves with a price on lost lives (and with larger batches, and with less "
        "exploration in the end)",
        "3.3.1, implied",
        ("breakout_final", "breakout_late"),
        lambda study: all_of(compare_evaluations(study, "breakout_final", "breakout_late")),
    ),
    Claim(
        "The early Boxing settings (rate 1e-3, batch 64, floor 0.1) learn less than the final ones",
        "3.3.1",
        ("boxing_early",),
        lambda study: all_of(compare_greedy_checks(study, "boxing_final", "boxing_early")),
    ),
    Claim(
        "With them, the learning curve oscillates more",
        "3.3.1",
        ("boxing_early",),
        lambda study: compare_steadiness(study, "boxing_final", "boxing_early", DQN),
    ),
    Claim(
        "A discount of 0.9 makes agents reckless: they concede more points than with 0.99",
        "3.3.2",
        ("boxing_low_gamma",),
        lambda study: all_of(
            compare_evaluations(study, "boxing_low_gamma", "boxing_final", "conceded_a_minute")
        ),
    ),
    Claim(
        "A discount of 0.9 plays worse than 0.99",
        "3.3.2, implied",
        ("boxing_low_gamma",),
        lambda study: all_of(compare_training(study, "boxing_final", "boxing_low_gamma")),
    ),
    Claim(
        "A discount of 0.995 makes agents shy: they keep a greater distance than with 0.99",
        "3.3.2",
        ("boxing_high_gamma",),
        lambda study: all_of(
            compare_evaluations(study, "boxing_high_gamma", "boxing_final", "distance")
        ),
    ),
    Claim(
        "All agents learn faster in expert mode: they gain more in the first 500 games",
        "additional",
        ("boxing_expert",),
        lambda study: all_of(
            compare_training(study, "boxing_expert", "boxing_final", milestone=1, gain=True)
        ),
    ),
    Claim(
        f"Starting from a Breakout agent is worth less than {MARGIN:g} points in Boxing, early "
        "(first 500 games) and at the end",
        "additional",
        ("boxing_transfer",),
        lambda study: all_of(
            [
                negated(gains)
                for milestone in (1, None)
                for gains in compare_training(
                    study, "boxing_transfer", "boxing_final", milestone=milestone, margin=MARGIN
                )
            ]
        ),
    ),
)


def findings(study: Study) -> pd.DataFrame:
    """The verdicts on `FINDINGS`."""
    return table(FINDINGS, study)


_UNTESTED = "not tested"
# How the source report explains its findings (its section 2.1).
INTERPRETATIONS = (
    Claim(
        "Double DQN leads in Boxing because it overestimates less",
        "2.1",
        ("boxing_final",),
        lambda study: _premise(
            all_of(
                [
                    compare_agents(study, "boxing_final", DOUBLE, [DQN, DUELING], 6),
                    overestimation(study, "boxing_final"),
                ]
            ),
            "whether it leads, and overestimates less; the cause is not tested",
        ),
    ),
    Claim(
        "Dueling Double DQN learns faster because of its two streams",
        "2.1",
        ("boxing_final",),
        lambda study: _premise(
            compare_agents(study, "boxing_final", DUELING, [DOUBLE], 1),
            "Double DQN is the same agent without the streams, and with half the weights",
        ),
    ),
    Claim(
        "The games differ because Boxing is highly stochastic as it was trained",
        "2.1",
        (),
        lambda study: Verdict(
            _UNTESTED,
            "its Boxing environment is not named; ours is without chance (@sec-stochasticity)",
        ),
    ),
    Claim(
        "Replay and a second network make DQN better than what was before it",
        "2.1",
        (),
        lambda study: Verdict(_UNTESTED, "no agent without them is trained; see @mnih2015"),
    ),
)


PREMISE = {SUPPORTED: "premise holds", CONTRADICTED: "premise fails"}


def _premise(verdict: Verdict, what: str) -> Verdict:
    """The verdict on what an interpretation presupposes, which is not one on the interpretation."""
    found = PREMISE.get(verdict.verdict, verdict.verdict)
    return Verdict(found, f"{verdict.evidence} ({what})")


def interpretations(study: Study) -> pd.DataFrame:
    """What the runs say on the premises of `INTERPRETATIONS`."""
    return table(INTERPRETATIONS, study).rename(columns={"claim": "interpretation"})


# The source report's four goals (its section 2.2), and that of its abstract; with what it says of
# them.
GOALS = (
    Claim(
        "Beat the computer's boxer even at the highest difficulty",
        "announced in its abstract; no result is given",
        ("boxing_final",),
        beaten_everywhere,
    ),
    Claim(
        "Human level in Boxing with each agent",
        "reached",
        ("boxing_final",),
        lambda study: human_level(study, "boxing_final"),
    ),
    Claim(
        "Human level in Breakout with each agent",
        "not with two of them",
        ("breakout_final",),
        lambda study: human_level(study, "breakout_final"),
    ),
    Claim(
        "Comparable data for three agents and two games",
        "reached",
        ("boxing_final", "breakout_final"),
        lambda study: runs_finished(study, ["boxing_final", "breakout_final"]),
    ),
    Claim(
        "How hyper-parameters change performance",
        "reached; it shows runs for the discount only",
        ("boxing_sensitivity", "boxing_low_gamma", "boxing_high_gamma"),
        lambda study: runs_finished(
            study, ["boxing_sensitivity", "boxing_low_gamma", "boxing_high_gamma"]
        ),
    ),
    Claim(
        "How well transfer from Breakout to Boxing works",
        "reached",
        ("boxing_transfer", "boxing_transfer_controls"),
        lambda study: runs_finished(study, ["boxing_transfer", "boxing_transfer_controls"]),
    ),
)
REACHED = {SUPPORTED: "reached", CONTRADICTED: "not reached"}  # what a verdict on a goal is called


def goals(study: Study) -> pd.DataFrame:
    """How far `GOALS` are reached."""
    names = {"claim": "goal", "source": "the source report", "verdict": "here"}
    found = table(GOALS, study).rename(columns=names)
    return found.assign(here=found.here.replace(REACHED))
