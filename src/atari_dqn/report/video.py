"""Videos of greedy games with live instruments: what the network sees, and what it makes of it.

A game is played once to record it, exactly as `evaluation.play` does, so that it is the game of
evaluations.csv. Then the emulator alone plays the recorded actions again while the pictures are
drawn: by then the game's length and the range of its values are known, and no picture need be kept.

Canvases are uint8 [height, width, 3]; places on them are pixels from the upper left corner.
"""

import io
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import chain, cycle, islice
from pathlib import Path

import av
import cv2
import matplotlib as mpl
import numpy as np
import torch
from av.video.reformatter import ColorRange, Colorspace
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image, ImageDraw, ImageFont
from torch import nn

from atari_dqn.envs import SIZE, AtariEnv, interleave, make_env
from atari_dqn.evaluation import EpisodeInProgress, EvaluationEpisode, player_of, q_of
from atari_dqn.networks import DuelingNetwork
from atari_dqn.params import Parameters
from atari_dqn.report import plots
from atari_dqn.schedules import epsilon_greedy

Seconds = tuple[float | None, float | None]  # of the game, as in a slice: (None, 10), (-12, None)
Colour = tuple[int, int, int]  # red, green, blue
# From the observations that a video shows, uint8 [N, 84, 84, stack], to light that lies over their
# pictures, uint8 [N, 84, 84, 3]
Layer = Callable[[np.ndarray], np.ndarray]

WIDTH, MARGIN, TOP = 720, 16, 48  # pixels; the television pictures begin at TOP
RIGHT, GAP = 352, 4  # pixels; the right column of a video with instruments, between its images
PACE = 2  # pixels a trace moves on every step; whole, so that the encoder can copy what was there
MOMENTS = 4, 5  # pictures of a game in a strip: of one or two games; of more, smaller ones

GROUND, PANEL, RULE = (20, 23, 26), (34, 38, 42), (70, 76, 82)
INK, SOFT, BAR = (238, 240, 241), (170, 178, 184), (118, 126, 133)
WHITE_IN = 0.3  # of an agent's colour, so that it holds its own on a dark ground
DUSK = 0.6  # of a picture's brightness, so that light over it can be seen

# The pictures are flat and mostly still, and what flickers keeps returning to how it was before:
# key pictures may be rare, and many earlier pictures are worth remembering.
ENCODER = {"preset": "slow", "tune": "animation", "crf": "30", "g": "600"}
ENCODER |= {"chromaoffset": "-4"}  # else grey keeps a tinge of the colours that were there
if torch.backends.cpu.get_cpu_capability() == "AVX512":
    ENCODER |= {"x264-params": "asm=AVX2"}  # x264's AVX-512 code gives other bytes now and then
REMEMBERED = 16, 32768  # earlier pictures, and squares of 16 pixels in them, that players remember


@dataclass(frozen=True)
class Video:
    """A video, and what stands for it where it cannot be played.

    One with a layer is twice as wide: without it, and beside that with it.
    """

    mp4: bytes  # H.264: a picture an agent step; the game's last is held for a second
    poster: bytes  # PNG, a telling picture of it
    strip: bytes  # PNG for paper: evenly spaced moments, and the values from first to last
    games: tuple[EvaluationEpisode, ...]  # one a contestant


def play_with_instruments(
    network: nn.Module,
    params: Parameters,
    title: str,
    seed: int,
    game: int,
    seconds: Seconds = (None, None),
    layer: Layer | None = None,
) -> Video:
    """Plays game number `game` as `evaluation.play` would, and records it with its instruments.

    `seconds` cuts an excerpt. A `layer` is drawn in a second copy of the picture beside it.
    """
    return _video({title: record(network, params, seed, game)}, seconds, layer)


def side_by_side(
    contestants: dict[str, tuple[nn.Module, Parameters]],
    seed: int,
    game: int,
    seconds: Seconds = (None, None),
) -> Video:
    """Lets every contestant (by name) play the same game, and records them side by side.

    The video is as long as the longest game; the others wait with their last pictures, dimmed.
    """
    recordings = {
        name: record(network, params, seed, game) for name, (network, params) in contestants.items()
    }
    return _video(recordings, seconds)


