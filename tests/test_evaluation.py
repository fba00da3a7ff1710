import numpy as np
import pandas as pd
import pytest

from atari_dqn import evaluation
from atari_dqn.agents import AGENTS
from atari_dqn.analysis.study import openings
from atari_dqn.envs import AtariEnv, EpisodeRecord, make_env
from atari_dqn.evaluation import (
    PLAYED_COLUMNS,
    check_values,
    discounted,
    held_out_states,
    play,
    player_of,
)
from atari_dqn.games import GAMES
from atari_dqn.runs import recorder, records
from atari_dqn.runs.run import Run
from atari_dqn.schedules import epsilon_greedy


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
        table = evaluation.EpisodeInProgress(parameters)
        table.start(evaluation.VALUE_GAMES * 100 + number, seed=1)
        rewards, ended = [], False
        while not ended:
            _, raw, terminated, truncated, _ = table.env.step(1)
            rewards.append(max(-1, min(1, raw)))
            ended = terminated or truncated
        scores.append(table.env.score)
        returns += [
            sum(reward * 0.5**later for later, reward in enumerate(rewards[now:]))
            for now in range(len(rewards))
        ]
    assert check.realised == pytest.approx(np.mean(returns), abs=1e-9)
    assert len(set(np.round(returns, 6))) > 5, "the test would not see a reward"
    assert check.score == pytest.approx(np.mean(scores))
    assert [game.score for game in games] == scores


def test_predicted_values_are_those_of_the_states_met_and_not_of_the_held_out_ones(
    small, monkeypatch
):
    monkeypatch.setattr(evaluation, "VALUE_GAMES", 1)
    met = []

    def player(observations):
        met.append(observations[0])  # the rest is padding
        brightness = observations.mean(axis=(1, 2, 3))
        return np.outer(brightness, np.linspace(-1, 2, 18)).astype(np.float32)

    held_out = np.full((3, 84, 84, 4), 7, np.uint8)
    check, _ = check_values(player, small(max_game_frames=400), held_out, episode=1, seed=1)
    states = [state for state in met if (state != 7).any()]
    assert len(states) == len(met) - 1 > 50
    assert check.held_out_q == pytest.approx(2 * 7)
    assert check.predicted == pytest.approx(2 * np.mean(states), rel=1e-5)
    assert check.predicted > 20 > check.held_out_q


def test_values_are_checked_with_the_exploration_of_an_evaluation(small, monkeypatch):
    monkeypatch.setattr(evaluation, "VALUE_GAMES", 1)
    chances = set()

    def choose(q_values, probability, rng):
        chances.add(probability)
        return epsilon_greedy(q_values, probability, rng)

    monkeypatch.setattr(evaluation, "epsilon_greedy", choose)
    held_out = np.zeros((1, 84, 84, 4), np.uint8)
    check_values(constant(18, 0, 1.0), small(evaluation_epsilon=0.25), held_out, 1, seed=1)
    assert chances == {0.25}


def test_rewards_of_evaluation_games_are_less_for_a_lost_life_too(small):
    parameters = small(game="breakout", life_loss_penalty=0.75, max_game_frames=1000)
    table = evaluation.EpisodeInProgress(parameters)
    table.start(0, seed=1)
    while table.env.lives == 5:
        table.step(0)
    assert table.rewards[-1] == -0.75


def test_a_player_sees_the_last_images_the_oldest_first_and_none_of_the_game_before(
    small, monkeypatch
):
    monkeypatch.setattr(evaluation, "EMULATORS", 1)
    parameters, seen = small(evaluation_epsilon=1.0), []

    def player(observations):
        seen.append(observations[0])
        return np.zeros((len(observations), 18), np.float32)

    wanted = []
    for game in play(player, parameters, 2, seed=1):
        emulator, actions = make_env(parameters), game.record.actions
        first, _ = emulator.reset(options={"record": game.record})
        images = [first] * 4 + [emulator.step(action)[0] for action in actions]
        wanted += [np.stack(images[at : at + 4], axis=-1) for at in range(len(actions))]
    np.testing.assert_array_equal(seen, wanted)


def test_evaluation_is_played_on_an_emulator_of_the_difficulty_and_stickiness_named(small):
    """The same random actions lead elsewhere on each."""
    distances, chosen = set(), set()
    for changes in ({}, {"difficulty": 1}, {"difficulty": 2}, {"sticky_actions": 0.5}):
        parameters = small(**changes, evaluation_epsilon=1.0)
        (game,) = play(constant(18, best=0, value=1.0), parameters, 1, seed=1)
        distances.add(game.distance)
        chosen.add(game.record.actions)
    assert len(distances) == 4
    assert len(chosen) == 1


