"""The games against Gymnasium's own wrappers, on the real cartridges."""

import ale_py
import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import AtariPreprocessing, FrameStackObservation

from atari_dqn import envs
from atari_dqn.envs import FIRE, AtariEnv, VectorEnv
from atari_dqn.games import GAMES

gymnasium.register_envs(ale_py)
AGENTS_SCORE, RIVALS_SCORE = 18, 19  # Boxing's memory cells
ROMS = {"boxing": "ALE/Boxing-v5", "breakout": "ALE/Breakout-v5"}


def gymnasium_game(game, frame_skip=4, noop_max=30, difficulty=0):
    env = gymnasium.make(
        ROMS[game], frameskip=1, repeat_action_probability=0.0, difficulty=difficulty
    )
    return AtariPreprocessing(env, frame_skip=frame_skip, noop_max=noop_max)


@pytest.mark.parametrize(("difficulty", "frame_skip"), [(0, 4), (3, 4), (1, 1), (2, 2)])
def test_boxing_is_pixel_for_pixel_that_of_gymnasiums_wrappers(difficulty, frame_skip):
    oracle = gymnasium_game("boxing", frame_skip, difficulty=difficulty)
    game = AtariEnv("boxing", difficulty=difficulty, frame_skip=frame_skip)
    actions = np.random.default_rng(0).integers(18, size=300)
    expected, _ = oracle.reset(seed=5)
    image, _ = game.reset(seed=5)
    np.testing.assert_array_equal(image, expected)
    for action in actions:
        expected, reward, terminated, truncated, _ = oracle.step(action)
        image, *rest = game.step(int(action))
        np.testing.assert_array_equal(image, expected)
        assert rest[:3] == [reward, terminated, truncated]


def test_a_whole_boxing_game_has_the_score_and_the_end_that_gymnasium_sees():
    oracle, game = gymnasium_game("boxing"), AtariEnv("boxing")
    oracle.reset(seed=1)
    game.reset(seed=1)
    rng, total, ended = np.random.default_rng(0), 0.0, False
    while not ended:
        action = int(rng.integers(18))
        _, reward, ended, _, _ = oracle.step(action)
        total += reward
        assert game.step(action)[2] == ended
    assert game.score == total
    assert 1700 < game.length < 1800  # two minutes, four frames per step


def test_breakout_is_served_at_the_start_and_after_every_lost_life_and_else_untouched():
    oracle, game = gymnasium_game("breakout", noop_max=0), AtariEnv("breakout", noop_max=0)
    oracle.reset(seed=2)
    game.reset(seed=2)
    *_, info = oracle.step(FIRE)
    rng, total, lost, ended = np.random.default_rng(1), 0.0, 0, False
    while not ended:
        action = int(rng.integers(4))
        lives = info["lives"]
        expected, reward, ended, _, info = oracle.step(action)
        image, mine, terminated, _, mine_info = game.step(action)
        assert (mine, terminated) == (reward, ended)
        total += reward
        if info["lives"] < lives:
            lost += 1
            assert mine_info["life_lost"]
            if not ended:
                *_, info = oracle.step(FIRE)  # the image in this step is of after the serve
        else:
            assert not mine_info["life_lost"]
            np.testing.assert_array_equal(image, expected)
    assert lost == 5
    assert game.score == total


def test_a_breakout_agent_that_does_nothing_loses_all_lives_and_does_not_stall():
    game = AtariEnv("breakout")
    game.reset(seed=0)
    for _ in range(2000):
        if game.step(0)[2]:
            return
    pytest.fail("the game went on for ever")


@pytest.mark.parametrize("game", ["boxing", "breakout", "pong"])
def test_observations_are_gymnasiums_frame_stack_across_games(game, small):
    lockstep = VectorEnv(small(game=game, max_game_frames=300), np.random.SeedSequence(3))
    alone = AtariEnv(game, max_game_frames=300)
    oracle = FrameStackObservation(alone, 4)
    seed = int(np.random.SeedSequence(3).generate_state(2)[0])
    expected, _ = oracle.reset(seed=seed)
    rng, ended = np.random.default_rng(0), 0
    while ended < 2:
        np.testing.assert_array_equal(
            lockstep.observations()[0].transpose(2, 0, 1), expected, err_msg="oldest image first"
        )
        action = int(rng.integers(4))
        was_over = lockstep.ended[0]
        step = lockstep.step(np.array([action, 0]))
        if was_over:  # this step only restarts, whatever the action
            assert (step.ages[0], step.rewards[0], step.terminated[0]) == (0, 0, False)
            expected, _ = oracle.reset()
        else:
            expected, _, terminated, truncated, _ = oracle.step(action)
            assert step.ages[0] == alone.length
            assert lockstep.ended[0] == (terminated or truncated)
            assert step.terminated[0] == terminated
            ended += terminated or truncated


