"""What each optimisation of the training core is worth: the time of an update without it.

    python benchmarks/gains.py [--rounds 5]

Every variant takes one optimisation, and nothing else, out of the code and times gradient steps
(DQN, batch 32, one thread), or the choice of eight actions, in a process of its own; variants take
turns. Writes gains.csv into results/benchmarks/: milliseconds (median of rounds) and their ratio to
what is kept.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn

from atari_dqn import networks, training
from atari_dqn.agents import AGENTS, Learner
from atari_dqn.params import Parameters
from atari_dqn.replay import Batch
from atari_dqn.runs import project_root

BATCH, UPDATES = 32, 120


def no_channels_last() -> None:
    """Convolutions in the order [B, S, 84, 84] that torch uses by default."""

    def forward(self: networks.Convolutions, observations: Tensor) -> Tensor:
        x = observations.permute(0, 3, 1, 2).contiguous().float().mul_(1 / 255)
        return nn.Sequential.forward(self, x).flatten(1)

    networks.Convolutions.forward = forward
    whole = networks.Convolutions.__init__

    def build(self: networks.Convolutions, stack: int) -> None:
        whole(self, stack)
        self.to(memory_format=torch.contiguous_format)

    networks.Convolutions.__init__ = build


def no_onednn_linear() -> None:
    """The hidden layer by torch's own matrix product."""
    networks.Linear.forward = nn.Linear.forward


def no_kept_memory() -> None:
    """Large blocks go back to the system after every use."""

    def prepare() -> None:
        torch.set_num_threads(1)
        torch.set_flush_denormal(True)

    training.prepare_process = prepare


def no_flushed_denormals() -> None:
    """Denormal numbers are computed with. A moment of Adam becomes one only after hundreds of
    updates without a gradient, so that these few hardly show what a long run gains."""
    whole = training.prepare_process

    def prepare() -> None:
        whole()
        torch.set_flush_denormal(False)

    training.prepare_process = prepare


def no_fused_adam() -> None:
    """Adam as a loop over tensors."""
    whole = torch.optim.Adam.__init__

    def build(self, *arguments, **options):
        whole(self, *arguments, **{**options, "fused": False})

    torch.optim.Adam.__init__ = build


VARIANTS: dict[str, Callable[[], None] | None] = {
    "update: as it is": None,
    "update: without channels-last memory": no_channels_last,
    "update: without oneDNN's linear layer": no_onednn_linear,
    "update: without keeping memory": no_kept_memory,
    "update: without flushing denormals": no_flushed_denormals,
    "update: without fused Adam": no_fused_adam,
    "update: target passes one by one": None,
    "eight actions: as it is": None,
    "eight actions: one by one": None,
}


def measure(variant: str) -> float:
    """Milliseconds an update, or a choice of eight actions."""
    change = VARIANTS[variant]
    if change:
        change()
    training.prepare_process()
    parameters = Parameters(experiment="gains", device="cpu")
    learner = Learner(AGENTS["dqn"], 18, parameters, seed=1)
    rng = np.random.default_rng(0)
    together = 1 if variant.endswith("one by one") else 2
    images = rng.integers(256, size=(2, together * BATCH, 84, 84, 4), dtype=np.uint8)
    batch = Batch(
        images[0],
        rng.integers(18, size=together * BATCH),
        np.zeros(together * BATCH, np.float32),
        np.ones(together * BATCH, np.float32),
        images[1],
    )

    def update() -> None:
        learner.learn(batch, together)

    def act() -> None:
        for share in np.split(images[0, :8], 8 if variant.endswith("one by one") else 1):
            learner.q_values(share)

    updating = variant.startswith("update")
    each, work = (together, update) if updating else (1, act)
    times = []
    for _ in range(UPDATES // each):
        start = time.perf_counter()
        work()
        times.append((time.perf_counter() - start) / each)
    return float(np.median(times)) * 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--variant", help="measure this one only, and print it")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    if chosen.variant:
        print(json.dumps(measure(chosen.variant)))
        return
    found: dict[str, list[float]] = {variant: [] for variant in VARIANTS}
    for _ in range(chosen.rounds):
        for variant, times in found.items():
            command = [sys.executable, __file__, "--variant", variant]
            times.append(json.loads(subprocess.check_output(command, text=True)))
    medians = {variant: float(np.median(times)) for variant, times in found.items()}
    rows = [
        {
            "variant": variant,
            "milliseconds": round(median, 2),
            "low": round(min(found[variant]), 2),
            "high": round(max(found[variant]), 2),
            "ratio": round(median / medians[f"{variant.partition(':')[0]}: as it is"], 3),
        }
        for variant, median in medians.items()
    ]
    chosen.output.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(chosen.output / "gains.csv", index=False)
    print(pd.DataFrame(rows).to_string(index=False))


if __name__ == "__main__":
    main()
