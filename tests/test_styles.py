"""Styles are what the console's memory says while recorded greedy episodes are played again."""

from dataclasses import astuple, dataclass
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ale_py import ALEInterface, roms
from synthetic import settings

from atari_dqn import params
from atari_dqn.envs import EpisodeRecord, make_env
from atari_dqn.report import ram
from atari_dqn.runs import records, styles, tables
from atari_dqn.runs.run import Run

ROOT = Path(__file__).parents[1]
STEPS = 120  # of a recorded episode, agent steps of four frames


@pytest.fixture
def run(small, tmp_path):
    """A run with two greedy episodes and a training one on record."""
    parameters = small(max_game_frames=2000)
    run = Run(params.pick(parameters, "double_dqn", 1), tmp_path)
    run.folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    games = [({"kind": "training", "episode": 1}, EpisodeRecord(3, bytes(5), None))]
    for number in range(2):
        actions = bytes(rng.integers(18, size=STEPS // 6).repeat(6).astype(np.uint8).tolist())
        heading = {"kind": "values", "episode": 100, "game": number}
        games.append((heading, EpisodeRecord(7 * number, actions, None)))
    (run.folder / records.FILE).write_bytes(records.encode(games))
    return run


def frames(record):
    """The console's memory before the first step and after each of its frames, from an emulator of
    its own."""
    ale = ALEInterface()
    ale.setFloat("repeat_action_probability", 0.0)
    ale.loadROM(roms.get_rom_path("boxing"))
    ale.reset_game()
    for _ in range(record.idle_frames):
        ale.act(0)
    yield ale.getRAM().astype(int)
    for action in record.actions:
        for _ in range(4):
            ale.act(ale.getLegalActionSet()[action])
            yield ale.getRAM().astype(int)


def memories(record):
    """The console's memory before the first step and after each."""
    return islice(frames(record), 0, None, 4)


def punches(memories):
    """How often either arm goes out past a third of its way; a blow taken sets both to 41."""
    return sum(
        before[arm] <= 24 < after[arm]
        for before, after in pairwise(memories)
        for arm in (55, 57)
        if not after[55] == after[57] == 41
    )


def test_every_blow_that_lands_is_a_punch(small, tmp_path):
    """A boxer that holds the button down never rests both of its arms."""
    run = Run(params.pick(small(max_game_frames=4000), "double_dqn", 1), tmp_path)
    run.folder.mkdir(parents=True)
    towards = bytes([14] * 40 + [1] * 400)  # down and left of where it starts, then only punching
    heading = {"kind": "values", "episode": 100, "game": 0}
    (run.folder / records.FILE).write_bytes(
        records.encode([(heading, EpisodeRecord(1, towards, None))])
    )
    styles.measure(run)
    row = pd.read_csv(run.styles).iloc[0]
    assert row.punches > row.scored > 0


def test_each_greedy_episode_has_a_row_with_what_the_memory_says(run):
    styles.measure(run)
    table = pd.read_csv(run.styles)
    assert table.episode.tolist() == [100, 100]
    assert table.game.tolist() == [0, 1]
    recorded = [record for heading, record in records.read_file(run.folder) if "game" in heading]
    for row, record in zip(table.itertuples(), recorded, strict=True):
        before, *after = memories(record)
        x, rival_x, y, rival_y = (np.array([one[cell] for one in after]) for cell in range(32, 36))
        near = (abs(x - rival_x) <= 30) & (abs(y - rival_y) <= 30)
        assert row.reach == pytest.approx(near.mean())
        assert row.distance == pytest.approx(np.hypot(x - rival_x, y - rival_y).mean())
        assert row.punches == punches([before, *after]) > 0
        points = [10 * (cell >> 4) + (cell & 15) for cell in (after[-1][18], after[-1][19])]
        assert [row.scored, row.conceded] == points
        assert row.score == points[0] - points[1]
        assert row.frames == 4 * STEPS + record.idle_frames


def greedy_game(of, episode):
    """The first greedy game of a stored run after so many training episodes."""
    folder = ROOT / "results" / "runs" / of / "seed-1"
    for heading, record in records.read_file(folder):
        if heading["kind"] == "values" and heading["episode"] == episode:
            return params.load(folder / "params.yaml"), record
    raise AssertionError("no such game is on record")


def test_blows_for_one_and_for_two_points_are_counted_as_every_frame_shows_them():
    parameters, record = greedy_game("boxing_final/double_dqn", 800)
    found = styles.MEASURED["boxing"](parameters, 800, 0, "0", record)
    cells = [memory[18] for memory in frames(record)]
    points = [100 if cell == 0xC0 else 10 * (cell >> 4) + (cell & 15) for cell in cells]
    gains = [gain for gain in np.diff(points) if gain]
    assert found.blows == len(gains) > 50
    assert found.doubles == gains.count(2) > 10
    assert found.scored == sum(gains) == 100


def test_the_ring_ends_where_boxers_get_no_further_but_by_a_blow():
    _, record = greedy_game("boxing_final/double_dqn", 100)
    seen = np.array([*frames(record)])
    for axis, cells in enumerate([(32, 33), (34, 35)]):  # x and y, of the agent and of its rival
        places, (low, high) = seen[:, cells], styles.RING[axis]
        assert (places == low).any() and (places == high).any()  # noqa: PT018
        assert np.mean((places < low) | (places > high)) < 0.02


@pytest.mark.parametrize("who", ["ropes", "rival_ropes"])
def test_at_the_ropes_is_within_four_pixels_of_an_end_of_the_ring(run, who):
    styles.measure(run)
    recorded = [record for heading, record in records.read_file(run.folder) if "game" in heading]
    for row, record in zip(pd.read_csv(run.styles).itertuples(), recorded, strict=True):
        _, *after = memories(record)
        x, y = ((32, 34) if who == "ropes" else (33, 35)) if after else ()
        at = [
            one[x] <= 34 or one[x] >= 105 or one[y] <= 7 or one[y] >= 83  # of 30 to 109, 3 to 87
            for one in after
        ]
        assert getattr(row, who) == pytest.approx(np.mean(at))


def test_maps_of_the_ring_hold_the_share_of_all_steps_of_a_check(run):
    found = styles.stays(run, 100)
    assert styles.checks(run) == [100]
    assert found.sum(axis=(1, 2)) == pytest.approx([1, 1])
    recorded = [record for heading, record in records.read_file(run.folder) if "game" in heading]
    steps = [memory for record in recorded for memory in [*memories(record)][1:]]
    for who, (x, y) in enumerate([(32, 34), (33, 35)]):
        expected = np.zeros_like(found[who])
        for memory in steps:
            column, row = (memory[x] - 30) // 4, (memory[y] - 3) // 4
            expected[np.clip(column, 0, 19), np.clip(row, 0, 21)] += 1 / len(steps)
        np.testing.assert_allclose(found[who], expected)


def test_what_is_measured_is_not_played_again_and_another_record_is(run, monkeypatch):
    styles.measure(run)
    once = run.styles.read_bytes()
    played = []
    replay = records.replay
    monkeypatch.setattr(records, "replay", lambda *one: played.append(one[1]) or replay(*one))
    styles.measure(run)
    assert (played, run.styles.read_bytes()) == ([], once)
    games = records.read_file(run.folder)
    games[2] = (games[2][0], EpisodeRecord(9, games[2][1].actions, None))
    (run.folder / records.FILE).write_bytes(records.encode(games))
    styles.measure(run)
    assert [one.idle_frames for one in played] == [9]
    assert run.styles.read_bytes() != once


def test_an_interruption_keeps_what_has_been_measured(run, monkeypatch):
    played, measured = [], styles.MEASURED["boxing"]

    def interrupted(*given):
        if played:
            raise KeyboardInterrupt
        played.append(given)
        return measured(*given)

    monkeypatch.setitem(styles.MEASURED, "boxing", interrupted)
    with pytest.raises(KeyboardInterrupt):
        styles.measure(run)
    assert len(pd.read_csv(run.styles)) == 1
    again = lambda *given: played.append(given) or measured(*given)  # noqa: E731
    monkeypatch.setitem(styles.MEASURED, "boxing", again)
    styles.measure(run)
    assert [game for _, _, game, *_ in played] == [0, 1], "each is played once"
    assert len(pd.read_csv(run.styles)) == 2


def followed(small):
    """A game of Breakout in which the paddle is always on its way to where the ball is."""
    parameters = small(game="breakout", max_game_frames=12_000)
    game, over = make_env(parameters), False
    game.reset(seed=0)
    while not over:
        ball, paddle = (int(game.ram()[cell]) for cell in (99, 72))
        aim = ball - 8
        action = 0 if abs(aim - paddle) < 4 else 2 if aim > paddle else 3
        over = game.step(action)[2]
    return parameters, game.played()


def through_the_wall(_):
    """A greedy game of a finished agent that brings the ball above the wall."""
    folder = ROOT / "results" / "runs" / "breakout_late" / "dueling_double_dqn" / "seed-1"
    for heading, record in records.read_file(folder):
        if heading == {"kind": "values", "episode": 3000, "game": 60002}:
            return params.load(folder / "params.yaml"), record
    raise AssertionError("the game is not on record")


def ball(picture):
    """Where the ball is between wall and paddle, x and y in pixels; nan if it is not there."""
    y, x = (picture[94:189, 8:152] == (200, 72, 72)).all(axis=2).nonzero()
    return (8 + x.mean(), 94 + y.mean()) if len(x) else (np.nan, np.nan)


@pytest.mark.parametrize("played", [followed, through_the_wall])
def test_balls_of_breakout_are_counted_as_the_picture_shows_them(small, tmp_path, played):
    parameters, record = played(small)
    run = Run(params.pick(parameters, parameters.agents[0], 1), tmp_path)
    run.folder.mkdir(parents=True)
    heading = {"kind": "values", "episode": 100, "game": 0}
    (run.folder / records.FILE).write_bytes(records.encode([(heading, record)]))
    styles.measure(run)
    row = pd.read_csv(run.styles).iloc[0]

    below, above, scores, lives = [], [], [], []
    for game in records.replay(run.params, record):
        picture = game.render()
        below.append(ball(picture))
        above.append(picture[32:57, 8:152].any())  # all black but for the ball
        scores.append(game.score)
        lives.append(game.lives)
    below, above = np.array(below), np.array(above)
    moved = np.diff(below, axis=0) / 4  # pixels per frame, x and y
    down = moved[:, 1]
    bounds = [1.75, 2.5]  # of the speeds
    # low in the picture, a ball that came down goes up: steps before and after its return
    steps = pairwise(np.flatnonzero(np.abs(down) > 0))
    turns = [(a, b) for a, b in steps if down[a] > 0 > down[b] and below[b][1] > 160]
    speeds = np.digitize([np.nanmedian(down[before - 4 : before]) for before, _ in turns], bounds)
    assert [row[f"returned_{speed}"] for speed in tables.SPEEDS] == np.bincount(speeds).tolist()
    assert np.bincount(speeds).min() > 2

    lost, speeds, places = np.flatnonzero(np.diff(lives) < 0), [], []
    for moment in lost:
        seen = np.flatnonzero(~np.isnan(down[:moment]))[-1]  # the last step all of which is seen
        x = below[seen + 1][0] + 4 * moved[seen][0] * (moment - seen - 1)
        speeds.append(np.digitize(down[seen], bounds))
        places.append(int(np.clip(x - 8, 0, 143)) // 48)  # thirds of the court
    counted = [row[f"lost_{speed}"] for speed in tables.SPEEDS]
    assert counted == np.bincount(speeds, minlength=3).tolist()
    counted = [row[f"lost_{third}"] for third in tables.THIRDS]
    assert counted == np.bincount(places, minlength=3).tolist()
    assert row.tunnel == above.any() == (played is through_the_wall)
    gained = np.diff(scores)[above[:-1] | above[1:]].sum()
    assert row.above == gained
    assert (gained > 100) == (played is through_the_wall)
    assert row.score == scores[-1]


@dataclass
class Moment:
    """Of a game of Breakout, as the console's memory and its score tell it."""

    y: int  # of the ball; 0 while none is in play
    score: float = 0
    lives: int = 5
    x: int = 100
    frames: int = 0

    def ram(self):
        memory = np.zeros(128, np.uint8)
        memory[[99, 101, 103]] = self.x, self.y, 1
        return memory


def of_moments(monkeypatch, moments):
    monkeypatch.setattr(records, "replay", lambda params, record: iter(moments))
    return styles.MEASURED["breakout"](None, 100, 0, "", None)


def test_points_above_the_wall_are_those_of_steps_that_begin_or_end_there(monkeypatch):
    """The wall's first row begins at 46; the n-th step scores 2 ** n."""
    places = [60, 60, 45, 45, 46, 46, 0, 0]
    found = of_moments(monkeypatch, [Moment(y, 2**n - 1) for n, y in enumerate(places)])
    assert (found.above, found.tunnel) == (2 + 4 + 8, 1)
    found = of_moments(monkeypatch, [Moment(y, n) for n, y in enumerate([60, 46, 0, 0, 46])])
    assert (found.above, found.tunnel) == (0, 0)


def test_a_ball_is_lost_in_the_third_of_the_court_where_it_was_before(monkeypatch):
    """The court's 144 pixels begin at 57, and beneath the paddle a ball goes on beyond them."""
    places = [20, 57, 104, 105, 152, 153, 200, 230]
    moments = [Moment(190, lives=9 - n, x=x) for n, x in enumerate(places)]
    found = of_moments(monkeypatch, [*moments, Moment(0, lives=1)])
    assert (found.lost_left, found.lost_middle, found.lost_right) == (3, 2, 3)


def test_no_punch_that_was_measured_lands_from_beyond_reach():
    punches = ram.stored_punches()
    assert max(punches.dx.max(), punches.dy.max()) == styles.REACH


def test_every_experiment_whose_styles_are_measured_trains_the_agent():
    for name in styles.EXPERIMENTS:
        assert styles.AGENT in settings(name).agents


@pytest.mark.parametrize("name", ["boxing_final/double_dqn", "breakout_late/dueling_double_dqn"])
def test_stored_styles_are_what_the_code_still_finds(name):
    """The last greedy game; what is stored is not measured again when only the code changes."""
    folder = ROOT / "results" / "runs" / name / "seed-1"
    path = ROOT / "results" / "styles" / name / "seed-1.csv"
    stored = tables.read_file(path, tables.STYLES[name.split("_")[0]])
    parameters = params.load(folder / "params.yaml")
    of_checks = (game for game in records.read_file(folder) if game[0]["kind"] == records.VALUES)
    heading, record = max(of_checks, key=lambda game: (game[0]["episode"], game[0]["game"]))
    key = (heading["episode"], heading["game"], records.digest(record))
    found = astuple(styles.MEASURED[parameters.game](parameters, *key, record))
    assert found == pytest.approx(next(stored.iloc[[-1]].itertuples(index=False, name=None)))
