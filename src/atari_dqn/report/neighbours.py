"""States that are alike to a network: those nearest to one another in its last hidden layer.

What the last linear layer is given is all that the values are made of. Mnih et al. (2015), figure
4, draw the same space in two dimensions; here distances are those of the space itself.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np
import pandas as pd
import torch
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from torch import Tensor, nn

from atari_dqn import params
from atari_dqn.analysis.study import Section
from atari_dqn.envs import AtariEnv, EpisodeRecord
from atari_dqn.games import GameFacts
from atari_dqn.params import Parameters
from atari_dqn.report.outputs import show_absent, show_figure, show_placeholders
from atari_dqn.report.plots import WIDTH
from atari_dqn.report.saliency import evaluated, observation_at
from atari_dqn.runs import models, records
from atari_dqn.runs.dataset import trajectory

GAMES = 12  # other games that are searched, each with an opening of its own
EVERY = 2  # agent steps between the states of them
NEAREST = 3  # states that are shown, each of another game
MOMENTS = {"a quarter": 1 / 4, "half": 1 / 2, "three quarters": 3 / 4}  # of the game
HEIGHT = 5.4  # inches


@torch.no_grad()
def features(network: nn.Module, observations: np.ndarray) -> np.ndarray:
    """What a network's last linear layer is given, float32 [N, 512], in observations uint8
    [N, 84, 84, S]; a dueling network has two, for the value and for the advantages: [N, 1024]."""
    device, parts = next(network.parameters()).device, []
    given: list[Tensor] = []
    with ExitStack() as hooks:
        for name, layer in network.named_children():
            if name.endswith("output"):
                hook = layer.register_forward_pre_hook(lambda _, inputs: given.append(inputs[0]))
                hooks.enter_context(hook)
        for part in torch.from_numpy(observations).split(256):
            given.clear()
            network(part.to(device))
            parts.append(torch.cat(given, dim=1).cpu())
    return torch.cat(parts).numpy()


@dataclass(frozen=True)
class States:
    """Some states of an evaluation game."""

    game: int  # its number
    record: EpisodeRecord
    steps: Sequence[int]  # agent steps before each
    features: np.ndarray  # float32 [N, F]

    def there(self, parameters: Parameters, place: int) -> AtariEnv:
        """The game in one of the states."""
        replayed = records.replay(parameters, self.record)
        return next(islice(replayed, self.steps[place], None))


def states(
    network: nn.Module, parameters: Parameters, game: int, record: EpisodeRecord, every: int = EVERY
) -> States:
    """Every so many states of a recorded game in which the agent chose an action."""
    played, steps = trajectory(parameters, record), range(0, len(record.actions), every)
    seen = [observation_at(played, step, parameters.frame_stack) for step in steps]
    return States(game, record, steps, features(network, np.stack(seen)))


def nearest(state: np.ndarray, others: Sequence[np.ndarray]) -> list[tuple[int, int, float]]:
    """Of several games' states (float [N, F] each) the one of each that is nearest to a state
    (float [F]): the game's place, the state's place in it and its distance, nearest first."""
    found = []
    for place, other in enumerate(others):
        distances = np.linalg.norm(other - state, axis=1)
        found.append((place, int(distances.argmin()), float(distances.min())))
    return sorted(found, key=lambda one: one[2])


def mean_distance(games: Sequence[np.ndarray]) -> float:
    """The mean distance of all pairs of states (float [N, F] a game) of different games."""
    total, pairs = 0.0, 0
    for one, other in combinations(map(torch.from_numpy, games), 2):
        total += torch.cdist(one, other).sum(dtype=torch.float64).item()
        pairs += len(one) * len(other)
    return total / pairs


def _of_other_openings(facts: GameFacts, games: dict[int, EpisodeRecord]) -> list[int]:
    """The numbers of the first game of each opening but that of game 0: greedy games of one opening
    are much alike."""
    firsts: dict[int, int] = {}
    for number in sorted(games):
        firsts.setdefault(facts.opening(games[number].idle_frames), number)
    return [number for number in firsts.values() if number]


def _off(places: Sequence[tuple[int, int]], others: Sequence[tuple[int, int]]) -> float:
    """The mean distance between the places of some and their places elsewhere; nan of nobody."""
    apart = np.array(places, float) - np.array(others, float)
    return float(np.hypot(*apart.T).mean()) if len(apart) else np.nan


def figure(pictures: Sequence[Sequence[tuple[str, np.ndarray]]], titles: Sequence[str]) -> Figure:
    """A row per moment, of pictures uint8 [210, 160, 3] with what is said under each; `titles`
    stand above the columns."""
    drawing, panels = plt.subplots(
        len(pictures), len(titles), figsize=(WIDTH, HEIGHT), squeeze=False
    )
    for row, shown in zip(panels, pictures, strict=True):
        for axes, (said, picture) in zip(row, shown, strict=True):
            axes.imshow(picture)
            axes.set(xticks=[], yticks=[], frame_on=False)
            axes.set_xlabel(said, fontsize="small")
    for axes, title in zip(panels[0], titles, strict=True):
        axes.set_title(title, fontsize="small")
    drawing.tight_layout()
    return drawing


def show_neighbours(section: Section) -> pd.DataFrame:
    """Three moments of a game, and the states of other games that are nearest to each in the
    network's last hidden layer. Returns a row per picture: moment, game, step, points of the agent,
    distance, as a share of the mean between states of different games, and how far off the boxers
    stand from their places at the moment (pixels, the mean of both; nan in other games)."""
    label = f"fig-{section.slug}-neighbours"
    table = pd.DataFrame(columns=["moment", "game", "step", "points", "distance", "off"])
    found = [(run, games) for run in section.usable if 0 in (games := evaluated(run))]
    if not found:
        show_placeholders(label)
        return table
    run, games = found[0]
    chosen = _of_other_openings(section.facts, games)[:GAMES]
    if len(chosen) < NEAREST:
        show_absent(label, f"Nearest states follow after games of {NEAREST + 1} openings.")
        return table
    network = models.load_model(run.folder / "model.safetensors", run.params)
    own = states(network, run.params, 0, games[0], every=1)
    others = [states(network, run.params, game, games[game]) for game in chosen]
    mean = mean_distance([each.features for each in (own, *others)])
    pictures: list[list[tuple[str, np.ndarray]]] = []
    for moment, share in MOMENTS.items():
        at = int(share * (len(own.steps) - 1))
        alike = nearest(own.features[at], [other.features for other in others])[:NEAREST]
        near = [(others[place], state, distance / mean) for place, state, distance in alike]
        places, shown = own.there(run.params, at).places(), []
        for each, state, distance in [(own, at, 0.0), *near]:
            env, step = each.there(run.params, state), each.steps[state]
            off = _off(env.places(), places)
            table.loc[len(table)] = [moment, each.game, step, env.points()[0], distance, off]
            said = f"{step * run.params.frame_skip / 60:.1f} s"
            said = (
                f"{moment}, {said}" if each is own else f"game {each.game}, {said}: {distance:.2f}"
            )
            shown.append((said, env.render()))
        pictures.append(shown)
    show_figure(
        figure(pictures, ["game 0", "nearest", "second", "third"]),
        label=label,
        caption=f"Three moments of the first evaluation game of {params.title(run.agent)} (left), "
        f"and what is most alike to its network: the nearest state of each of {len(others)} other "
        f"evaluation games, all with different openings, and of these the {NEAREST} nearest. Near "
        "is what differs little in the activations before the last layer; the last number is the "
        "distance, as a share of the mean between states of different games.",
        alt="Three pictures of a game, each with three of other games that the network finds "
        "most alike.",
        data=section.origin,
    )
    return table
