"""Verdicts on the source report's claims follow from the stored runs, and change with them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from atari_dqn import params
from atari_dqn.analysis import claims, summaries, verdicts
from atari_dqn.analysis.study import Study
from atari_dqn.params import TRAINING_VERSION
from atari_dqn.runs.run import Run

ROOT = Path(__file__).parents[1]


def store(results, experiment, agent, scores):
    """A run's folder with the given scores, as training would leave it."""
    run = Run(params.pick(params.load(ROOT / "params" / f"{experiment}.yaml"), agent, 1), results)
    run.folder.mkdir(parents=True, exist_ok=True)
    games = np.arange(1, len(scores) + 1)
    table = pd.DataFrame({"episode": games, "frames": games * 7000, "score": scores})
    table["epsilon"] = 0.22
    table.to_csv(run.folder / "episodes.csv", index=False)
    table.assign(seconds=games * 5.0)[["episode", "seconds"]].to_csv(
        run.folder / "timing.csv", index=False
    )
    params.dump(run.params, run.folder / "params.yaml")
    state = "complete" if len(scores) >= run.params.episodes else "interrupted"
    status = {"state": state, "episodes_done": len(scores), "episodes": run.params.episodes}
    (run.folder / "status.json").write_text(json.dumps(status))
    provenance = {
        "training_version": TRAINING_VERSION,
        "identity": run.params.identity(),
        "sessions": [{}],
    }
    (run.folder / "provenance.json").write_text(json.dumps(provenance))
    return run


def scores(mean, games=3000, seed=0):
    return mean + np.random.default_rng(seed).normal(0, 5, games)


def verdict(results, claim):
    table = claims.findings(Study("full", str(results)))
    return table[table.claim == claim].iloc[0]


BEST = "Double DQN ends highest in Boxing"


def test_without_runs_every_claim_is_not_yet_run(tmp_path):
    study = Study("full", str(tmp_path))
    assert set(claims.findings(study).verdict) == {verdicts.NOT_YET}
    assert set(claims.goals(study).here) == {verdicts.NOT_YET}
    assert set(claims.interpretations(study).verdict) == {verdicts.NOT_YET, "not tested"}
    assert summaries.reading(study, "boxing_low_gamma") == ""
    assert "Training has only begun: 0 of" in summaries.headline(study)


