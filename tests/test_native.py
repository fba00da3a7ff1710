"""The learner in C++ is held to 64-bit arithmetic and to itself; test_agents.py has more."""

import ctypes
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from test_agents import PlainNature, doubled

from atari_dqn import native
from atari_dqn.agents import AGENTS, Learner
from atari_dqn.native import NativeLearner, Unavailable, new_learner
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.replay import Batch

pytestmark = pytest.mark.native


def screens(rng, count, stack):
    """Observations like a game's: a still background, on which two boxes move."""
    states = np.zeros((count, 84, 84, stack), np.uint8)
    states[:] = np.kron(rng.integers(0, 2, (7, 7)), np.ones((12, 12)))[None, :, :, None] * 90
    for state in states:
        for channel in range(stack):
            for shade in (40, 200):
                y, x = rng.integers(0, 70, 2)
                state[y : y + 14, x : x + 9, channel] = shade
    return states


def batch_of(rng, count, stack, actions, gamma=0.99):
    return Batch(
        s_tm1=screens(rng, count, stack),
        a_tm1=rng.integers(actions, size=count),
        r_t=rng.choice([-1.0, 0.0, 1.0], count).astype(np.float32),
        discount_t=np.where(rng.random(count) < 0.2, 0, gamma).astype(np.float32),
        s_t=screens(rng, count, stack),
    )


def with_another_target(learner, scale=0.01):
    """The learner, its target network moved away from the online one; and its state."""
    state, generator = learner.get_state(), torch.manual_seed(1)
    for weight in state["target"].values():
        weight.add_(torch.randn(weight.shape, generator=generator) * scale)
    learner.set_state(state)
    return state


def exact_gradients(agent, state, batch):
    """Loss, gradients in 64 bits, by the direct convolutions of PyTorch, and how near to zero the
    input of a ReLU came on s_tm1, where rounding decides whether there is a gradient."""
    weights = {name: w.requires_grad_() for name, w in doubled(state["online"]).items()}
    tensors = Batch(**{name: torch.from_numpy(array) for name, array in vars(batch).items()})
    with torch.no_grad():
        target = PlainNature(doubled(state["target"]))
        wanted = AGENTS[agent].target(tensors, PlainNature(weights), target)
    online = PlainNature(weights)
    taken = online(tensors.s_tm1).gather(1, tensors.a_tm1[:, None]).squeeze(1)
    loss = ((taken - wanted) ** 2).mean()
    loss.backward()
    return loss.item(), {name: weight.grad for name, weight in weights.items()}, online.nearest


def nearest_after_an_update(agent, count, stack, actions, seed):
    """Holds an update to 64-bit arithmetic, unless a ReLU is too near to zero; returns how near."""
    parameters = Parameters(experiment="any", frame_stack=stack)
    learner = NativeLearner(AGENTS[agent], actions, parameters, seed)
    batch = batch_of(np.random.default_rng(seed), count, stack, actions)
    loss, gradients, nearest = exact_gradients(agent, with_another_target(learner), batch)
    if nearest < TOO_NEAR:
        return nearest
    assert learner.learn(batch)[0] == pytest.approx(loss, rel=1e-5)
    moments = learner.get_state()["moments"]
    for name, gradient in gradients.items():
        first, second = (moments[f"{name}.{key}"] for key in ("exp_avg", "exp_avg_sq"))
        size = gradient.norm()
        assert (first - 0.1 * gradient).norm() <= 1e-5 * 0.1 * size, name
        squares = gradient**2
        assert (second - 0.001 * squares).norm() <= 1e-4 * 0.001 * squares.norm(), name
    return nearest


TOO_NEAR = 3e-8  # about the rounding error of the input of a ReLU


