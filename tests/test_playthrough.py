"""Games looked at step by step and played on, beside an emulator that is told the same actions."""

import numpy as np
import pytest
import torch

from atari_dqn.agents import AGENTS
from atari_dqn.envs import EpisodeRecord, make_env
from atari_dqn.evaluation import player_of, q_of
from atari_dqn.params import AGENT_NAMES
from atari_dqn.report import playthrough
from atari_dqn.report.playthrough import (
    DOWN,
    FIRE,
    LEFT,
    RIGHT,
    UP,
    Playthrough,
    action_of,
    picture,
)
from atari_dqn.report.video import Critic

ACTIONS = bytes(np.random.default_rng(1).integers(18, size=40).tolist())


@pytest.fixture
def params(small):
    return small(max_game_frames=100_000)


def critic(params, seed=1):
    torch.manual_seed(seed)
    network = AGENTS[params.agents[0]].network(params.frame_stack, len(make_env(params).actions))
    return Critic(network.requires_grad_(False), params)


def played(params, idle, actions, changes=()):
    """What an emulator shows before every action, and at the end: pictures, images and scores.
    `changes` are made before the action of their number."""
    env, changes = make_env(params), dict(changes)
    image, _ = env.reset(options={"record": EpisodeRecord(idle, b"", None)})
    shown, images, scores = [env.render().copy()], [image.copy()], [0.0]
    for number, action in enumerate(actions):
        changes.get(number, lambda env: None)(env)
        image, *_ = env.step(action)
        shown.append(env.render().copy())
        images.append(image.copy())
        scores.append(env.score)
    return shown, images, scores


def test_every_moment_is_as_it_was_played(params, monkeypatch):
    monkeypatch.setattr(playthrough, "SOME", 16)
    judge, shares = critic(params), []
    record = EpisodeRecord(7, ACTIONS, None)
    game = Playthrough(judge, params, record, "a game", progress=shares.append)
    shown, images, scores = played(params, 7, ACTIONS)
    assert game.last == len(ACTIONS)
    assert not game.ended
    for moment in range(game.last + 1):
        assert (game.screen(moment) == shown[moment]).all()
        assert (game.planes(moment)[-1] == images[moment].ravel()).all()
        assert game.sights[moment].score == scores[moment]
        first = game.planes(moment)[0]
        assert (first == images[max(0, moment - 3)].ravel()).all(), "the oldest of four images"
    assert len({screen.tobytes() for screen in shown}) > 20, "the test would not see a shift"
    network = judge.network
    observations = np.stack([game.planes(moment) for moment in range(41)], axis=1)
    expected = q_of(player_of(network, params), observations)
    np.testing.assert_allclose(game.q_values, expected, atol=1e-5)
    assert game.best(5) == expected[5].argmax()
    np.testing.assert_allclose(game.values, expected.max(axis=1), atol=1e-5)
    assert shares == sorted(shares)
    assert len(shares) == 3


def test_a_branch_goes_on_from_its_moment_and_leaves_the_game_as_it_is(params):
    game = Playthrough(critic(params), params, EpisodeRecord(3, ACTIONS, None), "a game")
    branch = game.branch(25)
    for action in (2, 3, 4):
        branch.play(action)
    shown, _, _ = played(params, 3, ACTIONS[:25] + bytes([2, 3, 4]))
    assert all((branch.screen(moment) == shown[moment]).all() for moment in range(29))
    assert game.last == len(ACTIONS)
    assert branch.branch(28).actions == [*ACTIONS[:25], 2, 3, 4]


def test_settings_that_were_changed_on_the_way_are_changed_in_later_branches_too(params):
    """A branch of a branch is the game that was seen, not the recorded one."""
    later = bytes([4] * 30)
    game = Playthrough(critic(params), params, EpisodeRecord(3, ACTIONS, None), "a game")
    harder = game.branch(20, settings={"difficulty": 3})
    for action in later:
        harder.play(action)
    again = harder.branch(40, critic(params, seed=2))  # which sees everything anew
    changes = {20: lambda env: env.set_difficulty(3)}
    shown, *_ = played(params, 3, ACTIONS[:20] + later[:20], changes.items())
    unchanged, *_ = played(params, 3, ACTIONS[:20] + later[:20])
    assert (shown[-1] != unchanged[-1]).any(), "the test would not see a difference"
    assert (again.screen(40) == shown[-1]).all()
    assert (harder.screen(40) == shown[-1]).all()
    easy = harder.branch(20, settings={"difficulty": 0})
    assert easy.changes == {20: {"difficulty": 0}}, "the last word counts"
    assert harder.branch(19).changes == {19: {}}, "before there was a change"


