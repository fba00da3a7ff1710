"""Verdicts on the source report's claims follow from the stored runs, and change with them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from atari_dqn import claims, params, runs
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
    assert set(claims.goals(study).verdict) == {claims.NOT_YET}
    assert "Training has only begun: 0 of" in claims.headline(study)


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
