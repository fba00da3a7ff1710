"""What section 02 and the appendix show of the design: computed from modules, files and frames."""

import inspect
import textwrap
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import torch
from torch import nn

from atari_dqn import params
from atari_dqn.agents import AGENTS
from atari_dqn.analysis.study import data, spelled
from atari_dqn.envs import AtariEnv
from atari_dqn.games import GAMES
from atari_dqn.params import Parameters
from atari_dqn.replay import PIXELS, ImageCodec
from atari_dqn.runs.files import project_root

RARE = {
    *("warmup_games", "warmup_learning_rate", "initial_weights", "freeze_convolutions"),
    "transferred_layers",
}


def conv_output(size: int, kernel: int, stride: int, padding: int = 0, dilation: int = 1) -> int:
    """Side of a convolution's output in pixels (PyTorch's documentation of Conv2d)."""
    return (size + 2 * padding - dilation * (kernel - 1) - 1) // stride + 1


def layer_table() -> pd.DataFrame:
    """The convolutions of the Nature network: output size by the formula, and the real one."""
    stack = 4  # images
    network = AGENTS["dqn"].network(stack, actions=18)
    rows: list[dict[str, Any]] = []

    def record(layer: nn.Module, inputs: tuple, output: torch.Tensor) -> None:
        side, kernel, stride = inputs[0].shape[2], layer.kernel_size[0], layer.stride[0]
        by_formula = conv_output(side, kernel, stride, layer.padding[0], layer.dilation[0])
        rows.append(
            {
                "layer": len(rows) + 1,
                "input": f"{side} × {side} × {layer.in_channels}",
                "kernel": f"{kernel} × {kernel}",
                "stride": stride,
                "side by the formula": by_formula,
                "side of the module": output.shape[2],
                "output": f"{output.shape[2]} × {output.shape[3]} × {output.shape[1]}",
                "weights": f"{sum(weight.numel() for weight in layer.parameters()):,}",
            }
        )

    for layer in network.modules():
        if isinstance(layer, nn.Conv2d):
            layer.register_forward_hook(record)
    network(torch.zeros(1, 84, 84, stack, dtype=torch.uint8))
    return pd.DataFrame(rows)


def listing(*things: Callable) -> str:
    """The source of functions, as a block of code."""
    code = (textwrap.dedent(inspect.getsource(thing)).rstrip() for thing in things)
    return "```python\n" + "\n\n\n".join(code) + "\n```"


def memory_text(images: int = 2000) -> str:
    """A paragraph on how small the images of both games become, measured on random play."""
    sizes = {name: np.mean(_compressed_sizes(name, images)) for name in ("boxing", "breakout")}
    measured = " and ".join(
        f"{size:.0f} bytes in {GAMES[name].title}" for name, size in sizes.items()
    )
    million = {name: size * 1e6 / 1e9 for name, size in sizes.items()}
    return (
        f"Measured on {images:,} images of random play, an image of {PIXELS:,} bytes takes "
        f"{measured} on average: a million of them would take "
        + " and ".join(f"{size:.2f} GB" for size in million.values())
        + "."
        + _full_memory()
    )


def _full_memory() -> str:
    """What full memories were measured to hold, with what they keep beside the images; empty where
    that has not been measured."""
    path = project_root() / "results" / "benchmarks" / "memory.csv"
    if not path.exists():
        return ""
    last = pd.read_csv(path).groupby("game").tail(1)
    held = " and ".join(
        f"{row.resident_megabytes / 1000:.2f} GB in {GAMES[row.game].title}"
        for row in last.itertuples()
    )
    return f" A memory of {last.transitions.max():,} transitions was measured to hold {held}."


def exploration_text(p: Parameters) -> str:
    """How a set-up explores, and when it renews its target network."""
    fall = np.log(p.epsilon_floor / p.epsilon_start) / np.log(p.epsilon_decay)
    return (
        f"The probability of a random action starts at {p.epsilon_start:g} and is multiplied by "
        f"{p.epsilon_decay:g} for every finished game until it reaches its floor of "
        f"{p.epsilon_floor:g}, after {fall:,.0f} games. The target network is a copy of the online "
        f"network that is renewed every {p.target_update_period:,} updates, so that the target "
        "does not move with every step."
    )


