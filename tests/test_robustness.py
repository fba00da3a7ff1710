"""An agent under conditions that it has never met."""

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import SMALL
from synthetic import evaluate, store

from atari_dqn.envs import EpisodeRecord, make_env
from atari_dqn.games import GAMES
from atari_dqn.params import Parameters
from atari_dqn.runs import models, recorder, records, robustness, tables
from atari_dqn.runs.run import Run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    run = Run(Parameters(**{**SMALL, "evaluation_games": 3, "noop_max": 4}), folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        recorder.train(run)
    return run


@pytest.fixture(scope="module")
def measured(run):
    robustness.measure(run)
    return pd.read_csv(run.robustness)


def test_a_sequence_is_played_in_every_opening_but_that_of_the_game_it_comes_from(run, measured):
    games = pd.read_csv(run.folder / "evaluations.csv")
    best = games.loc[games.score.idxmax()]
    record = next(
        record
        for heading, record in records.read_file(run.folder)
        if heading["kind"] == "evaluation" and heading["game"] == best.game
    )
    played = measured[measured.condition == "sequence"]
    assert played.game.tolist() == sorted({1, 2, 3, 4} - {record.idle_frames})
    env, _ = records.begin(run.params, record)
    robustness.play_blindly(env, record.actions)
    assert (env.score, env.length) == (best.score, best.length), "there it is the game itself"


def test_mirrored_games_are_as_many_as_evaluation_games(run, measured):
    for condition in ("mirrored", "field", "bar_moved", "bar_gone"):
        assert sorted(measured[measured.condition == condition].game) == [0, 1, 2]
    assert set(measured.trained_games) == {3}


def test_what_is_measured_is_measured_again_for_another_model_only(run, measured, monkeypatch):
    before, real = run.robustness.read_bytes(), robustness.best_game
    run.robustness.write_bytes(before.replace(b"\nsequence,", b"\nsequence,1000", 1))
    robustness.measure(run)
    assert b"sequence,1000" in run.robustness.read_bytes()
    monkeypatch.setattr(robustness, "best_game", lambda run, _: real(run, 3))
    monkeypatch.setattr(models, "trained_games", lambda path: 4)
    robustness.measure(run)
    assert set(pd.read_csv(run.robustness).trained_games) == {4}


@pytest.mark.parametrize("condition", ["sequence", "mirrored"])
def test_a_condition_that_lacks_a_game_counts_as_not_played_and_is_played_again(
    run, measured, condition
):
    lines = measured.to_csv(index=False).encode().splitlines(keepends=True)
    cut = next(at for at, line in enumerate(lines) if line.startswith(condition.encode()))
    for left in (lines[:cut] + lines[cut + 1 :], lines[:1]):
        run.robustness.write_bytes(b"".join(left))
        shown = tables.trials(run)
        whole = {"sequence", *robustness.views(run.params)} - {condition}
        assert set(shown.condition if len(shown) else []) == (whole if len(left) > 1 else set())
        robustness.measure(run)
        assert sorted(run.robustness.read_bytes().splitlines(True)) == sorted(lines)
    assert len(tables.trials(run)) == len(lines) - 1


def test_a_run_under_way_is_not_measured(run, tmp_path):
    waiting = Run(run.params, tmp_path)
    robustness.measure(waiting)
    assert not waiting.robustness.exists()


def test_no_game_of_the_model_on_record_is_an_error(run):
    with pytest.raises(records.RecordError, match="no evaluation game of its model"):
        robustness.best_game(run, 2)


def test_the_best_game_is_the_models_own_and_was_played_as_it_was_trained(tmp_path):
    """An older model, and a game of another difficulty, score more."""
    run = store(tmp_path, "boxing_final", "dqn", np.zeros(10))
    played = {(100, 0): [90, 0, 0], (3000, 0): [10, 20, 0], (3000, 2): [0, 0, 80]}
    games = []
    for number, ((trained, difficulty), scores) in enumerate(played.items()):
        how = {"trained": trained, "difficulty": difficulty, "score": np.array(scores, float)}
        evaluate(run, games=3, add=number > 0, **how)
        heading = {"kind": "evaluation", "seed": 1, "sticky_actions": 0.0, "epsilon": 0.001}
        heading |= {"trained_games": trained, "difficulty": difficulty}
        games += [
            ({**heading, "game": game}, EpisodeRecord(10 * number + game, b"\1", None))
            for game in range(3)
        ]
    (run.folder / records.FILE).write_bytes(records.encode(games))
    assert robustness.best_game(run, 3000).idle_frames == 11
    assert robustness.best_game(run, 100).idle_frames == 0


def test_a_mirrored_player_sees_and_moves_the_other_way_round(small):
    parameters = small()
    names = [action.name for action in make_env(parameters).actions]

    def player(observations):
        """Moves to the darker side of the picture, and punches at any rate."""
        left, right = (
            observations[:, :, side].mean(axis=(1, 2, 3)) for side in (slice(42), slice(42, None))
        )
        wanted = np.where(left < right, "LEFTFIRE", "RIGHTFIRE")
        return np.array([[float(name == each) for name in names] for each in wanted])

    def move(player, picture):
        return names[int(player(picture)[0].argmax())]

    picture = np.zeros((1, 84, 84, 4), np.uint8)
    picture[:, 20:60, 60:68] = 200  # in the ring
    assert move(player, picture) == "LEFTFIRE"
    for condition in ("mirrored", "field"):
        seeing = robustness.changed(player, parameters, condition)
        assert move(seeing, picture) == "LEFTFIRE", "right of its mirror image is left"
        bent = robustness.changed(lambda seen: player(seen[:, :, ::-1]), parameters, condition)
        assert move(bent, picture) == "RIGHTFIRE"  # sees the picture, but moves are exchanged
    for condition in ("bar_moved", "bar_gone", "scoreboard"):
        assert move(robustness.changed(player, parameters, condition), picture) == "LEFTFIRE"


def pictures():
    """Random ones, that differ in every game, place and image."""
    return np.random.default_rng(0).integers(0, 255, (2, 84, 84, 4), np.uint8)


@pytest.mark.parametrize("game", ["boxing", "breakout"])
@pytest.mark.parametrize("condition", ["mirrored", "field"])
def test_a_view_exchanges_left_and_right_where_it_says(small, game, condition):
    picture, field = pictures(), np.zeros((84, 84), bool)
    field[GAMES[game].field] = True
    where = np.ones_like(field) if condition == "mirrored" else field
    before = picture.copy()
    seen = robustness.views(small(game=game))[condition](picture)
    np.testing.assert_array_equal(picture, before)
    np.testing.assert_array_equal(seen[:, ~where], before[:, ~where])
    np.testing.assert_array_equal(seen[:, where], before[:, :, ::-1][:, where])
    np.testing.assert_array_equal(field, field[:, ::-1])


@pytest.mark.parametrize("game", ["boxing", "breakout"])
def test_pytorch_can_be_shown_every_view(small, game):
    for view in robustness.views(small(game=game)).values():
        torch.from_numpy(view(np.zeros((2, 84, 84, 4), np.uint8)))  # it takes no negative strides


def test_a_bar_is_seen_at_the_other_edge_or_not_at_all_and_all_else_as_it_is(small):
    env = make_env(small())
    env.reset(seed=1)
    picture = np.array([env.step(step)[0] for step in range(4)])  # [games, height, width]
    stacked = np.repeat(picture[..., None], 4, axis=3)
    before, views = stacked.copy(), robustness.views(small())
    bar, other, rest = slice(0, 4), slice(80, 84), slice(5, 79)
    assert (before[:, :, bar] == 0).all()
    assert (before[:, :, other] > 0).all()
    moved, gone = (views[name](stacked) for name in ("bar_moved", "bar_gone"))
    np.testing.assert_array_equal(stacked, before)
    assert (moved[:, :, other] == 0).all()
    for seen in (moved, gone):
        np.testing.assert_array_equal(seen[:, :, bar], before[:, :, other][:, :, ::-1])
        np.testing.assert_array_equal(seen[:, :, rest], before[:, :, rest])
    np.testing.assert_array_equal(gone[:, :, other], before[:, :, other])
    assert not {"bar_moved", "bar_gone"} & {*robustness.views(small(game="breakout"))}


@pytest.mark.parametrize("game", ["boxing", "breakout"])
def test_all_that_moves_under_the_scoreboard_is_in_the_field_and_that_is_alike_on_both_sides(
    small, game
):
    env = make_env(small(game=game))
    first = env.reset(seed=1)[0]
    played = np.array([env.step(step % len(env.actions))[0] for step in range(150)])
    facts = GAMES[game]
    moving = (played != first).any(axis=0)
    assert moving[facts.field].any()
    moving[facts.field] = False
    assert not moving[facts.scoreboard :].any()
    empty = np.median(played, axis=0)[facts.field]  # where neither a boxer nor the ball stays
    edge = empty[:, [0, 1, -2, -1]]
    np.testing.assert_allclose(edge, edge[:, ::-1], atol=10)  # the walls' feet shine in a little


@pytest.mark.parametrize(("game", "rows"), [("boxing", 10), ("breakout", 6)])
def test_a_frozen_scoreboard_is_the_first_pictures_and_all_else_is_seen(small, game, rows):
    env = make_env(small(game=game))
    first = env.reset(seed=1)[0]
    for step in range(80):
        picture = env.step(step % len(env.actions))[0]
    assert (picture[:rows] != first[:rows]).any(), "the scoreboard changes with the game"
    stacked = np.repeat(picture[None, :, :, None], 4, axis=3)
    before = stacked.copy()
    seen = robustness.views(small(game=game))["scoreboard"](stacked)
    np.testing.assert_array_equal(stacked, before)
    for plane in range(4):
        np.testing.assert_array_equal(seen[0, :rows, :, plane], first[:rows])
        np.testing.assert_array_equal(seen[0, rows:, :, plane], picture[rows:])


def test_a_condition_that_is_missing_is_added_and_the_others_are_not_played_again(run):
    run.robustness.unlink(missing_ok=True)
    robustness.measure(run)
    before = run.robustness.read_text().splitlines(keepends=True)
    kept = [line for line in before if not line.startswith("bar_gone,")]
    kept[1] = kept[1].replace("sequence,1", "sequence,1001")
    run.robustness.write_text("".join(kept))
    robustness.measure(run)
    assert run.robustness.read_text().splitlines(keepends=True) == [before[0], kept[1], *before[2:]]


def test_blind_moves_begin_again_when_they_are_used_up(small):
    env = make_env(small(max_game_frames=60))
    env.reset(seed=1)
    robustness.play_blindly(env, bytes([2, 5, 7]))
    assert env.played().actions[:7] == bytes([2, 5, 7, 2, 5, 7, 2])
    assert env.frames >= 60
