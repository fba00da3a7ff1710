"""What the source report claims, in our words: findings, interpretations and goals, each with the
judge that gives its verdict."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import pandas as pd

from atari_dqn.analysis.statistics import BLOCK
from atari_dqn.analysis.study import Study
from atari_dqn.analysis.verdicts import (
    DOUBLE,
    DQN,
    DUELING,
    Outcome,
    Verdict,
    all_of,
    apart,
    beaten_everywhere,
    beats_variation,
    compare_agents,
    compare_evaluations,
    compare_greedy_checks,
    compare_steadiness,
    compare_style,
    compare_training,
    human_level,
    improves,
    improves_greedily,
    more_by,
    negated,
    overestimation,
    runs_finished,
)

ALL, REFINED = [DQN, DOUBLE, DUELING], [DOUBLE, DUELING]
MARGIN = 5.0  # points; less of a difference is none


@dataclass(frozen=True)
class Claim:
    """Something the source report says, in our words, and the section of it that says so;
    `experiments` are those it is about."""

    text: str
    source: str
    experiments: tuple[str, ...]
    judge: Callable[[Study], Verdict]
    short: str = ""  # the same for a tile of the board: at most 60 letters
    section: str = "sec-findings"  # the label of ours that shows its runs
    scores: tuple[tuple[str, str, int], ...] = ()  # experiment, agent, milestone (1 to 6): the
    # scores that it is about, where the source report gives them


def _scores(experiment: str, agents: list[str], milestone: int) -> tuple[tuple[str, str, int], ...]:
    return tuple((experiment, agent, milestone) for agent in agents)


def table(claims: tuple[Claim, ...], study: Study) -> pd.DataFrame:
    """A row per claim: its number, what is claimed and where, the verdict, the evidence."""
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
        "All agents are above the human in Boxing after 1,000 games",
        "sec-boxing",
        _scores("boxing_final", ALL, 2),
    ),
    Claim(
        "Double and Dueling Double DQN end above DQN in Boxing",
        "2.1",
        ("boxing_final",),
        lambda study: all_of(
            [compare_agents(study, "boxing_final", agent, [DQN], 6) for agent in REFINED]
        ),
        "Both refinements end above DQN in Boxing",
        "sec-boxing",
        _scores("boxing_final", ALL, 6),
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
        "Dueling Double DQN learns fastest in both games",
        "sec-results",
        _scores("boxing_final", [DUELING], 1) + _scores("breakout_final", [DUELING], 1),
    ),
    Claim(
        "Double DQN ends highest in Boxing",
        "2.1",
        ("boxing_final",),
        lambda study: compare_agents(study, "boxing_final", DOUBLE, [DQN, DUELING], 6),
        "Double DQN ends highest in Boxing",
        "sec-boxing",
        _scores("boxing_final", ALL, 6),
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
        "Double DQN ends lowest in Breakout",
        "sec-breakout",
        _scores("breakout_final", ALL, 6),
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
        "Only DQN reaches the human score in Breakout",
        "sec-breakout",
        _scores("breakout_final", ALL, 6),
    ),
    Claim(
        "Preprocessing, and the settings that came with it, make the agents considerably better in "
        "Breakout (only DQN was trained before it, for 7,000 games and not 3,000, and can be "
        "compared; any improvement counts)",
        "3.2.3",
        ("breakout_early", "breakout_late"),
        lambda study: all_of(compare_evaluations(study, "breakout_late", "breakout_early")),
        "Preprocessing and its settings make DQN better in Breakout",
        "sec-breakout-early",
    ),
    Claim(
        "DQN is the best of the later Breakout experiment",
        "3.2.3",
        ("breakout_late",),
        lambda study: compare_agents(study, "breakout_late", DQN, REFINED, 6),
        "DQN is the best in the second of three Breakout experiments",
        "sec-breakout-late",
        _scores("breakout_late", ALL, 6),
    ),
    Claim(
        "A penalty for losing a life helps in Breakout (together with larger batches and less "
        "exploration at the end)",
        "3.3.1, implied",
        ("breakout_final", "breakout_late"),
        lambda study: all_of(compare_evaluations(study, "breakout_final", "breakout_late")),
        "A life penalty, with other changes, helps in Breakout",
        "sec-breakout",
    ),
    Claim(
        "The early Boxing settings (a learning rate of 0.001, batches of 64, a minimum epsilon of "
        "0.1) learn less than the final ones",
        "3.3.1",
        ("boxing_early",),
        lambda study: all_of(compare_greedy_checks(study, "boxing_final", "boxing_early")),
        "The early Boxing settings learn less than the final ones",
        "sec-boxing-early",
    ),
    Claim(
        "With the early Boxing settings, the learning curve oscillates more",
        "3.3.1",
        ("boxing_early",),
        lambda study: compare_steadiness(
            study,
            ("boxing_final", DQN),
            ("boxing_early", DQN),
            study["boxing_early"].params.episodes,
        ),
        "With the early Boxing settings, the curve oscillates more",
        "sec-boxing-early",
    ),
    Claim(
        "A discount of 0.9 makes agents reckless: after the same training, and when they score the "
        "same, they concede more points per minute than with 0.99",
        "3.3.2",
        ("boxing_low_gamma",),
        lambda study: all_of(
            compare_style(study, "boxing_low_gamma", "boxing_final", "conceded_per_minute")
        ),
        "A discount of 0.9 makes agents reckless",
        "sec-low-gamma",
    ),
    Claim(
        "A discount of 0.9 plays worse than 0.99",
        "3.3.2, implied",
        ("boxing_low_gamma",),
        lambda study: all_of(compare_training(study, "boxing_final", "boxing_low_gamma")),
        "A discount of 0.9 plays worse than 0.99",
        "sec-low-gamma",
    ),
    Claim(
        "A discount of 0.995 makes agents shy: after the same training, and when they score the "
        "same, they keep a greater distance than with 0.99",
        "3.3.2",
        ("boxing_high_gamma",),
        lambda study: all_of(compare_style(study, "boxing_high_gamma", "boxing_final", "distance")),
        "A discount of 0.995 makes agents shy",
        "sec-high-gamma",
    ),
    Claim(
        "All agents learn faster in expert mode: in the first 500 games they gain more over their "
        f"own first {BLOCK}",
        "additional",
        ("boxing_expert",),
        lambda study: all_of(
            compare_training(study, "boxing_expert", "boxing_final", milestone=1, gain=True)
        ),
        "All agents learn faster in expert mode",
        "sec-expert",
    ),
    Claim(
        f"Starting from a Breakout agent helps little in Boxing: by less than {MARGIN:g} points, "
        "early (first 500 games) and at the end",
        "additional",
        ("boxing_transfer",),
        lambda study: all_of(
            [
                negated(gains)
                for milestone in (1, None)
                for gains in compare_training(
                    study,
                    "boxing_transfer",
                    "boxing_final",
                    milestone=milestone,
                    rule=more_by(MARGIN),
                )
            ]
        ),
        "Starting from a Breakout agent helps little in Boxing",
        "sec-transfer",
    ),
    Claim(
        f"A discount of 0.995 changes the score, by more than {MARGIN:g} points up or down against "
        "0.99 (the effect is called surprising, its direction is not stated)",
        "3.3.2",
        ("boxing_high_gamma",),
        lambda study: all_of(
            compare_training(study, "boxing_high_gamma", "boxing_final", rule=apart(MARGIN))
        ),
        "A discount of 0.995 has a surprising effect on the score",
        "sec-high-gamma",
    ),
    Claim(
        "Tuning the learning rate, the batch size and the number of games all helped in Boxing: "
        "a higher rate, larger batches and fewer games (901 to 1,400) score lower than the final "
        "settings",
        "3.3.2",
        ("boxing_sensitivity",),
        lambda study: all_of(
            [
                *(
                    beats_variation(study, "boxing_final", "boxing_sensitivity", variation)
                    for variation in ("learning rate x 4", "batch size x 2")
                ),
                improves(study, "boxing_final", DUELING, until=1400, episodes=500),
            ]
        ),
        "Tuning rate, batch size and games all helped in Boxing",
        "sec-sensitivity",
    ),
    Claim(
        "Clipped rewards make learning in Boxing faster than raw ones: they score more over the "
        "first 500 games",
        "3.1.1",
        ("boxing_sensitivity",),
        lambda study: beats_variation(study, "boxing_final", "boxing_sensitivity", "raw rewards"),
        "Clipped rewards make learning in Boxing faster",
        "sec-sensitivity",
    ),
    Claim(
        "With the early Boxing settings, DQN still improves: what it scores greedily during its "
        "last 500 games is more than during its first 500, by any amount",
        "3.3.1",
        ("boxing_early",),
        lambda study: improves_greedily(study, "boxing_early", DQN, until=500, episodes=500),
        "The early Boxing agent shows a small improvement",
        "sec-boxing-early",
    ),
    Claim(
        "In the later Breakout experiment Double and Dueling Double DQN are less stable than DQN: "
        "their curves oscillate more",
        "3.2.3",
        ("breakout_late",),
        lambda study: all_of(
            [
                compare_steadiness(
                    study,
                    ("breakout_late", DQN),
                    ("breakout_late", agent),
                    study["breakout_late"].params.episodes,
                )
                for agent in REFINED
            ]
        ),
        "Double Q-learning is less stable in the second Breakout run",
        "sec-breakout-late",
    ),
    Claim(
        "With a discount of 0.9 the agent keeps reverting its strategies: its curve oscillates "
        "more than with 0.99",
        "3.3.2",
        ("boxing_low_gamma",),
        lambda study: compare_steadiness(
            study,
            ("boxing_final", DUELING),
            ("boxing_low_gamma", DUELING),
            study["boxing_low_gamma"].params.episodes,
        ),
        "A discount of 0.9 makes the agent revert its strategies",
        "sec-low-gamma",
    ),
    Claim(
        "With more than 3,000 games of later Breakout they might have caught up with DQN",
        "3.2.3",
        ("breakout_late",),
        lambda study: Verdict(
            Outcome.UNTESTED, "no run is longer than the 3,000 games of the source report"
        ),
        "With more games they might have caught up with DQN",
        "sec-breakout-late",
    ),
    Claim(
        "The early Breakout agent was held back by exploiting too early",
        "3.2.3",
        ("breakout_early",),
        lambda study: Verdict(
            Outcome.UNTESTED,
            "no early run with another schedule of epsilon is planned; such schedules are tried in "
            "Boxing only (@sec-sensitivity)",
        ),
        "Early Breakout was held back by exploiting too early",
        "sec-breakout-early",
    ),
)


def findings(study: Study) -> pd.DataFrame:
    """The verdicts on `FINDINGS`."""
    found = table(FINDINGS, study).rename(columns={"source": "its section"})
    return found[["no.", "claim", "verdict", "evidence", "its section"]]


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
        "Expert mode is learned faster because both boxers move more slowly",
        "additional",
        ("boxing_expert",),
        lambda study: _premise(
            all_of(
                compare_training(study, "boxing_expert", "boxing_final", milestone=1, gain=True)
            ),
            "whether it is learned faster; no other cause is excluded",
        ),
    ),
    Claim(
        "Double and Dueling Double DQN are unstable in Breakout because double Q-learning is more "
        "complex",
        "3.2.3",
        ("breakout_late",),
        lambda study: Verdict(
            Outcome.UNTESTED,
            "how the three compare is claim 8 of @tbl-findings; no run varies the complexity alone",
        ),
    ),
    Claim(
        "The games differ because Boxing is highly stochastic as trained",
        "2.1",
        (),
        lambda study: Verdict(
            Outcome.UNTESTED,
            "its Boxing environment is not named; ours is without chance (@sec-stochasticity)",
        ),
    ),
    Claim(
        "Replay and a second network make DQN better than earlier methods",
        "2.1",
        (),
        lambda study: Verdict(Outcome.UNTESTED, "no agent without them is trained; see @mnih2015"),
    ),
    Claim(
        "With a discount of 0.995 agents shy from the opponent because of the reward they might "
        "lose later",
        "3.3.2",
        ("boxing_high_gamma",),
        lambda study: Verdict(
            Outcome.UNTESTED, "a distance can be measured (@sec-findings), a motive cannot"
        ),
    ),
)


def _premise(verdict: Verdict, what: str) -> Verdict:
    """The verdict on what an interpretation presupposes, which is not one on the interpretation."""
    return replace(verdict, evidence=f"{verdict.evidence} ({what})")


def interpretations(study: Study) -> pd.DataFrame:
    """What the runs say on the premises of `INTERPRETATIONS`."""
    names = {"claim": "interpretation", "source": "its section", "verdict": "premise"}
    return table(INTERPRETATIONS, study).rename(columns=names)


# The source report's four goals (its section 2.2), and that of its abstract; with what it says of
# them.
GOALS = (
    Claim(
        "Beat the computer's boxer even at the highest difficulty",
        "a training curve without numbers (figure 21); whether it is beaten is not stated",
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
        "reached; its runs change several at once, but for the discount",
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
# What a verdict on a goal is called
REACHED = dict(zip(Outcome.YES.value, ("reached in these runs", "reached"), strict=True)) | dict(
    zip(Outcome.NO.value, ("not reached in these runs", "not reached"), strict=True)
)


def goals(study: Study) -> pd.DataFrame:
    """How far `GOALS` are reached."""
    names = {"claim": "goal", "source": "the source report", "verdict": "our verdict"}
    found = table(GOALS, study).rename(columns=names)
    return found.assign(**{"our verdict": found["our verdict"].replace(REACHED)})
