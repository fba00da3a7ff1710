"""Verdicts on the source report's claims follow from the stored runs, and change with them.

`CASES` has every claim: runs with which it is plainly true, what else to store to make it plainly
false, and the numbers that the evidence must then give. Scores outside the games that a claim is
about say the opposite, and so loudly that one of them among those would change every number. Greedy
games say the opposite in all columns but the one that counts.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from synthetic import (
    AGENTS,
    SPREAD,
    TITLES,
    by_name,
    check,
    evaluate,
    facts,
    numbers,
    put_evaluations,
    settings,
    store,
    study,
    style,
    window,
    windows,
)

from atari_dqn.analysis import claims, summaries, verdicts
from atari_dqn.analysis.statistics import by_cluster, student_interval, welch_interval
from atari_dqn.analysis.study import Section, openings

LOUD = 5000.0  # points, of a game that must not count
DQN, DOUBLE, DUELING = AGENTS


@dataclass(frozen=True)
class Runs:
    """What is stored of a run. Without game `needed` the claim is open."""

    scores: np.ndarray
    needed: int = 0
    greedy: dict[str, float] | None = None  # means of columns of the final evaluation
    checks: dict[str, np.ndarray] | None = None  # columns, a value every hundred games
    styles: dict[str, np.ndarray] | None = None  # likewise

    def put(self, results, place):
        experiment, agent, *variation = place.split("/", 2)
        scores = self.scores[: settings(experiment).episodes]
        run = store(results, experiment, agent, scores, variation="".join(variation))
        if self.greedy is not None:
            evaluate(run, **self.greedy)
        if self.checks is not None:
            check(run, **self.checks)
        if self.styles is not None:
            style(run, **self.styles)

    def short(self):
        """The same, not quite long enough."""
        if self.greedy is not None:
            return replace(self, greedy={**self.greedy, "trained": self.needed - 1})
        return replace(self, scores=self.scores[: self.needed - 1])


def games(first, last, mean, outside):
    return Runs(window(first, last, mean, outside), last)


def early(mean, outside=-LOUD):  # games 1 to 500
    return games(1, 500, mean, outside)


def final(mean, outside=-LOUD):  # the last 500 of 3,000
    return games(2501, 3000, mean, outside)


def greedy(experiment, **means):
    return Runs(np.zeros(10), settings(experiment).episodes, greedy=means)


def swaying(by, luck=7.0, games=1400):
    """Blocks of 50 games, `by` above and below 0 in turn, each game `luck` off that; loud after."""
    scores = by * (-1.0) ** (np.arange(games) // 50) + luck * (-1.0) ** np.arange(games)
    return Runs(np.concatenate([scores, LOUD * (-1.0) ** np.arange(20)]), games)


def gaining(first, then, last=500):
    """A mean of the first 50 games, and one of the others up to 500."""
    scores = windows({(1, 50): first, (51, 500): then}, -LOUD)
    return Runs(scores, last)


def checked(games, **columns):
    return Runs(np.zeros(games), games, checks={"score": np.zeros(games // 100)} | columns)


def styled(until, early, late, **more):
    """Checks whose columns have a value up to half of `until` episodes, another from there to
    `until`, and a third after it."""
    half = until // 200
    columns = {
        name: np.r_[np.full(half, early[name]), np.full(half, late[name]), more.get(name, [])]
        for name in late
    }
    return Runs(np.zeros(until + 100 * len(more.get("score", []))), until, styles=columns)


def of_all(experiment, runs):
    return {f"{experiment}/{agent}": run for agent, run in zip(AGENTS, runs, strict=True)}


@dataclass(frozen=True)
class Case:
    claim: str  # word for word
    true: dict[str, Runs]  # by experiment/agent, or experiment/agent/variation
    false: tuple[dict[str, Runs], ...]  # any of these in its place makes it false
    evidence: str  # agents, experiments and numbers of the true one, without intervals
    table: str = "findings"


FINAL, LATE, EARLY = "boxing_final", "breakout_late", "breakout_early"
FASTER_IN_EXPERT_MODE = (  # a claim, and the premise of an interpretation
    of_all("boxing_expert", [gaining(first, first + 30) for first in (1, 2, 3)])
    | of_all(FINAL, [gaining(first, first + 10) for first in (51, 52, 53)]),
    tuple({f"boxing_expert/{agent}": gaining(80, 81)} for agent in AGENTS),
    f"DQN `boxing_expert` 30 `{FINAL}` 10, Double DQN `boxing_expert` 30 `{FINAL}` 10, "
    f"Dueling Double DQN `boxing_expert` 30 `{FINAL}` 10",
)
CASES = {
    "1 human in Boxing": Case(
        "All three agents exceed the human score in Boxing after 1,000 games",
        of_all(FINAL, [games(501, 1000, mean, -LOUD) for mean in (14, 15, 16)]),
        tuple({f"{FINAL}/{agent}": games(501, 1000, 10, LOUD)} for agent in AGENTS),
        "DQN 14 12.1, Double DQN 15 12.1, Dueling Double DQN 16 12.1",
    ),
    "2 above DQN in Boxing": Case(
        "Double and Dueling Double DQN end above DQN in Boxing",
        of_all(FINAL, [final(80, LOUD), final(90), final(85)]),
        ({f"{FINAL}/{DOUBLE}": final(70)}, {f"{FINAL}/{DUELING}": final(75)}),
        "Double DQN 90 DQN 80, Dueling Double DQN 85 DQN 80",
    ),
    "3 dueling early": Case(
        "Dueling Double DQN is the best of the first 500 games in both games",
        of_all(FINAL, [early(10, LOUD), early(20, LOUD), early(30)])
        | of_all("breakout_final", [early(3, LOUD), early(5, LOUD), early(8)]),
        (
            {f"{FINAL}/{DUELING}": early(15)},
            {f"breakout_final/{DUELING}": early(4)},
            {f"breakout_final/{DQN}": early(9)},
        ),
        "Dueling Double DQN 30 DQN 10, Dueling Double DQN 30 Double DQN 20, "
        "Dueling Double DQN 8 DQN 3, Dueling Double DQN 8 Double DQN 5",
    ),
    "4 double highest": Case(
        "Double DQN ends highest in Boxing",
        of_all(FINAL, [final(80, LOUD), final(92), final(90, LOUD)]),
        ({f"{FINAL}/{DQN}": final(94, LOUD)}, {f"{FINAL}/{DUELING}": final(95, LOUD)}),
        "Double DQN 92 DQN 80, Double DQN 92 Dueling Double DQN 90",
    ),
    "5 double lowest": Case(
        "Double DQN ends lowest in Breakout",
        of_all("breakout_final", [final(30), final(10, LOUD), final(20)]),
        ({f"breakout_final/{DQN}": final(5)}, {f"breakout_final/{DUELING}": final(5)}),
        "DQN 30 Double DQN 10, Dueling Double DQN 20 Double DQN 10",
    ),
    "6 only DQN human": Case(
        "Of the three, only DQN reaches the human score in Breakout",
        of_all("breakout_final", [final(40), final(15, LOUD), final(20, LOUD)]),
        (
            {f"breakout_final/{DQN}": final(25)},
            {f"breakout_final/{DOUBLE}": final(35)},
            {f"breakout_final/{DUELING}": final(35)},
        ),
        "DQN 40 30.5, Double DQN 15 30.5, Dueling Double DQN 20 30.5",
    ),
    "7 preprocessing": Case(
        "Preprocessing, and the settings that came with it, make the agents considerably better in "
        "Breakout (only DQN was trained before it, for 7,000 games and not 3,000, and can be "
        "compared; any improvement counts)",
        {f"{LATE}/{DQN}": greedy(LATE, score=30, scored=1), f"{EARLY}/{DQN}": greedy(EARLY)},
        ({f"{LATE}/{DQN}": greedy(LATE, score=10, scored=99)},),
        f"DQN `{LATE}` 30 `{EARLY}` 20",
    ),
    "8 DQN best of late": Case(
        "DQN is the best of the later Breakout experiment",
        of_all(LATE, [final(30), final(20, LOUD), final(25, LOUD)]),
        ({f"{LATE}/{DOUBLE}": final(35, LOUD)}, {f"{LATE}/{DUELING}": final(35, LOUD)}),
        "DQN 30 Double DQN 20, DQN 30 Dueling Double DQN 25",
    ),
    "9 price on lives": Case(
        "A penalty for losing a life helps in Breakout (together with larger batches and less "
        "exploration at the end)",
        of_all("breakout_final", [greedy("breakout_final", score=x) for x in (31, 32, 33)])
        | of_all(LATE, [greedy(LATE, score=x, distance=90) for x in (21, 22, 23)]),
        tuple({f"breakout_final/{agent}": greedy("breakout_final", score=9)} for agent in AGENTS),
        f"DQN `breakout_final` 31 `{LATE}` 21, Double DQN `breakout_final` 32 `{LATE}` 22, "
        f"Dueling Double DQN `breakout_final` 33 `{LATE}` 23",
    ),
    "10 early learn less": Case(
        "The early Boxing settings (a learning rate of 0.001, batches of 64, a minimum epsilon of "
        "0.1) learn less than the final ones",
        {
            f"{FINAL}/{DQN}": replace(
                checked(1500, score=np.r_[np.full(13, 30.0), 44.0, -LOUD]), needed=1400
            ),
            "boxing_early/dqn": checked(1400, score=np.full(14, 10.0)),
        },
        ({"boxing_early/dqn": checked(1400, score=np.full(14, 50.0))},),
        f"DQN `{FINAL}` 31 `boxing_early` 10",
    ),
    "11 early oscillates": Case(
        "With the early Boxing settings, the learning curve oscillates more",
        {f"{FINAL}/{DQN}": swaying(1.0), "boxing_early/dqn": swaying(5.0)},
        ({f"{FINAL}/{DQN}": swaying(5.0), "boxing_early/dqn": swaying(1.0)},),
        # a block is twice `by` from its neighbours; luck explains 1.5 * 7 ** 2 / 49 of the squares
        # (and the mean scores are 0)
        f"DQN `{FINAL}` {2.5**0.5:.1f} `boxing_early` {98.5**0.5:.1f} 0 0",
    ),
    "12 reckless": Case(
        "A discount of 0.9 makes agents reckless: after the same training, and when they score the "
        "same, they concede more points per minute than with 0.99",
        {  # points in two minutes
            f"boxing_low_gamma/{DUELING}": styled(
                1000, {"score": -50, "conceded": -LOUD}, {"score": 30, "conceded": 60}
            ),
            f"{FINAL}/{DUELING}": styled(
                1000,
                {"score": 31, "conceded": 40},
                {"score": 50, "conceded": 20},
                score=[90] * 4,
                conceded=[LOUD] * 4,
            ),
        },
        (
            {
                f"boxing_low_gamma/{DUELING}": styled(
                    1000, {"score": -50, "conceded": LOUD}, {"score": 30, "conceded": 10}
                )
            },
            {  # more after the same training, fewer at the same score
                f"boxing_low_gamma/{DUELING}": styled(
                    1000, {"score": -50, "conceded": LOUD}, {"score": 30, "conceded": 30}
                )
            },
        ),
        f"30 50 Dueling Double DQN `boxing_low_gamma` 30 `{FINAL}` 10, 30 20",
    ),
    "13 low discount worse": Case(
        "A discount of 0.9 plays worse than 0.99",
        {
            f"{FINAL}/{DUELING}": games(835, 1000, 60, -LOUD),
            f"boxing_low_gamma/{DUELING}": games(835, 1000, 40, LOUD),
        },
        ({f"boxing_low_gamma/{DUELING}": games(835, 1000, 70, -LOUD)},),
        f"Dueling Double DQN `{FINAL}` 60 `boxing_low_gamma` 40",
    ),
    "14 shy": Case(
        "A discount of 0.995 makes agents shy: after the same training, and when they score the "
        "same, they keep a greater distance than with 0.99",
        {
            f"boxing_high_gamma/{DUELING}": styled(
                2000, {"score": -50, "distance": -LOUD}, {"score": 40, "distance": 50}
            ),
            f"{FINAL}/{DUELING}": styled(
                2000,
                {"score": -90, "distance": LOUD},
                {"score": 60, "distance": 30},
                score=[44] * 3,
                distance=[35] * 3,
            ),
        },
        (
            {
                f"boxing_high_gamma/{DUELING}": styled(
                    2000, {"score": -50, "distance": LOUD}, {"score": 40, "distance": 20}
                )
            },
            {
                f"boxing_high_gamma/{DUELING}": styled(
                    2000, {"score": -50, "distance": LOUD}, {"score": 40, "distance": 33}
                )
            },
        ),
        f"40 60 Dueling Double DQN `boxing_high_gamma` 50 `{FINAL}` 30, 50 35",
    ),
    "15 faster in expert mode": Case(
        "All agents learn faster in expert mode: in the first 500 games they gain more over their "
        "own first 50",
        *FASTER_IN_EXPERT_MODE,
    ),
    "16 transfer": Case(
        "Starting from a Breakout agent helps little in Boxing: by less than 5 points, early "
        "(first 500 games) and at the end",
        of_all(
            "boxing_transfer",
            [Runs(windows({(1, 500): x + 4, (835, 1000): x + 44}, LOUD), 1000) for x in (1, 2, 3)],
        )
        | of_all(
            FINAL,
            [Runs(windows({(1, 500): x, (835, 1000): x + 40}, -LOUD), 1000) for x in (1, 2, 3)],
        ),
        (
            *(
                {f"boxing_transfer/{agent}": Runs(windows({(1, 500): 9, (835, 1000): 40}, -LOUD))}
                for agent in AGENTS
            ),
            *(
                {f"boxing_transfer/{agent}": Runs(windows({(1, 500): 0, (835, 1000): 50}, -LOUD))}
                for agent in AGENTS
            ),
        ),
        ", ".join(
            f"{name} `boxing_transfer` {x + 4} `{FINAL}` {x}"
            for more in (0, 40)
            for x, name in zip(
                (more + 1, more + 2, more + 3),
                ("DQN", "Double DQN", "Dueling Double DQN"),
                strict=True,
            )
        ),
    ),
    "17 high discount": Case(
        "A discount of 0.995 changes the score, by more than 5 points up or down against 0.99 (the "
        "effect is called surprising, its direction is not stated)",
        {
            f"boxing_high_gamma/{DUELING}": games(1668, 2000, 30, LOUD),
            f"{FINAL}/{DUELING}": games(1668, 2000, 40, -LOUD),
        },
        ({f"boxing_high_gamma/{DUELING}": games(1668, 2000, 42, LOUD)},),
        f"Dueling Double DQN `boxing_high_gamma` 30 `{FINAL}` 40",
    ),
    "18 tuning": Case(
        "Tuning the learning rate, the batch size and the number of games all helped in Boxing: "
        "a higher rate, larger batches and fewer games (901 to 1,400) score lower than the final "
        "settings",
        {
            f"{FINAL}/{DUELING}": Runs(
                windows({(1, 500): 30, (901, 1400): 50, (2501, 3000): 80}, -LOUD), 3000
            ),
            f"boxing_sensitivity/{DUELING}/learning rate x 4": games(1, 500, 10, LOUD),
            f"boxing_sensitivity/{DUELING}/batch size x 2": games(1, 500, 20, LOUD),
        },
        (
            {f"boxing_sensitivity/{DUELING}/learning rate x 4": games(1, 500, 40, LOUD)},
            {f"boxing_sensitivity/{DUELING}/batch size x 2": games(1, 500, 40, LOUD)},
            {
                f"{FINAL}/{DUELING}": Runs(
                    windows({(1, 500): 30, (901, 1400): 90, (2501, 3000): 80}, -LOUD), 3000
                )
            },
        ),
        f"Dueling Double DQN `{FINAL}` 30 `boxing_sensitivity` 4 10, "
        f"Dueling Double DQN `{FINAL}` 30 `boxing_sensitivity` 2 20, "
        "Dueling Double DQN 500 3000 1400 80 50",
    ),
    "19 clipped rewards": Case(
        "Clipped rewards make learning in Boxing faster than raw ones: they score more over the "
        "first 500 games",
        {
            f"{FINAL}/{DUELING}": early(30),
            f"boxing_sensitivity/{DUELING}/raw rewards": early(20, LOUD),
        },
        ({f"boxing_sensitivity/{DUELING}/raw rewards": early(40)},),
        f"Dueling Double DQN `{FINAL}` 30 `boxing_sensitivity` 20",
    ),
    "20 early improves": Case(
        "With the early Boxing settings, DQN still improves: what it scores greedily during its "
        "last 500 games is more than during its first 500, by any amount",
        {"boxing_early/dqn": checked(1400, score=np.repeat([5.0, -LOUD, 15.0], [5, 4, 5]))},
        ({"boxing_early/dqn": checked(1400, score=np.repeat([15.0, LOUD, 5.0], [5, 4, 5]))},),
        "DQN 500 1400 500 15 5",
    ),
    "21 double less stable": Case(
        "In the later Breakout experiment Double and Dueling Double DQN are less stable than DQN: "
        "their curves oscillate more",
        of_all(LATE, [swaying(by, games=3000) for by in (1.0, 5.0, 5.0)]),
        (
            of_all(LATE, [swaying(by, games=3000) for by in (3.0, 1.0, 5.0)]),
            of_all(LATE, [swaying(by, games=3000) for by in (3.0, 5.0, 1.0)]),
        ),
        f"DQN {2.5**0.5:.1f} Double DQN {98.5**0.5:.1f} 0 0, "
        f"DQN {2.5**0.5:.1f} Dueling Double DQN {98.5**0.5:.1f} 0 0",
    ),
    "22 low gamma reverts": Case(
        "With a discount of 0.9 the agent keeps reverting its strategies: its curve oscillates "
        "more than with 0.99",
        {
            f"{FINAL}/{DUELING}": swaying(1.0, games=1000),
            f"boxing_low_gamma/{DUELING}": swaying(5.0, games=1000),
        },
        (
            {
                f"{FINAL}/{DUELING}": swaying(5.0, games=1000),
                f"boxing_low_gamma/{DUELING}": swaying(1.0, games=1000),
            },
        ),
        f"Dueling Double DQN `{FINAL}` {2.5**0.5:.1f} `boxing_low_gamma` {98.5**0.5:.1f} 0 0",
    ),
    "double overestimates less": Case(
        "Double DQN leads in Boxing because it overestimates less",
        {
            f"{FINAL}/{agent}": replace(
                final(mean, outside),
                checks={  # up to game 1,500, the first half, nothing counts
                    "score": np.zeros(30),
                    "realised": np.r_[np.full(15, LOUD), np.full(15, got)],
                    "predicted": np.r_[np.full(15, LOUD - gap * LOUD), np.full(15, got + gap)],
                },
            )
            for agent, mean, outside, gap, got in (
                (DQN, 80, LOUD, 2.0, 4.0),
                (DOUBLE, 90, -LOUD, 0.5, 3.0),
                (DUELING, 85, LOUD, 9.0, 7.0),
            )
        },
        (
            {
                f"{FINAL}/{DOUBLE}": replace(
                    final(90),
                    checks={
                        "score": np.zeros(30),
                        "realised": np.full(30, 2.0),
                        "predicted": np.r_[np.full(15, -LOUD), np.full(15, 5.0)],
                    },
                )
            },
            {f"{FINAL}/{DUELING}": final(95, LOUD)},
        ),
        "Double DQN 90 DQN 80, Double DQN 90 Dueling Double DQN 85, DQN 2 Double DQN 0.5 4 3",
        "interpretations",
    ),
    "dueling learns faster": Case(
        "Dueling Double DQN learns faster because of its two streams",
        {f"{FINAL}/{DOUBLE}": early(20, LOUD), f"{FINAL}/{DUELING}": early(30)},
        ({f"{FINAL}/{DUELING}": early(15)},),
        "Dueling Double DQN 30 Double DQN 20 (Double DQN is the same agent without the streams)",
        "interpretations",
    ),
    "expert is slower": Case(
        "Expert mode is learned faster because both boxers move more slowly",
        *FASTER_IN_EXPERT_MODE,
        "interpretations",
    ),
    "goal human in Boxing": Case(
        "Human level in Boxing with each agent",
        of_all(FINAL, [final(mean) for mean in (14, 15, 16)]),
        tuple({f"{FINAL}/{agent}": final(10, LOUD)} for agent in AGENTS),
        "DQN 14 12.1, Double DQN 15 12.1, Dueling Double DQN 16 12.1",
        "goals",
    ),
    "goal human in Breakout": Case(
        "Human level in Breakout with each agent",
        of_all("breakout_final", [final(mean) for mean in (34, 35, 36)]),
        tuple({f"breakout_final/{agent}": final(27, LOUD)} for agent in AGENTS),
        "DQN 34 30.5, Double DQN 35 30.5, Dueling Double DQN 36 30.5",
        "goals",
    ),
    "goal comparable data": Case(
        "Comparable data for three agents and two games",
        of_all(FINAL, [final(0)] * 3) | of_all("breakout_final", [final(0)] * 3),
        (),
        f"100 `{FINAL}` 100 `breakout_final` 100",
        "goals",
    ),
    "goal hyper-parameters": Case(
        "How hyper-parameters change performance",
        {
            **{
                f"boxing_sensitivity/{DUELING}/{label}": Runs(np.zeros(500), 500)
                for label in settings("boxing_sensitivity").variations
            },
            f"boxing_low_gamma/{DUELING}": Runs(np.zeros(1000), 1000),
            f"boxing_high_gamma/{DUELING}": Runs(np.zeros(2000), 2000),
        },
        (),
        "100 `boxing_sensitivity` 100 `boxing_low_gamma` 100 `boxing_high_gamma` 100",
        "goals",
    ),
    "goal transfer": Case(
        "How well transfer from Breakout to Boxing works",
        {
            **of_all("boxing_transfer", [Runs(np.zeros(1000), 1000)] * 3),
            **{
                f"boxing_transfer_controls/{DUELING}/{label}": Runs(np.zeros(1000), 1000)
                for label in settings("boxing_transfer_controls").variations
            },
        },
        (),
        "100 `boxing_transfer` 100 `boxing_transfer_controls` 100",
        "goals",
    ),
}
WORDS = {  # of the tables, for true, false and not known yet
    "findings": ("in these runs: yes", "in these runs: no", "open"),
    "interpretations": ("in these runs: yes", "in these runs: no", "open"),
    "goals": ("reached in these runs", "not reached in these runs", "open"),
}
COLUMNS = {
    "findings": ("claim", "verdict"),
    "interpretations": ("interpretation", "premise"),
    "goals": ("goal", "our verdict"),
}


def judged(results, case):
    """The verdict and the evidence in the row that the report's table has of a claim."""
    stored, (claim, word) = study(results), COLUMNS[case.table]
    if case.table == "findings":
        table = claims.table([one for one in claims.FINDINGS if one.text == case.claim], stored)
    else:
        table = getattr(claims, case.table)(stored)
    (row,) = table[table[claim] == case.claim].to_dict("records")
    return row[word], row["evidence"]


