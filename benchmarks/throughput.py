"""Training speed beside the peers': agent steps per second of the whole machine, in one run.

    make bench            or    python benchmarks/throughput.py --peers .venv-bench/bin/python

Every contestant does the unit of work of `workload.py` in processes of its own. All set-ups take
part in the first two rounds, and each library's best of those in the others; contestants take
turns, so that a slow spell of the machine meets them all. Writes throughput.csv (median, lowest and
highest round), throughput.svg and machine.json into results/benchmarks/.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from ale_py import roms
from torch import nn
from workload import BATCH, UPDATE_PERIOD

from atari_dqn.agents import AGENTS
from atari_dqn.envs import ALEInterface
from atari_dqn.report import plots
from atari_dqn.report.cost import OURS, best_setups, draw_throughput
from atari_dqn.runs.files import project_root
from atari_dqn.runs.recorder import processor
from atari_dqn.training import prepare_process

HERE = Path(__file__).parent
CORES = os.cpu_count() or 1
TRIALS = 2  # rounds of all set-ups; one alone may be a slow spell's
SCRIPTS = {OURS: "run_ours.py", "Stable-Baselines3": "run_sb3.py", "Tianshou": "run_tianshou.py"}


# The speed of a machine that does nothing but emulation and the necessary arithmetic at its highest
# speed: what is necessary for direct convolutions, or by the best algorithm that is known for them.
ROOFLINES = {"share_of_direct_roofline": False, "share_of_needed_roofline": True}


@dataclass(frozen=True)
class Contestant:
    """A library in one set-up: `processes` of `threads` each, all at once."""

    library: str
    agent: str
    processes: int
    threads: int
    environments: int

    @property
    def setup(self) -> str:
        several = "one process per core" if self.processes > 1 else "one process"
        return f"{several}, {self.threads} thread{'s' * (self.threads > 1)}"

    def measure(self, peers: str, steps: int) -> float:
        """Agent steps a second, all processes together."""
        python = sys.executable if self.library == OURS else peers
        command = [python, str(HERE / SCRIPTS[self.library]), f"--agent={self.agent}"]
        command += [f"--environments={self.environments}", f"--threads={self.threads}"]
        command += [f"--steps={steps}"]
        environment = {**os.environ, "OMP_NUM_THREADS": str(self.threads)}
        environment["PYTHONWARNINGS"] = "ignore"
        running = [
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
            )
            for _ in range(self.processes)
        ]
        speed = 0.0
        for process in running:
            output, errors = process.communicate()
            if process.returncode:
                raise SystemExit(f"{self} failed:\n{errors[-2000:]}")
            result = json.loads(output.splitlines()[-1])
            speed += result["steps"] / result["seconds"]
        return speed


def contestants() -> Iterator[Contestant]:
    for library in SCRIPTS:
        # Double DQN is measured where a library has it: Stable-Baselines3 has not.
        agents = ["dqn"] if library == "Stable-Baselines3" else ["dqn", "double_dqn"]
        for agent in agents:
            for environments in (1, 8):
                yield Contestant(library, agent, 1, CORES, environments)
                yield Contestant(library, agent, CORES, 1, environments)
    yield Contestant(OURS, "dqn", 1, 1, 8)  # what a second core brings


def matrix_peak() -> float:
    """Float32 operations a second of one core, by torch's matrix product."""
    size, best = 1024, 0.0
    x, weight = torch.randn(size, size), torch.randn(size, size)
    for _ in range(40):
        start = time.perf_counter()
        torch.mm(x, weight)
        best = max(best, 2 * size**3 / (time.perf_counter() - start))
    return best


def emulation_seconds(steps: int = 3000) -> float:
    """Seconds that the emulator alone takes for an agent step of Boxing (4 frames)."""
    ale = ALEInterface()
    ale.loadROM(roms.get_rom_path("boxing"))
    actions = ale.getMinimalActionSet()
    choices = np.random.default_rng(0).integers(len(actions), size=steps)
    start = time.perf_counter()
    for choice in choices:
        if ale.game_over():
            ale.reset_game()
        for _ in range(4):
            ale.act(actions[choice])
    return (time.perf_counter() - start) / steps


def layer_operations(agent: str) -> list[tuple[nn.Module, int, bool]]:
    """Every layer with its float operations an image, forwards, and whether its input needs a
    gradient (pixels need none)."""
    found = []
    network = AGENTS[agent].network(4, 18)

    def count(layer: nn.Module, inputs: tuple, output: torch.Tensor) -> None:
        each = 2 * layer.weight[0].numel() * output[0].numel()
        found.append((layer, each, inputs[0].shape[1] != 4))

    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            layer.register_forward_hook(count)
    network(torch.zeros(1, 84, 84, 4, dtype=torch.uint8))
    return found


