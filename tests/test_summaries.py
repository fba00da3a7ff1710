"""The computed sentences of the report give the numbers, names and verdicts of the stored runs."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic import (
    AGENTS,
    ROOT,
    check,
    evaluate,
    facts,
    numbers,
    store,
    study,
    window,
    windows,
)

from atari_dqn.analysis import summaries
from atari_dqn.analysis.claims import FINDINGS
from atari_dqn.analysis.statistics import coverage, likeness, series_interval
from atari_dqn.analysis.study import Section
from atari_dqn.analysis.verdicts import Mean
from atari_dqn.params import VALUE_GAMES

DQN, DOUBLE, DUELING = AGENTS
FAR = 5000.0  # points, of a game that must not count


def boxing(results, means, experiment="boxing_final", first=2501, last=3000):
    """Runs whose games from first to last have these means; other games say the opposite."""
    for agent, mean in means.items():
        scores = window(first, last, mean, -FAR * mean, after=0 if last == 3000 else 10)
        store(results, experiment, agent, scores)
    return study(results)


def test_the_headline_has_each_agents_mean_the_best_first_beside_a_human_and_random_play(tmp_path):
    text = summaries.headline(boxing(tmp_path, {DQN: 5.0, DOUBLE: 13.0, DUELING: 11.5}))
    ranked = ["Double DQN", 13.0, "Dueling Double DQN", 11.5, "DQN", 5.0]
    assert facts(text.split("**")[1]) == [3000, *ranked, 500, 100, 12.1, 0.1]


def test_a_headline_of_runs_in_progress_compares_the_last_hundred_episodes_that_all_have_played(
    tmp_path,
):
    store(tmp_path, "boxing_final", DQN, window(701, 800, 6.0, FAR, after=100))
    store(tmp_path, "boxing_final", DOUBLE, window(701, 800, 9.0, -FAR, after=0))
    text = summaries.headline(study(tmp_path))
    expected = [800, "Double DQN", 9.0, "DQN", 6.0, 100, 100, 12.1, 0.1]
    assert facts(text.split("**")[1]) == expected


def test_an_agent_has_one_score_wherever_it_is_told(tmp_path):
    """In the headline, beside the others and in the reading, of runs in progress and of finished
    ones: never that of an evaluation."""
    for length, expected, window_ in ((810, 42.0, 100), (3000, 33.0, 500)):
        scores = np.r_[np.full(length - 100, 30.75), np.full(100, 42.0)]  # of 500, 33
        run = store(tmp_path, "boxing_final", DOUBLE, scores)
        for agent in (DQN, DUELING):
            store(tmp_path, "boxing_final", agent, np.full(length, 1.0))
        evaluate(run, score=77.0, trained=length)
        stored = study(tmp_path)
        found = summaries.score(stored["boxing_final"], DOUBLE)
        assert (found.mean, found.window, found.episodes) == (expected, window_, length)
        assert float(found) == expected
        assert expected in facts(summaries.headline(stored))
        (line,) = [
            one for one in lines(summaries.reading(stored, "boxing_final")) if "- Double" in one
        ]
        assert facts(line)[:4] == ["Double DQN", expected, window_, length]
        assert "Evaluated after" in line
        assert "77" not in summaries.headline(stored)


def three_true_and_one_false(results):
    """Claims 1, 2 and 4 hold, claim 3 is false, and nothing is stored for the others."""
    means = {DQN: 80.0, DOUBLE: 90.0, DUELING: 85.0}
    for agent, mean in means.items():
        store(results, "boxing_final", agent, np.full(3000, mean))
    return study(results)


def test_the_claims_that_are_judged_are_counted_by_verdict(tmp_path):
    stored = three_true_and_one_false(tmp_path)
    counted = summaries.headline(stored).split("the planned runs can test 22", 1)[1]
    assert "4 have been judged so far (3 “in these runs: yes”, 1 “in these runs: no”)" in counted


def test_before_an_agent_is_past_its_early_games_the_share_of_all_games_is_told(tmp_path):
    stored = study(tmp_path)
    planned = 0
    for section in stored.sections.values():
        planned += (
            section.params.episodes
            * len(section.params.agents)
            * len(section.params.variations or [1])
        )
    store(tmp_path, "boxing_final", DQN, np.zeros(499))
    store(tmp_path, "breakout_early", DQN, np.zeros(301))
    assert numbers(summaries.headline(stored))[:2] == [800, planned]
    share = numbers(summaries.conclusion(stored))[0]
    assert share == pytest.approx(100 * 800 / planned, abs=0.051)


def test_an_agent_is_past_its_early_games_after_five_hundred(tmp_path):
    store(tmp_path, "boxing_final", DQN, np.full(499, 50.0))
    store(tmp_path, "boxing_final", DOUBLE, np.full(500, 7.0))
    text = summaries.headline(study(tmp_path))
    assert facts(text.split("**")[1]) == [500, "Double DQN", 7.0, 100, 100, 12.1, 0.1]


def lines(text):
    return [line for line in text.splitlines() if line.startswith("- ")]


def test_a_readings_line_has_the_last_mean_the_random_share_and_the_largest_drop(tmp_path):
    # means of 100 games rise to 10, fall by 8, and rise to 14; single scores fall by 14
    scores = np.repeat([0.0, 10.0, 2.0, 14.0], 100) + np.tile([3.0, -3.0], 200)
    store(tmp_path, "boxing_final", DOUBLE, scores, epsilon=np.linspace(1, 0.07, 400))
    line = lines(summaries.reading(study(tmp_path), "boxing_final"))[0]
    # of 100 games, the mean first passes 12.1 with 85 games about 14 and 15 about 2
    assert facts(line) == ["Double DQN", 14.0, 100, 400, 7, 100, 12.1, 385, 100, 8.0]


def test_a_run_that_never_passes_the_human_score_is_not_said_to(tmp_path):
    store(tmp_path, "boxing_final", DOUBLE, np.full(300, 12.0))
    store(tmp_path, "breakout_final", DOUBLE, np.full(300, 13.0))
    for experiment in ("boxing_final", "breakout_final"):
        assert "passed" not in summaries.reading(study(tmp_path), experiment)
    store(tmp_path, "breakout_final", DOUBLE, np.full(300, 31.0))
    assert "human 30.5 after game 100;" in summaries.reading(study(tmp_path), "breakout_final")


def test_a_reading_has_a_line_for_every_seed_each_of_its_own_games(tmp_path):
    for seed, mean in ((1, 20.0), (2, 40.0)):
        run = store(tmp_path, "boxing_final", DQN, np.full(300, mean), seed=seed)
        check(run, np.array([1.0, 2.0, mean + 1]))
    stored = study(tmp_path)
    stored.sections["boxing_final"] = Section(
        "boxing_final", "full", str(tmp_path), agents=[DQN], seeds=[1, 2]
    )
    first, second, *_ = lines(summaries.reading(stored, "boxing_final"))
    assert facts(first)[:3] == ["DQN", 1, 20.0]
    assert facts(second)[:3] == ["DQN", 2, 40.0]
    assert facts(first)[-3:] == [VALUE_GAMES, 300, 21.0]
    assert facts(second)[-3:] == [VALUE_GAMES, 300, 41.0]


def test_a_reading_gives_the_claims_about_its_experiment_with_number_and_verdict(tmp_path):
    stored = three_true_and_one_false(tmp_path)
    said = [line for line in lines(summaries.reading(stored, "boxing_final")) if "Claim" in line]
    judged = {int(re.search(r"Claim (\d+)", line)[1]): line for line in said}
    assert sorted(judged) == [1, 2, 3, 4]
    for number, line in judged.items():
        assert line.endswith(f"*in these runs: {'no' if number == 3 else 'yes'}*.")
    assert "“Double DQN ends highest in Boxing”" in judged[4]
    store(tmp_path, "breakout_final", DQN, np.zeros(200))
    waiting = lines(summaries.reading(study(tmp_path), "breakout_final"))[-1]
    assert numbers(waiting) == [5, 6, 9], "claim 3 is false already"


def test_the_newest_greedy_games_are_those_of_an_evaluation_not_long_ago(tmp_path):
    """An evaluation counts until the checks along the way are more than a hundred games newer."""
    run = store(tmp_path, "boxing_final", DQN, np.full(500, 5.0))
    check(run, np.array([0.0, 10.0, 20.0, 30.0, 40.0]))
    for trained, expected in ((400, [400, 7.0, 40]), (399, [VALUE_GAMES, 500, 40.0])):
        evaluate(run, trained=trained, score=7.0)
        line = lines(summaries.reading(study(tmp_path), "boxing_final"))[0]
        assert facts(line)[-3:] == expected


def test_scores_are_those_up_to_the_last_milestone_beside_the_source_reports_of_the_same(tmp_path):
    run = store(tmp_path, "boxing_final", DQN, window(2501, 3000, 70.0, FAR, after=0))
    evaluate(run, score=60.0)
    store(tmp_path, "boxing_final", DOUBLE, window(1501, 2000, 91.0, FAR))
    store(tmp_path, "breakout_final", DUELING, np.zeros(499))
    table = summaries.scores(study(tmp_path)).set_index(["game", "agent"])
    assert len(table) == 6
    own = table.loc["Boxing", "DQN"]
    assert own.evaluated == pytest.approx(60.0)
    assert own.tolist()[:3] == ["2,501 to 3,000", pytest.approx(70.0), 85.61]
    own = table.loc["Boxing", "Double DQN"]
    assert own.tolist()[:3] == ["1,501 to 2,000", pytest.approx(91.0), 90.79], "its table 2"
    assert np.isnan(own.evaluated)
    for nothing in (("Boxing", "Dueling Double DQN"), ("Breakout", "Dueling Double DQN")):
        assert table.loc[nothing].isna().all()


def test_no_score_of_the_source_report_stands_beside_shorter_runs(tmp_path, monkeypatch):
    store(tmp_path, "boxing_final", DQN, np.zeros(3000))
    stored = study(tmp_path)
    monkeypatch.setattr(summaries, "MILESTONES", (100, 200, 300, 400, 500, 600))
    assert summaries.scores(stored)["source report's"].isna().all()


def test_a_reading_tells_where_a_run_stands_and_when_it_passed_the_human_score(tmp_path):
    curve = np.concatenate([np.linspace(0, 24.1, 200), np.full(100, 20.0)])
    store(tmp_path, "boxing_final", "dqn", curve)
    text = summaries.reading(study(tmp_path), "boxing_final")
    mean = pd.Series(curve).rolling(100).mean()
    passed = int(mean.gt(12.1).idxmax()) + 1
    assert "DQN scores 20.0 points per game over the last 100 of 300 games, with 22% random" in text
    assert f"first passed the human 12.1 after game {passed};" in text
    assert "Claims 1 to 4 of @tbl-findings are still open" in text


def test_an_agent_that_has_just_begun_is_compared_with_nobody(tmp_path):
    store(tmp_path, "boxing_final", "dqn", np.full(700, 5.0))
    store(tmp_path, "boxing_final", "double_dqn", np.full(600, 9.0))
    store(tmp_path, "boxing_final", "dueling_double_dqn", np.full(120, 50.0))
    headline = summaries.headline(study(tmp_path))
    assert "After 600 games of Boxing each, Double DQN scores 9.0 points per game" in headline
    assert "and DQN 5.0 (mean of the last 100 games" in headline


def test_a_second_seed_that_has_just_begun_takes_nothing_from_the_first(tmp_path):
    store(tmp_path, "boxing_final", "dqn", np.full(700, 5.0))
    stored = study(tmp_path)
    section = stored["boxing_final"]
    second = section.episodes.head(120).assign(seed=2, score=90.0)
    section.__dict__["episodes"] = pd.concat([section.episodes, second])
    headline = summaries.headline(stored)
    assert "After 700 games of Boxing, DQN scores 5.0 points per game (mean" in headline


def test_finished_agents_stand_in_the_headline_alone(tmp_path):
    for agent, early, end in ((DQN, 30.0, 80.0), (DOUBLE, 20.0, 90.0)):
        store(
            tmp_path,
            "boxing_final",
            agent,
            windows({(601, 700): early, (2501, 3000): end}, FAR, after=0),
        )
    store(tmp_path, "boxing_final", DUELING, window(601, 700, 95.0, FAR, after=0))
    text = summaries.headline(study(tmp_path))
    expected = [3000, "Double DQN", 90.0, "DQN", 80.0, 500, 100, 12.1, 0.1]
    assert facts(text.split("**")[1]) == expected


@pytest.mark.parametrize(
    ("lengths", "window_"), [((700, 600), 100), ((3000, 2999), 100), ((3000, 3000), 500)]
)
def test_of_several_seeds_the_one_that_has_played_fewest_says_how_far_they_are(
    tmp_path, lengths, window_
):
    for seed, length in enumerate(lengths, start=1):
        store(tmp_path, "boxing_final", DQN, np.zeros(length), seed=seed)
    section = Section("boxing_final", "full", str(tmp_path), [DQN], [1, 2])
    found = summaries.score(section, DQN)
    assert (found.episodes, found.window) == (min(lengths), window_)


def test_finished_runs_are_told_of_as_finished(tmp_path):
    for agent, mean in (("dqn", 80.0), ("double_dqn", 90.0), ("dueling_double_dqn", 85.0)):
        run = store(tmp_path, "boxing_final", agent, np.full(3000, mean))
        evaluate(run, score=mean)
    stored = study(tmp_path)
    headline = summaries.headline(stored)
    said = "After 3,000 games of Boxing each, Double DQN scores 90.0 points per game, Dueling"
    assert said in headline
    reading = summaries.reading(stored, "boxing_final")
    scored = pd.read_csv(run.folder / "evaluations.csv").score.mean()
    said = f"Evaluated after 3,000 training games, it scored {scored:.1f} (40 evaluation games)"
    assert said in reading
    assert "so far" not in (headline.split("Of the source report")[0] + reading).lower()


def test_a_run_that_was_not_evaluated_yet_is_not_said_to_have_been(tmp_path):
    run = store(tmp_path, "boxing_final", "dqn", np.full(160, 1.0))
    check(run, [2.0])
    text = summaries.reading(study(tmp_path), "boxing_final")
    assert "it scored 2.0" in text
    assert "greedy games after game 100" in text
    assert "Evaluated" not in text


def test_at_another_difficulty_no_human_score_is_passed(tmp_path):
    store(tmp_path, "boxing_expert", "dqn", np.full(600, 60.0))
    text = summaries.reading(study(tmp_path), "boxing_expert")
    assert "DQN scores 60.0" in text
    assert "human" not in text


TILE = re.compile(
    r"::: \{\.tile \.(yes|no|unclear|open|untested) verdict=\"[^\"]+\"\}\n\*\*(\d+)\*\* (.+)\.\n\n"
    r"(?:(Source: .+)\n\n)?@([a-z-]+)\n:::"
)


def test_the_board_has_a_tile_for_every_claim_that_says_something_and_a_line_for_the_others(
    tmp_path,
):
    board, rest = summaries.board(three_true_and_one_false(tmp_path)).rsplit("\n\n", 1)
    assert board.startswith("::: {.board}\n")
    assert board.endswith("\n:::\n:::")
    tiles = TILE.findall(board)
    assert [int(number) for _, number, *_ in tiles] == [1, 2, 3, 4]
    assert [kind for kind, *_ in tiles] == ["yes", "yes", "no", "yes"]
    words = re.findall(r'verdict="([^"]+)"', board)
    assert words == [f"in these runs: {word}" for word in ("yes", "yes", "no", "yes")]
    assert not TILE.sub("", board).removeprefix("::: {.board}").removesuffix(":::").strip()
    untested = [
        number
        for number, claim in enumerate(FINDINGS, start=1)
        if "might have caught" in claim.short or "exploiting too early" in claim.short
    ]
    assert len(untested) == 2
    assert untested == [len(FINDINGS) - 1, len(FINDINGS)], "so that the others are in a row"
    listed = f"5 to {len(FINDINGS) - 2}", ", ".join(map(str, untested))
    assert rest == "Claims of @tbl-findings without a tile: open {}; not tested {}.".format(*listed)


def test_an_open_claim_has_a_tile_once_there_are_scores_of_ours(tmp_path):
    store(tmp_path, "boxing_final", DQN, np.full(1200, 60.0))
    (kind, number, *_, said, _), *_ = TILE.findall(summaries.board(study(tmp_path)))
    assert (kind, number) == ("open", "1")
    assert "Ours: DQN 60.0, Double DQN –" in said


def test_without_runs_the_board_is_a_line():
    assert summaries.board(study(Path("nowhere"))).startswith(
        "Claims of @tbl-findings without a tile"
    )


def test_tiles_are_short_and_lead_to_sections_that_exist(tmp_path):
    notebooks = "".join(path.read_text("utf-8") for path in (ROOT / "notebooks").glob("*.ipynb"))
    for number, claim in enumerate(FINDINGS, start=1):
        assert len(claim.short) <= 60, number
        assert f"{{#{claim.section}" in notebooks, number


def test_a_tile_has_the_source_reports_scores_and_ours(tmp_path):
    rng = np.random.default_rng(0)
    for agent, mean in {DQN: 40.0, DOUBLE: 60.0}.items():
        store(tmp_path, "boxing_final", agent, mean + rng.normal(0, 5, 3000))
    said = {
        number: text for _, number, _, text, _ in TILE.findall(summaries.board(study(tmp_path)))
    }
    theirs, ours = said["4"].split(" Ours: ")
    assert facts(theirs) == ["DQN", 85.6, "Double DQN", 92.6, "Dueling Double DQN", 89.8]
    assert numbers(ours) == pytest.approx([40, 60], abs=0.5)
    theirs, ours = said["1"].split(" Ours: ")
    assert facts(theirs) == ["DQN", 51.6, "Double DQN", 80.2, "Dueling Double DQN", 72.4]
    assert ours.endswith("Dueling Double DQN –.")
    assert "5" not in said, "the source report alone has a score"
    store(tmp_path, "breakout_late", DOUBLE, np.full(3000, 16.8))
    found = {tile[1]: tile[3] for tile in TILE.findall(summaries.board(study(tmp_path)))}
    theirs, ours = found["8"].split(" Ours: ")
    assert facts(theirs) == ["DQN", 26.3]
    assert "Double DQN 16.8" in ours, "of those it is compared with"
    assert "Boxing 36.3, Breakout 4.9" in summaries._numbers(study(tmp_path), FINDINGS[2])


# Of every claim, the section of ours and the source report's scores that its tile has, as its
# tables 1 and 2 print them, and which of six parts of the training they are of
BOXERS = "DQN 85.6, Double DQN 92.6, Dueling Double DQN 89.8"
BREAKERS = "DQN 36.1, Double DQN 15.4, Dueling Double DQN 21.4"
TILES = (
    ("boxing", "DQN 51.6, Double DQN 80.2, Dueling Double DQN 72.4", 2),
    ("boxing", BOXERS, 6),
    ("results", "Boxing 36.3, Breakout 4.9", 1),
    ("boxing", BOXERS, 6),
    *[("breakout", BREAKERS, 6)] * 2,
    ("breakout-early", "", 0),
    ("breakout-late", "DQN 26.3", 6),
    *[(name, "", 0) for name in ("breakout", "boxing-early", "boxing-early")],
    *[(name, "", 0) for name in ("low-gamma", "low-gamma", "high-gamma")],
    *[(name, "", 0) for name in ("expert", "transfer", "high-gamma")],
    *[(name, "", 0) for name in ("sensitivity", "sensitivity", "boxing-early")],
    *[(name, "", 0) for name in ("breakout-late", "low-gamma")],
    *[(name, "", 0) for name in ("breakout-late", "breakout-early")],
)


def test_every_tile_leads_to_the_runs_it_is_about_and_has_the_scores_of_its_own_games(tmp_path):
    for experiment in ("boxing_final", "breakout_final", "breakout_late"):
        for agent in AGENTS:
            store(tmp_path, experiment, agent, np.repeat(np.arange(1.0, 7.0), 500))
    stored = study(tmp_path)
    for claim, (section, theirs, part) in zip(FINDINGS, TILES, strict=True):
        assert claim.section == f"sec-{section}", claim.text
        said, _, ours = summaries._numbers(stored, claim).partition(" Ours: ")
        assert said == (f"Source: {theirs}." if theirs else ""), claim.text
        assert set(numbers(ours)) == ({part} if theirs else set()), claim.text


def test_a_tile_has_an_interval_only_if_that_is_over_seeds():
    few, many = (Mean(60.04, 58.0, 62.0, seeds) for seeds in (2, 3))
    assert summaries._over_seeds(few) == "60.0"
    assert numbers(summaries._over_seeds(many)) == [60.0, 58.0, 62.0]
    assert summaries._over_seeds(None) == "–"


def test_endings_count_the_games_that_the_agent_won_before_the_clock_and_how_fast(tmp_path):
    """By hand: of the first 500 games 100 are won in 3,600 frames by 90 points, 50 lost so."""
    full = 7141
    scores = np.r_[np.full(100, 90.0), np.full(50, -90.0), np.full(350, 10.0), np.full(100, 7.0)]
    frames = np.r_[np.full(150, 3600), np.full(350, full), np.full(100, 3600)]
    run = store(tmp_path, "boxing_final", DQN, scores)
    table = pd.read_csv(run.folder / "episodes.csv")
    table.assign(frames=np.cumsum(frames)).to_csv(run.folder / "episodes.csv", index=False)
    found = summaries.endings(study(tmp_path)["boxing_final"]).set_index("measure")
    assert list(found.columns) == ["agent", "seed", 500], "the next milestone is not reached"
    seconds = (150 * 3600 + 350 * full) / 500 / 60
    expected = [20, seconds, (50 * 90 + 350 * 10) / (500 * seconds / 60)]
    assert found[500].tolist() == pytest.approx(expected)
    store(tmp_path, "breakout_final", DQN, np.zeros(600))
    assert summaries.endings(study(tmp_path)["breakout_final"]).empty


def test_the_reading_of_values_is_the_mean_error_and_the_last_check_of_each_agent(tmp_path):
    run = store(tmp_path, "boxing_final", DQN, np.full(300, 5.0))
    check(run, np.array([1.0, 2.0, 3.0]))
    path = run.folder / "values.csv"
    values = pd.read_csv(path).assign(predicted=[2.0, 4.0, 9.0], realised=[1.0, 2.0, 3.0])
    values.to_csv(path, index=False)
    said = summaries.values_reading(study(tmp_path)["boxing_final"])
    # errors of 1, 2 and 6 lie 0.5, -1 and 0.5 off a line: Student's t with the two degrees of
    # freedom of three values that are no more alike than chance, or wider
    found = facts(said)
    assert [*found[:3], *found[6:]] == ["DQN", 3.0, 3, 9.0, 3.0, 300]
    assert found[3] == 95
    assert found[4:6] == [round(end, 1) for end in series_interval(np.array([1.0, 2.0, 6.0]))]
    assert "3.0 more" in said
    run = store(tmp_path, "boxing_final", DQN, np.full(1300, 5.0))
    predicted = np.repeat([-FAR, 1.0], [3, 10])  # the first ones an untrained network's
    check(run, np.zeros(13), predicted=predicted, realised=np.repeat([0, 1.5, 2.0], [3, 9, 1]))
    said = summaries.values_reading(study(tmp_path)["boxing_final"])
    found = facts(said)
    assert [*found[:3], *found[6:]] == ["DQN", 0.6, 10, 1.0, 2.0, 1300]
    assert found[4] < -0.6 < found[5] < 0, "predicted less realised, where it predicts less"
    assert "0.6 less" in said
    assert summaries.values_reading(study(tmp_path)["breakout_final"]) == ""


def test_how_alike_blocks_are_is_measured_in_the_stored_runs(tmp_path):
    assert summaries.neighbours(study(tmp_path)) == ""
    rng, level, blocks = np.random.default_rng(0), 0.0, []
    for _ in range(60):  # blocks of 50 that resemble one another
        level = 0.9 * level + rng.normal()
        blocks.append(np.full(50, level))
    store(tmp_path, "boxing_final", DQN, np.concatenate(blocks))
    measured = [likeness(np.array(blocks)[at : at + 10, 0]) for at in range(0, 60, 10)]
    said = summaries.neighbours(study(tmp_path))
    ceiling = [10] if max(measured) == pytest.approx(0.8) else []
    assert ("can show" in said) == ("fewer" in said) == bool(ceiling)
    stretches, at_median, highest, at_highest = (
        numbers(part) for part in re.split(r"simulations|blocks\)\. |; there", said)
    )
    assert stretches == pytest.approx([50, 6, np.median(measured)], abs=0.006)
    assert highest == pytest.approx([max(measured), *ceiling], abs=0.006)
    for held in (at_median, at_highest):
        assert (held[0], held[2]) == (95, 10)
    assert 60 < at_highest[1] < at_median[1] < 98, "% of cases"


def test_stretches_of_few_blocks_are_trusted_no_more_than_their_own_number_allows(tmp_path):
    """Of 500 games are ten blocks, of 1,167 of early Breakout 23: each has its own ceiling."""
    rising = np.repeat(np.tanh(np.arange(-5, 5)), 50)  # alike, but for its line
    store(tmp_path, "boxing_final", DQN, rising)
    store(tmp_path, "breakout_early", DQN, np.random.default_rng(0).normal(size=1200))
    said = summaries.neighbours(study(tmp_path))
    highest, ceiling = numbers(said.split("The highest value is")[1])[:2]
    assert (highest, ceiling) == (0.8, 10)
    assert numbers(said)[-2:] == pytest.approx([100 * coverage(0.8, 10), 10], abs=0.5)


def test_over_three_seeds_the_agents_are_compared_by_interquartile_means_of_both_games(tmp_path):
    """Scores are human-normalised: in Boxing (x - 0.1) / 12, in Breakout (x - 1.7) / 28.8."""
    boxing_, breakout = {"boxing_final": [12.1, 24.1, 48.1]}, {"breakout_final": [30.5, 59.3, 1.7]}
    stored = study(tmp_path)
    for name, means in (boxing_ | breakout).items():
        for seed, mean in enumerate(means, start=1):
            store(tmp_path, name, DQN, window(2501, 3000, mean, FAR, after=0), seed=seed)
        stored.sections[name] = Section(name, "full", str(tmp_path), [DQN], [1, 2, 3])
    # 1, 2, 4 and 1, 2, 0: without the highest and the lowest
    agent, mean, low, high, *_ = facts(summaries.over_seeds(stored))
    assert (agent, mean) == ("DQN", 1.5)
    assert low < mean < high
    assert summaries.over_seeds(stored) in summaries.conclusion(stored)
    for seeds in ([1, 2], [1, 2, 3, 4]):  # too few; one that is not there
        stored.sections["boxing_final"] = Section(
            "boxing_final", "full", str(tmp_path), [DQN], seeds
        )
        assert summaries.over_seeds(stored) == ""


def test_what_random_play_is_given_by_a_difficulty_is_told_when_both_are_measured(tmp_path):
    final = store(tmp_path, "boxing_final", DQN, np.zeros(700))
    expert = store(tmp_path, "boxing_expert", DQN, np.zeros(700))
    evaluate(final, trained=700, epsilon=1.0, score=0.5)
    pair = ("boxing_expert", "boxing_final")
    assert summaries.head_start(study(tmp_path), *pair) == ""
    evaluate(expert, trained=700, score=70.0)  # greedily
    assert summaries.head_start(study(tmp_path), *pair) == ""
    evaluate(final, trained=700, add=True, epsilon=1.0, difficulty=3, score=6.5)
    found = numbers(summaries.head_start(study(tmp_path), *pair))
    assert [found[at] for at in (0, 3, 4, 7, 8)] == [6.5, 3, 0.5, 0, 6.0]
    assert found[1] < 6.5 < found[2]
    assert "higher" in summaries.head_start(study(tmp_path), *pair)
    assert "lower" in summaries.head_start(study(tmp_path), *reversed(pair))


def test_how_long_an_agent_trains_is_told_of_each_run_that_there_is(tmp_path):
    assert summaries.duration(study(tmp_path)["boxing_final"]) == ""
    store(tmp_path, "boxing_final", DQN, np.zeros(3000))
    store(tmp_path, "boxing_final", DOUBLE, np.zeros(250))
    said = summaries.duration(study(tmp_path)["boxing_final"])
    assert facts(said) == [3000, "DQN", 3000, 3.3, "Double DQN", 250, 0.3], "of processor time"


@pytest.mark.parametrize(
    ("given", "expected"),
    [([4], "4"), ([1, 2], "1, 2"), ([1, 2, 3], "1 to 3"), ([1, 3, 4, 5, 8, 9], "1, 3 to 5, 8, 9")],
)
def test_three_claims_in_a_row_are_told_as_a_range(given, expected):
    assert summaries._listed(given) == expected
