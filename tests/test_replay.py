"""The compressed ring against a naive memory that keeps every observation whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atari_dqn import replay
from atari_dqn.replay import PIXELS, ImageCodec, ReplayMemory


@pytest.fixture(autouse=True)
def _short_segments(monkeypatch):
    monkeypatch.setattr(replay, "SEGMENT", 200)  # nine images, so that segments are freed


def picture(number):
    """An image that no other number has."""
    image = np.full(PIXELS, number % 251, np.uint8)
    image[:4] = np.frombuffer(np.uint32(number).tobytes(), np.uint8)
    return image


class NaiveMemory:
    """Keeps whole observations of every stream; forgets what needs an overwritten image."""

    def __init__(self, rows, stack):
        self.rows, self.stack = rows, stack
        self.streams = {}

    def append(self, stream, image, begins, action, reward, terminated):
        slots = self.streams.setdefault(stream, [])
        observation = [image] * self.stack
        if not begins:
            observation = [*slots[-1]["observation"][1:], image]
        slots.append(
            {
                "observation": observation,
                "begins": begins,
                "transition": (action, reward, terminated),
            }
        )

    def transitions(self, n_steps=1, gamma=0.9):
        """{(stream, slot): (s_tm1, a, r, discount, s_t)} of what a full ring still holds."""
        found = {}
        for stream, slots in self.streams.items():
            written = len(slots)
            # a full ring still has `rows` images; the first `stack` slots lack some of theirs
            first = 0 if written < self.rows else written - self.rows + self.stack
            for number in range(max(1, first), written):
                slot = slots[number]
                if slot["begins"]:
                    continue
                spanned = [slot]
                for later in slots[number + 1 : number + n_steps]:
                    if later["begins"]:
                        break
                    spanned.append(later)
                action, _, _ = slot["transition"]
                reward = sum(
                    gamma**power * each["transition"][1] for power, each in enumerate(spanned)
                )
                ended = spanned[-1]["transition"][2]
                discount = 0 if ended else gamma ** len(spanned)
                before, after = slots[number - 1]["observation"], spanned[-1]["observation"]
                found[stream, number] = (before, action, reward, discount, after)
        return found


def fill(memory, naive, lengths, steps, rng):
    """Writes `steps` rows of games whose lengths are drawn from `lengths`."""
    streams = memory.streams
    ages, left = np.zeros(streams, int), rng.choice(lengths, streams)
    for number in range(steps):
        begins = (ages > left) | (number == 0)
        ages = np.where(begins, 0, ages)
        left = np.where(begins, rng.choice(lengths, streams), left)
        images = np.stack([picture(number * streams + stream) for stream in range(streams)])
        actions = rng.integers(18, size=streams)
        rewards = rng.integers(-1, 2, size=streams).astype(np.float32)
        terminated = (ages == left) & (rng.random(streams) < 0.5)
        memory.append(images, ages, actions, rewards, terminated)
        for stream in range(streams):
            naive.append(
                stream,
                images[stream],
                begins[stream],
                actions[stream],
                rewards[stream],
                terminated[stream],
            )
        ages = ages + 1


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(8, 30),
    streams=st.integers(1, 3),
    stack=st.integers(1, 4),
    lengths=st.lists(st.integers(1, 12), min_size=1, max_size=4),
    steps=st.integers(3, 80),
    n_steps=st.integers(1, 5),
    seed=st.integers(0, 2**31),
)
def test_samples_equal_a_naive_memorys_wrap_around_included(
    rows, streams, stack, lengths, steps, n_steps, seed
):
    sequence = np.random.SeedSequence(seed)
    memory = ReplayMemory(rows * streams, streams, stack, 0.9, sequence, n_steps)
    naive = NaiveMemory(rows, stack)
    fill(memory, naive, lengths, steps, np.random.default_rng(seed))
    expected = naive.transitions(n_steps)
    state = memory.rng.bit_generator.state
    drawn_rows, drawn_streams = memory._draw(200)
    memory.rng.bit_generator.state = state
    batch = memory.sample(200)
    newest = steps - 1
    for index in range(200):
        # the number of the slot that this row holds now
        number = newest - (newest - int(drawn_rows[index])) % rows
        before, action, reward, discount, after = expected[int(drawn_streams[index]), number]
        stacked = np.stack(before, axis=-1).reshape(84, 84, stack)
        np.testing.assert_array_equal(batch.s_tm1[index], stacked)
        stacked = np.stack(after, axis=-1).reshape(84, 84, stack)
        np.testing.assert_array_equal(batch.s_t[index], stacked)
        assert batch.a_tm1[index] == action
        assert batch.r_t[index] == pytest.approx(reward, abs=1e-6)
        assert batch.discount_t[index] == pytest.approx(discount, rel=1e-6)


def test_sampling_is_uniform_over_all_transitions_but_those_of_a_full_rings_oldest_rows():
    rows, streams, stack = 20, 2, 4
    memory = ReplayMemory(rows * streams, streams, stack, 0.9, np.random.SeedSequence(0))
    naive = NaiveMemory(rows, stack)
    fill(memory, naive, [3, 7], 47, np.random.default_rng(1))
    expected = naive.transitions()
    drawn_rows, drawn_streams = memory._draw(40_000)
    numbers = 46 - (46 - drawn_rows) % rows
    keys, counts = np.unique(np.stack([drawn_streams, numbers]), axis=1, return_counts=True)
    assert {(int(stream), int(number)) for stream, number in keys.T} == set(expected)
    mean = 40_000 / len(expected)
    chi_square = ((counts - mean) ** 2 / mean).sum()
    assert chi_square < len(expected) + 4 * np.sqrt(2 * len(expected))


def test_an_empty_memory_cannot_be_sampled():
    memory = ReplayMemory(80, 2, 4, 0.9, np.random.SeedSequence(0))
    with pytest.raises(ValueError, match="no transition yet"):
        memory.sample(1)


def test_a_restored_memory_draws_the_same_transitions():
    def filled():
        memory = ReplayMemory(60, 2, 4, 0.9, np.random.SeedSequence(5))
        fill(memory, NaiveMemory(30, 4), [5], 50, np.random.default_rng(2))
        return memory

    memory, restored = filled(), ReplayMemory(60, 2, 4, 0.9, np.random.SeedSequence(6))
    memory.sample(10)
    assert 0 not in memory.frames.segments, "the first segments are freed by now"
    assert len(memory.frames.segments) > 3
    restored.set_state(memory.get_state())
    for one in (memory, restored):
        fill(one, NaiveMemory(30, 4), [5], 7, np.random.default_rng(3))
    first, second = memory.sample(64), restored.sample(64)
    for name in ("s_tm1", "a_tm1", "r_t", "discount_t", "s_t"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


@given(seed=st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_compression_loses_nothing_even_of_noise(seed):
    rng = np.random.default_rng(seed)
    codec = ImageCodec(rng.integers(256, size=PIXELS, dtype=np.uint8).tobytes())
    image = rng.integers(256, size=PIXELS, dtype=np.uint8)
    assert codec.decompress(codec.compress(image)) == image.tobytes()


def test_segments_are_dropped_when_their_images_are_overwritten():
    memory = ReplayMemory(80, 2, 4, 0.9, np.random.SeedSequence(0))
    for number in range(20):
        fill(memory, NaiveMemory(40, 4), [5], 40, np.random.default_rng(number))
        held = sum(len(segment) for segment in memory.frames.segments.values())
        assert held <= memory.frames.size.sum() + 2 * replay.SEGMENT
        assert sum(memory.frames.held.values()) == len(memory)
