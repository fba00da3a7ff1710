"""Where the time of a training step goes: one process, one thread, the unit of work of workload.py.

    python benchmarks/breakdown.py

Writes breakdown.csv into results/benchmarks/: part, milliseconds per update, share, and, for what
is arithmetic, the speed it reaches as a share of the processor's float32 matrix peak: counted are
the operations of direct convolutions, of which the native learner needs fewer, so its share may
pass 1.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
from throughput import layer_operations, matrix_peak, operations
from workload import BATCH, CAPACITY, EPSILON, LEARNING_STARTS, UPDATE_PERIOD, WARM_UP

from atari_dqn.params import Parameters
from atari_dqn.runs.files import project_root
from atari_dqn.runs.recorder import processor
from atari_dqn.training import Trainer, prepare_process

UPDATES = 400


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
    spent: dict[str, float] = {}

    def timed(part: str, function: Callable) -> Callable:
        def measured(*arguments: Any) -> Any:
            start = time.perf_counter()
            result = function(*arguments)
            spent[part] = spent.get(part, 0.0) + time.perf_counter() - start
            return result

        return measured

    trainer.memory.sample = timed("sampling", trainer.memory.sample)
    trainer.memory.append = timed("storing", trainer.memory.append)
    trainer.envs.step = timed("emulation and preprocessing", trainer.envs.step)
    trainer.learner.q_values = timed("selecting actions", trainer.learner.q_values)
    trainer.learner.learn = timed("update", trainer.learner.learn)
    before, start = trainer.learner.updates, time.perf_counter()
    while trainer.learner.updates < before + UPDATES:
        next(steps)
    whole = time.perf_counter() - start
    updates = trainer.learner.updates - before
    spent["everything else"] = whole - sum(spent.values())
    acting = UPDATE_PERIOD * sum(each for _, each, _ in layer_operations("dqn"))
    arithmetic = {
        "update": UPDATE_PERIOD * operations("dqn") - acting,
        "selecting actions": acting,
    }
    table = pd.DataFrame(
        {
            "part": part,
            "milliseconds_per_update": round(seconds / updates * 1e3, 3),
            "share": round(seconds / whole, 3),
            "share_of_peak": (
                round(arithmetic[part] * updates / seconds / peak, 2) if part in arithmetic else ""
            ),
        }
        for part, seconds in sorted(spent.items(), key=lambda item: -item[1])
    )
    table["processor"] = processor()
    chosen.output.mkdir(parents=True, exist_ok=True)
    table.to_csv(chosen.output / "breakdown.csv", index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
