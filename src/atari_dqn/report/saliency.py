"""What a network looks at: how much its values change when a place of what it sees is blurred
(Greydanus et al., 2018), and the patterns that its first layer looks for."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pandas as pd
import torch
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from torch import nn

from atari_dqn import params
from atari_dqn.agents import AGENTS, initial_network
from atari_dqn.analysis.study import Section
from atari_dqn.envs import SIZE, EpisodeRecord, make_env
from atari_dqn.report.outputs import show_figure, show_placeholders, show_table
from atari_dqn.report.plots import WIDTH
from atari_dqn.runs import models, records
from atari_dqn.runs.dataset import Trajectory, trajectory
from atari_dqn.runs.run import Run

STRIDE = 4  # pixels between the places that are blurred
STILL = 0.01  # of the largest weight: a change that no colour shows
REACHED = 0.995  # the share of the weights that lie on the colours' scale
BLUR = 3.0  # pixels, standard deviation: of the blur, and of the place's soft edge


@dataclass(frozen=True)
class Saliency:
    """Maps [21, 21] of how much a network's values depend on each place of an observation."""

    value: np.ndarray  # points; of the state's value, here the mean over all actions
    advantages: np.ndarray  # points; of what sets the actions apart, root mean square over them


def places() -> np.ndarray:
    """Soft masks float32 [441, 84, 84, 1], one per place, 1 in its middle."""
    centres = np.arange(STRIDE // 2, SIZE, STRIDE)
    pixels = np.arange(SIZE)
    near = np.exp(-((pixels - centres[:, None]) ** 2) / (2 * BLUR**2))  # [21, 84]
    masks = near[:, None, :, None] * near[None, :, None, :]  # [21, 21, 84, 84]
    return masks.reshape(-1, SIZE, SIZE, 1).astype(np.float32)


@torch.no_grad()
def saliency(network: nn.Module, observation: np.ndarray) -> Saliency:
    """Of a network that sees bytes [84, 84, S]. A dueling network's V is the mean of its values
    over the actions, so that the two maps are those of its streams."""
    blurred = np.stack(
        [cv2.GaussianBlur(image, (0, 0), BLUR) for image in np.moveaxis(observation, -1, 0)], -1
    )
    masks = places()
    seen = observation * (1 - masks) + blurred * masks  # [441, 84, 84, S]
    device = next(network.parameters()).device
    values = network(torch.from_numpy(np.concatenate([observation[None], seen])).to(device))
    state = values.mean(dim=1)  # [442]
    advantages = values - state[:, None]  # [442, A]
    side = len(range(STRIDE // 2, SIZE, STRIDE))
    return Saliency(
        (state[1:] - state[0]).abs().cpu().numpy().reshape(side, side),
        (advantages[1:] - advantages[0]).pow(2).mean(1).sqrt().cpu().numpy().reshape(side, side),
    )


@torch.no_grad()
def spreads(network: nn.Module, observations: np.ndarray) -> dict[str, float]:
    """How much of a network's values is the state's, in observations [N, 84, 84, S]: Q(s, a) is
    V(s) + A(s, a), with V the mean over the actions (Wang et al., 2016, equation 9)."""
    device = next(network.parameters()).device
    values = torch.cat(
        [network(part.to(device)) for part in torch.from_numpy(observations).split(256)]
    )  # [N, A]
    state = values.mean(1)  # [N]
    best = values.topk(2, dim=1).values  # [N, 2]
    between, within = state.var(correction=0), (values - state[:, None]).pow(2).mean()
    return {
        "value of a state": state.mean().item(),
        "spread between states": between.sqrt().item(),
        "spread between actions": within.sqrt().item(),
        "gap of the best two": (best[:, 0] - best[:, 1]).mean().item(),
        "the state's share, %": 100 * (between / (between + within)).item(),
    }


def show_spreads(section: Section) -> pd.DataFrame:
    """How far apart values lie between the states of a game, and between the actions in one, to
    every stored network of the section's runs; returns the table."""
    table, rows = f"tbl-{section.slug}-spreads", list[dict[str, object]]()
    if (game := first_game(section)) is None:
        show_placeholders(table)
        return pd.DataFrame(rows)
    player, seen = game
    for run in section.usable:
        heading: dict[str, object] = {"agent": params.title(run.agent)}
        if len(section.params.seeds) > 1:
            heading["seed"] = run.seed
        for games, network in models.along_training(run):
            rows.append(heading | {"games": games} | spreads(network, seen))
    show_table(
        pd.DataFrame(rows),
        label=table,
        caption=f"{section.title}: how much of an agent's values is the state's, after so many "
        f"training games, in every state of one game, {params.title(player.agent)}'s first "
        "evaluation game: the mean value of a state, standard deviations of the states' values and "
        "of the actions' around them, how far the best action is above the second, and the part of "
        "the values' variance that lies between states.",
        decimals=2,
    )
    return pd.DataFrame(rows)


def first_game(section: Section) -> tuple[Run, np.ndarray] | None:
    """The first of a section's runs that has been evaluated, and what it saw in its first
    evaluation game, bytes [steps, 84, 84, stack]; None before."""
    for run in section.usable:
        if (record := first_evaluated(run)) is not None:
            game, stack = trajectory(run.params, record), run.params.frame_stack
            steps = range(len(game.actions))
            return run, np.stack([observation_at(game, step, stack) for step in steps])
    return None


def observation_at(game: Trajectory, step: int, stack: int) -> np.ndarray:
    """What an agent sees of a game before agent step `step` (0, 1, ...): bytes [84, 84, stack]."""
    return np.stack([game.observations[max(0, step - back)] for back in reversed(range(stack))], -1)


def figure(observations: dict[str, np.ndarray], networks: dict[str, nn.Module]) -> Figure:
    """A row per observation (bytes [84, 84, S], by its title): the newest image, and over it two
    maps per network, each on a scale of its own."""
    columns = 1 + 2 * len(networks)
    height = 1.15 * WIDTH / columns * len(observations) + 0.5
    drawing, panels = plt.subplots(
        len(observations), columns, figsize=(WIDTH, height), squeeze=False
    )
    for place, (row, (title, observation)) in enumerate(
        zip(panels, observations.items(), strict=True)
    ):
        newest = observation[..., -1]
        row[0].imshow(newest, cmap="gray", vmin=0, vmax=255)
        row[0].set_ylabel(title, fontsize="small")
        for number, (name, network) in enumerate(networks.items()):
            found = saliency(network, observation)
            for column, kind in enumerate(("value", "advantages")):
                axes = row[1 + 2 * number + column]
                axes.imshow(newest, cmap="gray", vmin=0, vmax=255)
                heat = getattr(found, kind) / max(getattr(found, kind).max(), 1e-9)
                axes.imshow(
                    heat,
                    cmap="inferno",
                    alpha=heat,
                    extent=(0, SIZE, SIZE, 0),
                    interpolation="bicubic",
                )
                if place == 0:
                    axes.set_title(f"{textwrap.fill(name, 14)}\n{kind}", fontsize="small")
        for axes in row:
            axes.set(xticks=[], yticks=[])
    panels[0][0].set_title("seen\n(newest image)", fontsize="small")
    drawing.tight_layout()
    return drawing


def filters_figure(networks: dict[str, nn.Module]) -> Figure:
    """The kernels of each network's first layer, 8 by 8 pixels: a column per kernel, and from top
    to bottom the oldest to the newest of the images that it is laid over. Red is positive; one
    scale for all, whose ends few weights pass."""
    drawing, panels = plt.subplots(
        len(networks), 1, figsize=(WIDTH, 1.1 * len(networks) + 0.2), squeeze=False
    )
    found = {name: first_layer(network.state_dict()) for name, network in networks.items()}
    most = np.quantile(np.abs(np.stack(list(found.values()))), REACHED)
    for axes, (name, kernels) in zip(panels[:, 0], found.items(), strict=True):
        padded = np.pad(kernels, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=np.nan)
        sheet = np.block([[kernel[image] for kernel in padded] for image in range(padded.shape[1])])
        axes.imshow(sheet, cmap="RdBu_r", vmin=-most, vmax=most)
        axes.set_title(name, fontsize="small", loc="left")
        axes.axis("off")
    drawing.tight_layout()
    return drawing


def first_layer(weights: Mapping[str, torch.Tensor]) -> np.ndarray:
    """The kernels of a network's first layer, float32 [32, S, 8, 8]."""
    return weights["convolutions.0.weight"].cpu().numpy()


def start_of(run: Run) -> np.ndarray:
    """The kernels of the first layer that a run's training started from (`training.Trainer`)."""
    weights_seed = int(np.random.SeedSequence(run.seed).spawn(4)[3].generate_state(1)[0])
    initial, actions = models.initial_weights(run), len(make_env(run.params).actions)
    network = initial_network(AGENTS[run.agent], actions, run.params, weights_seed, initial)
    return first_layer(network.state_dict())


def unlearned(networks: dict[str, nn.Module], runs: dict[str, Run]) -> str:
    """A sentence on the kernels of the first layer that are in every network still those that it
    started from: none of their weights has moved by `STILL` of the largest there are. Empty where
    there are none."""
    kernels = np.stack([first_layer(network.state_dict()) for network in networks.values()])
    starts = np.stack([start_of(runs[name]) for name in networks])
    moved, most = np.abs(kernels - starts).max((2, 3, 4)), np.abs(kernels).max()
    idle = np.flatnonzero((moved < STILL * most).all(axis=0))
    if not len(idle):
        return ""
    numbers = ", ".join(str(number + 1) for number in idle)
    noun, verb = ("Columns", "have") if len(idle) > 1 else ("Column", "has")
    return (
        f" {noun} {numbers}, counted from the left, {verb} learned nothing in any of these "
        f"networks: no weight is more than {moved[:, idle].max():.3f} from where it was drawn "
        f"(the largest weight of all is {most:.2f})."
    )


# Parts of a picture of Boxing, in places: the score and the clock, and the ring within its ropes
PARTS = {
    "score and clock": (slice(0, 3), slice(None)),
    "ring": (slice(3, 19), slice(4, 18)),
}
SAMPLED = 50  # agent steps between the states that the shares are means over


def shares(maps: list[np.ndarray]) -> dict[str, float]:
    """How the maps' sum is shared among the parts of the picture, in percent."""
    total = np.sum(maps, axis=0)
    parts = {name: 100 * float(total[place].sum() / total.sum()) for name, place in PARTS.items()}
    return parts | {"elsewhere": 100 - sum(parts.values())}


def show_saliency(section: Section) -> pd.DataFrame:
    """What the network of each evaluated agent looks at in one game, and their first layers.
    Returns where the changes come from in Boxing: `shares` by agent and what changes, the last row
    as if all places counted alike; no rows where none are shown."""
    rows: list[dict[str, Any]] = []
    label, kernels = f"fig-{section.slug}-saliency", f"fig-{section.slug}-filters"
    table = f"tbl-{section.slug}-saliency"
    found = [(run, record) for run in section.usable if (record := first_evaluated(run))]
    if not found:
        show_placeholders(label, kernels, table)
        return pd.DataFrame(rows)
    player, record = found[0]
    game, stack = trajectory(player.params, record), player.params.frame_stack
    last = len(game.actions) - 1
    steps = {"a quarter": last // 4, "half": last // 2, "the last step": last}
    observations = {name: observation_at(game, step, stack) for name, step in steps.items()}
    shown = {params.title(run.agent): run for run, _ in found if run.seed == player.seed}
    networks = {
        name: models.load_model(run.folder / "model.safetensors", run.params)
        for name, run in shown.items()
    }
    show_figure(
        figure(observations, networks),
        label=label,
        caption=f"{section.title}: what changes when a place is blurred: the value of the state, "
        "and the advantages of the actions over one another (bright: much, each map on its own "
        f"scale). One game by {params.title(player.agent)}, its first evaluation game, at three "
        "moments.",
        alt="Pictures of one game with bright spots where the networks look.",
        data=section.origin,
    )
    if section.facts.boxers is not None:
        sampled = [observation_at(game, step, stack) for step in range(0, last, SAMPLED)]
        for name, network in networks.items():
            seen = [saliency(network, each) for each in sampled]
            for kind in ("value", "advantages"):
                maps = [getattr(each, kind) for each in seen]
                rows.append({"agent": name, "what changes": kind, **shares(maps)})
        even = {"agent": "if all places", "what changes": "counted alike"}
        rows.append({**even, **shares([np.ones_like(maps[0])])})
        show_table(
            pd.DataFrame(rows),
            label=table,
            caption=f"{section.title}: where the changes come from, in percent: the sum of the "
            f"maps of {len(sampled)} states of that game, one every {SAMPLED} steps. Last, the "
            "parts' shares of all places.",
            decimals=0,
        )
    show_figure(
        filters_figure(networks),
        label=kernels,
        caption=f"{section.title}: the 32 patterns of each first layer: a column each, from the "
        "oldest image (top) to the newest. Red adds, blue takes away; one scale for all of them."
        + unlearned(networks, shown),
        alt="Small patterns of red and blue for each network's first layer.",
        data=section.origin,
    )
    return pd.DataFrame(rows)


def first_evaluated(run: Run) -> EpisodeRecord | None:
    """The record of the first evaluation game, as it was trained, of a run's newest model; None
    without one."""
    return evaluated(run).get(0)


def evaluated(run: Run) -> dict[int, EpisodeRecord]:
    """The records of all those evaluation games, by their numbers."""
    if not (run.folder / records.FILE).exists():
        return {}
    games = records.as_trained(run.params, records.read_file(run.folder, torn=True))
    newest = max((heading["trained_games"] for heading, _ in games), default=0)
    return {
        heading["game"]: record for heading, record in games if heading["trained_games"] == newest
    }