def units(p: Parameters) -> pd.DataFrame:
    """What a frame, an agent step, an update and a game are, and how many there are at most."""
    frames = GAMES["boxing"].full_frames
    assert frames is not None
    steps = frames / p.frame_skip
    rows = [
        ("frame", "a picture of the emulator, 1/60\u00a0s", frames),
        ("agent step", f"a decision; {p.frame_skip} frames", steps),
        (
            "update",
            f"a lesson of the network, every {p.update_period} steps",
            steps / p.update_period,
        ),
        ("game", "from the bell to the bell, or to a knock-out", 1),
    ]
    all_games = f"in {p.episodes:,} games of Boxing, at most"
    return pd.DataFrame(
        {
            "unit": unit,
            "is": meaning,
            "in a full game of Boxing": f"{count:,.0f}",
            all_games: _rounded(count * p.episodes),
        }
        for unit, meaning, count in rows
    )


def _rounded(count: float) -> str:
    """Three digits that count, thousands apart."""
    return f"{float(f'{count:.3g}'):,.0f}"


def _compressed_sizes(name: str, images: int) -> list[int]:
    """Bytes of every image of a game of random play, compressed as the replay memory does."""
    game, rng = AtariEnv(name), np.random.default_rng(0)
    image, _ = game.reset(seed=0)
    codec = ImageCodec(image.tobytes())
    sizes = []
    for _ in range(images):
        image, _, terminated, truncated, _ = game.step(int(rng.integers(len(game.actions))))
        sizes.append(len(codec.compress(image.tobytes())))
        if terminated or truncated:
            game.reset()
    return sizes


def settings(of: list[Parameters]) -> pd.DataFrame:
    """A row per training parameter, with its unit and its value in each experiment.

    Parameters that only other experiments use are left out.
    """
    shown = [key for key in Parameters.model_fields if key not in RARE | params.NOT_TRAINING]
    table = pd.DataFrame(
        {
            "parameter": [f"`{key}`" for key in shown],
            "meaning": [Parameters.model_fields[key].description for key in shown],
        }
    )
    for item in of:
        table[f"`{item.experiment}`"] = [_text(getattr(item, key)) for key in shown]
    return table


def differences(of: list[Parameters]) -> pd.DataFrame:
    """A row per experiment: its agents, games, and what differs from the first one's settings."""
    first = of[0]
    rows = []
    for item in of:
        different = [
            f"`{key}` {_text(getattr(item, key))}"
            for key in Parameters.model_fields
            if key not in params.NOT_TRAINING and getattr(item, key) != getattr(first, key)
        ]
        different += [f"variations: {'; '.join(map(spelled, item.variations))}"] * bool(
            item.variations
        )
        rows.append(
            {
                "experiment": f"`{item.experiment}`",
                "agents": "all"
                if len(item.agents) == len(AGENTS)
                else ", ".join(params.title(agent) for agent in item.agents),
                "games": f"{item.episodes:,}",
                "what differs": "; ".join(different) or "–",
            }
        )
    return pd.DataFrame(rows)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        mantissa, exponent = f"{value:e}".split("e")
        return f"{float(mantissa):g}e{int(exponent)}" if 0 < value < 1e-3 else f"{value:g}"
    return f"{value:,}" if type(value) is int else str(value)


def deviations() -> pd.DataFrame:
    """The numbered decisions of notebooks/data/deviations.yaml."""
    return pd.DataFrame(
        [
            {
                "no.": str(number),
                "decision, and why": f"**{entry['what']}** (`{entry['where']}`). "
                f"*Source report:* {entry['source']} *Reason:* {entry['why']}",
            }
            for number, entry in enumerate(data("deviations"), start=1)
        ]
    )
