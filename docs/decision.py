"""Draws the README's picture, a moment of a game as a stored run's agent decides it.

python docs/decision.py results/runs/boxing_final/double_dqn/seed-1 model.safetensors
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from atari_dqn import evaluation, params
from atari_dqn.envs import AtariEnv, make_env
from atari_dqn.evaluation import q_of
from atari_dqn.report import plots
from atari_dqn.runs.models import load_model

STEPS = 300  # agent steps into the game


def main(folder: Path, model: str) -> None:
    values = params.read_values(folder / "params.yaml")
    parameters = params.parse(values, str(folder / "params.yaml"))
    network = load_model(folder / model, parameters)
    player, game = evaluation.player_of(network, parameters), make_env(parameters)
    images = [game.reset(seed=1)[0].reshape(-1)] * parameters.frame_stack
    for _ in range(STEPS):
        action = q_of(player, np.stack(images)[:, None])[0].argmax()
        images = [*images[1:], game.step(int(action))[0].reshape(-1)]
    draw(game, np.stack(images), q_of(player, np.stack(images)[:, None])[0])


def draw(game: AtariEnv, images: np.ndarray, q_values: np.ndarray) -> None:
    """The television's picture, the observation (images [4, 84*84]) and the Q-values [A]."""
    plots.style()
    plt.rcParams["figure.autolayout"] = False
    figure = plt.figure(figsize=(plots.WIDTH, 2.4))
    parts = figure.add_gridspec(1, 3, width_ratios=[1.5, 2.1, 2.2], wspace=0.55)
    television = figure.add_subplot(parts[0])
    television.imshow(game.render())
    television.axis("off")
    grid = parts[1].subgridspec(2, 2, wspace=0.06, hspace=0.06)
    for place, image in enumerate(images.reshape(-1, 84, 84)):
        panel = figure.add_subplot(grid[place // 2, place % 2])
        panel.imshow(image, cmap="gray", vmin=0, vmax=255)
        panel.axis("off")
    axes = figure.add_subplot(parts[2])
    colours = ["0.6"] * len(q_values)
    colours[int(q_values.argmax())] = plots.STYLES["double_dqn"].colour
    axes.scatter(q_values, [action.name.lower() for action in game.actions], c=colours, s=14)
    axes.set(xlabel="Q-value")
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=5.5)
    metadata = {"Date": None, "Creator": None}
    path = Path(__file__).with_suffix(".svg")
    figure.savefig(path, bbox_inches="tight", metadata=metadata)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
