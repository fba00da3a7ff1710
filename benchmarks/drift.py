"""How far apart do the two learners end, that differ by rounding alone?

    python benchmarks/drift.py results/runs/boxing_final/*/seed-1 [--updates 200]

From a run's last weights, with Adam's moments at zero, three learners make the same updates, on
batches of the run's newest games: PyTorch's, the native one, and PyTorch's once more with the
transitions of every batch in another order, which changes no more than the rounding of its sums.
Writes drift.csv into results/benchmarks/, three rows (draws of batches) per run: how far PyTorch's
weights have moved, and how far the two others' are from them (Euclidean norms of the differences).
"""

import argparse
import math
from pathlib import Path

import numpy as np
import pandas as pd
from torch import Tensor

from atari_dqn.agents import AGENTS, Learner
from atari_dqn.envs import make_env
from atari_dqn.native import NativeLearner
from atari_dqn.params import Parameters, stored_parameters
from atari_dqn.replay import Batch, ReplayMemory
from atari_dqn.runs import dataset
from atari_dqn.runs.files import project_root
from atari_dqn.runs.models import read_model
from atari_dqn.runs.recorder import processor
from atari_dqn.training import prepare_process

TRANSITIONS, DRAWS = 20_000, 3


def in_order(batch: Batch, order: np.ndarray) -> Batch:
    return Batch(**{name: values[order] for name, values in vars(batch).items()})


def drift(
    params: Parameters,
    weights: dict[str, Tensor],
    memory: ReplayMemory,
    updates: int,
    rng: np.random.Generator,
) -> dict[str, float]:
    """The three distances after that many updates on batches of the memory."""
    agent, actions = AGENTS[params.agents[0]], len(make_env(params).actions)
    params = params.model_copy(update={"device": "cpu"})
    learners = [kind(agent, actions, params, 0) for kind in (Learner, NativeLearner, Learner)]
    for learner in learners:
        learner.set_state({**learner.get_state(), "online": weights, "target": weights})
    torch_learner, native, permuted = learners
    for _ in range(updates):
        batch = memory.sample(params.batch_size)
        torch_learner.learn(batch)
        native.learn(batch)
        permuted.learn(in_order(batch, rng.permutation(params.batch_size)))
    reference = torch_learner.weights()
    others = {"moved": weights, "native": native.weights(), "permuted": permuted.weights()}
    return {
        name: math.hypot(*(float((of[key] - reference[key]).norm()) for key in weights))
        for name, of in others.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("runs", type=Path, nargs="+", help="stored runs' folders, .../seed-N")
    parser.add_argument("--updates", type=int, default=200)
    parser.add_argument("--output", type=Path, default=project_root() / "results" / "benchmarks")
    chosen = parser.parse_args()
    prepare_process()
    rows = []
    for folder in chosen.runs:
        params, weights = stored_parameters(folder), read_model(folder / "model.safetensors")
        last = int(pd.read_csv(folder / "episodes.csv").episode.max())
        for draw in range(1, DRAWS + 1):
            memory = dataset.rebuilt_memory(folder, last, TRANSITIONS, seed=draw)
            found = drift(params, weights, memory, chosen.updates, np.random.default_rng(draw))
            heading = {"experiment": params.experiment, "agent": params.agents[0], "draw": draw}
            distances = {name: float(f"{distance:.3g}") for name, distance in found.items()}
            rows.append({**heading, "updates": chosen.updates, **distances})
            print(rows[-1], flush=True)
    chosen.output.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(rows).assign(processor=processor())
    table.to_csv(chosen.output / "drift.csv", index=False)


if __name__ == "__main__":
    main()