INTERVAL = re.compile(
    r"[, ]*\(?(difference of their squares|difference|DQN's is larger by|) ?"
    r"(-?[\d.]+) to (-?[\d.]+)\)?"
)


def check_intervals(evidence):
    """Each lies about what it is said to be the interval of: a mean, or a difference."""
    evidence = by_name(evidence)
    evidence = re.sub(r"` \([^)]*\)", "`", evidence)  # a variation's name, with its numbers
    for found in INTERVAL.finditer(evidence):
        *_, one, other = (0.0, *numbers(evidence[: found.start()]))
        what, low, high = found[1], float(found[2]), float(found[3])
        middle, rounding = (one - other, 0.11) if what else (other, 0.06)
        if "squares" in what:
            middle, rounding = other**2 - one**2, 0.06 * (one + other) + 0.06
        assert low <= high
        assert (low + high) / 2 == pytest.approx(middle, abs=rounding), found[0]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_claim_is_true_with_its_numbers_and_open_while_any_run_lacks_a_game(tmp_path, case):
    true, _, not_yet = WORDS[case.table]
    for place, stored in case.true.items():
        stored.put(tmp_path, place)
    word, evidence = judged(tmp_path, case)
    assert word == (true if case.false else "reached"), evidence  # a fact is one in any runs
    assert facts(INTERVAL.sub("", evidence)) == facts(case.evidence)
    check_intervals(evidence)
    for place, stored in case.true.items():
        stored.short().put(tmp_path, place)
        assert judged(tmp_path, case)[0] == not_yet, place
        stored.put(tmp_path, place)


