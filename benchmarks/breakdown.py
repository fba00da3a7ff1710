"""Where the time of a training step goes: one process, one thread, the unit of work of workload.py.

    python benchmarks/breakdown.py

Writes breakdown.csv into results/benchmarks/: part, milliseconds an update, share, and, for what is
arithmetic, the speed it reaches as a share of the processor's float32 matrix peak. Measuring adds
a few per cent to the whole, mostly to the small parts.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from throughput import layer_operations, matrix_peak
from torch import nn
from torch.profiler import ProfilerActivity, profile, record_function
from workload import BATCH, CAPACITY, EPSILON, LEARNING_STARTS, UPDATE_PERIOD, WARM_UP

from atari_dqn.params import Parameters
from atari_dqn.runs import project_root
from atari_dqn.training import Trainer, prepare_process

UPDATES = 200
# torch's operators, by what they do here
OPERATORS = {
    "aten::mkldnn_convolution": "convolutions, forward",
    "aten::convolution_backward": "convolutions, backward",
    "mkldnn::_linear_pointwise": "hidden linear layer, forward and backward",
    "aten::_fused_adam_": "Adam",
    "aten::copy_": "bytes to floats",
    "aten::mul_": "bytes to floats",
    "aten::clamp_min_": "ReLU",
    "aten::threshold_backward": "ReLU",
}


def named(name: str, function: Callable) -> Callable:
    def recorded(*arguments: Any) -> Any:
        with record_function(name):
            return function(*arguments)

    return recorded


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    prepare_process()
    peak = matrix_peak()
    parameters = Parameters(
        experiment="benchmark",
        device="cpu",
        batch_size=BATCH,
        epsilon_start=EPSILON,
        update_period=UPDATE_PERIOD,
        replay_capacity=CAPACITY,
        learning_starts=LEARNING_STARTS,
    )
    trainer = Trainer(parameters, "dqn", seed=1)
    steps = trainer.run()
    while trainer.agent_steps < LEARNING_STARTS + WARM_UP:
        next(steps)
    trainer.memory.sample = named("sampling", trainer.memory.sample)
    trainer.memory.append = named("storing", trainer.memory.append)
    trainer.games.step = named("emulation and preprocessing", trainer.games.step)
    trainer.learner.q_values = named("selecting actions", trainer.learner.q_values)
    before, start = trainer.learner.updates, time.perf_counter()
    with profile(activities=[ProfilerActivity.CPU]) as profiled:
        while trainer.learner.updates < before + UPDATES:
            next(steps)
        seconds = time.perf_counter() - start
    updates = trainer.learner.updates - before
    table = parts(profiled, seconds, updates)
    arithmetic = operations()
    table["share_of_peak"] = [
        round(arithmetic[part] / (milliseconds / 1e3) / peak, 2) if part in arithmetic else ""
        for part, milliseconds in zip(table.part, table.milliseconds_an_update, strict=True)
    ]
    chosen.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(chosen.output / "breakdown.csv", index=False)
    print(table.to_string(index=False))


def operations() -> dict[str, float]:
    """Float operations an update, by part: the target's and the online network's passes."""
    counted = dict.fromkeys(OPERATORS.values(), 0)
    for layer, each, to_input in layer_operations("dqn"):
        if isinstance(layer, nn.Conv2d):
            counted["convolutions, forward"] += 2 * BATCH * each
            counted["convolutions, backward"] += (1 + to_input) * BATCH * each
        elif layer.out_features == 512:
            counted["hidden linear layer, forward and backward"] += 4 * BATCH * each
    counted["selecting actions"] = UPDATE_PERIOD * sum(e for _, e, _ in layer_operations("dqn"))
    return {part: number for part, number in counted.items() if number}


def parts(profiled: profile, seconds: float, updates: int) -> pd.DataFrame:
    """Milliseconds an update of every part; what no part accounts for is a part too."""
    ours = {"sampling", "storing", "emulation and preprocessing", "selecting actions"}
    spent: dict[str, float] = {}
    for event in profiled.events():
        outer = event
        while outer is not None and outer.name not in ours:
            outer = outer.cpu_parent
        if outer is not None:  # within one of our own parts
            part = outer.name if event is outer else None
            spent_now = event.cpu_time_total
        else:
            part, spent_now = OPERATORS.get(event.name), event.self_cpu_time_total
        if part:
            spent[part] = spent.get(part, 0.0) + spent_now
    milliseconds = {part: microseconds / 1e3 / updates for part, microseconds in spent.items()}
    whole = seconds * 1e3 / updates
    milliseconds["everything else"] = whole - sum(milliseconds.values())
    rows = [
        {
            "part": part,
            "milliseconds_an_update": round(value, 3),
            "share": round(value / whole, 3),
        }
        for part, value in sorted(milliseconds.items(), key=lambda item: -item[1])
    ]
    return pd.DataFrame(rows)


if __name__ == "__main__":
    main()
