import numpy as np
import pandas as pd
import pytest

from atari_dqn import evaluation, recording
from atari_dqn.agents import AGENTS
from atari_dqn.evaluation import check_values, discounted, held_out_states, play, player_of
from atari_dqn.runs import Run


def test_discounted_returns_are_sums_to_the_games_end():
    rewards = [1.0, 0.0, -1.0, 2.0]
    expected = [
        sum(0.9 ** (later - now) * rewards[later] for later in range(now, 4)) for now in range(4)
    ]
    np.testing.assert_allclose(discounted(rewards, 0.9), expected)


def constant(actions, best, value):
    """A player that values every action alike but for one."""
    q = np.zeros(actions, np.float32)
    q[best] = value
    return lambda observations: np.tile(q, (len(observations), 1))


def untrained(parameters, actions):
    return player_of(AGENTS["dqn"].network(4, actions), parameters)


def test_realised_values_are_the_discounted_clipped_returns_of_the_games_played(small, monkeypatch):
    monkeypatch.setattr(evaluation, "VALUE_GAMES", 3)
    parameters = small(game="boxing", max_game_frames=1200, evaluation_epsilon=0.0, gamma=0.5)
    player = constant(18, best=1, value=7.0)
    held_out = np.zeros((5, 84, 84, 4), np.uint8)
    check, games = check_values(player, parameters, held_out, episode=100, seed=1)
    assert (check.episode, check.held_out_q, check.predicted) == (100, 7.0, 7.0)
    returns, scores = [], []
    for number in range(evaluation.VALUE_GAMES):
        table = evaluation.Table(parameters)
        table.start(evaluation.VALUE_GAMES * 100 + number, seed=1)
        rewards, ended = [], False
        while not ended:
            _, raw, terminated, truncated, _ = table.emulator.step(1)
            rewards.append(max(-1, min(1, raw)))
            ended = terminated or truncated
        scores.append(table.emulator.score)
        returns += [
            sum(reward * 0.5**later for later, reward in enumerate(rewards[now:]))
            for now in range(len(rewards))
        ]
    assert check.realised == pytest.approx(np.mean(returns), abs=1e-9)
    assert len(set(np.round(returns, 6))) > 5, "the test would not see a reward"
    assert check.score == pytest.approx(np.mean(scores))
    assert [game.score for game in games] == scores


def test_held_out_states_are_the_same_for_all_runs_and_not_alike(small):
    states = held_out_states(small(max_game_frames=2000))
    again = held_out_states(small(max_game_frames=2000, seeds=[9], gamma=0.5))
    np.testing.assert_array_equal(states, again)
    assert len({state.tobytes() for state in states}) > 500


@pytest.mark.parametrize(("game", "actions"), [("boxing", 18), ("breakout", 4)])
def test_a_greedy_agent_that_does_nothing_finishes_its_games(small, game, actions):
    """Breakout serves the ball for it."""
    parameters = small(game=game, max_game_frames=108_000, evaluation_epsilon=0.0)
    games = list(play(constant(actions, 0, 1.0), parameters, 2, seed=0))
    assert len(games) == 2
    assert all(game.frames < 10_000 for game in games)
    assert all(not game.won for game in games)


def test_random_play_in_breakout_scores_what_others_have_measured(small):
    parameters = small(game="breakout", max_game_frames=108_000, evaluation_epsilon=1.0)
    player = untrained(parameters, 4)
    scores = [game.score for game in play(player, parameters, 40, seed=0)]
    assert np.mean(scores) == pytest.approx(1.2, abs=0.8)


def test_a_finished_run_is_evaluated_as_trained_and_under_the_conditions_it_asks_for(
    tmp_path, small
):
    asked = {"evaluation_difficulties": [0, 1], "evaluation_stickiness": [0.25]}
    run = Run(small(difficulty=1, episodes=2, max_game_frames=100, **asked), tmp_path)
    recording.train(run)
    table = pd.read_csv(run.folder / "evaluations.csv")
    played = table.groupby(["difficulty", "sticky_actions"]).size().to_dict()
    assert played == {(1, 0.0): 2, (0, 0.0): 2, (1, 0.25): 2}
    assert set(table.trained_games) == {2}


def test_a_condition_that_a_cartridge_does_not_have_is_refused(small):
    with pytest.raises(ValueError, match="evaluation_difficulties: \\[2\\] is not allowed"):
        small(game="breakout", evaluation_difficulties=[2])


def test_play_style_counts_every_point_of_a_game_and_how_near_the_boxers_are(small):
    parameters = small(max_game_frames=4000, evaluation_epsilon=1.0)
    for game in play(untrained(parameters, 18), parameters, 3, seed=0):
        assert game.scored - game.conceded == game.score
        assert min(game.scored, game.conceded) > 0, "the test would not see who scored"
        assert 10 < game.distance < 120
    breakout = small(game="breakout", agents=["dqn"])
    (game,) = play(untrained(breakout, 4), breakout, 1, seed=0)
    assert np.isnan(game.distance)
