"""The unit of work that every contestant of `throughput.py` does, and its stopwatch.

Boxing, Nature network, batch 32, one update every 4 agent steps, replay capacity 100,000, learning
on, epsilon 0.1, everything included.
"""

import argparse
import json
import time

import torch

BATCH, UPDATE_PERIOD, CAPACITY, LEARNING_STARTS = 32, 4, 100_000, 1000
# Late in a run; early on, a library that asks no network for a random action would do less work.
EPSILON = 0.1
WARM_UP = 800  # agent steps after learning starts that are not timed


def arguments() -> argparse.Namespace:
    """--agent, --environments, --threads, --steps; sets torch's threads."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--agent", choices=["dqn", "double_dqn"], default="dqn")
    parser.add_argument("--environments", type=int, default=8)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--steps", type=int, default=3000, help="agent steps that are timed")
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    return chosen


class Stopwatch:
    """Times the agent steps from LEARNING_STARTS + WARM_UP on."""

    def __init__(self, steps: int):
        self.steps = steps
        self.start: tuple[int, float] | None = None

    def finished(self, agent_steps: int) -> bool:
        """To be told after every step; prints the result and is true when the time is taken."""
        if self.start is None:
            if agent_steps >= LEARNING_STARTS + WARM_UP:
                self.start = (agent_steps, time.perf_counter())
            return False
        done = agent_steps - self.start[0]
        if done < self.steps:
            return False
        print(json.dumps({"steps": done, "seconds": time.perf_counter() - self.start[1]}))
        return True
