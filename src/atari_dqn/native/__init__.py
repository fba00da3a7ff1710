"""The learner in C++: the same update as `agents.Learner`, in little more than half the time.

`learner.cpp`, which says how, is compiled by the system's C++ compiler when it is first needed and
kept in the user's cache. `python -m atari_dqn.native` does that beforehand, and says how it went.
"""

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from atari_dqn.agents import (
    Agent,
    Learner,
    double_q_learning,
    initial_network,
    q_learning,
    torch_device,
)
from atari_dqn.gpu import GraphLearner
from atari_dqn.networks import FEATURES, DuelingNetwork, NatureNetwork
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.replay import Batch

SOURCE = Path(__file__).with_name("learner.cpp")
COMPILERS = ("c++", "g++", "clang++")
# No compiler may join or reorder float operations, so that all of them give the same bits
EXACT = ("-ffp-contract=off", "-fno-fast-math")
FLAGS = ("-std=c++20", "-O3", "-mavx2", "-mfma", *EXACT, "-shared", "-fPIC")
WIDE = ("-mavx512f",)  # besides, where the processor has it: the same bits, in wider registers


class Unavailable(RuntimeError):
    """The native learner cannot be had on this machine; the message says why, in a few words."""


def cache_folder() -> Path:
    """Where compiled libraries are kept. Raises Unavailable."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if not os.path.isabs(base):
        raise Unavailable("there is no home folder to keep it in; XDG_CACHE_HOME can name another")
    return Path(base) / "atari_dqn" / "native"


def flags_here() -> tuple[str, ...]:
    """FLAGS, and WIDE if PyTorch finds AVX-512 here."""
    return (*FLAGS, *WIDE) if torch.backends.cpu.get_cpu_capability() == "AVX512" else FLAGS


def compiled(flags: tuple[str, ...] | None = None, compiler: str | None = None) -> Path:
    """The library, compiled if this compiler has not yet compiled this source with these flags, by
    default `flags_here`.

    By default the compiler that CXX names, or the first of COMPILERS, that can do it. Processes
    that come at the same time each compile it; the last one's file stays, and is the same. Raises
    Unavailable.
    """
    if (machine := platform.machine()) not in ("x86_64", "AMD64"):
        raise Unavailable(f"this processor, {machine}, lacks AVX2 and FMA")
    flags = flags_here() if flags is None else flags
    names = [compiler] if compiler else list(filter(None, [os.environ.get("CXX"), *COMPILERS]))
    failed: list[Unavailable] = []
    for name in names:
        try:
            program, *options = shlex.split(name)
        except ValueError:  # quotes that do not end, or nothing but spaces
            failed.append(Unavailable(f"CXX is {name!r}, which names no compiler"))
            continue
        if (found := shutil.which(program)) is not None:
            try:
                return _compiled_by([found, *options], flags)
            except Unavailable as error:
                failed.append(error)
    raise failed[0] if failed else Unavailable(f"no C++ compiler was found ({', '.join(names)})")


def _compiled_by(compiler: list[str], flags: tuple[str, ...]) -> Path:
    def call(*arguments: str | Path) -> str:
        done = subprocess.run(
            [*compiler, *arguments],
            capture_output=True,
            check=True,
            text=True,
            env={**os.environ, "LC_ALL": "C"},
        )
        return done.stdout

    try:
        key = "\0".join([SOURCE.read_text(), call("--version"), *compiler, *flags])
        digest = hashlib.sha256(key.encode()).hexdigest()
        library = cache_folder() / f"learner-{digest[:16]}.so"
        if not library.exists():
            library.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=library.parent) as folder:
                unfinished = Path(folder) / library.name
                call(*flags, "-o", unfinished, SOURCE)
                with unfinished.open("rb") as file:
                    os.fsync(file.fileno())  # no crash of the machine leaves a part of it
                unfinished.replace(library)
    except subprocess.CalledProcessError as error:
        lines = error.stderr.splitlines() or [f"exit status {error.returncode}"]
        told = next((line for line in lines if "error" in line or "failed" in line), lines[-1])
        raise Unavailable(f"{compiler[0]} cannot compile {SOURCE.name}: {told}") from None
    except OSError as error:
        told = f"{error.filename or cache_folder()}: {error.strerror}"
        raise Unavailable(f"{told}; XDG_CACHE_HOME can name another cache") from None
    return library


@cache
def load(library: Path | None = None) -> ctypes.CDLL:
    """The library with its functions' types; by default the one that `compiled` gives. Raises
    Unavailable, also if this processor lacks AVX2 or FMA."""
    try:
        native = _opened(library) if library else _opened_or_compiled_again()
    except OSError as error:
        raise Unavailable(f"the compiled learner cannot be loaded: {error}") from None
    native.processor_suffices.restype = ctypes.c_bool
    if not native.processor_suffices():
        raise Unavailable("this processor lacks AVX2 or FMA")
    array, number, real = ctypes.c_void_p, ctypes.c_int, ctypes.c_double
    types: dict[str, tuple[Any, list]] = {
        "learner_new": (ctypes.c_void_p, [number] * 4),
        "learner_free": (None, [array]),
        "learner_layout": (ctypes.POINTER(ctypes.c_long), [array]),
        "learner_array": (ctypes.POINTER(ctypes.c_float), [array, number]),
        "learner_transform": (None, [array]),
        "learner_q_values": (ctypes.c_bool, [array, array, number, array]),
        "learner_update": (
            ctypes.c_bool,
            [array] * 6 + [number, ctypes.c_bool, real, real, ctypes.c_long, array],
        ),
        "learner_update_target": (None, [array, ctypes.c_float]),
    }
    for name, (result, arguments) in types.items():
        function = getattr(native, name)
        function.restype, function.argtypes = result, arguments
    return native


def _opened(library: Path) -> ctypes.CDLL:
    return ctypes.CDLL(str(library))


def _opened_or_compiled_again() -> ctypes.CDLL:
    """A damaged file in the cache is replaced."""
    try:
        return _opened(compiled())
    except OSError:
        compiled().unlink(missing_ok=True)
        return _opened(compiled())


def new_learner(
    agent: Agent,
    actions: int,
    params: Parameters,
    seed: int,
    initial: dict[str, Tensor] | None = None,
) -> "Learner | NativeLearner":
    """The learner that `params.learner` asks for; "auto" is the native one on a CPU if it can be
    had. Raises ParameterError if "native" is asked for in vain."""
    given = (agent, actions, params, seed, initial)
    if params.learner == "native" and params.device == "cuda":
        raise ParameterError("learner: 'native' is not allowed: it needs the CPU; device is 'cuda'")
    if params.learner != "native" and torch_device(params.device).type == "cuda":
        return GraphLearner(*given)
    if params.learner == "torch":
        return Learner(*given)
    try:
        return NativeLearner(*given)
    except Unavailable as error:
        if params.learner == "native":
            raise ParameterError(f"learner: 'native' is not allowed: {error}") from None
        _say_once(torch_instead(error))
        return Learner(*given)


def torch_instead(reason: Unavailable) -> str:
    """What a user is told who gets the PyTorch learner for that reason."""
    return f"PyTorch learns, more slowly than the native learner would: {reason}"


@cache
def _say_once(line: str) -> None:
    warnings.warn(line, stacklevel=2)


# What learner.cpp can do: the network and the target of each agent that it knows
KNOWN: dict[tuple[type[nn.Module], Any], dict[str, bool]] = {
    (NatureNetwork, q_learning): {"dueling": False, "double_q": False},
    (NatureNetwork, double_q_learning): {"dueling": False, "double_q": True},
    (DuelingNetwork, double_q_learning): {"dueling": True, "double_q": True},
}


class NativeLearner:
    """A look-alike of `agents.Learner`; their states can be exchanged.

    Raises Unavailable if there is no library to be had, or if it does not know the agent.
    """

    kind = "native"
    device = torch.device("cpu")

    def __init__(
        self,
        agent: Agent,
        actions: int,
        params: Parameters,
        seed: int,
        initial: dict[str, Tensor] | None = None,
        library: Path | None = None,
    ):
        if (agent.network, agent.target) not in KNOWN:
            known = f"{agent.network.__name__} with {agent.target.__name__}"
            raise Unavailable(f"it does not know the agent of {known}")
        kind = KNOWN[agent.network, agent.target]
        self.params, self.actions, self.dueling = params, actions, kind["dueling"]
        self._native = load(library)
        self._learner = self._native.learner_new(
            params.frame_stack, actions, kind["dueling"], kind["double_q"]
        )
        if not self._learner:
            raise MemoryError
        starts = self._native.learner_layout(self._learner)[: len(PARTS) + 1]
        size = starts[-1]
        self._online, self._target, self._first, self._second = (
            np.ctypeslib.as_array(self._native.learner_array(self._learner, which), (size,))
            for which in range(4)
        )
        self._places = {
            name: slice(*ends) for name, *ends in zip(PARTS, starts[:-1], starts[1:], strict=True)
        }
        weights = initial_network(agent, actions, params, seed, initial).state_dict()
        self._pack(weights, self._online)
        self._pack(weights, self._target)
        self._native.learner_transform(self._learner)
        self.learning_rate = params.learning_rate
        self.updates = 0

    def __del__(self) -> None:
        if getattr(self, "_learner", None):
            self._native.learner_free(self._learner)

    def q_values(self, observations: np.ndarray) -> np.ndarray:
        """Bytes [N, 84, 84, S] to Q-values float32 [N, A]."""
        states = self._bytes(observations, len(observations))
        q = np.empty((len(states), self.actions), np.float32)
        if len(states) and not self._native.learner_q_values(
            self._learner, states.ctypes.data, len(states), q.ctypes.data
        ):
            raise MemoryError
        return q

    def learn(self, batch: Batch) -> tuple[float, float]:
        """Makes one gradient step and updates the target network if that is due.

        Returns the batch's mean loss and mean Q(s_tm1, a_tm1). Raises MemoryError, after which the
        learner is of no use, and ValueError if the arrays do not fit each other or the network.
        """
        size = len(batch.a_tm1)
        arrays = (
            self._bytes(batch.s_tm1, size),
            np.ascontiguousarray(batch.a_tm1, np.int64),
            np.ascontiguousarray(batch.r_t, np.float32),
            np.ascontiguousarray(batch.discount_t, np.float32),
            self._bytes(batch.s_t, size),
        )
        sizes, taken = {len(array) for array in arrays}, arrays[1]
        if sizes != {size} or size == 0 or not 0 <= taken.min() <= taken.max() < self.actions:
            raise ValueError(
                f"no batch for {self.actions} actions: lengths {sizes}, a_tm1 {batch.a_tm1}"
            )
        loss_and_q = np.empty(2)
        if not self._native.learner_update(
            self._learner,
            *(array.ctypes.data for array in arrays),
            size,
            self.params.freeze_convolutions,
            self.learning_rate,
            self.params.adam_epsilon,
            self.updates + 1,
            loss_and_q.ctypes.data,
        ):
            raise MemoryError
        self.updates += 1
        if self.updates % self.params.target_update_period == 0:
            self._native.learner_update_target(self._learner, self.params.tau)
        return float(loss_and_q[0]), float(loss_and_q[1])

    def set_learning_rate(self, rate: float) -> None:
        self.learning_rate = rate

    def weights(self) -> dict[str, Tensor]:
        """The online network's, as copies, by the names that the PyTorch network has for them."""
        return self._unpack(self._online)

    def set_weights(self, weights: dict[str, Tensor]) -> None:
        """Replaces the online network's. Raises ValueError if they are another network's."""
        self._pack(weights, self._online)
        self._native.learner_transform(self._learner)

    def get_state(self) -> dict[str, Any]:
        """Weights, Adam's moments and counters, as `agents.Learner.get_state` returns them."""
        first, second = self._unpack(self._first), self._unpack(self._second)
        moments: dict[str, Tensor] = {}
        for name in self._trained() if self.updates else ():
            moments[f"{name}.step"] = torch.tensor(float(self.updates))
            moments[f"{name}.exp_avg"] = first[name]
            moments[f"{name}.exp_avg_sq"] = second[name]
        return {
            "online": self.weights(),
            "target": self._unpack(self._target),
            "moments": moments,
            "updates": self.updates,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores what `get_state`, of either learner, returned. Raises ValueError if that is
        another network's."""
        self._pack(state["online"], self._online)
        self._pack(state["target"], self._target)
        self.updates = state["updates"]
        for moment, flat in (("exp_avg", self._first), ("exp_avg_sq", self._second)):
            flat[:] = 0
            suffix = f".{moment}"
            stored = {
                name.removesuffix(suffix): value
                for name, value in state["moments"].items()
                if name.endswith(suffix)
            }
            self._pack(stored, flat, self._trained() if self.updates else [])
        self._native.learner_transform(self._learner)

    def _bytes(self, observations: np.ndarray, count: int) -> np.ndarray:
        shape = (count, 84, 84, self.params.frame_stack)
        if observations.shape != shape:
            raise ValueError(f"observations {observations.shape}, not {shape}")
        return np.ascontiguousarray(observations, np.uint8)

    def _views(self, flat: np.ndarray) -> dict[str, np.ndarray]:
        """The parts of a flat array, by the names and in the shapes that PyTorch has for them, as
        views: writing to one writes to the array."""
        stack, actions = self.params.frame_stack, self.actions
        part = {name: flat[place] for name, place in self._places.items()}
        # [row of blocks, column of blocks][row in the block, column, channel][output channel]
        first = part["conv1"].reshape(2, 2, 4, 4, stack, 32).transpose(5, 4, 0, 2, 1, 3)
        second = part["conv2"].reshape(2, 2, 2, 2, 32, 64).transpose(5, 4, 0, 2, 1, 3)
        third = part["conv3"].reshape(3, 3, 64, 64).transpose(3, 2, 0, 1)
        hidden = part["hidden"].reshape(-1, FEATURES, 16).transpose(0, 2, 1)  # [units/16, 16, ...]
        bias = part["hidden_bias"].reshape(-1, 16)
        views = {
            "convolutions.0.weight": first,  # [32, S, 2, 4, 2, 4]: 8 is two blocks of 4
            "convolutions.0.bias": part["bias1"],
            "convolutions.2.weight": second,
            "convolutions.2.bias": part["bias2"],
            "convolutions.4.weight": third,
            "convolutions.4.bias": part["bias3"],
        }
        streams = ("value_", "advantage_") if self.dueling else ("",)
        for index, stream in enumerate(streams):
            units = slice(32 * index, 32 * (index + 1))
            views[f"{stream}hidden.weight"] = hidden[units]
            views[f"{stream}hidden.bias"] = bias[units]
        if self.dueling:
            views["value_output.weight"] = part["value"].reshape(1, 512)
            views["value_output.bias"] = part["value_bias"][:1]
        views[f"{streams[-1]}output.weight"] = part["output"].reshape(actions, 512)
        views[f"{streams[-1]}output.bias"] = part["output_bias"][:actions]
        return views

    def _shape(self, name: str, view: np.ndarray) -> tuple[int, ...]:
        """The shape in PyTorch of a view, some of whose axes are split in two there."""
        if view.ndim == 6:  # convolutions of blocks
            a, b, c, d, e, f = view.shape
            return (a, b, c * d, e * f)
        if "hidden.weight" in name:
            return (512, FEATURES)
        return (512,) if "hidden.bias" in name else view.shape

    def _trained(self) -> list[str]:
        """The names of the weights that learn."""
        frozen = "convolutions." if self.params.freeze_convolutions else None
        names = self._views(self._online)
        return [name for name in names if frozen is None or not name.startswith(frozen)]

    def _pack(
        self, weights: dict[str, Any], flat: np.ndarray, names: list[str] | None = None
    ) -> None:
        """Writes `weights`, which must be those of `names`, by default all, into a flat array."""
        views = self._views(flat)
        if (odd := weights.keys() ^ (views if names is None else names)) != set():
            raise ValueError(f"the state of another network: {', '.join(sorted(odd))}")
        for name, value in weights.items():
            shape = self._shape(name, views[name])
            if tuple(value.shape) != shape:
                raise ValueError(f"{name} has shape {tuple(value.shape)}, not {shape}")
            values = torch.as_tensor(value).float().cpu().numpy()
            views[name][...] = values.reshape(views[name].shape)

    def _unpack(self, flat: np.ndarray) -> dict[str, Tensor]:
        return {
            name: torch.from_numpy(np.array(view, order="C").reshape(self._shape(name, view)))
            for name, view in self._views(flat).items()
        }


PARTS = (
    *("conv1", "bias1", "conv2", "bias2", "conv3", "bias3", "hidden", "hidden_bias"),
    *("output", "output_bias", "value", "value_bias"),
)