@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize(("count", "actions"), [(32, 18), (64, 4)])
def test_gradients_of_the_batches_in_use_are_those_of_64_bit_arithmetic(agent, count, actions):
    """Boxing's and Breakout's. A ReLU so near to zero is bad luck, which another seed ends."""
    nearest = [nearest_after_an_update(agent, count, 4, actions, seed) for seed in range(3)]
    assert max(nearest) > TOO_NEAR, nearest


@pytest.mark.parametrize("agent", AGENTS)
@given(
    count=st.integers(1, 40),
    stack=st.integers(1, 8),
    actions=st.integers(1, 18),
    seed=st.integers(0, 1000),
)
@example(count=1, stack=1, actions=1, seed=2)
@settings(max_examples=8, deadline=None, derandomize=True, database=None)
def test_gradients_and_moments_are_those_of_64_bit_arithmetic(agent, count, stack, actions, seed):
    assume(nearest_after_an_update(agent, count, stack, actions, seed) > TOO_NEAR)


@pytest.mark.parametrize("agent", AGENTS)
def test_it_stays_beside_the_pytorch_learner_for_some_updates(agent):
    parameters = Parameters(experiment="any", target_update_period=4)
    ours, reference = (make(AGENTS[agent], 6, parameters, 3) for make in (NativeLearner, Learner))
    rng = np.random.default_rng(0)
    for rate in (1e-5, 2e-5, 1e-4, 1e-4, 5e-5):
        batch = batch_of(rng, 8, 4, 6)
        for learner in (ours, reference):
            learner.set_learning_rate(rate)
        np.testing.assert_allclose(ours.learn(batch), reference.learn(batch), rtol=1e-3)
    one, other = ours.get_state(), reference.get_state()
    assert one["moments"].keys() == other["moments"].keys()
    for part in ("online", "target", "moments"):
        for name, value in one[part].items():
            wanted = other[part][name]
            assert value.shape == wanted.shape, name
            assert (value - wanted).norm() <= 2e-3 * wanted.norm() + 1e-7, name


def silent_units(state, batch, rng):
    """Weights that meet only black pixels, or only units that are silent or get no gradient."""
    for layer in (0, 2, 4):
        bias = state["online"][f"convolutions.{layer}.bias"]
        bias[torch.from_numpy(rng.random(len(bias)) < 0.6)] = -50.0
    batch.s_tm1[:, ::2], batch.s_tm1[:, :, 1::4], batch.s_tm1[..., 2] = 0, 0, 0


def one_corner(state, batch, rng):
    """Only the features of the corner matter, which see 36x36 pixels, black in one image."""
    for stream in ("value", "advantage"):
        state["online"][f"{stream}_hidden.weight"][:, 64:] = 0
    batch.s_tm1[:, :36, :36, 1] = 0


@pytest.mark.parametrize("spoil", [silent_units, one_corner])
def test_a_gradient_that_is_exactly_zero_is_exactly_zero(spoil):
    parameters = Parameters(experiment="any")
    learner = NativeLearner(AGENTS["dueling_double_dqn"], 6, parameters, 0)
    state, rng = with_another_target(learner), np.random.default_rng(0)
    batch = batch_of(rng, 4, 4, 6)
    spoil(state, batch, rng)
    learner.set_state(state)
    _, gradients, _ = exact_gradients("dueling_double_dqn", state, batch)
    learner.learn(batch)
    moments = learner.get_state()["moments"]
    for name, gradient in gradients.items():
        zero = gradient == 0
        assert (moments[f"{name}.exp_avg"][zero] == 0).all(), name
        assert (moments[f"{name}.exp_avg_sq"][zero] == 0).all(), name
    zeros = (gradients["convolutions.0.weight"] == 0).double().mean()
    assert 0.1 < zeros < 1, "the test would show nothing"