@pytest.mark.parametrize(("game", "enough"), [("boxing", 1), ("breakout", 864)])
def test_a_game_is_described_by_what_its_emulator_says_at_its_end(small, monkeypatch, game, enough):
    monkeypatch.setattr(AtariEnv, "knockout", lambda self: -1)
    monkeypatch.setattr(AtariEnv, "points", lambda self: (8.0, 9.0))
    settings = {"difficulty": 1, "sticky_actions": 0.5, "evaluation_epsilon": 0.25}
    table = evaluation.EpisodeInProgress(small(game=game, **settings))
    table.start(5, seed=6)
    table.env.length, table.env.frames, table.distances = 11, 12, [1.0, 2.0]
    for score, won in ((enough - 1, False), (enough, True)):
        table.env.score = float(score)
        assert table.result(seed=6).row() == dict(
            zip(
                PLAYED_COLUMNS,
                (5, score, 11, 12, won, -1, 1, 0.5, 0.25, 6, 8.0, 9.0, 1.5),
                strict=True,
            )
        )


def test_held_out_states_are_the_same_for_all_runs_and_not_alike(small, monkeypatch):
    states = held_out_states(small(max_game_frames=2000))
    assert len({state.tobytes() for state in states}) > 500
    monkeypatch.setattr(evaluation, "HELD_OUT_STATES", 100)
    again = held_out_states(small(max_game_frames=2000, seeds=[9], gamma=0.5))
    np.testing.assert_array_equal(states[:100], again)


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
    scores = [game.score for game in play(constant(4, 0, 1.0), parameters, 20, seed=0)]
    assert np.mean(scores) == pytest.approx(1.2, abs=0.8)


def test_a_finished_run_is_evaluated_as_trained_and_under_the_conditions_it_asks_for(
    tmp_path, small
):
    asked = {"evaluation_difficulties": [0, 1], "evaluation_stickiness": [0.25]}
    run = Run(small(difficulty=1, episodes=2, max_game_frames=100, **asked), tmp_path)
    recorder.train(run)
    table = pd.read_csv(run.folder / "evaluations.csv")
    played = table.groupby(["difficulty", "sticky_actions"]).size().to_dict()
    assert played == {(1, 0.0): 2, (0, 0.0): 2, (1, 0.25): 2}
    assert set(table.trained_games) == {2}


def test_a_condition_that_a_cartridge_does_not_have_is_refused(small):
    with pytest.raises(ValueError, match="evaluation_difficulties: \\[2\\] is not allowed"):
        small(game="breakout", evaluation_difficulties=[2])


def test_play_style_counts_every_point_of_a_game_and_how_near_the_boxers_are(small):
    parameters = small(max_game_frames=4000, evaluation_epsilon=1.0)
    for game in play(constant(18, 0, 1.0), parameters, 2, seed=0):
        assert game.scored - game.conceded == game.score
        assert min(game.scored, game.conceded) > 0, "the test would not see who scored"
        assert 10 < game.distance < 120
    breakout = small(game="breakout", agents=["dqn"])
    (game,) = play(untrained(breakout, 4), breakout, 1, seed=0)
    assert np.isnan(game.distance)


def test_the_opening_of_an_evaluation_game_follows_from_its_number_and_the_seed(small):
    parameters = small(max_game_frames=40, evaluation_games=12)
    for seed in (1, 2):
        played = list(evaluation.play(lambda seen: np.zeros((len(seen), 18)), parameters, 12, seed))
        table = pd.DataFrame({"seed": seed, "game": [episode.game for episode in played]})
        table = table.assign(sticky_actions=0.0, epsilon=0.001)
        drawn = [episode.record.idle_frames for episode in played]
        assert openings(table, parameters) == drawn
        assert len(set(drawn)) > 5
        breakout = parameters.model_copy(update={"game": "breakout"})
        assert openings(table, breakout) == [idle % 4 for idle in drawn]
        for chance in ({"sticky_actions": 0.25}, {"epsilon": 1.0}):
            assert len(set(openings(table.assign(**chance), breakout))) == 12, "none is another"


@pytest.mark.parametrize(("game", "different"), [("breakout", 4), ("boxing", 30)])
def test_idle_frames_lead_to_as_many_different_games_as_is_said(small, game, different):
    """By the pictures of 40 steps of the same moves."""
    parameters, pictures = small(game=game, noop_max=30, max_game_frames=400), {}
    for idle in range(1, 31):
        env, _ = records.begin(parameters, EpisodeRecord(idle, b"", None))
        moves = np.random.default_rng(0).integers(len(env.actions), size=40)
        seen = b"".join(env.step(int(move))[0].tobytes() for move in moves)
        pictures.setdefault(seen, set()).add(GAMES[game].opening(idle))
    assert len(pictures) == different
    assert all(len(opening) == 1 for opening in pictures.values())
    assert len(set.union(*pictures.values())) == different