@pytest.mark.parametrize(("clip", "expected"), [(True, [1, -1]), (False, [2, -3])])
def test_rewards_are_clipped_for_learning_and_raw_in_the_score(small, monkeypatch, clip, expected):
    lockstep = VectorEnv(small(clip_rewards=clip), np.random.SeedSequence(0))
    for env, points in zip(lockstep.envs, (2, -3), strict=True):
        monkeypatch.setattr(env, "frame_skip", 1)
        monkeypatch.setattr(env, "ale", _Rewarding(env.ale, points))
    before = [env.score for env in lockstep.envs]
    step = lockstep.step(np.zeros(2, int))
    assert step.rewards.tolist() == expected
    assert [env.score - was for env, was in zip(lockstep.envs, before, strict=True)] == [2, -3]


class _Rewarding:
    """An emulator whose every frame gives the same reward."""

    def __init__(self, ale, points):
        self._ale, self._points = ale, points

    def act(self, action):
        self._ale.act(action)
        return self._points

    def __getattr__(self, name):
        return getattr(self._ale, name)


def test_a_lost_life_costs_its_penalty_and_does_not_end_the_game(small):
    parameters = small(game="breakout", max_game_frames=10_000, life_loss_penalty=1.0)
    lockstep = VectorEnv(parameters, np.random.SeedSequence(0))
    rewards, games = [], 0
    while not games:
        step = lockstep.step(np.zeros(2, int))
        rewards.append(step.rewards[0])
        games = len(step.finished)
    assert rewards.count(-1.0) == 5
    assert step.finished[0].score >= 0


def test_a_game_cut_by_its_frame_limit_is_not_terminated(small):
    lockstep = VectorEnv(small(), np.random.SeedSequence(0))
    finished = []
    while not finished:
        step = lockstep.step(np.zeros(2, int))
        finished = step.finished
    assert not step.terminated.any()
    assert 120 <= finished[0].frames < 124


@pytest.mark.parametrize(("game", "difficulty"), [("boxing", 0), ("boxing", 3), ("breakout", 1)])
@pytest.mark.parametrize("sticky", [0.0, 0.25])
def test_a_restored_game_goes_on_exactly_as_the_saved_one(game, difficulty, sticky):
    def new():
        return AtariEnv(game, difficulty=difficulty, sticky_actions=sticky, max_game_frames=900)

    def play(env, actions):
        trace = []
        for action in actions:
            image, reward, terminated, truncated, info = env.step(int(action))
            trace.append((image.tobytes(), env.ram().tobytes(), reward, truncated, info))
            if terminated or truncated:
                trace.append(env.reset()[0].tobytes())  # the idle frames are drawn here
        return trace, env.score, env.frames

    saved, restored = new(), new()
    saved.reset(seed=11)
    restored.reset(seed=99)
    rng = np.random.default_rng(4)
    play(saved, rng.integers(len(saved.actions), size=101))
    restored.set_state(saved.get_state())
    actions = rng.integers(len(saved.actions), size=400)
    assert play(saved, actions) == play(restored, actions)


@pytest.mark.parametrize(
    ("cell", "knockout"), [(AGENTS_SCORE, 1), (RIVALS_SCORE, -1)], ids=["given", "received"]
)
def test_the_hundredth_point_is_a_knockout_for_whoever_scores_it(cell, knockout):
    game = AtariEnv("boxing")
    game.reset(seed=0)
    assert game.knockout() == 0
    game.ale.setRAM(cell, 0x99)
    rng, terminated = np.random.default_rng(0), False
    while not terminated:
        assert game.knockout() == 0
        *_, terminated, _, _ = game.step(int(rng.integers(18)))
    assert game.length < 1000, "long before the time is up"
    assert game.knockout() == knockout
    assert max(game.points()) == game.points()[knockout < 0] == 100