@dataclass(frozen=True)
class Recording:
    """A game of T steps, A actions, and what a network made of it."""

    params: Parameters
    result: EvaluationEpisode
    symbol: str  # what `values` are: V(s) or max Q
    actions: np.ndarray  # int [T]
    q_values: np.ndarray  # float32 [T, A]
    values: np.ndarray  # float [T]
    scores: np.ndarray  # points, float [T + 1]: before every step, and at the end
    otherwise: str = "random"  # what an action is that is not the best one

    @property
    def agent(self) -> str:
        return self.params.agents[0]

    @property
    def colour(self) -> Colour:
        """The agent's, as in all figures, for a dark ground."""
        red, green, blue = (
            round(255 * (share + (1 - share) * WHITE_IN))
            for share in plots.STYLES[self.agent].colour
        )
        return red, green, blue

    @property
    def rate(self) -> Fraction:
        """Steps a second."""
        return Fraction(60, self.params.frame_skip)

    def replay(self) -> Iterator[EpisodeInProgress]:
        """The game before every step, and at the end."""
        episode = EpisodeInProgress(self.params)
        episode.replay(self.result.record)
        yield episode
        for action in self.actions:
            episode.step(int(action))
            yield episode


class Critic:
    """What a network makes of what it sees: the value of every action, and of the state."""

    def __init__(self, network: nn.Module, params: Parameters):
        self.agents = params.agents  # its own is the first
        self.network, self.player = network, player_of(network, params)
        self.stream = network.value_output if isinstance(network, DuelingNetwork) else None
        self.symbol = "V(s)" if self.stream else "max Q"

    def __call__(self, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Q-values float32 [N, A] of observations (uint8 [stack, N, 84*84]), and the values float32
        [N]: what the value stream of a dueling network says, else the greatest Q-values."""
        q_values = q_of(self.player, planes)
        if self.stream is None:
            return q_values, q_values.max(axis=1)
        said: list[torch.Tensor] = []
        device = next(self.network.parameters()).device
        with (
            torch.no_grad(),
            self.stream.register_forward_hook(lambda *call: said.append(call[2])),
        ):
            self.network(torch.from_numpy(interleave(planes)).to(device))
        return q_values, said[0][:, 0].cpu().numpy()


def record(network: nn.Module, params: Parameters, seed: int, game: int) -> Recording:
    """Plays game number `game` as `evaluation.play` would."""
    episode, ended = EpisodeInProgress(params), False
    episode.start(game, seed)
    critic = Critic(network, params)
    decisions, scores = [], [0.0]
    while not ended:
        q_values, values = critic(episode.planes[:, None])
        action = int(epsilon_greedy(q_values, params.evaluation_epsilon, episode.rng)[0])
        ended = episode.step(action)
        decisions.append((action, q_values[0], float(values[0])))
        scores.append(episode.env.score)
    arrays = (np.array(column) for column in (*zip(*decisions, strict=True), scores))
    return Recording(params, episode.result(seed), critic.symbol, *arrays)


def _video(recordings: dict[str, Recording], seconds: Seconds, layer: Layer | None = None) -> Video:
    """A video of one game with its instruments and perhaps a layer, or of several side by side."""
    games = list(recordings.values())
    rate, longest = games[0].rate, max(len(game.actions) for game in games)
    if any(game.rate != rate for game in games):
        raise ValueError("contestants must hold their actions for equally many frames")
    bounds = (None if second is None else round(second * rate) for second in seconds)
    steps = range(*slice(*bounds).indices(longest + 1))  # the last one is the end of the game
    if not steps:
        raise ValueError(f"seconds {seconds}: the game lasts {float(longest / rate):.1f} s")
    stage = Stage(recordings)
    poster, poster_step = b"", _telling(games, steps)
    pictures = MOMENTS[len(games) > 2]
    moments = np.linspace(steps[0], steps[-1], pictures).round().astype(int).tolist()
    kept = {}  # the television pictures of the moments
    lights = layer(_seen(games[0], steps)) if layer else None

    def drawn() -> Iterator[np.ndarray]:
        nonlocal poster
        for step in stage.play(steps):
            canvas = stage.canvas
            if lights is not None:
                plain = canvas.copy()
                stage.columns[0].shine(lights[step - steps[0]])
                canvas = np.hstack([plain, canvas])
            if step == poster_step:
                smallest = [cv2.IMWRITE_PNG_COMPRESSION, 9]
                poster = cv2.imencode(".png", canvas[:, :, ::-1], smallest)[1].tobytes()
            if step in moments:
                kept[step] = [column.picture for column in stage.columns]
            for _ in range(1 + round(rate) if step == longest else 1):
                yield canvas

    mp4 = _encoded(drawn(), rate)
    strip = _strip(recordings, kept, steps)
    return Video(mp4, poster, strip, tuple(game.result for game in games))


def _seen(game: Recording, steps: range) -> np.ndarray:
    """The observations at some steps of a game, uint8 [steps, 84, 84, stack]."""
    replayed = islice(game.replay(), steps.start, steps.stop)
    return interleave(np.stack([episode.planes.copy() for episode in replayed], axis=1))


def television(games: Iterator[AtariEnv]) -> bytes:
    """MP4 of what the television shows of a game that is being played, three times as large."""
    game = next(games)

    def drawn() -> Iterator[np.ndarray]:
        for now in chain([game], games):
            yield now.render().repeat(3, axis=0).repeat(3, axis=1)

    return _encoded(drawn(), Fraction(60, game.frame_skip))


def _encoded(pictures: Iterator[np.ndarray], rate: Fraction) -> bytes:
    """MP4 (H.264) of pictures uint8 [height, width, 3], `rate` a second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "video.mp4")  # a file, as its index is moved to the front in the end
        with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
            stream = container.add_stream("libx264", rate=rate)
            stream.pix_fmt = "yuv420p"
            stream.codec_context.thread_count = 1  # the same bytes every time
            stream.codec_context.colorspace = Colorspace.ITU709
            stream.codec_context.color_range = ColorRange.MPEG
            for number, picture in enumerate(pictures):
                if number == 0:
                    stream.height, stream.width, _ = picture.shape
                    squares = -(-stream.height // 16) * -(-stream.width // 16)
                    refs = min(REMEMBERED[0], REMEMBERED[1] // squares)  # level 4.1 of H.264
                    stream.codec_context.options = {**ENCODER, "refs": str(refs)}
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                frame = frame.reformat(
                    format="yuv420p", dst_colorspace=Colorspace.ITU709, threads=1
                )
                frame.pts = None  # the next one
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        return path.read_bytes()


def _telling(games: list[Recording], steps: range) -> int:
    """The step, in the later half, at which the choice of an action matters most to them all."""
    common = min(len(game.actions) for game in games)  # when the first of them ends
    first = min((steps[0] + steps[-1]) // 2, common - 1)
    last = max(first + 1, min(steps.stop, common))
    spreads = sum(np.ptp(game.q_values[first:last], axis=1) for game in games)
    return max(steps[0], first + int(np.argmax(spreads)))


class Stage:
    """A canvas with a column per game, and for a single one its network's mind beside it."""

    def __init__(self, recordings: dict[str, Recording]):
        games = list(recordings.values())
        width = min(320, (WIDTH - MARGIN) // len(games) - MARGIN)
        height = TOP + width * 210 // 160 + 148
        self.canvas = np.full((height + height % 2, WIDTH, 3), GROUND, np.uint8)  # H.264: even
        self.columns = [
            _Column(self.canvas[:, x : x + width], name, recordings)
            for name, x in zip(recordings, range(MARGIN, WIDTH, width + MARGIN), strict=False)
        ]
        single = len(games) == 1
        self.mind = _Mind(self.canvas[:, RIGHT:-MARGIN], games[0]) if single else None

    def play(self, steps: range) -> Iterator[int]:
        """Plays the games to the end of `steps`, and draws these."""
        replays = [column.game.replay() for column in self.columns]
        for step in range(steps.stop):
            for column, replay in zip(self.columns, replays, strict=True):
                last = len(column.game.actions)
                if step > last:
                    continue  # it waits
                episode = next(replay)
                if step in steps or step == last:
                    column.draw(episode.env.render(), step)
                    if self.mind is not None:
                        self.mind.draw(episode.planes, step)
            if step in steps:
                yield step


class _Column:
    """A game's name, television, score, clock and the trace of its value.

    All traces of a video have the same axis throughout. Triangles are points: upright ones at the
    top won, inverted ones at the bottom lost.
    """

    def __init__(self, view: np.ndarray, name: str, recordings: dict[str, Recording]):
        self.view, self.game = view, recordings[name]
        width, self.colour = view.shape[1], self.game.colour
        _write(view, name, 0, 34, 19, self.colour, bold=True)
        self.screen = view[TOP : TOP + width * 210 // 160]
        self.under = view[self.screen.shape[0] + TOP :]  # score, clock and value, then the trace
        values = np.concatenate([game.values for game in recordings.values()])
        self.low, self.high = float(values.min()), float(values.max())
        self.trace = self.under[72:136]
        self.ground = np.full_like(self.trace, GROUND)
        ticks = MaxNLocator(2, steps=[1, 2, 5, 10]).tick_values(self.low, self.high)
        self.high = max(self.high, self.low + 1e-6)
        self.decimals = min(3, max(0, 1 - int(np.floor(np.log10(self.high - self.low)))))
        ticks = [tick for tick in ticks if self.low <= tick <= self.high]
        labels = {_number(tick): tick for tick in (*ticks[:1], *ticks[-1:])}
        self.left = 8 + max((_glyphs(label, 15).shape[1] for label in labels), default=0)
        self.seconds = (width - self.left) / PACE / float(self.game.rate)
        self.ground[:, self.left :] = PANEL
        for label, tick in labels.items():
            y = round(self._y(tick))
            self.ground[y, self.left :] = RULE
            _write(self.ground, label, self.left - 6, y + 5, 15, SOFT, align=1)

    def _y(self, value: np.ndarray | float) -> np.ndarray | float:
        """The row of a value (or several); the edges are for the marks of points."""
        return 12 + (self.high - value) / (self.high - self.low) * (self.trace.shape[0] - 25)

    def draw(self, screen: np.ndarray, step: int) -> None:
        """Draws a step; `screen` is the television's picture, uint8 [210, 160, 3]."""
        game, width = self.game, self.view.shape[1]
        size, doubled = self.screen.shape[1::-1], screen.repeat(2, 0).repeat(2, 1)
        self.picture = cv2.resize(doubled, size, interpolation=cv2.INTER_AREA)
        self.screen[:] = self.picture
        now = min(step, len(game.actions) - 1)  # at the end, the last decision stays
        if step > now:
            self.screen[:] //= 3
            said = {1: "knock-out", 0: "finished", -1: "knocked out"}[game.result.knockout]
            _write(self.screen, said, width // 2, self.screen.shape[0] // 2, 26, INK, True, 0.5)
        self.under[:72] = GROUND
        minutes, seconds = divmod(int(step / game.rate), 60)
        _write(self.under, f"score {_number(game.scores[step])}", 0, 30, 22, INK, bold=True)
        _write(self.under, f"{minutes}:{seconds:02}", width, 30, 18, SOFT, align=1)
        _write(self.under, f"{game.symbol}, last {self.seconds:.0f} s", 0, 62, 16, SOFT)
        value = _number(game.values[now], self.decimals)
        _write(self.under, value, width, 62, 18, self.colour, bold=True, align=1)
        self._draw_trace(now)

    def shine(self, light: np.ndarray) -> None:
        """Lays light, uint8 [84, 84, 3], over the step that has been drawn, which becomes grey and
        darker: on a ground of colours it could not be told from these."""
        height, width, _ = self.screen.shape
        clear = 1 - cv2.resize(light, (width, height), interpolation=cv2.INTER_CUBIC) / 255
        for drawn in (self.picture, self.screen):
            grey = cv2.cvtColor(drawn, cv2.COLOR_RGB2GRAY)[:, :, None] * DUSK
            drawn[:] = np.rint(255 - (255 - grey) * clear)

    def _draw_trace(self, step: int) -> None:
        plot = self.ground[:, self.left :].copy()
        height, width, _ = plot.shape
        first = max(0, step - width // PACE)
        x = width - 3 - PACE * (step - np.arange(first, step + 1))
        gains = np.diff(self.game.scores, prepend=0.0)[first : step + 1]
        for at, gain in zip(x[gains != 0], gains[gains != 0], strict=True):
            base, tip = (8, 0) if gain > 0 else (height - 9, height - 1)
            corners = np.array([(at - 5, base), (at + 5, base), (at, tip)])
            cv2.fillConvexPoly(plot, corners, INK if gain > 0 else SOFT, cv2.LINE_AA)
        points = np.stack([x, self._y(self.game.values[first : step + 1])], axis=1)
        points = np.rint(points * 16).astype(np.int32)  # sixteenths of a pixel: shift=4
        cv2.polylines(plot, [points], False, self.colour, 2, cv2.LINE_AA, shift=4)
        self.trace[:] = self.ground
        self.trace[:, self.left :] = plot


class _Mind:
    """The observation, and the Q-value of every action as a bar from their mean.

    Q-values of one state differ far less than those of different states; for a dueling network
    the bars are its advantages A(s, a). The chosen action has the agent's colour. One that was
    chosen at random instead of a better one is white, and stays marked for half a second. A bar
    with a white end is cut short.
    """

    def __init__(self, view: np.ndarray, game: Recording):
        self.game = game
        self.side = min(SIZE, view.shape[1] // game.params.frame_stack - GAP)
        _write(view, "what the network sees", 0, 34, 16, SOFT)
        _write(view, "action values, relative to mean", 0, TOP + SIZE + 34, 16, SOFT)
        self.images = view[TOP : TOP + self.side]
        self.bars = view[TOP + SIZE + 46 : -MARGIN]
        means = game.q_values.mean(axis=1, keepdims=True)
        # A few outliers would make all other bars short: they are cut at the panel's edge instead.
        full = max(1e-6, float(np.quantile(np.abs(game.q_values - means).max(axis=1), 0.98)))
        self.shares = (game.q_values - means) / full
        _write(view, f"±{full:.2g}", view.shape[1], TOP + SIZE + 34, 16, SOFT, align=1)
        self.random = game.actions != game.q_values.argmax(axis=1)
        self.names = [words(action.name) for action in make_env(game.params).actions]
        self.pitch = min(60, self.bars.shape[0] // len(self.names))
        self.left = 10 + max(_glyphs(name, 17).shape[1] for name in self.names)
        self.reach = (view.shape[1] - self.left) // 2
        self.ground = np.full_like(self.bars, GROUND)
        panel = self.ground[: len(self.names) * self.pitch, self.left :]
        panel[:] = PANEL
        panel[:, self.reach] = SOFT
        for row, name in enumerate(self.names):
            _write(self.ground, name, self.left - 8, self._baseline(row), 17, SOFT, align=1)

    def _baseline(self, row: int) -> int:
        return row * self.pitch + self.pitch // 2 + 6

    def draw(self, planes: np.ndarray, step: int) -> None:
        """Draws a step; `planes` are the images of the observation, uint8 [stack, 84*84]."""
        for number, image in enumerate(planes.reshape(-1, SIZE, SIZE)):
            x = number * (self.side + GAP)
            small = cv2.resize(image, (self.side, self.side), interpolation=cv2.INTER_AREA)
            self.images[:, x : x + self.side] = small[:, :, None]
        now = min(step, len(self.game.actions) - 1)
        recent = slice(max(0, now - round(self.game.rate / 2) + 1), now + 1)
        guessed = set(self.game.actions[recent][self.random[recent]].tolist())
        self.bars[:] = self.ground
        middle, inset = self.left + self.reach, max(3, self.pitch // 6)
        for row, share in enumerate(self.shares[now]):
            length = 4 * round(float(np.clip(share, -1, 1)) * self.reach / 4)  # compresses well
            start, end = sorted((middle, middle + length))
            top, bottom = row * self.pitch, (row + 1) * self.pitch
            colour = BAR
            if row == self.game.actions[now]:
                colour = INK if self.random[now] else self.game.colour
                self.bars[top:bottom, : self.left] = GROUND
                at = (self.left - 8, self._baseline(row))
                _write(self.bars, self.names[row], *at, 17, INK, align=1)
            self.bars[top + inset : bottom - inset, start : end + 1] = colour
            if abs(share) > 1:
                tip = slice(start, start + 4) if share < 0 else slice(end - 4, end)
                self.bars[top + inset : bottom - inset, tip] = INK
            if row in guessed:
                at = (self.bars.shape[1] - 6, self._baseline(row))
                _write(self.bars, self.game.otherwise, *at, 17, INK, True, 1)


def words(action: str) -> str:
    """UPRIGHTFIRE is up right fire."""
    for word in ("UP", "DOWN", "LEFT", "RIGHT"):
        action = action.replace(word, f"{word} ")
    return action.lower().strip()


def _number(value: float, decimals: int | None = None) -> str:
    text = f"{value:g}" if decimals is None else f"{value:.{decimals}f}"
    return text.replace("-", "−")


@cache
def _glyphs(text: str, size: int, bold: bool = False) -> np.ndarray:
    """How far a line of text covers its pixels, float32 [height, width, 1]; drawn only once."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    path = Path(mpl.get_data_path(), "fonts", "ttf", name)
    font = ImageFont.truetype(path, size, layout_engine=ImageFont.Layout.BASIC)
    image = Image.new("L", (int(np.ceil(font.getlength(text))), size + size // 3))
    ImageDraw.Draw(image).text((0, size), text, fill=255, font=font, anchor="ls")
    return np.asarray(image, np.float32)[:, :, None] / 255


def _write(
    view: np.ndarray,
    text: str,
    x: int,
    baseline: int,
    size: int,
    colour: Colour,
    bold: bool = False,
    align: float = 0.0,
) -> None:
    """Writes a line, smaller if it would not fit; x is its left end (align 0), middle (0.5) or
    right end (1)."""
    glyphs = _glyphs(text, size, bold)
    if glyphs.shape[1] > view.shape[1]:
        size = size * view.shape[1] // glyphs.shape[1]
        glyphs = _glyphs(text, size, bold)
    x, y = x - round(align * glyphs.shape[1]), max(0, baseline - size)
    area = view[y : y + glyphs.shape[0], x : x + glyphs.shape[1]]
    area[:] = np.rint(area + (np.array(colour) - area) * glyphs[: len(area)])


def _strip(
    recordings: dict[str, Recording], kept: dict[int, list[np.ndarray]], steps: range
) -> bytes:
    """The television pictures in `kept` (by step), above the values of all `steps`."""
    rows, buffer = len(recordings), io.BytesIO()
    left, right, gap = 0.35 if rows == 1 else 0.55, 0.1, 0.08  # inches
    side = (plots.WIDTH - left - right + gap) / len(kept) - gap
    pitch, below = side * 210 / 160 + 0.24, 1.3
    height = 0.25 + rows * pitch + below
    with mpl.rc_context():
        plots.style()
        figure = Figure(figsize=(plots.WIDTH, height), layout="none")

        def place(x: float, y: float, width: float, high: float) -> tuple[float, ...]:
            """Inches as shares of the figure."""
            return x / plots.WIDTH, y / height, width / plots.WIDTH, high / height

        course = figure.add_axes(place(left, 0.47, plots.WIDTH - left - right, 0.5))
        for row, ((name, game), look) in enumerate(
            zip(recordings.items(), _looks(recordings), strict=True)
        ):
            rate, last = float(game.rate), len(game.actions)
            for column, (step, screens) in enumerate(kept.items()):
                x, y = left + column * (side + gap), below + (rows - 1 - row) * pitch + 0.22
                where = place(x, y, side, side * 210 / 160)
                axes = figure.add_axes(where, frame_on=False, xticks=[], yticks=[])
                axes.imshow(screens[row], aspect="auto")
                score = f"score {_number(game.scores[min(step, last)])}"
                axes.set_xlabel(score + ", end" * (step >= last), fontsize="small", labelpad=2)
                if row == 0:
                    axes.set_title(f"{step / rate:.1f} s", fontsize="medium", pad=3)
                if column == 0 and rows > 1:
                    axes.set_ylabel(name, fontsize="medium", color=look.colour)
            shown = np.arange(steps.start, min(steps.stop, last))
            label, how = f"{name}: {game.symbol}", {"color": look.colour, "ls": look.line}
            course.plot(shown / rate, game.values[shown], lw=1.1, label=label, **how)
        for step in kept:
            course.axvline(step / rate, color="0.6", lw=0.8, zorder=0)
        course.set_xlabel("seconds", labelpad=2)
        course.margins(x=0.01)
        course.locator_params(axis="y", nbins=3)
        course.legend(ncols=rows, loc="lower left", bbox_to_anchor=(-0.01, 0.95), fontsize="small")
        figure.savefig(buffer, format="png", dpi=200, metadata={"Software": None})
    return buffer.getvalue()


def _looks(recordings: dict[str, Recording]) -> list[plots.Style]:
    """How each game's values are drawn: as its agent's; of one agent at several stages, as
    shades."""
    agents = [game.agent for game in recordings.values()]
    if len(set(agents)) == len(agents):
        return [plots.STYLES[agent] for agent in agents]
    return [
        plots.Style(shade, line)
        for shade, line in zip(plots.shades(len(agents)), cycle(("--", "-")), strict=False)
    ]