def some_updates(learner, updates=range(6), count=7):
    """A digest of the state after updates, and of Q-values."""
    digest = hashlib.sha256()
    for number in updates:
        rng = np.random.default_rng(number)
        batch = batch_of(rng, count, learner.params.frame_stack, learner.actions)
        digest.update(np.array(learner.learn(batch)).tobytes())
        digest.update(learner.q_values(batch.s_t).tobytes())
    state = learner.get_state()
    for part in ("online", "target", "moments"):
        for name, value in state[part].items():
            digest.update(name.encode() + value.numpy().tobytes())
    return digest.hexdigest()


PARAMETERS = Parameters(experiment="any", frame_stack=3, target_update_period=4, tau=0.3)
FROZEN = Parameters(experiment="any", frame_stack=4, freeze_convolutions=True)
# agent, parameters, actions, batch: what takes another way through the source; the first 16 digits
# of the digest
PINNED = [
    ("dqn", Parameters(experiment="any", frame_stack=4), 18, 33, "6e8c725c32dc7e78"),
    ("double_dqn", FROZEN, 4, 16, "4707358a1c5e2907"),
    ("dueling_double_dqn", PARAMETERS, 6, 7, "2161fcb340c57356"),
    ("dueling_double_dqn", Parameters(experiment="any", frame_stack=4), 18, 32, "533e733293511d94"),
]


def pinned_updates(agent, parameters, actions, count, library=None):
    """The digest after updates from weights and moments that depend on nothing but this function;
    some moments are so small that they sink among the denormal numbers."""
    learner = NativeLearner(AGENTS[agent], actions, parameters, 1, library=library)
    learner.learn(batch_of(np.random.default_rng(0), 1, parameters.frame_stack, actions))
    state, rng = learner.get_state(), np.random.default_rng(0)
    for part in ("online", "target"):
        for weight in state[part].values():
            weight.copy_(torch.from_numpy(rng.integers(-512, 512, weight.shape) / 8192))
    for name, moment in state["moments"].items():
        if not name.endswith(".step"):
            small = rng.integers(0, 512, moment.shape) * 2.0**-134
            moment.copy_(torch.from_numpy(small))
    learner.set_state(state)
    return some_updates(learner, count=count)[:16]


BUILDS = {
    "g++ -O1": ("g++", ("-O1",)),
    "g++ -O3 for this processor": ("g++", ("-O3", "-march=native")),
    "clang++ -O3 for this processor": ("clang++", ("-O3", "-march=native")),
}


@pytest.mark.parametrize("build", BUILDS)
def test_every_compiler_gives_the_same_bits(build, tmp_path, monkeypatch):
    compiler, optimisation = BUILDS[build]
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    flags = (*(flag for flag in native.FLAGS if flag != "-O3"), *optimisation)
    library = native.compiled(flags, compiler)
    for *case, digest in PINNED:
        assert pinned_updates(*case, library=library) == digest


@pytest.mark.parametrize(("agent", "parameters", "actions", "count", "digest"), PINNED)
def test_the_bits_are_those_that_stored_runs_were_trained_with(
    agent, parameters, actions, count, digest
):
    """If this fails, raise TRAINING_VERSION: the arithmetic is another one."""
    assert pinned_updates(agent, parameters, actions, count) == digest


@pytest.mark.parametrize("agent", AGENTS)
def test_a_state_restored_half_way_gives_the_same_bits(agent):
    whole, other = (NativeLearner(AGENTS[agent], 6, PARAMETERS, seed) for seed in (1, 9))
    some_updates(whole, range(3))
    other.set_state(whole.get_state())
    assert some_updates(other, range(3, 6)) == some_updates(whole, range(3, 6))
    assert some_updates(other, range(3)) != some_updates(whole, range(1, 4))


def test_a_state_can_go_to_the_pytorch_learner_and_back():
    ours = NativeLearner(AGENTS["dueling_double_dqn"], 6, PARAMETERS, 1)
    some_updates(ours, range(3))
    between = Learner(AGENTS["dueling_double_dqn"], 6, PARAMETERS, 2)
    between.set_state(ours.get_state())
    back = NativeLearner(AGENTS["dueling_double_dqn"], 6, PARAMETERS, 3)
    back.set_state(between.get_state())
    assert some_updates(back, range(3, 6)) == some_updates(ours, range(3, 6))


