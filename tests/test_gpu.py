"""Learning on a GPU. Without one, a graph's recording is replaced by calling the recorded function:
that leaves everything but the recording to be tested."""

import numpy as np
import pytest
import torch

from atari_dqn import gpu
from atari_dqn.agents import AGENTS, Learner
from atari_dqn.envs import VectorEnv
from atari_dqn.runs import models, recorder
from atari_dqn.runs.run import Run


class Called:
    """What `gpu._Graph` does, without a graph: its calls before the recording included."""

    def __init__(self, function, inputs, undo=lambda: None):
        self.function = function
        for _ in range(gpu.WARM_UP):
            function(*inputs)
        undo()

    def __call__(self, *inputs):
        return self.function(*inputs)


@pytest.fixture
def device(monkeypatch):
    if torch.cuda.is_available():
        return torch.device("cuda")
    monkeypatch.setattr(gpu, "_Graph", Called)
    return torch.device("cpu")


def memories(parameters, device, steps=60):
    """The same games of random play in both kinds of memory."""
    both = [
        gpu.new_memory(parameters, np.random.SeedSequence(1), torch.device("cpu")),
        gpu.GPUReplayMemory(
            *(parameters.replay_capacity, 2, 4, parameters.gamma, np.random.SeedSequence(1)),
            parameters.n_steps,
            device=device,
        ),
    ]
    envs, rng = VectorEnv(parameters, np.random.SeedSequence(2)), np.random.default_rng(0)
    for memory in both:
        memory.append(envs.planes[-1], *[np.zeros(2)] * 4)
    for _ in range(steps):
        actions = rng.integers(envs.actions, size=2)
        step = envs.step(actions)
        for memory in both:
            memory.append(step.images, step.ages, actions, step.rewards, step.terminated)
    return both


def images(batch):
    """The two stacks of a batch whose images are on the GPU, uint8 [N, 84, 84, S] each."""
    planes = batch.images.cpu().numpy()[batch.drawn.slots]
    stacks = planes.reshape(*planes.shape[:2], 84, 84).transpose(1, 2, 3, 0)
    return stacks[..., :4], stacks[..., -4:]


@pytest.mark.parametrize("n_steps", [1, 3])
@pytest.mark.parametrize("capacity", [200, 64])  # with room to spare; full
def test_the_memory_on_the_gpu_samples_what_the_compressed_one_does(
    small, device, capacity, n_steps
):
    compressed, on_gpu = memories(small(replay_capacity=capacity, n_steps=n_steps), device)
    expected, batch = compressed.sample(40), on_gpu.sample(40)
    before, after = images(batch)
    np.testing.assert_array_equal(before, expected.s_tm1)
    np.testing.assert_array_equal(after, expected.s_t)
    for name in ("a_tm1", "r_t", "discount_t"):
        np.testing.assert_array_equal(getattr(batch.drawn, name), getattr(expected, name))


@pytest.mark.parametrize("capacity", [200, 64])
def test_the_two_memories_can_exchange_their_states(small, device, capacity):
    parameters = small(replay_capacity=capacity)
    compressed, on_gpu = memories(parameters, device)
    expected = images(on_gpu.sample(40))
    on_gpu.rng.bit_generator.state = compressed.rng.bit_generator.state
    other, other_on_gpu = memories(parameters, device, steps=3)
    other.set_state(on_gpu.get_state())
    other_on_gpu.set_state(compressed.get_state())
    for restored in (other.sample(40), other_on_gpu.sample(40)):
        found = images(restored) if hasattr(restored, "drawn") else (restored.s_tm1, restored.s_t)
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("agent", "n_steps"), [*((agent, 1) for agent in AGENTS), ("dqn", 3)])
def test_the_recorded_update_is_the_reference_learners(small, device, agent, n_steps):
    """Weights agree after updates across a new target network and new step sizes, but for rounding
    that sixteen updates have made larger: by 1.4% of the way on one processor."""
    parameters = small(batch_size=8, adam_epsilon=1.5e-4, n_steps=n_steps)
    compressed, on_gpu = memories(parameters, device)
    reference = Learner(AGENTS[agent], 18, parameters.model_copy(update={"device": "cpu"}), 7)
    learner = gpu.GraphLearner(AGENTS[agent], 18, parameters, 7)
    start = {name: value.clone() for name, value in reference.weights().items()}
    for update in range(16):
        for each in (reference, learner):
            each.set_learning_rate(1e-4 * (1 + update))
        expected = reference.learn(compressed.sample(8))
        found = learner.learn(on_gpu.sample(8)).tolist()
        assert found == pytest.approx(expected, rel=1e-3, abs=1e-5)
    assert learner.updates == reference.updates == 16
    for name, weight in reference.weights().items():
        moved = (weight - start[name]).norm()
        assert (learner.weights()[name].cpu() - weight).norm() < 5e-2 * moved, name


def test_a_recorded_learner_goes_on_from_a_saved_state(small, device):
    parameters = small(batch_size=8)
    _, memory = memories(parameters, device)
    learner = gpu.GraphLearner(AGENTS["double_dqn"], 18, parameters, 7)
    for _ in range(5):
        learner.learn(memory.sample(8))
    other = gpu.GraphLearner(AGENTS["double_dqn"], 18, parameters, 8)
    other.learn(memory.sample(8))  # has recorded an update of its own
    other.set_state(learner.get_state())
    batches = [memory.sample(8) for _ in range(4)]
    expected = [learner.learn(batch).tolist() for batch in batches]
    assert [other.learn(batch).tolist() for batch in batches] == expected
    assert all(
        torch.equal(value, learner.weights()[name]) for name, value in other.weights().items()
    )


def test_q_values_of_all_games_and_of_any_other_number(small, device):
    parameters = small(batch_size=8)
    compressed, _ = memories(parameters, device)
    learner = gpu.GraphLearner(AGENTS["dqn"], 18, parameters, 7)
    reference = Learner(AGENTS["dqn"], 18, parameters.model_copy(update={"device": "cpu"}), 7)
    for count in (parameters.environments, 5):
        for _ in range(2):
            states = compressed.sample(count).s_t
            found = learner.q_values(states)
            np.testing.assert_allclose(found, reference.q_values(states), rtol=1e-3, atol=1e-5)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="without one this is any run")
def test_a_run_on_a_gpu_is_trained_to_its_end(small, tmp_path):
    run = Run(small(device="cuda", snapshot_games=[1], emulator_processes=2), tmp_path)
    recorder.train(run, None)
    assert run.state() == "complete"
    assert models.trained_games(run.folder / "model.safetensors") == run.params.episodes
    assert [path.name for path in (run.folder / "snapshots").iterdir()] == [
        "games-00001.safetensors"
    ]