def test_sticky_actions_from_a_moment_on_are_the_same_whenever_they_are_replayed(params):
    game = Playthrough(critic(params), params, EpisodeRecord(3, ACTIONS, None), "a game")
    sticky = game.branch(10, settings={"sticky_actions": 0.9})
    for action in bytes([3, 4] * 15):
        sticky.play(action)
    again = sticky.branch(40, critic(params, seed=2))
    unsticky, *_ = played(params, 3, ACTIONS[:10] + bytes([3, 4] * 15))
    assert (sticky.screen(40) == again.screen(40)).all()
    assert any((sticky.screen(at) != unsticky[at]).any() for at in range(11, 41))


def test_the_clock_can_be_set_and_the_game_ends_when_it_has_run_down(params):
    game = Playthrough(critic(params), params, EpisodeRecord(3, ACTIONS, None), "a game")
    branch = game.branch(8, settings={"clock": 10})
    while not branch.ended:
        branch.play(0)
    seconds = (branch.last - 8) * 4 / 60
    assert seconds == pytest.approx(10, abs=1.2)
    with pytest.raises(ValueError, match="ended"):
        branch.play(0)
    assert branch.branch(branch.last).ended


@pytest.mark.parametrize("settings", [{"clock": 121}, {"difficulty": 4}])
def test_what_a_game_does_not_have_cannot_be_set(params, settings):
    game = Playthrough(critic(params), params, EpisodeRecord(3, b"", None), "a game")
    with pytest.raises(ValueError, match="boxing has no"):
        game.branch(0, settings=settings)


def test_a_game_without_a_clock_has_none_to_set(small):
    env = make_env(small(game="breakout"))
    with pytest.raises(ValueError, match="breakout has no clock"):
        env.set_clock(10)


@pytest.mark.parametrize("agent", AGENT_NAMES)
def test_a_moment_is_drawn_alone_or_beside_another_game(small, agent):
    params = small(agents=[agent])
    game = Playthrough(critic(params), params, EpisodeRecord(3, ACTIONS[:6], None), "one")
    other = game.branch(2, critic(small(agents=["dqn"]), seed=2), "two")
    alone, beside = picture([game], 3), picture([game, other], 3)
    assert alone.shape[1:] == beside.shape[1:] == (720, 3)
    assert (alone != picture([game], 2)).any()
    assert (beside == picture([game, other], 3)).all()
    assert other.recording().agent == "dqn", "whose colour it has"
    assert game.recording().agent == agent
    assert (picture([other], 6) == picture([other], 2)).all(), "it waits"


SIDES = ["UP", "RIGHT", "LEFT", "DOWN", "UPRIGHT", "UPLEFT", "DOWNRIGHT", "DOWNLEFT"]
BOXING = ["NOOP", "FIRE", *SIDES, *(f"{side}FIRE" for side in SIDES)]
BREAKOUT = ["NOOP", "FIRE", "RIGHT", "LEFT"]


@pytest.mark.parametrize(
    ("pressed", "names", "action"),
    [
        (set(), BOXING, "NOOP"),
        ({FIRE, DOWN, LEFT}, BOXING, "DOWNLEFTFIRE"),
        ({RIGHT, UP}, BOXING, "UPRIGHT"),
        ({LEFT, RIGHT, FIRE}, BOXING, "FIRE"),
        ({LEFT, RIGHT, UP, DOWN}, BOXING, "NOOP"),
        ({LEFT, RIGHT, UP}, BOXING, "UP"),
        ({UP, LEFT}, BREAKOUT, "LEFT"),
        ({FIRE, LEFT}, BREAKOUT, "LEFT"),
        ({FIRE, DOWN}, BREAKOUT, "FIRE"),
        ({DOWN}, BREAKOUT, "NOOP"),
        ({UP, LEFT, FIRE}, BREAKOUT, "LEFT"),
    ],
)
def test_keys_are_a_joystick_as_far_as_the_cartridge_reads_it(pressed, names, action):
    assert names[action_of(pressed, names)] == action