# Multiplications of a Cook-Toom convolution (native/learner.cpp) as a share of the direct one's: it
# needs (m + r - 1)^2 for a tile of m x m outputs of an r x r filter. By inputs of the layer.
COOK_TOOM = {
    4: 25 * 25 / (20 * 20 * 4),  # F(4, 2), 5x5 tiles for 20x20 outputs; 2x2 taps of blocks
    32: 9 * 16 / (9 * 9 * 4),  # F(3, 2), 3x3 tiles for 9x9 outputs
    64: 4 * 36 / (7 * 7 * 9),  # F(4, 3), 2x2 tiles for 7x7 outputs
}


def operations(agent: str, needed: bool = False) -> float:
    """Float operations of an agent step: its share of an update, and selecting its action. By
    direct convolutions, or those that are really needed: by Cook-Toom convolutions, transforms
    left out."""
    layers = [
        (each * (COOK_TOOM[layer.in_channels] if needed and isinstance(layer, nn.Conv2d) else 1), d)
        for layer, each, d in layer_operations(agent)
    ]
    forward = sum(each for each, _ in layers)
    to_input = sum(each for each, wanted in layers if wanted)
    # target on s', online on s, the gradients of weights and of inputs; Double: online on s' too
    passes = 3 * forward + to_input + (forward if agent == "double_dqn" else 0)
    return BATCH * passes / UPDATE_PERIOD + forward


def finalists(speeds: dict[Contestant, list[float]]) -> list[Contestant]:
    """Each library's best set-up with each agent, by the trials; and ours on one core."""
    trials = {contestant: np.median(found[:TRIALS]) for contestant, found in speeds.items()}
    best: dict[tuple[str, str], Contestant] = {}
    for contestant, speed in trials.items():
        key = (contestant.library, contestant.agent)
        if key not in best or speed > trials[best[key]]:
            best[key] = contestant
    alone = [contestant for contestant in speeds if contestant.processes * contestant.threads == 1]
    return [*best.values(), *alone]


def table(
    speeds: dict[Contestant, list[float]], rooflines: dict[str, dict[str, float]]
) -> pd.DataFrame:
    """A row per contestant; shares and ratios are of medians. `rooflines`: agent steps per second
    of a core, by the name of the share's column and by agent."""
    medians = {contestant: float(np.median(found)) for contestant, found in speeds.items()}
    rows = []
    for contestant, found in speeds.items():
        peers = [
            speed
            for other, speed in medians.items()
            if other.library != OURS and other.agent == contestant.agent
        ]
        cores = contestant.processes * contestant.threads
        rows.append(
            {
                "library": contestant.library,
                "setup": contestant.setup,
                "agent": contestant.agent,
                "processes": contestant.processes,
                "environments": contestant.environments,
                "steps_per_second": round(medians[contestant], 1),
                "low": round(min(found), 1),
                "high": round(max(found), 1),
                "rounds": len(found),
                "ratio_to_best_peer": round(medians[contestant] / max(peers), 2),
                **{
                    name: round(medians[contestant] / (speeds[contestant.agent] * cores), 3)
                    for name, speeds in rooflines.items()
                },
            }
        )
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peers", required=True, help="the Python that has the peers")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--steps", type=int, default=3000, help="agent steps timed a process")
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    prepare_process()
    field = list(contestants())
    speeds: dict[Contestant, list[float]] = {contestant: [] for contestant in field}
    peaks, emulations = [], []
    for turn in range(chosen.rounds):
        peaks.append(matrix_peak())
        emulations.append(emulation_seconds())
        for contestant in field if turn < TRIALS else finalists(speeds):
            speed = contestant.measure(chosen.peers, chosen.steps)
            speeds[contestant].append(speed)
            print(f"round {turn + 1}: {contestant} {speed:.0f} steps/s", flush=True)
    peak, emulation = float(np.median(peaks)), float(np.median(emulations))
    agents = ("dqn", "double_dqn")
    rooflines = {
        name: {agent: 1 / (operations(agent, needed) / peak + emulation) for agent in agents}
        for name, needed in ROOFLINES.items()
    }
    chosen.output.mkdir(parents=True, exist_ok=True)
    measured = table(speeds, rooflines)
    measured.to_csv(chosen.output / "throughput.csv", index=False)
    plots.style()
    figure = draw_throughput(best_setups(measured))
    figure.savefig(chosen.output / "throughput.svg", metadata={"Date": None, "Creator": None})
    machine = {
        "processor": processor(),
        "cores": CORES,
        "float32_gflops_per_core": round(peak / 1e9, 1),
        "emulation_ms_an_agent_step": round(emulation * 1e3, 3),
        "megaflop_an_agent_step": {
            name: {agent: round(operations(agent, needed) / 1e6, 1) for agent in agents}
            for name, needed in ROOFLINES.items()
        },
        "roofline_steps_per_second_a_core": {
            name: {agent: round(speed, 1) for agent, speed in speeds_of.items()}
            for name, speeds_of in rooflines.items()
        },
        "rounds": chosen.rounds,
        "agent_steps_timed": chosen.steps,
        "update_period": UPDATE_PERIOD,
    }
    (chosen.output / "machine.json").write_text(json.dumps(machine, indent=1) + "\n")
    print(measured.to_string(index=False))
    print(json.dumps(machine, indent=1))


if __name__ == "__main__":
    main()