@pytest.mark.parametrize(
    ("double", "expected"),
    [(92.0, verdicts.SUPPORTED), (60.0, verdicts.CONTRADICTED), (80.05, verdicts.INCONCLUSIVE)],
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
    assert verdict(tmp_path, BEST).verdict == verdicts.NOT_YET
    assert "`boxing_final` 40%" in verdict(tmp_path, BEST).evidence
    human = "All three agents exceed the human score in Boxing after 1,000 games"
    assert verdict(tmp_path, human).verdict == verdicts.SUPPORTED


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
    parts = {kind: verdicts.Verdict(kind, kind) for kind in ("supported", "inconclusive")}
    both = verdicts.all_of([*parts.values()])
    assert both.verdict == "inconclusive"
    assert both.evidence == "supported; inconclusive"
    against = verdicts.all_of(
        [verdicts.Verdict("contradicted", ""), verdicts.Verdict(verdicts.NOT_YET, "")]
    )
    assert against.verdict == "contradicted"
    for kind in ("supported", "inconclusive"):
        waiting = verdicts.all_of([verdicts.Verdict(kind, "a"), verdicts.Verdict("open", "b")])
        assert (waiting.verdict, waiting.evidence) == ("open", "b")
    assert verdicts.negated(verdicts.Verdict("supported", "")).verdict == "contradicted"
    assert verdicts.negated(verdicts.Verdict("inconclusive", "")).verdict == "inconclusive"


def test_a_curve_that_swings_is_told_from_one_that_rises(tmp_path):
    rising = np.linspace(0, 80, 3000)
    store(tmp_path, "boxing_final", "dqn", rising + scores(0.0, seed=1))
    swinging = 2 + 8 * np.sin(np.arange(1400) / 40)
    store(tmp_path, "boxing_early", "dqn", swinging + scores(0.0, games=1400))
    claim = "With them, the learning curve oscillates more"
    assert verdict(tmp_path, claim).verdict == verdicts.SUPPORTED
    store(tmp_path, "boxing_early", "dqn", scores(0.0, games=1400))
    assert verdict(tmp_path, claim).verdict == verdicts.INCONCLUSIVE, "it does not learn at all"


def test_a_curve_that_rises_less_does_not_oscillate_more(tmp_path):
    claim = "With them, the learning curve oscillates more"
    found = []
    for seed in range(20):
        luck = np.random.default_rng(seed).normal(0, 15, (2, 3000))
        store(tmp_path, "boxing_final", "dqn", np.linspace(0, 80, 3000) + luck[0])
        store(tmp_path, "boxing_early", "dqn", np.linspace(0, 12, 1400) + luck[1, :1400])
        found.append(verdict(tmp_path, claim).verdict)
    assert found.count(verdicts.INCONCLUSIVE) >= 17


def check(run, scores):
    """Gives a run its greedy scores after every hundred games."""
    games = 100 * np.arange(1, len(scores) + 1)
    table = pd.DataFrame({"episode": games, "score": scores, "predicted": 1.0, "realised": 1.0})
    table.to_csv(run.folder / "values.csv", index=False)


def test_what_is_learned_along_the_way_is_compared_after_the_same_games(tmp_path):
    claim = (
        "The early Boxing settings (rate 1e-3, batch 64, floor 0.1) learn less than the final ones"
    )
    final = store(tmp_path, "boxing_final", "dqn", scores(0.0))
    check(final, np.concatenate([np.full(14, 30.0), np.full(16, -90.0)]))
    early = store(tmp_path, "boxing_early", "dqn", scores(90.0, games=1400))
    assert verdict(tmp_path, claim).verdict == verdicts.NOT_YET
    check(early, 10.0 + np.arange(14) % 3)
    found = verdict(tmp_path, claim)
    assert found.verdict == verdicts.SUPPORTED, "whatever it scores while it explores"
    assert "DQN: `boxing_final` 30.0 against `boxing_early` 10.9" in found.evidence
    check(early, 40.0 + np.arange(14) % 3)
    assert verdict(tmp_path, claim).verdict == verdicts.CONTRADICTED


def test_only_dqn_is_human_in_breakout_falls_with_a_better_double_dqn(tmp_path):
    claim = "Of the three, only DQN reaches the human score in Breakout"
    for agent, mean in (("dqn", 40.0), ("double_dqn", 15.0), ("dueling_double_dqn", 21.0)):
        store(tmp_path, "breakout_final", agent, scores(mean))
    assert verdict(tmp_path, claim).verdict == verdicts.SUPPORTED
    store(tmp_path, "breakout_final", "double_dqn", scores(35.0))
    assert verdict(tmp_path, claim).verdict == verdicts.CONTRADICTED


def test_a_reading_tells_where_a_run_stands_and_when_it_passed_the_human_score(tmp_path):
    curve = np.concatenate([np.linspace(0, 24.1, 200), np.full(100, 20.0)])
    store(tmp_path, "boxing_final", "dqn", curve)
    text = summaries.reading(Study("full", str(tmp_path)), "boxing_final")
    mean = pd.Series(curve).rolling(100).mean()
    passed = int(mean.gt(12.1).idxmax()) + 1
    assert "DQN scores 20.0 points a game over the last 100 of 300 games, 22% of its" in text
    assert f"first passed the human 12.1 after game {passed};" in text
    assert "claims 1, 2, 3, 4 are still open" in text


def test_a_reading_puts_the_source_reports_scores_beside_ours_at_the_last_common_mark(tmp_path):
    store(tmp_path, "boxing_final", "dqn", np.full(1100, 60.0))
    store(tmp_path, "boxing_final", "double_dqn", np.full(600, 20.0))
    study = Study("full", str(tmp_path))
    expected = (
        "where both are known: DQN 60.0 and 51.6 (games 501 to 1,000), "
        "Double DQN 20.0 and 29.0 (games 1 to 500)."
    )
    for text in (summaries.reading(study, "boxing_final"), summaries.conclusion(study)):
        assert expected in text
        assert "does not say how often its network was updated" in text
    store(tmp_path, "boxing_final", "double_dqn", np.full(600, 40.0))
    text = summaries.reading(Study("full", str(tmp_path)), "boxing_final")
    assert "Double DQN 40.0 and 29.0" in text
    assert "updated" not in text, "where ours are not below"


def test_an_agent_that_has_just_begun_is_named_and_compared_with_nobody(tmp_path):
    store(tmp_path, "boxing_final", "dqn", np.full(700, 5.0))
    store(tmp_path, "boxing_final", "double_dqn", np.full(600, 9.0))
    store(tmp_path, "boxing_final", "dueling_double_dqn", np.full(120, 50.0))
    study = Study("full", str(tmp_path))
    assert (
        "After 600 games of Boxing the agent with the most points so far, Double DQN, scores 9.0"
        in (summaries.headline(study))
    )
    assert "Double DQN 9.0, DQN 5.0" in summaries.conclusion(study)
    assert "Dueling Double DQN has played 120 games only" in summaries.conclusion(study)


def test_a_second_seed_that_has_just_begun_takes_nothing_from_the_first(tmp_path):
    store(tmp_path, "boxing_final", "dqn", np.full(700, 5.0))
    study = Study("full", str(tmp_path))
    section = study["boxing_final"]
    second = section.episodes.head(120).assign(seed=2, score=90.0)
    section.__dict__["episodes"] = pd.concat([section.episodes, second])
    assert "After 700 games of Boxing DQN scores 5.0 points a game" in summaries.headline(study)


def test_a_reading_tells_of_the_newest_greedy_games(tmp_path):
    run = store(tmp_path, "boxing_final", "dqn", np.full(900, 5.0))
    check(run, [0.0, 10.0, 20.0, 30.0, 40.0])
    evaluate(run, trained=420, score=7.0)
    text = summaries.reading(Study("full", str(tmp_path)), "boxing_final")
    assert "Playing 40 games greedily after 420 of training, it scored" in text
    evaluate(run, trained=390, score=7.0)
    text = summaries.reading(Study("full", str(tmp_path)), "boxing_final")
    assert "Playing four games greedily after 500 of training, it scored 40.0" in text


def test_finished_runs_are_told_of_as_finished(tmp_path):
    for agent, mean in (("dqn", 80.0), ("double_dqn", 90.0), ("dueling_double_dqn", 85.0)):
        run = store(tmp_path, "boxing_final", agent, np.full(3000, mean))
        evaluate(run, score=mean)
    study = Study("full", str(tmp_path))
    headline = summaries.headline(study)
    assert (
        "over the last 500 of 3,000 training games is that of Double DQN, 90.0 points" in headline
    )
    reading = summaries.reading(study, "boxing_final")
    scored = pd.read_csv(run.folder / "evaluations.csv").score.mean()
    said = f"Playing 40 games greedily after 3,000 of training, it scored {scored:.1f}"
    assert said in reading
    assert "so far" not in headline.split("Of 16 claims")[0] + reading


def test_at_another_difficulty_no_human_score_is_passed(tmp_path):
    store(tmp_path, "boxing_expert", "dqn", np.full(600, 60.0))
    text = summaries.reading(Study("full", str(tmp_path)), "boxing_expert")
    assert "DQN scores 60.0" in text
    assert "human" not in text


def test_an_interpretation_gets_no_verdict_but_its_premise_does(tmp_path):
    for agent, mean in (("dqn", 80.0), ("double_dqn", 60.0), ("dueling_double_dqn", 70.0)):
        store(tmp_path, "boxing_final", agent, scores(mean))
    found = claims.interpretations(Study("full", str(tmp_path))).verdict.tolist()
    assert found[:2] == ["premise fails", "premise holds"]


def evaluate(run, trained=None, **columns):
    """Gives a run an evaluation of 40 greedy games, whose columns have the given means."""
    columns = {"distance": 40.0, "scored": 30.0, "conceded": 10.0, **columns}
    rng = np.random.default_rng(1)
    games = {name: mean + rng.normal(0, 1, 40) for name, mean in columns.items()}
    table = pd.DataFrame({"game": range(40), "difficulty": run.params.difficulty, **games})
    table = table.assign(
        sticky_actions=0.0, epsilon=0.001, trained_games=trained or run.params.episodes,
        length=1785, frames=7140,
    )  # fmt: skip
    table.to_csv(run.folder / "evaluations.csv", index=False)


def test_greedy_games_decide_where_two_set_ups_explore_differently(tmp_path):
    claim = "A discount of 0.9 makes agents reckless: they concede more points than with 0.99"
    for experiment, conceded in (("boxing_final", 10.0), ("boxing_low_gamma", 30.0)):
        for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
            run = store(tmp_path, experiment, agent, scores(50.0))
            evaluate(run, score=50.0, conceded=conceded)
    found = verdict(tmp_path, claim)
    assert found.verdict == verdicts.SUPPORTED
    assert "conceded a minute, greedy: Dueling Double DQN: `boxing_low_gamma` 15." in found.evidence
    evaluate(run, score=50.0, conceded=1.0)
    assert verdict(tmp_path, claim).verdict == verdicts.CONTRADICTED
    evaluate(run, trained=300, score=50.0, conceded=30.0)
    assert verdict(tmp_path, claim).verdict == verdicts.NOT_YET, "of an unfinished model"


def test_a_greedy_game_that_repeats_others_weighs_in_the_mean_and_is_no_further_evidence(tmp_path):
    claim = "A discount of 0.995 makes agents shy: they keep a greater distance than with 0.99"
    once = {}
    for experiment, mean in (("boxing_final", 20.0), ("boxing_high_gamma", 20.5)):
        for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
            run = store(tmp_path, experiment, agent, scores(50.0, games=4000))
            evaluate(run, score=50.0, distance=mean)
            once[run.folder / "evaluations.csv"] = pd.read_csv(run.folder / "evaluations.csv")
    few = {path: table.head(10) for path, table in once.items()}
    for path, table in few.items():
        table.to_csv(path, index=False)
    expected = verdict(tmp_path, claim)
    for path, table in few.items():
        repeated = pd.concat([table.assign(game=table.game + 10 * k) for k in range(10)])
        repeated.to_csv(path, index=False)
    found = verdict(tmp_path, claim)
    assert found.verdict == expected.verdict == verdicts.INCONCLUSIVE
    assert found.evidence.split("difference")[0] == expected.evidence.split("difference")[0]


def test_no_gain_from_transfer_is_support_for_its_not_helping(tmp_path):
    claim = claims.FINDINGS[-1].text
    agents = ("dqn", "double_dqn", "dueling_double_dqn")
    for agent in agents:
        store(tmp_path, "boxing_final", agent, scores(50.0))
        store(tmp_path, "boxing_transfer", agent, scores(50.0)[::-1])
    assert verdict(tmp_path, claim).verdict == verdicts.SUPPORTED
    for agent in agents:
        store(tmp_path, "boxing_transfer", agent, scores(60.0))
    assert verdict(tmp_path, claim).verdict == verdicts.CONTRADICTED


def test_what_is_gained_counts_in_expert_mode_and_not_the_scale_of_its_scores(tmp_path):
    claim = "All agents learn faster in expert mode: they gain more in the first 500 games"
    rising = np.linspace(0, 30, 3000)
    for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
        store(tmp_path, "boxing_final", agent, rising + scores(0, seed=1))
        store(tmp_path, "boxing_expert", agent, rising[:1000] + scores(20, 1000, seed=2))
    assert verdict(tmp_path, claim).verdict == verdicts.INCONCLUSIVE
    for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
        store(tmp_path, "boxing_expert", agent, 10 * rising[:1000] + scores(0, 1000, seed=2))
    assert verdict(tmp_path, claim).verdict == verdicts.SUPPORTED


def test_three_seeds_a_side_are_compared_as_seeds(tmp_path):
    section = Study("full", str(tmp_path))["boxing_final"]
    section.__dict__["episodes"] = pd.DataFrame(
        {
            "agent": np.repeat(["dqn", "double_dqn"], 3 * 150),
            "seed": np.tile(np.repeat([1, 2, 3], 150), 2),
            "episode": np.tile(np.arange(1, 151), 6),
            "score": np.repeat([10.0, 20.0, 30.0, 25.0, 35.0, 45.0], 150),
        }
    )
    pair = (section, section)
    found = verdicts.better(pair, ("double_dqn", "dqn"), 1, 150)
    welch = stats.ttest_ind([25, 35, 45], [10, 20, 30], equal_var=False).confidence_interval()
    assert found.verdict == verdicts.NOT_YET, "one seed is planned"
    section.params = section.params.model_copy(update={"seeds": [1, 2, 3]})
    found = verdicts.better(pair, ("double_dqn", "dqn"), 1, 150)
    assert found.verdict == verdicts.INCONCLUSIVE, "though every block of games is above"
    assert f"difference {welch.low:.1f} to {welch.high:.1f}" in found.evidence
