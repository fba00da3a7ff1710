import pandas as pd
import pytest

from atari_dqn.envs import FIRE, AtariEnv
from atari_dqn.games import boxing_points
from atari_dqn.report import ram
from atari_dqn.report.ram import BOXERS, Punch

NOOP = 0


def test_a_score_is_two_decimal_digits_or_a_knockout():
    assert [boxing_points(cell) for cell in (0x00, 0x07, 0x10, 0x99, 0xC0)] == [0, 7, 10, 99, 100]


@pytest.fixture
def game():
    """A game of Boxing, frame by frame, a moment after the bell."""
    game = AtariEnv("boxing", frame_skip=1, noop_max=0)
    game.reset(seed=1)
    for _ in range(20):
        game.step(NOOP)
    return game


def test_while_fire_is_held_an_arm_goes_out_by_eight_a_frame(game):
    arm = []
    for _ in range(12):
        game.step(FIRE)
        arm.append(int(max(game.ram()[cell] for cell in BOXERS["agent"].arms)))
    assert arm == [0, *range(8, 73, 8), 72, 72]


@pytest.mark.parametrize(
    ("distance", "points"), [(14, 2), (17, 2), (20, 1), (26, 1), (29, 1), (40, 0)]
)
def test_boxers_held_in_place_score_two_from_near_and_one_from_far(game, distance, points):
    agent, computer = BOXERS["agent"], BOXERS["computer"]
    held = {agent.x: 40, agent.y: 40, computer.x: 40 + distance, computer.y: 40 + 16}
    held |= dict.fromkeys(computer.arms, 0)  # or it hits back in the same frame
    rewards = []
    for _ in range(13):
        for cell, value in held.items():
            game.ale.setRAM(cell, value)
        rewards.append(game.step(FIRE)[1])
    assert sum(rewards) == points


def test_the_punches_of_a_game_add_up_to_its_score(monkeypatch):
    games = []

    class Recorded(AtariEnv):
        def __init__(self, *arguments, **settings):
            super().__init__(*arguments, **settings)
            games.append(self)

    monkeypatch.setattr(ram, "AtariEnv", Recorded)
    found = list(ram.scoring_punches(games=1))
    punches = pd.DataFrame([punch for punch, _ in found])
    totals = punches.groupby("boxer").points.sum()
    assert totals["agent"] - totals["computer"] == games[0].score
    assert set(punches.points) == {1, 2}
    stored = ram.stored_punches()
    pd.testing.assert_frame_equal(stored[stored.game == 0], punches)
    pictures = ram.first_pictures()
    first = {
        points: next(seen for seen in found if seen[0][1:3] == ("agent", points))
        for points in (1, 2)
    }
    assert all((pictures[points] == picture).all() for points, (_, picture) in first.items())
    drawn = {axes.get_title(): axes.get_images()[0] for axes in ram.frames_figure(pictures).axes}
    assert list(drawn) == ["1 point", "2 points"]
    for image, picture in zip(drawn.values(), (pictures[1], pictures[2]), strict=True):
        assert (image.get_array() == picture[:, 8:]).all()


def test_the_stored_punches_score_two_exactly_where_the_arm_is_bent():
    punches = ram.stored_punches()
    assert punches.game.nunique() == 60
    assert ((punches.points == 2) == (punches.arm <= 52)).all()
    assert ((punches.points == 1) == (punches.arm >= 56)).all()


def test_the_summary_of_punches_counts_each_boxers_and_their_extremes():
    punches = pd.DataFrame(
        [
            Punch(0, "agent", 1, dx=20, dy=10, arm=56),
            Punch(0, "agent", 1, dx=26, dy=14, arm=64),
            Punch(0, "computer", 2, dx=12, dy=16, arm=40),
        ]
    )
    table = ram.summary(punches).set_index(["boxer", "points"])
    assert table.loc[("agent", 1)].to_dict() == {
        **{"punches": 2, "arm, least": 56, "arm, most": 64},
        **{"horizontal, median": 23, "horizontal, most": 26, "vertical, median": 12},
    }
    assert table.loc[("computer", 2)].to_dict() == {
        **{"punches": 1, "arm, least": 40, "arm, most": 40},
        **{"horizontal, median": 12, "horizontal, most": 12, "vertical, median": 16},
    }
    left, right = ram.punches_figure(punches).axes
    assert sum(bar.get_height() for bar in left.patches) == 3
    assert "the arm" in left.get_xlabel()
    assert sorted(right.collections[0].get_offsets().tolist()) == [[12, 16], [20, 10], [26, 14]]
    assert "horizontal" in right.get_xlabel()
    assert "vertical" in right.get_ylabel()


def test_the_same_actions_repeat_a_game_unless_actions_stick():
    for name in ("boxing", "breakout"):
        assert ram.first_difference(name, sticky_actions=0.0, steps=100) is None
        assert ram.first_difference(name, sticky_actions=0.25, steps=100) <= 50
