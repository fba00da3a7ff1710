"""The whole training loop with the native learner and with PyTorch's, side by side in one process.

    python benchmarks/learners.py [--transitions 1000000] [--rounds 12]

Every agent on Boxing as params/boxing_final.yaml has it, and Double DQN on Breakout with a batch of
64: two trainers with full replay memories take turns of a few hundred agent steps, and their CPU
time is counted. Writes learners.csv into results/benchmarks/: agent steps per CPU second of both,
and the ratio with the 90% interval of its median over the rounds; in place of what it has of the
same processor and instructions. Where there is AVX-512,

    export ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2 MKL_ENABLE_INSTRUCTIONS=AVX2
    python benchmarks/learners.py

measures how fast both are without it.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from whole_run import fill

from atari_dqn import params
from atari_dqn.agents import AGENTS
from atari_dqn.runs.files import project_root
from atari_dqn.runs.recorder import processor
from atari_dqn.training import Trainer, prepare_process

TURN, WARM_UP = 320, 320  # agent steps
MACHINE = ["processor", "instructions"]
CASES = [*(("boxing_final", agent) for agent in AGENTS), ("breakout_final", "double_dqn")]


def advance(trainer: Trainer, steps: int) -> float:
    """Agent steps a second of processor time."""
    running, before, start = trainer.run(), trainer.agent_steps, time.process_time()
    while trainer.agent_steps < before + steps:
        next(running)
    return (trainer.agent_steps - before) / (time.process_time() - start)


def compare(experiment: str, agent: str, transitions: int, rounds: int) -> dict[str, object]:
    parameters = params.load(project_root() / "params" / f"{experiment}.yaml")
    trainers = {}
    for learner in ("native", "torch"):
        changes = {"learner": learner, "device": "cpu", "learning_starts": 0}
        trainers[learner] = Trainer(parameters.model_copy(update=changes), agent, seed=1)
    fill(trainers["native"], transitions)
    for name in ("envs", "memory"):  # one memory of that size is enough: both start from it
        getattr(trainers["torch"], name).set_state(getattr(trainers["native"], name).get_state())
    speeds = {learner: [] for learner in trainers}
    for trainer in trainers.values():
        advance(trainer, WARM_UP)
    for _ in range(rounds):
        for learner, trainer in trainers.items():
            speeds[learner].append(advance(trainer, TURN))
    ratios = np.array(speeds["native"]) / np.array(speeds["torch"])
    draws = np.random.default_rng(0).choice(ratios, (10_000, rounds))
    low, high = np.quantile(np.median(draws, axis=1), [0.05, 0.95])
    return {
        "experiment": experiment,
        "agent": agent,
        "native_steps_per_second": round(float(np.median(speeds["native"])), 1),
        "torch_steps_per_second": round(float(np.median(speeds["torch"])), 1),
        "ratio": round(float(np.median(ratios)), 2),
        "low": round(float(low), 2),
        "high": round(float(high), 2),
        "rounds": rounds,
        "transitions": len(trainers["native"].memory),
        "processor": processor(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transitions", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    prepare_process()
    rows = []
    for experiment, agent in CASES:
        rows.append(compare(experiment, agent, chosen.transitions, chosen.rounds))
        print(rows[-1], flush=True)
    chosen.output.mkdir(parents=True, exist_ok=True)
    path, table = chosen.output / "learners.csv", pd.DataFrame(rows)
    if path.exists():
        before = pd.read_csv(path)
        others = ~before.set_index(MACHINE).index.isin(table.set_index(MACHINE).index)
        table = pd.concat([before[others], table])
    table.to_csv(path, index=False)


if __name__ == "__main__":
    main()
