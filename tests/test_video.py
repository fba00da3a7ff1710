"""Videos of short games on the real cartridges, with untrained networks."""

import colorsys
import io
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pytest
import torch

from atari_dqn.agents import AGENTS
from atari_dqn.envs import make_env
from atari_dqn.evaluation import play, player_of
from atari_dqn.report import plots
from atari_dqn.report import video as module
from atari_dqn.report.video import play_with_instruments, side_by_side


def untrained(params):
    torch.manual_seed(0)
    network = AGENTS[params.agents[0]].network(params.frame_stack, len(make_env(params).actions))
    return network.requires_grad_(False)


def decoded(video):
    """Its pictures, uint8 [pictures, height, width, 3], and its length in seconds."""
    assert video.index(b"moov") < video.index(b"mdat"), "a player would have to load it all first"
    with av.open(io.BytesIO(video)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        pictures = np.stack(
            [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        )
        return pictures, float(stream.duration * stream.time_base)


def image(png):
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)


@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize("game", ["boxing", "breakout"])
def test_the_game_on_video_is_the_evaluated_one(small, game, agent):
    params = small(game=game, agents=[agent], max_game_frames=600, evaluation_epsilon=0.3)
    network = untrained(params)
    player = player_of(network, params)
    evaluated = {played.game: played for played in play(player, params, 3, seed=5)}
    video = play_with_instruments(network, params, "Agent", 5, 2, seconds=(None, 0.2))
    assert repr(video.games) == repr((evaluated[2],))  # nan is not equal to itself


def test_a_video_has_a_picture_a_step_and_holds_the_last_for_a_second(small):
    params = small(evaluation_epsilon=0.5)
    video = play_with_instruments(untrained(params), params, "Double DQN", 1, 0)
    pictures, seconds = decoded(video.mp4)
    steps = video.games[0].length
    assert pictures.shape[0] == steps + 1 + 15
    assert pictures.shape[2] == module.WIDTH
    assert seconds == pytest.approx(len(pictures) / 15, abs=0.01)
    assert (pictures[-1].astype(int) - pictures[-15]).max() < 32, "the last picture is held"
    assert image(video.poster).shape == pictures.shape[1:]
    height, width, _ = image(video.strip).shape
    assert (width, height) > (1200, 400)


def test_the_television_and_the_observation_are_those_of_the_game(small):
    """Decoded pictures, compared with the same game played by hand."""
    params = small(evaluation_epsilon=1.0)
    video = play_with_instruments(untrained(params), params, "Agent", 1, 0)
    pictures, _ = decoded(video.mp4)
    table = module.EpisodeInProgress(params)
    table.start(0, seed=1)
    for picture in pictures[: video.games[0].length]:
        screen = picture[module.TOP : module.TOP + 420 : 2, module.MARGIN : module.MARGIN + 320 : 2]
        assert np.abs(screen.astype(int) - table.env.render()).mean() < 6
        x = module.RIGHT + 3 * (84 + module.GAP)
        newest = picture[module.TOP : module.TOP + 84, x : x + 84, 1]
        assert np.abs(newest.astype(int) - table.planes[-1].reshape(84, 84)).mean() < 6
        table.rng.random(1)  # whether to explore, and how, as `epsilon_greedy` draws it
        table.step(int(table.rng.integers(18, size=1)[0]))


def test_the_same_game_gives_the_same_bytes(small):
    params = small(agents=["dueling_double_dqn"], evaluation_epsilon=0.5)
    network = untrained(params)
    contestants = {"one": (network, params), "two": (network, params)}
    for make in (
        lambda: play_with_instruments(network, params, "Agent", 1, 0, (None, 1)),
        lambda: side_by_side(contestants, 1, 0, (None, 1)),
    ):
        assert make() == make()


@pytest.mark.parametrize(
    ("seconds", "pictures"), [((None, 1), 15), ((1, 2.4), 21), ((-2, None), 30 + 15)]
)
def test_an_excerpt_lasts_as_long_as_was_asked_for(small, seconds, pictures):
    params = small(max_game_frames=200)
    network = untrained(params)
    whole, _ = decoded(play_with_instruments(network, params, "Agent", 1, 0).mp4)
    video = play_with_instruments(network, params, "Agent", 1, 0, seconds)
    part, _ = decoded(video.mp4)
    assert len(part) == pictures
    start = round((seconds[0] or 0) * 15) if (seconds[0] or 0) >= 0 else len(whole) - pictures
    assert np.abs(part[0].astype(int) - whole[start]).mean() < 3


def test_an_excerpt_without_a_picture_is_an_error(small):
    params = small()
    with pytest.raises(ValueError, match="lasts 1"):
        play_with_instruments(untrained(params), params, "Agent", 1, 0, seconds=(60, None))


def test_the_value_stream_is_the_mean_of_the_q_values(small):
    """The dueling network's advantages have mean 0; the others' value is the greatest Q."""
    for agent, reduce in (("dueling_double_dqn", np.mean), ("double_dqn", np.max)):
        params = small(agents=[agent], evaluation_epsilon=0.5)
        recording = module.record(untrained(params), params, seed=1, game=0)
        expected = reduce(recording.q_values, axis=1)
        np.testing.assert_allclose(recording.values, expected, atol=1e-6)
        assert recording.values.std() > 1e-5, "the test would not see a wrong order"


def test_an_agent_has_the_colour_on_video_that_it_has_in_the_figures(small):
    """Lighter, on a dark ground: its hue is the same, and it is that of no other agent."""
    seen = {}
    for agent in AGENTS:
        params = small(agents=[agent], max_game_frames=100)
        poster = image(play_with_instruments(untrained(params), params, "Agent", 1, 0).poster)
        mind = poster[module.TOP + 84 + 46 : -module.MARGIN, module.RIGHT + 150 : -module.MARGIN]
        colours, counts = np.unique(mind.reshape(-1, 3)[:, ::-1], axis=0, return_counts=True)
        vivid = np.ptp(colours.astype(int), axis=1) > 60
        (colour,) = colours[vivid & (counts > 200)]  # the bar of the chosen action
        seen[agent] = tuple(colour)
        wanted = colorsys.rgb_to_hsv(*plots.STYLES[agent].colour)
        assert colorsys.rgb_to_hsv(*colour / 255)[0] == pytest.approx(wanted[0], abs=0.01)
    assert len(set(seen.values())) == len(AGENTS)


def test_one_agent_at_two_stages_is_drawn_in_two_shades_and_two_agents_in_their_own_colours(small):
    recordings = {
        agent: module.record(untrained(params), params, 1, 0)
        for agent in ("dqn", "double_dqn")
        for params in [small(agents=[agent], max_game_frames=40)]
    }
    assert module._looks(recordings) == [plots.STYLES["dqn"], plots.STYLES["double_dqn"]]
    one = recordings["dqn"]
    early, late = module._looks({"100 games": one, "500 games": one})
    assert {early.colour, late.colour}.isdisjoint({look.colour for look in plots.STYLES.values()})
    assert early.colour != late.colour
    assert early.line != late.line


def test_most_of_a_strip_are_its_pictures(small):
    params = small(max_game_frames=200)
    video = play_with_instruments(untrained(params), params, "Agent", 1, 0)
    shown = image(video.strip).astype(int)
    green = shown[:, :, 1] > shown[:, :, 2] + 20  # the ring, which the curves are not drawn on
    places = np.flatnonzero(green.mean(axis=0) > 0.3)
    wide = np.split(places, np.flatnonzero(np.diff(places) > 10) + 1)
    assert len(wide) == module.MOMENTS[0]
    assert min(map(len, wide)) / 200 * 2.54 > 3  # centimetres
    assert green.mean() > 0.36


def test_three_contestants_play_until_the_last_has_finished(small):
    lengths = (100, 160, 240)
    contestants = {}
    for agent, frames in zip(AGENTS, lengths, strict=True):
        params = small(agents=[agent], max_game_frames=frames, evaluation_epsilon=0.5)
        contestants[agent] = (untrained(params), params)
    video = side_by_side(contestants, 1, 0)
    pictures, _ = decoded(video.mp4)
    assert len(pictures) == max(game.length for game in video.games) + 1 + 15
    for (network, params), recorded in zip(contestants.values(), video.games, strict=True):
        assert [recorded] == list(play(player_of(network, params), params, 1, seed=1))
    bright = [[picture[48:330, x : x + 218].mean() for x in (16, 250, 484)] for picture in pictures]
    for column, game in enumerate(video.games):
        during, after = bright[game.length - 1][column], bright[game.length][column]
        assert after < during / 2, "dimmed once its game is over"
    assert all(image(png).shape[1] >= module.WIDTH for png in (video.poster, video.strip))


def test_beside_a_video_with_a_layer_lies_the_same_in_grey_under_its_light(small):
    params = small(evaluation_epsilon=1.0)
    network, given = untrained(params), []

    def layer(observations):
        given.append(observations)
        light = np.zeros((*observations.shape[:3], 3), np.uint8)
        light[:, :42, :, 2] = 255  # blue, over the upper half
        return light

    plain, _ = decoded(play_with_instruments(network, params, "Agent", 1, 0, (1, None)).mp4)
    video = play_with_instruments(network, params, "Agent", 1, 0, (1, None), layer)
    assert video == play_with_instruments(network, params, "Agent", 1, 0, (1, None), layer)
    pictures, _ = decoded(video.mp4)
    assert pictures.shape == (*plain.shape[:2], 2 * module.WIDTH, 3)
    # Every eighth picture will do; the last two of these are of those that are held at the end
    plain, pictures = (every[::-8][::-1].astype(np.int16) for every in (plain, pictures))
    left, right = pictures[:, :, : module.WIDTH], pictures[:, :, module.WIDTH :]
    assert np.abs(left - plain).mean() < 3
    screen = slice(module.MARGIN, module.MARGIN + 320)
    middle, bottom = module.TOP + 210, module.TOP + 420  # of the television's picture
    under, over = right[:-2, middle + 8 : bottom, screen], right[:, module.TOP : middle, screen]
    assert np.ptp(under.astype(int), axis=3).mean() < 6, "grey"
    grey = left[:-2, middle + 8 : bottom, screen] @ [0.299, 0.587, 0.114]
    assert np.abs(under.mean(axis=3) - module.DUSK * grey).mean() < 6, "and darker"
    red, _, blue = over[:, :-10].mean(axis=(0, 1, 2))
    assert blue > 240
    assert red < 120
    beside = slice(module.RIGHT, None)
    assert np.abs(right[:, :, beside].astype(int) - left[:, :, beside]).mean() < 3
    assert image(video.poster).shape == pictures.shape[1:]
    strip = image(video.strip).astype(int)
    green = strip[:, :, 1] > strip[:, :, 2] + 20
    assert green.mean() < 0.01, "on paper the pictures have the layer"

    table = module.EpisodeInProgress(params)
    table.replay(video.games[0].record)
    seen = [table.planes.copy()]
    for action in video.games[0].record.actions:
        table.step(action)
        seen.append(table.planes.copy())
    assert (given[0] == np.stack(seen[15:]).reshape(-1, 4, 84, 84).transpose(0, 2, 3, 1)).all()


def test_what_plays_one_video_plays_one_twice_as_wide(small):
    params = small(max_game_frames=40)
    network = untrained(params)
    levels = [
        video.mp4[video.mp4.index(b"avcC") + 7]  # of H.264, ten times; in the stream's description
        for layer in (None, lambda seen: np.zeros((len(seen), 84, 84, 3), np.uint8))
        for video in [play_with_instruments(network, params, "Agent", 1, 0, layer=layer)]
    ]
    assert max(levels) <= 41


def test_contestants_must_keep_the_same_time(small):
    contestants = {}
    for skip in (4, 5):
        params = small(frame_skip=skip)
        contestants[f"every {skip} frames"] = (untrained(params), params)
    with pytest.raises(ValueError, match="equally many frames"):
        side_by_side(contestants, 1, 0)


def test_action_names_are_words():
    names = ["NOOP", "FIRE", "UP", "UPRIGHTFIRE", "DOWNLEFT"]
    assert [module.words(name) for name in names] == [
        "noop",
        "fire",
        "up",
        "up right fire",
        "down left",
    ]


@pytest.fixture
def instruments(small, monkeypatch):
    """A stage with a game by hand, of 1,000 steps of which each is a fifteenth of a second, and the
    texts that are written on it. The third action is the best, and the fifth the worst; two points
    are scored at step 950, and three conceded at 970."""
    texts = []
    monkeypatch.setattr(module, "_write", lambda view, text, *_, **how: texts.append(text))

    def of(knockout=0, chosen=3):
        q_values = np.zeros((1000, 18), np.float32)
        q_values[:, 3], q_values[:, 5] = 1, -1
        scores = np.repeat([0.0, 2.0, -1.0], [950, 20, 31])
        game = module.Recording(
            small(), SimpleNamespace(knockout=knockout), "max Q",
            np.full(1000, chosen), q_values, np.linspace(0, 1, 1000), scores,
        )  # fmt: skip
        return module.Stage({"Agent": game}), texts

    return of


SCREEN, PLANES = np.zeros((210, 160, 3), np.uint8), np.zeros((4, 84 * 84), np.uint8)


def test_under_the_picture_stand_score_clock_and_value_of_that_step(instruments):
    stage, texts = instruments()
    (column,) = stage.columns
    for step, said in ((949, "score 0"), (950, "score 2"), (990, "score −1")):
        column.draw(SCREEN, step)
        assert said in texts[-4:]
    assert texts[-3] == "1:06"
    assert float(texts[-1]) == pytest.approx(990 / 999, abs=0.01)


def test_points_are_marked_above_the_trace_and_those_of_the_rival_below(instruments):
    stage, _ = instruments()
    (column,) = stage.columns
    column.draw(SCREEN, 990)
    plot = column.trace[:, column.left :]
    height, width, _ = plot.shape
    scored, conceded = (width - 3 - module.PACE * (990 - step) for step in (950, 970))
    above, below = plot[4], plot[height - 5]
    assert [tuple(above[x]) for x in (scored, conceded)] == [module.INK, module.PANEL]
    assert [tuple(below[x]) for x in (scored, conceded)] == [module.PANEL, module.SOFT]


@pytest.mark.parametrize(
    ("knockout", "said"), [(1, "knock-out"), (0, "finished"), (-1, "knocked out")]
)
def test_at_its_end_a_game_says_who_was_knocked_out(instruments, knockout, said):
    stage, texts = instruments(knockout)
    (column,) = stage.columns
    column.draw(SCREEN, 999)
    assert said not in texts
    column.draw(SCREEN, 1000)
    assert said in texts


@pytest.mark.parametrize("chosen", [3, 5])
def test_a_bar_goes_to_the_right_if_its_action_is_better_than_the_mean(instruments, chosen):
    stage, texts = instruments(chosen=chosen)
    mind = stage.mind
    mind.draw(PLANES, 500)
    middle = mind.left + mind.reach

    def beside(row):
        place = row * mind.pitch + mind.pitch // 2
        return tuple(mind.bars[place, middle - 10]), tuple(mind.bars[place, middle + 10])

    # the best is in the agent's colour if it is chosen; a worse one is chosen at random, and white
    best, worst = (mind.game.colour, module.BAR) if chosen == 3 else (module.BAR, module.INK)
    assert beside(3) == (module.PANEL, best)
    assert beside(5) == (worst, module.PANEL)
    assert beside(7) == (module.PANEL, module.PANEL)
    assert ("random" in texts) == (chosen == 5)