@pytest.mark.parametrize(
    ("case", "changes"),
    [(case, changes) for case in CASES.values() for changes in case.false],
    ids=[f"{name}: {', '.join(places)}" for name, case in CASES.items() for places in case.false],
)
def test_a_claim_is_false_if_any_part_of_it_is(tmp_path, case, changes):
    for place, stored in (case.true | changes).items():
        stored.put(tmp_path, place)
    word, evidence = judged(tmp_path, case)
    assert word == WORDS[case.table][1], evidence
    check_intervals(evidence)


PARTIAL = [
    name
    for name, case in CASES.items()
    for experiment in {place.split("/")[0] for place in case.true}
    if sum(place.startswith(experiment) for place in case.true) < len(settings(experiment).agents)
]


@pytest.mark.parametrize("name", dict.fromkeys(PARTIAL))
def test_what_agents_do_of_whom_a_claim_says_nothing_changes_nothing(tmp_path, name):
    case = CASES[name]
    for place, stored in case.true.items():
        stored.put(tmp_path, place)
    expected = judged(tmp_path, case)
    others = {
        f"{experiment}/{agent}"
        for experiment in {place.split("/")[0] for place in case.true}
        if not settings(experiment).variations
        for agent in settings(experiment).agents
    }
    lengths = {place.split("/")[0]: len(stored.scores) for place, stored in case.true.items()}
    for place in sorted(others - set(case.true)):
        length = lengths[place.split("/")[0]]
        loud = np.full(length // 100, LOUD)
        styles = {"score": loud, "conceded": loud, "distance": loud}
        every = replace(checked(length, score=loud), greedy=dict.fromkeys(SPREAD, LOUD))
        replace(every, styles=styles).put(tmp_path, place)
    assert judged(tmp_path, case) == expected


def test_every_claim_has_a_case_with_the_experiments_that_it_is_about():
    untested = (*claims.FINDINGS[22:], *claims.INTERPRETATIONS[3:])  # which no run can judge
    by_text = {case.claim: case for case in CASES.values()}
    for claim in (*claims.FINDINGS, *claims.INTERPRETATIONS, *claims.GOALS[1:]):
        if claim in untested:
            assert claim.judge(None).verdict == "not tested"
            continue
        stored = {place.split("/")[0] for place in by_text[claim.text].true}
        assert set(claim.experiments) <= stored, claim.text
    numbered = [claim.text for claim in claims.FINDINGS]
    assert [by_text[text].table for text in numbered[:22]] == ["findings"] * 22


GOAL_BOXER = claims.GOALS[0].text
EVERYWHERE = {0: 90.0, 1: 4.0, 2: 95.0, 3: 60.0}  # mean score by difficulty


def boxes(run, means, **columns):
    """Evaluates a run at each difficulty with a mean score; wins half of it by knock-out, and is
    knocked out in a quarter of the games."""
    out = {"knockout": [1, 0, -1, 1] * 10}
    (run.folder / "evaluations.csv").unlink(missing_ok=True)
    for number, (difficulty, mean) in enumerate(means.items()):
        evaluate(run, add=number > 0, score=mean, difficulty=difficulty, **out, **columns)


def test_the_computers_boxer_is_beaten_if_every_agent_wins_at_every_difficulty(tmp_path):
    case = Case(GOAL_BOXER, {}, (), "", "goals")
    assert judged(tmp_path, case)[0] == "open"
    runs = {agent: store(tmp_path, FINAL, agent, np.zeros(10)) for agent in AGENTS}
    for agent in (DQN, DOUBLE):
        boxes(runs[agent], dict.fromkeys(EVERYWHERE, 50.0))
    word, evidence = judged(tmp_path, case)
    assert (word, facts(evidence)[-3:]) == ("open", ["Dueling Double DQN", 0, 4])
    assert evidence.startswith("DQN wins at all difficulties"), "what is known already"
    run = runs[DUELING]
    boxes(run, EVERYWHERE)
    # episodes played otherwise do not count: with sticky actions, at random, of an earlier model
    for otherwise in ({"sticky_actions": 0.25}, {"epsilon": 1.0}, {"trained": 2000}):
        for difficulty in EVERYWHERE:
            evaluate(run, add=True, score=-80.0, difficulty=difficulty, **otherwise)
    word, evidence = judged(tmp_path, case)
    assert word == "reached in these runs"
    means = facts(INTERVAL.sub("", evidence))
    assert means[0] == 1, "the hardest, whose mean over the agents is lowest"
    assert evidence.count("wins at all difficulties") == 3
    expected = {DQN: (0, 50), DOUBLE: (0, 50), DUELING: (1, 4)}
    assert means[1:] == [one for agent, won in expected.items() for one in (TITLES[agent], *won)]
    check_intervals(evidence)
    for difficulty in EVERYWHERE:
        boxes(run, {**EVERYWHERE, difficulty: -6.0})
        word, evidence = judged(tmp_path, case)
        assert word == "not reached in these runs", difficulty
        assert facts(INTERVAL.sub("", evidence))[-5:] == [
            "Dueling Double DQN",
            3,
            4,
            difficulty,
            -6,
        ]
        boxes(run, {key: mean for key, mean in EVERYWHERE.items() if key != difficulty})
        word, evidence = judged(tmp_path, case)
        assert (word, facts(evidence)[-3:]) == ("open", ["Dueling Double DQN", 3, 4])
    boxes(run, EVERYWHERE, trained=2999)
    assert judged(tmp_path, case)[0] == "open", "a model that is not the finished run's"
    boxes(run, EVERYWHERE)
    boxes(runs[DQN], {**EVERYWHERE, 0: -6.0})
    assert judged(tmp_path, case)[0] == "not reached in these runs", "of whichever agent"


def test_what_is_played_of_a_goal_that_waits_is_a_share_of_all_games_planned(tmp_path):
    for agent in AGENTS:
        store(tmp_path, "breakout_final", agent, np.zeros(3000))
    store(tmp_path, FINAL, DQN, np.zeros(2250))
    case = CASES["goal comparable data"]
    assert judged(tmp_path, case)[0] == "open"
    expected = "62 `boxing_final` 25 `breakout_final` 100"  # 2,250 of 9,000; 62.5 on average
    assert facts(judged(tmp_path, case)[1]) == facts(expected)
    assert facts(judged(tmp_path, CASES["4 double highest"])[1]) == facts("`boxing_final` 25")


def test_the_doubt_about_where_training_began_widens_the_interval_of_a_gain(tmp_path):
    case = CASES["15 faster in expert mode"]
    for place, stored in case.true.items():
        stored.put(tmp_path, place)
    # Of 50 games, two lie 100 above the level of the others: a variance of 100 ** 2 * (2 / 50) *
    # (48 / 50) = 384 a game, 384 / 50 of a mean, twice that of the difference of two.
    half = 1.96 * (2 * 384 / 50) ** 0.5
    for part in judged(tmp_path, case)[1].split("; "):
        assert numbers(part)[-2:] == pytest.approx([20 - half, 20 + half], abs=0.06)


@pytest.fixture
def three_seeds(tmp_path):
    """Stores Dueling Double DQN from three seeds, whose scores and greedy games have the means of
    one experiment each, and returns the study."""

    def of(**means):
        stored = study(tmp_path)
        for experiment, of_seeds in means.items():
            for seed, mean in enumerate(of_seeds, start=1):
                scores = window(2501, 3000, mean, -LOUD)[: settings(experiment).episodes]
                run = store(tmp_path, experiment, DUELING, scores, seed=seed)
                boxes(run, dict.fromkeys(EVERYWHERE, mean), conceded=mean)
            stored.sections[experiment] = Section(
                experiment, "full", str(tmp_path), [DUELING], [1, 2, 3]
            )
        return stored

    return of


def test_of_three_seeds_a_mean_has_students_interval_over_seeds(three_seeds):
    stored = three_seeds(boxing_final=[10.0, 20.0, 30.0])
    found = verdicts.human_level(stored, FINAL)
    half = stats.t.ppf(0.975, 2) * 10 / 3**0.5
    assert found.verdict == "inconclusive"
    assert numbers(found.evidence) == pytest.approx([20, 20 - half, 20 + half, 12.1], abs=0.06)
    boxer = verdicts.beaten_everywhere(stored)
    assert boxer.verdict == "inconclusive"
    expected = [0, 0, 4, 0, 20, 20 - half, 20 + half]  # hardest, won, of, worst, mean, interval
    assert numbers(boxer.evidence) == pytest.approx(expected, abs=0.06)
    assert verdicts.human_level(three_seeds(boxing_final=[19.0, 20.0, 21.0]), FINAL).verdict == (
        "supported"
    )


def test_of_three_seeds_greedy_episodes_are_compared_as_seeds(three_seeds):
    one, other = [60.0, 80.0, 100.0], [20.0, 24.0, 28.0]
    stored = three_seeds(boxing_low_gamma=one, boxing_final=other)
    (found,) = verdicts.compare_evaluations(stored, "boxing_low_gamma", FINAL)
    low, high = stats.ttest_ind(one, other, equal_var=False).confidence_interval()
    assert numbers(by_name(found.evidence)) == pytest.approx([80, 24, low, high], abs=0.06)
    assert found.verdict == "supported"


def test_two_seeds_support_nothing_however_clear_their_difference(three_seeds):
    stored = three_seeds(boxing_low_gamma=[60.0, 80.0], boxing_final=[20.0, 24.0, 28.0])
    stored.sections["boxing_low_gamma"].params.seeds[:] = [1, 2]
    (found,) = verdicts.compare_evaluations(stored, "boxing_low_gamma", FINAL)
    assert found.verdict == "in these runs: yes"
    assert verdicts.negated(found).verdict == "in these runs: no"


def test_a_boxers_episodes_that_begin_alike_are_one_piece_of_evidence(tmp_path):
    for agent in AGENTS:
        boxes(store(tmp_path, FINAL, agent, np.zeros(10)), EVERYWHERE)
    stored = study(tmp_path)
    played = stored[FINAL].all_evaluations
    hardest = played[(played.agent == DQN) & (played.difficulty == 1)]
    assert hardest.opening.nunique() < len(hardest)
    expected = student_interval(by_cluster(hardest.score, hardest.opening))
    found = INTERVAL.search(verdicts.beaten_everywhere(stored).evidence)
    assert [float(found[2]), float(found[3])] == pytest.approx(expected, abs=0.06)


def scores(mean, games=3000, seed=0):
    return mean + np.random.default_rng(seed).normal(0, 5, games)


def verdict(results, text):
    (claim,) = [claim for claim in claims.FINDINGS if claim.text == text]
    return claim.judge(study(results))


BEST = "Double DQN ends highest in Boxing"
YES, NO, UNCLEAR = "in these runs: yes", "in these runs: no", "in these runs: unclear"


def test_without_runs_every_claim_is_not_yet_run(tmp_path):
    empty = study(tmp_path)
    assert set(claims.findings(empty).verdict) == {"open", "not tested"}
    assert set(claims.goals(empty)["our verdict"]) == {"open"}
    assert set(claims.interpretations(empty)["premise"]) == {"open", "not tested"}
    assert summaries.reading(empty, "boxing_low_gamma") == ""
    assert "Training has only begun: 0 of" in summaries.headline(empty)


@pytest.mark.parametrize(
    ("double", "expected"),
    [(92.0, YES), (60.0, NO), (80.05, UNCLEAR)],
)
def test_a_comparison_is_judged_by_the_interval_of_the_difference(tmp_path, double, expected):
    means = {"dqn": 80.0, "double_dqn": double, "dueling_double_dqn": 80.0}
    for seed, (agent, mean) in enumerate(means.items()):
        store(tmp_path, "boxing_final", agent, scores(mean, seed=seed))
    found = verdict(tmp_path, BEST)
    assert found.verdict == expected
    assert "against DQN 79.7, difference" in found.evidence


def test_a_claim_about_games_not_yet_played_is_not_judged(tmp_path):
    for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
        store(tmp_path, "boxing_final", agent, scores(50.0, games=1200))
    assert verdict(tmp_path, BEST).verdict == "open"
    assert "Boxing, final settings (40% played)" in verdict(tmp_path, BEST).evidence
    human = "All three agents exceed the human score in Boxing after 1,000 games"
    assert verdict(tmp_path, human).verdict == YES


def test_a_changed_score_changes_the_numbers(tmp_path):
    for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
        run = store(tmp_path, "boxing_final", agent, scores(50.0))
    before = verdict(tmp_path, BEST).evidence
    path = run.folder / "episodes.csv"
    table = pd.read_csv(path)
    table.loc[2999, "score"] = 100000.0
    table.to_csv(path, index=False)
    assert verdict(tmp_path, BEST).evidence != before


def test_the_parts_of_a_claim_are_weighed_together():
    outcome, verdict = verdicts.Outcome, verdicts.Verdict
    both = verdicts.all_of([verdict(outcome.YES, "a"), verdict(outcome.UNCLEAR, "b")])
    assert (both.outcome, both.evidence) == (outcome.UNCLEAR, "a; b")
    against = verdicts.all_of([verdict(outcome.NO, ""), verdict(outcome.OPEN, "")])
    assert against.outcome == outcome.NO
    for kind in (outcome.YES, outcome.UNCLEAR):
        waiting = verdicts.all_of([verdict(kind, "a"), verdict(outcome.OPEN, "b")])
        assert (waiting.outcome, waiting.evidence) == (outcome.OPEN, "b")
    assert verdicts.negated(verdict(outcome.YES, "")).outcome == outcome.NO
    assert verdicts.negated(verdict(outcome.UNCLEAR, "")).outcome == outcome.UNCLEAR


def test_the_word_is_strong_from_three_seeds_on_of_every_part_that_a_verdict_needs():
    outcome, verdict = verdicts.Outcome, verdicts.Verdict
    assert [verdict(outcome.YES, "", seeds).verdict for seeds in (1, 2, 3, 4)] == [
        *(YES, YES),
        *("supported", "supported"),
    ]
    assert verdict(outcome.NO, "", 3).verdict == "contradicted"
    assert verdict(outcome.UNCLEAR, "", 3).verdict == "inconclusive"
    one, many = verdict(outcome.YES, "", 1), verdict(outcome.YES, "", 5)
    assert verdicts.all_of([one, many]).verdict == YES
    assert verdicts.all_of([one, verdict(outcome.NO, "", 5)]).verdict == "contradicted"
    assert verdicts.all_of([many, verdict(outcome.NO, "", 1)]).verdict == NO


def test_a_curve_that_swings_is_told_from_one_that_rises(tmp_path):
    rising = np.linspace(0, 80, 3000)
    store(tmp_path, "boxing_final", "dqn", rising + scores(0.0, seed=1))
    swinging = 2 + 8 * np.sin(np.arange(1400) / 40)
    store(tmp_path, "boxing_early", "dqn", swinging + scores(0.0, games=1400))
    claim = "With the early Boxing settings, the learning curve oscillates more"
    assert verdict(tmp_path, claim).verdict == YES
    store(tmp_path, "boxing_early", "dqn", scores(0.0, games=1400))
    assert verdict(tmp_path, claim).verdict == UNCLEAR, "it does not learn at all"


def test_a_curve_that_rises_less_does_not_oscillate_more(tmp_path):
    claim = "With the early Boxing settings, the learning curve oscillates more"
    found = []
    for seed in range(20):
        luck = np.random.default_rng(seed).normal(0, 15, (2, 3000))
        store(tmp_path, "boxing_final", "dqn", np.linspace(0, 80, 3000) + luck[0])
        store(tmp_path, "boxing_early", "dqn", np.linspace(0, 12, 1400) + luck[1, :1400])
        found.append(verdict(tmp_path, claim).verdict)
    assert found.count(UNCLEAR) >= 17


def test_what_is_learned_along_the_way_is_compared_after_the_same_games(tmp_path):
    claim = (
        "The early Boxing settings (a learning rate of 0.001, batches of 64, a minimum epsilon of "
        "0.1) learn less than the final ones"
    )
    final = store(tmp_path, "boxing_final", "dqn", scores(0.0))
    check(final, np.concatenate([np.full(14, 30.0), np.full(16, -90.0)]))
    store(tmp_path, "boxing_early", "dqn", scores(90.0, games=1399))
    assert verdict(tmp_path, claim).verdict == "open"
    early = store(tmp_path, "boxing_early", "dqn", scores(90.0, games=1400))
    check(early, 10.0 + np.arange(14) % 3)
    found = verdict(tmp_path, claim)
    assert found.verdict == YES, "whatever it scores while it explores"
    assert "DQN: `boxing_final`, 30.0 against `boxing_early`, 10.9" in by_name(found.evidence)
    check(early, 40.0 + np.arange(14) % 3)
    assert verdict(tmp_path, claim).verdict == NO


def test_only_dqn_is_human_in_breakout_falls_with_a_better_double_dqn(tmp_path):
    claim = "Of the three, only DQN reaches the human score in Breakout"
    for agent, mean in (("dqn", 40.0), ("double_dqn", 15.0), ("dueling_double_dqn", 21.0)):
        store(tmp_path, "breakout_final", agent, scores(mean))
    assert verdict(tmp_path, claim).verdict == YES
    store(tmp_path, "breakout_final", "double_dqn", scores(35.0))
    assert verdict(tmp_path, claim).verdict == NO


def test_an_interpretation_gets_no_verdict_but_its_premise_does(tmp_path):
    for agent, mean in (("dqn", 80.0), ("double_dqn", 60.0), ("dueling_double_dqn", 70.0)):
        store(tmp_path, "boxing_final", agent, scores(mean))
    found = claims.interpretations(study(tmp_path))["premise"].tolist()
    assert found[:2] == [NO, YES]


def test_an_evaluation_of_a_finished_run_decides_and_none_of_an_unfinished_one(tmp_path):
    claim = CASES["7 preprocessing"].claim
    for experiment, mean, length in ((EARLY, 10.0, 7000), (LATE, 30.0, 3000)):
        run = store(tmp_path, experiment, DQN, scores(50.0, length))
        evaluate(run, score=mean)
    found = verdict(tmp_path, claim)
    assert found.verdict == YES
    assert "evaluated: DQN: `breakout_late`, 30." in by_name(found.evidence)
    evaluate(run, score=1.0)
    assert verdict(tmp_path, claim).verdict == NO
    evaluate(run, trained=300, score=30.0)
    assert verdict(tmp_path, claim).verdict == "open", "of an unfinished model"


def test_greedy_episodes_that_begin_alike_are_one_piece_of_evidence(tmp_path):
    """Openings differ by more than the two agents do; 100 games of Breakout have four of them."""
    claim, sides = CASES["7 preprocessing"].claim, []
    for seed, (experiment, mean, length) in enumerate(((EARLY, 20.0, 7000), (LATE, 24.0, 3000))):
        run = store(tmp_path, experiment, DQN, scores(50.0, length))
        evaluate(run, games=100)
        path = run.folder / "evaluations.csv"
        table = pd.read_csv(path)
        worth = np.random.default_rng(seed).normal(0, 12, 4)[openings(table, run.params)]
        table["score"] = mean + worth - worth.mean()
        put_evaluations(path, table)
        sides.append(table.score)
    low, _ = welch_interval(sides[1], sides[0])
    assert low > 0, "if each game were evidence of its own"
    found = verdict(tmp_path, claim)
    assert found.verdict == UNCLEAR
    assert "`breakout_late`, 24.0 against `breakout_early`, 20.0" in by_name(found.evidence)


def test_a_difference_of_style_that_skill_may_explain_is_unclear(tmp_path):
    """No check of the other run scores within five points."""
    case = CASES["12 reckless"]
    for place, stored in case.true.items():
        stored.put(tmp_path, place)
    better = styled(1000, {"score": 36, "conceded": 40}, {"score": 50, "conceded": 20})
    better.put(tmp_path, f"{FINAL}/{DUELING}")
    word, evidence = judged(tmp_path, case)
    assert word == UNCLEAR
    assert evidence.endswith("only 0 of 5 checks have one of the same score beside them")


def test_styles_that_are_not_measured_are_said_to_be(tmp_path):
    for place, stored in CASES["14 shy"].true.items():
        replace(stored, scores=np.zeros(3000), styles=None).put(tmp_path, place)
    for agent in (DQN, DOUBLE):
        store(tmp_path, FINAL, agent, np.zeros(3000))
    word, evidence = judged(tmp_path, CASES["14 shy"])
    assert word == "open"
    assert "not measured yet" in evidence


def test_three_seeds_styles_are_compared_as_seeds(three_seeds):
    stored = three_seeds(boxing_low_gamma=[0.0] * 3, boxing_final=[0.0] * 3)
    conceded = {"boxing_low_gamma": [60.0, 80.0, 100.0], "boxing_final": [20.0, 24.0, 28.0]}
    for name, means in conceded.items():
        for run, mean in zip(stored[name].runs, means, strict=True):
            style(run, score=np.full(10, 30.0), conceded=np.full(10, mean))
    (found,) = verdicts.compare_style(stored, *conceded, "conceded_per_minute")
    one, other = (np.divide(means, 2) for means in conceded.values())
    low, high = stats.ttest_ind(one, other, equal_var=False).confidence_interval()
    told = numbers(by_name(found.evidence))[:6]
    assert told == pytest.approx([30, 30, 40, 12, low, high], abs=0.06)
    # all checks score alike: each stands beside the first seed's first
    student = stats.ttest_1samp(one - other[0], 0).confidence_interval()
    expected = [40, other[0], student.low, student.high]
    assert numbers(by_name(found.evidence))[6:] == pytest.approx(expected, abs=0.06)
    assert found.verdict == "inconclusive" if student.low < 0 else "supported"


def test_a_change_either_way_is_one_and_a_small_one_is_none():
    rule, outcome = verdicts.apart(5.0), verdicts.Outcome
    for low, high, expected in (
        *((6, 9, outcome.YES), (-9, -6, outcome.YES), (-4, 4, outcome.NO)),
        *((-9, 9, outcome.UNCLEAR), (2, 8, outcome.UNCLEAR), (-8, -2, outcome.UNCLEAR)),
    ):
        assert rule(low, high) == expected, (low, high)


def test_no_gain_from_transfer_is_support_for_its_not_helping(tmp_path):
    claim = CASES["16 transfer"].claim
    agents = ("dqn", "double_dqn", "dueling_double_dqn")
    for agent in agents:
        store(tmp_path, "boxing_final", agent, scores(50.0))
        store(tmp_path, "boxing_transfer", agent, scores(50.0)[::-1])
    assert verdict(tmp_path, claim).verdict == YES
    for agent in agents:
        store(tmp_path, "boxing_transfer", agent, scores(60.0))
    assert verdict(tmp_path, claim).verdict == NO


def test_what_is_gained_counts_in_expert_mode_and_not_the_scale_of_its_scores(tmp_path):
    claim = (
        "All agents learn faster in expert mode: in the first 500 games they gain more over their "
        "own first 50"
    )
    rising = np.linspace(0, 30, 3000)
    for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
        store(tmp_path, "boxing_final", agent, rising + scores(0, seed=1))
        store(tmp_path, "boxing_expert", agent, rising[:1000] + scores(20, 1000, seed=2))
    assert verdict(tmp_path, claim).verdict == UNCLEAR
    for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
        store(tmp_path, "boxing_expert", agent, 10 * rising[:1000] + scores(0, 1000, seed=2))
    assert verdict(tmp_path, claim).verdict == YES


def test_three_seeds_a_side_are_compared_as_seeds(tmp_path):
    section = study(tmp_path)["boxing_final"]
    section.__dict__["episodes"] = pd.DataFrame(
        {
            "agent": np.repeat(["dqn", "double_dqn"], 3 * 150),
            "seed": np.tile(np.repeat([1, 2, 3], 150), 2),
            "episode": np.tile(np.arange(1, 151), 6),
            "score": np.repeat([10.0, 20.0, 30.0, 25.0, 35.0, 45.0], 150),
        }
    )
    pair = (section, section)
    found = verdicts.compare_scores(pair, ("double_dqn", "dqn"), 1, 150)
    welch = stats.ttest_ind([25, 35, 45], [10, 20, 30], equal_var=False).confidence_interval()
    assert found.verdict == "open", "one seed is planned"
    section.params = section.params.model_copy(update={"seeds": [1, 2, 3]})
    found = verdicts.compare_scores(pair, ("double_dqn", "dqn"), 1, 150)
    assert found.verdict == "inconclusive", "though every block of games is above"
    assert f"difference {welch.low:.1f} to {welch.high:.1f}" in found.evidence
    # of nine pairs of seeds, 35 and 45 are above all three, and 25 above two
    assert "probability of improvement 89%" in found.evidence


def test_how_far_a_goal_is_counts_games_not_experiments(tmp_path):
    """500 of 1,000 games of one, none of 2,000 and 7,000 of the others: a twentieth of all."""
    store(tmp_path, "boxing_low_gamma", DUELING, np.zeros(500))
    names = ["boxing_sensitivity", "boxing_low_gamma", "boxing_high_gamma"]
    stored = study(tmp_path)
    assert [stored[name].planned for name in names] == [7000, 1000, 2000]
    found = verdicts.runs_finished(stored, names)
    assert (found.outcome, numbers(found.evidence)[0]) == (verdicts.Outcome.OPEN, 5)
