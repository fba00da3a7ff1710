"""A run's published models: the online network after so many games of training."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from torch import nn

from atari_dqn.agents import AGENTS, initial_network, torch_device
from atari_dqn.envs import make_env
from atari_dqn.params import Parameters, shown, stored_parameters
from atari_dqn.runs import weights
from atari_dqn.runs.files import RunError, model_file
from atari_dqn.runs.run import COMPLETE, Run
from atari_dqn.training import weights_seed


def model_bytes(state: dict[str, torch.Tensor], games: int) -> bytes:
    """The contents of a model.safetensors: the weights as float16, and beside them the games of
    training and the checksum of both."""
    half = {name: value.half().cpu().contiguous().numpy() for name, value in state.items()}
    return weights.pack(half, games)


def trained_games(path: Path) -> int:
    """The training games behind a model.safetensors. Raises RunError if it cannot be read."""
    return weights.games_of(path)


def read_model(path: Path) -> dict[str, torch.Tensor]:
    """The weights in a model.safetensors, float32. Raises RunError if it cannot be read, or is not
    as it was written."""
    return {name: torch.from_numpy(value).float() for name, value in weights.read(path).items()}


def load_model(path: Path, parameters: Parameters) -> nn.Module:
    """The network of `parameters`' first agent with the weights in `path`. Raises RunError if they
    cannot be read, or are another network's."""
    actions = len(make_env(parameters).actions)
    network = AGENTS[parameters.agents[0]].network(parameters.frame_stack, actions)
    weights = read_model(path)
    try:
        network.load_state_dict(weights)
    except RuntimeError as error:
        said = " ".join(str(error).split())
        raise RunError(f"{path} cannot be read: {shown(said)}") from None
    return network.requires_grad_(False).to(torch_device(parameters.device))


def untrained(run: Run) -> nn.Module:
    """The network that a run began with. Raises RunError as `initial_weights` does."""
    agent, actions = AGENTS[run.agent], len(make_env(run.params).actions)
    network = initial_network(
        agent, actions, run.params, weights_seed(run.seed), initial_weights(run)
    )
    return network.requires_grad_(False)


def stored(run: Run) -> dict[int, Path]:
    """{games of training: file} of a run's stored models: snapshots, and the newest."""
    return in_folder(run.folder)


def along_training(run: Run) -> Iterator[tuple[int, nn.Module]]:
    """(games of training, network) of a run, from 0 games on. Raises RunError as `initial_weights`
    does, and if a stored model cannot be read."""
    yield 0, untrained(run)
    for games, path in stored(run).items():
        yield games, load_model(path, run.params)


def in_folder(folder: Path) -> dict[int, Path]:
    """The same of a stored run's folder."""
    return dict(sorted((trained_games(path), path) for path in weights.files(folder)))


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
    parameters = stored_parameters(folder, overrides)
    return load_model(path, parameters), parameters