def test_a_breakout_game_knows_no_knockout():
    game = AtariEnv("breakout")
    game.reset(seed=0)
    for cell in (AGENTS_SCORE, RIVALS_SCORE):
        game.ale.setRAM(cell, 0xC0)
        assert game.knockout() == 0


def test_the_difficulty_switches_slow_the_agent_and_its_rival():
    """Pixels moved in 24 frames of DOWN: the agent is slowed by bit 0."""
    moved = {}
    for difficulty in range(4):
        game = AtariEnv("boxing", difficulty=difficulty, noop_max=0)
        game.reset(seed=0)
        start = int(game.ram()[34])
        for _ in range(6):
            game.step(5)
        moved[difficulty] = abs(int(game.ram()[34]) - start)
    assert moved[0] == moved[2] > 1.8 * moved[1] == 1.8 * moved[3] > 0


def test_sticky_actions_repeat_the_last_executed_action_frame_by_frame(monkeypatch):
    game = AtariEnv("boxing", sticky_actions=0.25, noop_max=0)
    game.reset(seed=0)
    executed, emulator = [], game.ale
    monkeypatch.setattr(game, "ale", _Recording(emulator, executed))
    asked = np.random.default_rng(0).permutation(np.repeat(np.arange(18), 90))
    for action in asked:
        game.step(int(action))
    executed = np.array(executed).reshape(-1, 4)
    stuck = executed != asked[:, None]
    changed = np.append(True, asked[1:] != asked[:-1])
    # k frames in a row keep the earlier action with probability 0.25^k
    assert stuck[changed, 0].mean() == pytest.approx(0.25, abs=0.03)
    assert stuck[changed, 1].mean() == pytest.approx(0.25**2, abs=0.02)
    before = np.append(0, executed[:-1, 3])
    assert (executed[:, 0] == np.where(stuck[:, 0], before, asked)).all()


class _Recording:
    """An emulator that remembers which actions were executed."""

    def __init__(self, ale, executed):
        self._ale, self._executed = ale, executed

    def act(self, action):
        self._executed.append(action.value)
        return self._ale.act(action)

    def __getattr__(self, name):
        return getattr(self._ale, name)


def test_a_used_emulator_plays_as_a_new_one_does():
    """Emulators go from game to game, whatever their last game was."""

    def play(game):
        images = [game.reset(seed=1)[0]]
        actions = np.random.default_rng(2).integers(18, size=300)
        images += [game.step(int(action))[0] for action in actions]
        return game.score, game.ram().tobytes(), np.stack(images).tobytes()

    envs._LEFT.clear()
    expected = play(AtariEnv("boxing"))
    envs._LEFT.clear()
    used = AtariEnv("boxing", difficulty=3, sticky_actions=0.5)
    emulator = used.ale
    assert play(used) != expected
    emulator.setRAM(AGENTS_SCORE, 0x42)
    del used
    game = AtariEnv("boxing")
    assert game.ale is emulator
    assert play(game) == expected
    assert AtariEnv("boxing").ale is not emulator, "which is in use"


def test_every_game_begins_alike_however_many_were_played_before():
    """Left to itself, the emulator draws the console's timer at every reset, and a game of Boxing
    in fifteen begins a frame later."""
    game = AtariEnv("boxing", noop_max=0)
    beginnings = {(game.reset()[0].tobytes(), game.ram().tobytes()) for _ in range(60)}
    assert len(beginnings) == 1
    left_to_itself = set()
    for _ in range(60):
        game.ale.reset_game()
        left_to_itself.add(game.ram().tobytes())
    assert len(left_to_itself) == 2


@pytest.mark.parametrize("game", GAMES)
def test_the_difficulties_of_a_game_are_the_emulators(game):
    assert list(GAMES[game].difficulties) == AtariEnv(game).ale.getAvailableDifficulties()


def test_an_unknown_difficulty_is_refused():
    with pytest.raises(ValueError, match="breakout has no difficulty 3"):
        AtariEnv("breakout", difficulty=3)
