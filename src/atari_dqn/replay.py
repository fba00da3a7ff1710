"""The replay memory: every image stored once, compressed; transitions sampled uniformly.

Each environment writes its own stream of slots; slot t of a stream holds the image x_t, the action
and reward that led to it, and its age (agent steps since its game began):

    slot      0    1    2    3    4    5    6
    image     x0   x1   x2   x3   y0   y1   y2      a game that ended with x3, then the next one
    age       0    1    2    3    0    1    2
    action    -    a0   a1   a2   -    b0   b1      "-": the restart ignored its action

A transition is named by the slot it ends in, so every slot with age > 0 is one. With a stack of
S images, the transition of slot t needs x_{t-S} to x_t, where an index that would reach across the
start of the game (t - k with k > age) is replaced by the game's first image.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard

from atari_dqn.envs import SIZE, interleave

PIXELS = SIZE * SIZE
SEGMENT = 40 << 20  # bytes


@dataclass(frozen=True)
class Batch:
    """Transitions s_tm1 -a_tm1-> (r_t, s_t), N of them."""

    s_tm1: np.ndarray  # uint8 [N, 84, 84, S]
    a_tm1: np.ndarray  # int64 [N]
    r_t: np.ndarray  # float32 [N]
    discount_t: np.ndarray  # float32 [N], of the value of s_t: gamma, or 0 where the game ended
    s_t: np.ndarray  # uint8 [N, 84, 84, S]


@dataclass(frozen=True)
class Drawn:
    """Transitions of the memory, N of them."""

    slots: np.ndarray  # int64, of the images, oldest first: the first S rows are s_tm1, the last S
    # are s_t; [S+1, N], or with several steps of reward [2S, N]
    a_tm1: np.ndarray  # int64 [N]
    r_t: np.ndarray  # float32 [N]
    discount_t: np.ndarray  # float32 [N]


class ImageCodec:
    """Lossless compression of images that resemble one another.

    The first image is the dictionary of all that follow (zstandard's raw-content dictionary):
    background and lettering then cost almost nothing.
    """

    def __init__(self, first_image: bytes):
        self.first_image = first_image
        dictionary = zstandard.ZstdCompressionDict(
            first_image, dict_type=zstandard.DICT_TYPE_RAWCONTENT
        )
        settings = zstandard.ZstdCompressionParameters.from_level(
            -1, write_content_size=False, write_checksum=False, write_dict_id=False
        )
        self.compress = zstandard.ZstdCompressor(
            dict_data=dictionary, compression_params=settings
        ).compress
        self._decompress = zstandard.ZstdDecompressor(dict_data=dictionary).decompress

    def decompress(self, data: bytes | memoryview) -> bytes:
        return self._decompress(data, max_output_size=PIXELS)


class ImageStore:
    """Compressed images by slot, in a few large segments that are filled one after the other.

    A million small blocks of memory would leave no room between them for a batch's large ones, and
    the process would grow and grow. Slots are written in the order of the ring, so that segments
    empty, and are dropped, in the order in which they were filled.
    """

    def __init__(self, slots: int):
        self.segment = np.zeros(slots, np.int32)  # number of the segment that holds a slot's image
        self.start = np.zeros(slots, np.int32)  # its place there
        self.size = np.zeros(slots, np.int32)  # 0: nothing was written yet
        self.segments: dict[int, Any] = {}  # bytes, or a bytearray of that being filled
        self.held: dict[int, int] = {}  # images a segment holds
        self.newest, self.end = -1, SEGMENT

    def __setitem__(self, slot: int, data: bytes) -> None:
        if self.size[slot]:
            self._forget(int(self.segment[slot]))
        if self.end + len(data) > SEGMENT:
            self.newest, self.end = self.newest + 1, 0
            self.segments[self.newest], self.held[self.newest] = bytearray(SEGMENT), 0
        self.segments[self.newest][self.end : self.end + len(data)] = data
        self.segment[slot], self.start[slot], self.size[slot] = self.newest, self.end, len(data)
        self.held[self.newest] += 1
        self.end += len(data)

    def _forget(self, segment: int) -> None:
        self.held[segment] -= 1
        if self.held[segment] == 0 and segment != self.newest:
            del self.segments[segment], self.held[segment]

    def read(self, slots: np.ndarray) -> list[memoryview]:
        """The compressed images of slots [N]."""
        views = {number: memoryview(data) for number, data in self.segments.items()}
        places = (self.segment[slots], self.start[slots], self.start[slots] + self.size[slots])
        return [
            views[segment][start:end]
            for segment, start, end in zip(*(place.tolist() for place in places), strict=True)
        ]

    def get_state(self, oldest_first: np.ndarray) -> dict[str, Any]:
        """The images of the given slots, in the order in which they were written."""
        pieces = []
        segments = self.segment[oldest_first]
        for number in np.unique(segments).tolist():
            slots = oldest_first[segments == number]
            start, last = int(self.start[slots[0]]), int(slots[-1])
            end = int(self.start[last] + self.size[last])
            pieces.append(bytes(memoryview(self.segments[number])[start:end]))
        return {"pieces": pieces, "sizes": self.size[oldest_first]}

    def set_state(self, state: dict[str, Any], oldest_first: np.ndarray) -> None:
        """Restores what `get_state` returned, into an empty store: a piece becomes a segment."""
        self.size[oldest_first] = state["sizes"]
        ends = np.cumsum(state["sizes"], dtype=np.int64)
        starts = ends - state["sizes"]
        begins = np.cumsum([0, *(len(piece) for piece in state["pieces"])])
        number = np.searchsorted(begins, starts, side="right") - 1
        self.segment[oldest_first], self.start[oldest_first] = number, starts - begins[number]
        self.segments = dict(enumerate(state["pieces"]))
        self.held = dict(enumerate(np.bincount(number, minlength=len(self.segments)).tolist()))
        self.newest, self.end = len(self.segments) - 1, SEGMENT  # the next write begins another


class ReplayMemory:
    """A ring of `capacity` slots, shared equally by `streams` environments. `gamma` is the
    discount of a step; a game that was merely cut goes on, as far as it is concerned.

    With `n_steps` above 1 a transition spans so many steps, or fewer where its game ends or the
    memory does: s_t is the last step's, r_t the discounted sum of their rewards (Sutton, 1988).

    Sampling from it before it holds a transition raises ValueError.
    """

    def __init__(
        self,
        capacity: int,
        streams: int,
        stack: int,
        gamma: float,
        seed: np.random.SeedSequence,
        n_steps: int = 1,
    ):
        self.n_steps = n_steps
        self.rows, self.streams, self.stack = capacity // streams, streams, stack
        self.gamma = gamma
        self.rng = np.random.default_rng(seed)
        self.codec: ImageCodec | None = None
        self.frames = ImageStore(self.rows * streams)
        shape = (self.rows, streams)
        self.ages = np.zeros(shape, np.int32)
        self.actions = np.zeros(shape, np.uint8)
        self.rewards = np.zeros(shape, np.float32)
        self.terminated = np.zeros(shape, bool)
        self.row = 0  # the next one to be written
        self.full = False

    def __len__(self) -> int:
        """Slots written so far."""
        return (self.rows if self.full else self.row) * self.streams

    def append(
        self,
        images: np.ndarray,
        ages: np.ndarray,
        actions: np.ndarray,
        rewards: np.ndarray,
        terminated: np.ndarray,
    ) -> None:
        """Writes one slot a stream: images uint8 [streams, 84*84], the rest [streams]."""
        self._store(images)
        self.ages[self.row] = ages
        self.actions[self.row] = actions
        self.rewards[self.row] = rewards
        self.terminated[self.row] = terminated
        self.row += 1
        if self.row == self.rows:
            self.row, self.full = 0, True

    def sample(self, count: int) -> Batch:
        """`count` transitions, drawn uniformly and independently.

        They are drawn from all, but in a full ring never from the `stack` oldest rows, not even
        where a young game's transition there is whole.
        """
        drawn = self.draw(count)
        images = self._images(drawn.slots)
        return Batch(
            s_tm1=interleave(images[: self.stack]),
            a_tm1=drawn.a_tm1,
            r_t=drawn.r_t,
            discount_t=drawn.discount_t,
            s_t=interleave(images[-self.stack :]),
        )

    def draw(self, count: int) -> "Drawn":
        """The same transitions, their images by slot."""
        rows, streams = self._draw(count)
        ages = self.ages[rows, streams]
        rewards, steps = self.rewards[rows, streams], np.ones(count, np.int64)
        for step in range(1, self.n_steps):
            goes_on = self._goes_on(rows, streams, step)
            following = self.rewards[(rows + step) % self.rows, streams]
            rewards = rewards + np.where(goes_on, np.float32(self.gamma**step) * following, 0)
            steps += goes_on
        last = (rows + steps - 1) % self.rows
        back = np.arange(self.stack, -1, -1)[:, None]  # S, ..., 1, 0 slots back
        slots = (rows - np.minimum(back, ages)) % self.rows * self.streams + streams  # [S+1, N]
        if self.n_steps > 1:
            after = (last - np.minimum(back[1:], ages + steps - 1)) % self.rows
            slots = np.concatenate([slots[:-1], after * self.streams + streams])  # [2S, N]
        ended = self.terminated[last, streams]
        return Drawn(
            slots=slots,
            a_tm1=self.actions[rows, streams].astype(np.int64),
            r_t=rewards.astype(np.float32),
            discount_t=np.where(ended, 0, self.gamma**steps).astype(np.float32),
        )

    def _goes_on(self, rows: np.ndarray, streams: np.ndarray, steps: int) -> np.ndarray:
        """bool [N]: whether the game of each slot goes on for so many steps, in the memory."""
        oldest = self.row if self.full else 0
        place = (rows - oldest) % self.rows + steps
        later = self.ages[(rows + steps) % self.rows, streams]
        return (place < len(self) // self.streams) & (later == self.ages[rows, streams] + steps)

    def _draw(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows and streams of `count` transitions; rejected draws are drawn again."""
        # Counted from the oldest row. In a full ring the first `stack` rows are left out: the
        # images before them are overwritten.
        oldest = self.row if self.full else 0
        first = self.stack if self.full else 0
        last = self.rows if self.full else self.row
        if last < 2:  # the second row is the first to end a transition
            raise ValueError("the replay memory holds no transition yet")
        rows, streams = np.empty(count, np.int64), np.empty(count, np.int64)
        missing = np.arange(count)
        while missing.size:
            rows[missing] = (oldest + self.rng.integers(first, last, missing.size)) % self.rows
            streams[missing] = self.rng.integers(self.streams, size=missing.size)
            missing = missing[self.ages[rows[missing], streams[missing]] == 0]
        return rows, streams

    def _store(self, images: np.ndarray) -> None:
        """Keeps a row of images, uint8 [streams, 84*84]."""
        if self.codec is None:
            self.codec = ImageCodec(images[0].tobytes())
        for stream, image in enumerate(images):
            self.frames[self.row * self.streams + stream] = self.codec.compress(image)

    def _images(self, slots: np.ndarray) -> np.ndarray:
        """Slots [K, N] to images uint8 [K, N, 84*84]."""
        assert self.codec is not None
        decompress = self.codec.decompress
        raw = b"".join([decompress(data) for data in self.frames.read(slots.reshape(-1))])
        return np.frombuffer(raw, np.uint8).reshape(*slots.shape, PIXELS)

    def get_state(self) -> dict[str, Any]:
        """The whole memory: arrays, the random generator's state, and the compressed images."""
        used = self.rows if self.full else self.row
        return {
            "ages": self.ages[:used],
            "actions": self.actions[:used],
            "rewards": self.rewards[:used],
            "terminated": self.terminated[:used],
            "row": self.row,
            "full": self.full,
            "rng": self.rng.bit_generator.state,
            "first_image": self.codec.first_image if self.codec else b"",
            "frames": self.frames.get_state(self._oldest_first()),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores what `get_state` returned."""
        used = len(state["ages"])
        for name in ("ages", "actions", "rewards", "terminated"):
            getattr(self, name)[:used] = state[name]
        self.row, self.full = state["row"], state["full"]
        self.rng.bit_generator.state = state["rng"]
        self.codec = ImageCodec(state["first_image"]) if state["first_image"] else None
        self.frames = ImageStore(self.rows * self.streams)
        self.frames.set_state(state["frames"], self._oldest_first())

    def _oldest_first(self) -> np.ndarray:
        """All slots that are written, in the order of writing."""
        written = np.arange(len(self))
        return np.roll(written, -self.row * self.streams) if self.full else written