def test_an_observation_has_the_same_values_alone_and_among_others():
    learner = NativeLearner(AGENTS["dueling_double_dqn"], 6, Parameters(experiment="any"), 1)
    states = screens(np.random.default_rng(0), 21, 4)
    together = learner.q_values(states)
    for index in (0, 7, 20):
        assert (learner.q_values(states[index : index + 1])[0] == together[index]).all()
    assert learner.q_values(states[:0]).shape == (0, 6)


@pytest.mark.parametrize("agent", ["dqn", "double_dqn"])
@pytest.mark.parametrize("network", ["online", "target"])
@pytest.mark.parametrize("name", ["convolutions.0.bias", "output.bias"])
def test_nan_goes_where_it_goes_in_pytorch(agent, network, name):
    """It is the greatest value there, which no maximum hides."""
    learners = [
        make(AGENTS[agent], 6, Parameters(experiment="any"), 1) for make in (NativeLearner, Learner)
    ]
    batch = batch_of(np.random.default_rng(0), 8, 4, 6)
    batch.a_tm1[:] = 1
    for learner in learners:
        state = learner.get_state()
        state[network][name][3] = float("nan")
        learner.set_state(state)
    native, torch_ = [learner.learn(batch)[0] for learner in learners]
    np.testing.assert_allclose(native, torch_, rtol=1e-5)
    assert np.isnan(native) == ("convolutions" in name or network == "target")


def test_the_state_of_another_network_is_refused():
    dueling = NativeLearner(AGENTS["dueling_double_dqn"], 6, Parameters(experiment="any"), 1)
    plain = NativeLearner(AGENTS["dqn"], 6, Parameters(experiment="any"), 1)
    with pytest.raises(
        ValueError, match=r"another network: advantage_hidden\.bias, .*, hidden\.bias"
    ):
        dueling.set_weights(plain.weights())
    with pytest.raises(ValueError, match=r"output\.weight has shape \(4, 512\), not \(6, 512\)"):
        plain.set_weights(
            NativeLearner(AGENTS["dqn"], 4, Parameters(experiment="any"), 1).weights()
        )
    with pytest.raises(ValueError, match="another network: "):
        plain.set_state({**plain.get_state(), "updates": 5})
    with pytest.raises(ValueError, match="no batch for 6 actions"):
        plain.learn(batch_of(np.random.default_rng(0), 8, 4, 18))


def test_weights_that_lie_on_a_card_are_fetched():
    class OnCard(torch.Tensor):
        def __array__(self, *given):
            raise TypeError("cannot convert cuda:0 device type tensor to numpy")

    ours, other = (
        NativeLearner(AGENTS["dqn"], 6, Parameters(experiment="any"), seed) for seed in (1, 2)
    )
    weights = other.weights()
    ours.set_weights({name: value.as_subclass(OnCard) for name, value in weights.items()})
    for name, value in ours.weights().items():
        torch.testing.assert_close(value, weights[name], rtol=0, atol=0)


# ---- Building it ---------------------------------------------------------------------------------


@pytest.fixture
def no_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    native.load.cache_clear()
    native._say_once.cache_clear()
    yield
    native.load.cache_clear()
    native._say_once.cache_clear()


def test_without_a_compiler_pytorch_learns_and_one_line_says_so(no_compiler, small):
    with pytest.warns(UserWarning, match=r"PyTorch learns.*no C\+\+ compiler was found") as said:
        learners = [new_learner(AGENTS["dqn"], 6, small(), 1) for _ in range(2)]
    assert len(said) == 1
    assert [learner.kind for learner in learners] == ["torch", "torch"]
    with pytest.raises(ParameterError, match=r"learner: 'native' is not allowed: no C\+\+"):
        new_learner(AGENTS["dqn"], 6, small(learner="native"), 1)


