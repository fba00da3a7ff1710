"""A run's published models: the online network's weights, float16, in a safetensors file that
says after how many games of training."""

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from atari_dqn import params
from atari_dqn.agents import AGENTS, torch_device
from atari_dqn.envs import make_env
from atari_dqn.params import Parameters
from atari_dqn.runs.files import RunError, model_file
from atari_dqn.runs.run import COMPLETE, Run


def model_bytes(weights: dict[str, torch.Tensor], games: int) -> bytes:
    """The contents of a model.safetensors: the weights as float16, and beside them the games of
    training and the checksum of both."""
    half = {name: value.half().cpu().contiguous() for name, value in weights.items()}
    about = {"games": games, "sha256": _digest(half, games)}
    return save(half, {"about": json.dumps(about)})  # one entry: safetensors' order is random


def _digest(half: dict[str, torch.Tensor], games: int) -> str:
    digest = hashlib.sha256(f"{games}\n".encode())
    for name, value in sorted(half.items()):
        digest.update(f"{name} {list(value.shape)} {value.dtype}\n".encode())
        digest.update(value.numpy().tobytes())
    return digest.hexdigest()


def trained_games(path: Path) -> int:
    """The training games behind a model.safetensors. Raises RunError if it cannot be read."""
    return _open(path)[0]


def read_model(path: Path) -> dict[str, torch.Tensor]:
    """The weights in a model.safetensors, float32. Raises RunError if it cannot be read, or is not
    as it was written."""
    games, digest, half = _open(path, weights=True)
    if digest != _digest(half, games):
        raise RunError(f"{path} is damaged: it does not have the checksum that it was written with")
    return {name: value.float() for name, value in half.items()}


def _open(path: Path, weights: bool = False) -> tuple[int, str, dict[str, torch.Tensor]]:
    """The games of training, the checksum and, if they are asked for, the weights as stored."""
    try:
        with safe_open(path, "pt") as file:
            about = json.loads((file.metadata() or {})["about"])
            half = {name: file.get_tensor(name) for name in file.keys()} if weights else {}  # noqa: SIM118
            return int(about["games"]), about["sha256"], half
    except KeyError as error:
        raise RunError(f"{path} cannot be read: it does not say its {error}") from None
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise RunError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None


def load_model(path: Path, parameters: Parameters) -> nn.Module:
    """The network of `parameters`' first agent with the weights in `path`."""
    actions = len(make_env(parameters).actions)
    network = AGENTS[parameters.agents[0]].network(parameters.frame_stack, actions)
    network.load_state_dict(read_model(path))
    return network.requires_grad_(False).to(torch_device(parameters.device))


def stored(run: Run) -> dict[int, Path]:
    """{games of training: file} of a run's stored models: snapshots, and the newest."""
    return in_folder(run.folder)


def in_folder(folder: Path) -> dict[int, Path]:
    """The same of a stored run's folder."""
    paths = [*folder.glob("snapshots/*.safetensors"), folder / "model.safetensors"]
    return dict(sorted((trained_games(path), path) for path in paths if path.exists()))


def initial_weights(run: Run) -> dict[str, torch.Tensor] | None:
    """The weights that a run starts from; raises RunError if they are not there yet."""
    source = run.source()
    if source is None:
        return None
    if source.state() != COMPLETE:
        raise RunError(
            f"{run.name} starts from {source.name}, which is {source.state()}; train that one to "
            f"its end first: `python -m atari_dqn experiments run {source.experiment}` does, or "
            f"`train` with its file, --agent {source.agent} and --seed {source.seed}"
        )
    try:
        return read_model(source.folder / "model.safetensors")
    except RunError as error:
        raise RunError(f"{run.name} starts from {source.name}: {error}") from None


def stored_agent(folder: Path, overrides: dict[str, Any]) -> tuple[nn.Module, Parameters]:
    """A stored run's newest model, and its parameters with `overrides` on top. Raises RunError or
    ParameterError on bad input."""
    path = model_file(folder)
    values = params.read_values(folder / "params.yaml")
    parameters = params.parse({**values, **overrides}, str(folder / "params.yaml"))
    try:
        return load_model(path, parameters), parameters
    except RunError:
        raise
    except RuntimeError as error:  # of PyTorch: weights of another network
        raise RunError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None
