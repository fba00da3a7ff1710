"""Verdicts on the source report's claims follow from the stored runs, and change with them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from atari_dqn import claims, params, runs, summaries
from atari_dqn.params import TRAINING_VERSION
from atari_dqn.sections import Study

ROOT = Path(__file__).parents[1]


def store(results, experiment, agent, scores):
    """A run's folder with the given scores, as training would leave it."""
    run = runs.Run(
        params.pick(params.load(ROOT / "params" / f"{experiment}.yaml"), agent, 1), results
    )
    run.folder.mkdir(parents=True, exist_ok=True)
    games = np.arange(1, len(scores) + 1)
    table = pd.DataFrame({"episode": games, "frames": games * 7000, "score": scores})
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


def scores(mean, games=3000):
    return mean + np.random.default_rng(0).normal(0, 5, games)


def verdict(results, claim):
    table = claims.findings(Study("full", str(results)))
    return table[table.claim == claim].iloc[0]


BEST = "Double DQN ends highest in Boxing"


def test_without_runs_every_claim_is_not_yet_run(tmp_path):
    study = Study("full", str(tmp_path))
    assert set(claims.findings(study).verdict) == {claims.NOT_YET}
    assert set(claims.goals(study).state) == {claims.NOT_YET}
    assert summaries.reading(study, "boxing_low_gamma") == ""
    assert "Training has only begun: 0 of" in summaries.headline(study)


@pytest.mark.parametrize(
    ("double", "expected"),
    [(92.0, claims.SUPPORTED), (60.0, claims.CONTRADICTED), (80.05, claims.INCONCLUSIVE)],
)
def test_a_comparison_is_judged_by_the_interval_of_the_difference(tmp_path, double, expected):
    for agent, mean in (("dqn", 80.0), ("double_dqn", double), ("dueling_double_dqn", 80.0)):
        store(tmp_path, "boxing_final", agent, scores(mean))
    found = verdict(tmp_path, BEST)
    assert found.verdict == expected
    assert "against DQN 79.7, difference" in found.evidence


def test_a_claim_about_games_not_yet_played_is_not_judged(tmp_path):
    for agent in ("dqn", "double_dqn", "dueling_double_dqn"):
        store(tmp_path, "boxing_final", agent, scores(50.0, games=1200))
    assert verdict(tmp_path, BEST).verdict == claims.NOT_YET
    assert "`boxing_final`: 40% of its games" in verdict(tmp_path, BEST).evidence
    human = "All three agents exceed the human score in Boxing after 1,000 games"
    assert verdict(tmp_path, human).verdict == claims.SUPPORTED


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
    parts = {kind: claims.Verdict(kind, kind) for kind in ("supported", "inconclusive")}
    both = claims.all_of([*parts.values()])
    assert both.verdict == "inconclusive"
    assert both.evidence == "supported; inconclusive"
    against = claims.all_of([claims.Verdict("contradicted", ""), claims.Verdict("not yet run", "")])
    assert against.verdict == "contradicted"
    assert claims.negated(claims.Verdict("supported", "")).verdict == "contradicted"
    assert claims.negated(claims.Verdict("inconclusive", "")).verdict == "inconclusive"


def test_learning_that_falls_back_is_told_from_learning_that_rises(tmp_path):
    rising = np.linspace(0, 80, 3000)
    store(tmp_path, "boxing_final", "dqn", rising)
    store(tmp_path, "boxing_early", "dqn", 20 + 15 * np.sin(np.arange(1400) / 100))
    claim = "With them, learning is unstable: the curve falls back further from its best"
    assert verdict(tmp_path, claim).verdict == claims.SUPPORTED
    store(tmp_path, "boxing_early", "dqn", rising[:1400])
    assert verdict(tmp_path, claim).verdict == claims.INCONCLUSIVE


def test_only_dqn_is_human_in_breakout_falls_with_a_better_double_dqn(tmp_path):
    claim = "Of the three, only DQN reaches the human score in Breakout"
    for agent, mean in (("dqn", 40.0), ("double_dqn", 15.0), ("dueling_double_dqn", 21.0)):
        store(tmp_path, "breakout_final", agent, scores(mean))
    assert verdict(tmp_path, claim).verdict == claims.SUPPORTED
    store(tmp_path, "breakout_final", "double_dqn", scores(35.0))
    assert verdict(tmp_path, claim).verdict == claims.CONTRADICTED


def test_a_reading_tells_where_a_run_stands_and_when_it_passed_the_human_score(tmp_path):
    curve = np.concatenate([np.linspace(0, 24.1, 200), np.full(100, 20.0)])
    run = store(tmp_path, "boxing_final", "dqn", curve)
    table = pd.read_csv(run.folder / "episodes.csv").assign(epsilon=0.22)
    table.to_csv(run.folder / "episodes.csv", index=False)
    text = summaries.reading(Study("full", str(tmp_path)), "boxing_final")
    mean = pd.Series(curve).rolling(100).mean()
    passed = int(mean.gt(12.1).idxmax()) + 1
    assert "DQN scores 20.0 points a game over the last 100 of 300 games, 22% of its" in text
    assert f"first passed the human 12.1 after game {passed};" in text
    assert "5 more claims wait" in text