def test_set_up_compiles_it_or_says_why_not(tmp_path):
    command = [sys.executable, "-m", "atari_dqn.native"]
    compiler = tmp_path / "compiler"  # optimising takes most of the time, and nothing is run
    compiler.write_text('#!/bin/sh\nexec c++ "$@" -O0\n')
    compiler.chmod(0o755)
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "CXX": str(compiler)}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert said.stdout == "The native learner is ready.\n"
    assert len(list((tmp_path / "atari_dqn" / "native").iterdir())) == 1
    without = {**environment, "PATH": str(tmp_path), "CXX": ""}
    said = subprocess.run(command, env=without, capture_output=True, text=True, check=True)
    assert re.fullmatch(r"PyTorch learns.*: no C\+\+ compiler was found \(.*\)\n", said.stdout)


def test_the_parameter_chooses_the_learner(small):
    kinds = {
        learner: new_learner(AGENTS["dqn"], 6, small(learner=learner, device="cpu"), 1).kind
        for learner in ("auto", "native", "torch")
    }
    assert kinds == {"auto": "native", "native": "native", "torch": "torch"}


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """An empty cache and a source that compiles at once, for a processor that is none."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    source = tmp_path / "quick.cpp"
    source.write_text('extern "C" bool processor_suffices() { return false; }')
    monkeypatch.setattr(native, "SOURCE", source)
    native.load.cache_clear()
    yield tmp_path / "cache" / "atari_dqn" / "native"
    native.load.cache_clear()


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ('[ "$1" = --version ] || { echo "fatal error: nope" >&2; exit 1; }', "fatal error: nope"),
        ('[ "$1" = --version ] || exit 3', "exit status 3"),
        ("echo Fehler: kaputt >&2; exit 1", "Fehler: kaputt"),
    ],
)
def test_a_compiler_that_fails_is_quoted_and_the_next_one_tried(
    script, told, quick, tmp_path, monkeypatch
):
    broken = tmp_path / "broken"
    broken.write_text(f"#!/bin/sh\n{script}\n")
    broken.chmod(0o755)
    with pytest.raises(Unavailable, match=rf"broken cannot compile quick\.cpp: {told}$"):
        native.compiled(compiler=str(broken))
    assert not quick.exists() or not list(quick.iterdir()), "something half-made is left"
    monkeypatch.setenv("CXX", f"{broken} -O1")
    assert native.compiled().parent == quick
    monkeypatch.setattr(native, "COMPILERS", ("false",))
    with pytest.raises(Unavailable, match=rf"broken cannot compile quick\.cpp: {told}$"):
        native.compiled()


@pytest.mark.parametrize("nonsense", [" ", '"g++'])
def test_a_name_that_names_no_compiler_is_told_and_the_next_one_tried(nonsense, quick, monkeypatch):
    monkeypatch.setenv("CXX", nonsense)
    assert native.compiled().parent == quick
    monkeypatch.setattr(native, "COMPILERS", ())
    with pytest.raises(Unavailable, match=f"CXX is {re.escape(repr(nonsense))}, which names no"):
        native.compiled()


@pytest.mark.parametrize(("found", "wide"), [("AVX512", True), ("AVX2", False), ("DEFAULT", False)])
def test_wide_registers_are_used_where_there_are_any(found, wide, quick, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: found)
    compiler = tmp_path / "compiler"
    compiler.write_text('#!/bin/sh\necho "$@" > "$0.said"; exec c++ "$@"\n')
    compiler.chmod(0o755)
    native.compiled(compiler=str(compiler))
    assert ("-mavx512f" in compiler.with_name("compiler.said").read_text().split()) == wide


def test_another_kind_of_processor_is_named_before_a_compiler_is_asked(monkeypatch):
    monkeypatch.setattr(native.platform, "machine", lambda: "arm64")
    monkeypatch.setattr(native.subprocess, "run", lambda *given, **more: pytest.fail("asked"))
    with pytest.raises(Unavailable, match="this processor, arm64, lacks AVX2 and FMA"):
        native.compiled()


def test_a_cache_that_cannot_be_written_is_named_with_the_way_out(tmp_path, monkeypatch):
    (tmp_path / "cache").write_text("a file where a folder belongs")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(Unavailable, match=r"cache/atari_dqn/native: Not a .*; XDG_CACHE_HOME can"):
        native.compiled()


def test_on_a_processor_without_the_instructions_pytorch_learns_and_says_so(quick, small):
    native._say_once.cache_clear()
    with pytest.raises(Unavailable, match="this processor lacks AVX2 or FMA"):
        native.load()
    with pytest.warns(UserWarning, match="PyTorch learns.*: this processor lacks AVX2 or FMA"):
        assert new_learner(AGENTS["dqn"], 6, small(device="cpu"), 1).kind == "torch"


def test_asking_a_processor_for_the_instructions_takes_none_of_them():
    """Else it would be the end of the process on the very machines that lack them."""
    if shutil.which("objdump") is None:
        pytest.skip("objdump is not installed")
    library = native.compiled()
    asking, whole = (
        subprocess.run(
            ["objdump", "--no-show-raw-insn", *options, library],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for options in (["--disassemble=processor_suffices"], ["--syms"])
    )
    assert "ret" in asking
    assert not re.search(r"%[xyz]mm|\tv[a-z]+ ", asking)
    assert "learner_update" in whole
    assert "_GLOBAL__sub_I" not in whole, "something runs as soon as the library is loaded"


def test_a_damaged_library_is_compiled_again(quick):
    library = native.compiled()
    whole = library.read_bytes()
    library.write_bytes(b"")
    with pytest.raises(Unavailable, match="lacks AVX2"):
        native.load()
    assert library.read_bytes() == whole


def test_a_build_that_is_killed_leaves_nothing_that_is_used(quick, tmp_path):
    """Half the library is written when the machine, or somebody, ends it."""
    compiler = tmp_path / "compiler"
    compiler.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && exec c++ --version\n[ -e "$0.once" ] && exec c++ "$@"\n'
        'while [ "$1" != -o ]; do shift; done\nprintf "\\177ELF half" > "$2"\n'
        'touch "$0.once"; exec sleep 600\n'
    )
    compiler.chmod(0o755)
    code = "import pathlib, sys; from atari_dqn import native; "
    code += "native.SOURCE = pathlib.Path(sys.argv[1]); native.compiled(compiler=sys.argv[2])"
    command = [sys.executable, "-c", code, str(native.SOURCE), str(compiler)]
    building = subprocess.Popen(command, start_new_session=True)
    while not compiler.with_name("compiler.once").exists():
        assert building.poll() is None, "the compiler was not called"
        time.sleep(0.02)
    assert len(list(quick.rglob("*.so"))) == 1, "the half"
    os.killpg(building.pid, signal.SIGKILL)
    building.wait()
    library = native.compiled(compiler=str(compiler))
    assert library.parent == quick
    with pytest.raises(Unavailable, match="lacks AVX2"):
        native.load(library)


def test_without_a_home_there_is_one_plain_line(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    with pytest.raises(Unavailable, match="there is no home folder to keep it in"):
        native.compiled()


def test_several_processes_may_build_it_at_once(tmp_path):
    compiler = tmp_path / "compiler"  # which waits for the other, if not for ever
    compiler.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && exec c++ --version\ntouch "$0.$$"; tries=0\n'
        'while [ $(ls "$0".* | wc -l) -lt 2 ] && [ $tries -lt 600 ]\n'
        'do sleep 0.1; tries=$((tries + 1)); done\nexec c++ "$@"\n'
    )
    compiler.chmod(0o755)
    source = tmp_path / "quick.cpp"
    source.write_text('extern "C" bool processor_suffices() { return false; }')
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "CXX": str(compiler)}
    code = "import sys, pathlib; from atari_dqn import native; "
    code += f"native.SOURCE = pathlib.Path({str(source)!r}); print(native.compiled())"
    started = [
        subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    printed = {process.communicate()[0] for process in started}
    assert [process.returncode for process in started] == [0, 0]
    (path,) = printed
    assert list((tmp_path / "atari_dqn" / "native").iterdir()) == [Path(path.decode().strip())]


def test_the_native_learner_is_had_where_it_is_asked_for_beside_a_gpu_too(small, monkeypatch):
    monkeypatch.setattr(native, "torch_device", lambda name: torch.device("cuda"))
    monkeypatch.setattr(native, "GraphLearner", lambda *given: "on the GPU")
    for learner, expected in (("auto", "on the GPU"), ("torch", "on the GPU")):
        assert new_learner(AGENTS["dqn"], 6, small(learner=learner), 1) == expected
    assert new_learner(AGENTS["dqn"], 6, small(learner="native"), 1).kind == "native"


# ---- Its memory ----------------------------------------------------------------------------------

SANITIZED = ("-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
ROUNDED = "std::aligned_alloc(4096, (n * sizeof(X) + 4095) / 4096 * 4096)"


def test_updates_of_every_shape_touch_no_memory_but_their_own_and_give_it_back(tmp_path):
    """`fuzz_learner.cpp` under the address, leak and undefined behaviour sanitizers. Its arrays end
    where their contents do, not at the next page."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    source = native.SOURCE.read_text()
    assert source.count(ROUNDED) == 1
    exact = source.replace(ROUNDED, "std::malloc(n * sizeof(X))")
    (tmp_path / "learner.cpp").write_text(exact)
    flags = [flag for flag in native.flags_here() if flag not in ("-O3", "-shared", "-fPIC")]
    fuzz, program = Path(__file__).with_name("fuzz_learner.cpp"), tmp_path / "fuzz"
    build = [compiler, *flags, *SANITIZED, "-I", tmp_path, fuzz, "-o", program]
    done = subprocess.run(build, capture_output=True, text=True)
    if "cannot find" in done.stderr:
        pytest.skip(f"this compiler has no sanitizers: {done.stderr.splitlines()[0]}")
    assert done.returncode == 0, done.stderr
    leaks = {"ASAN_OPTIONS": f"detect_leaks={int(sys.platform == 'linux')}"}
    done = subprocess.run([program], capture_output=True, text=True, env={**os.environ, **leaks})
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


MALLINFO = ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks")
MALLINFO += ("used", "free", "keep")


def allocated():
    """Bytes that malloc has given out in this process."""

    class Found(ctypes.Structure):
        _fields_ = [(name, ctypes.c_size_t) for name in MALLINFO]

    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = Found
    found = mallinfo()
    return found.hblkhd + found.used


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="glibc counts its memory")
def test_memory_does_not_grow_from_update_to_update():
    """By byte, so that few updates tell what every one of ten thousand would take."""
    shape = {"frame_stack": 1, "freeze_convolutions": True, "target_update_period": 7}
    parameters = Parameters(experiment="any", **shape)
    learner = NativeLearner(AGENTS["dqn"], 2, parameters, 1)
    batch, grown = batch_of(np.random.default_rng(0), 1, 1, 2), []
    for updates in (20, 50, 250):  # the first ones are from empty
        before = allocated()
        for _ in range(updates):
            learner.learn(batch)
            learner.q_values(batch.s_t)
        grown.append(allocated() - before)
    assert grown[0] > 10**6, "it is not counted"
    assert grown[2] < grown[1] + 200 * 16, "the least that malloc gives"
