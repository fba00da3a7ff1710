"""The diagrams tell the truth, and nothing in them hides anything else."""

import re
from itertools import combinations

import numpy as np
import pytest
import torch
from matplotlib import pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path
from matplotlib.text import Text

from atari_dqn.agents import AGENTS
from atari_dqn.report import diagrams, fingerprint, plots

FIGURES = {
    "interaction": diagrams.interaction,
    "q_learning_steps": diagrams.q_learning_steps,
    "epsilon_greedy": diagrams.epsilon_greedy,
    "dueling_idea": diagrams.dueling_idea,
    "whole_agent": diagrams.whole_agent,
    "project_files": diagrams.project_files,
    **{f"layers {name}": lambda name=name: diagrams.layers(name) for name in AGENTS},
}


@pytest.fixture(autouse=True)
def _style():
    plots.style()
    yield
    plt.close("all")


def texts_of(figure):
    """{text: its rectangle in pixels} of all that is written."""
    figure.canvas.draw()
    written = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text()]
    return [(text.get_text(), text.get_window_extent()) for text in written]


def paths_of(figure, kind):
    return [
        patch.get_transform().transform_path(patch.get_path()) for patch in figure.findobj(kind)
    ]


def points_of(path):
    """Points [N, 2] close together along all lines of a path."""
    lines = [Path(line).interpolated(200).vertices for line in path.to_polygons(closed_only=False)]
    return np.concatenate(lines)


def enters(points, place):
    return ((place.min < points) & (points < place.max)).all(axis=1).any()


def contains(outer, inner):
    return (outer.min <= inner.min).all() and (outer.max >= inner.max).all()


def misplaced(figure):
    """What cannot be read in a figure, as sentences."""
    texts, wrong = texts_of(figure), []
    boxes = [path.get_extents() for path in paths_of(figure, FancyBboxPatch)]
    arrows = [points_of(path) for path in paths_of(figure, FancyArrowPatch)]
    for (one, a), (other, b) in combinations(texts, 2):
        if a.overlaps(b):
            wrong.append(f"{one!r} overlaps {other!r}")
    for text, place in texts:
        if not contains(figure.bbox, place):
            wrong.append(f"{text!r} leaves the figure")
        if any(place.overlaps(box) and not contains(box, place) for box in boxes):
            wrong.append(f"{text!r} crosses the outline of a box")
        if any(enters(arrow, place) for arrow in arrows):
            wrong.append(f"{text!r} is crossed by an arrow")
    for box in boxes:
        if not contains(figure.bbox, box):
            wrong.append("a box leaves the figure")
        inside = box.padded(-2)
        if any(enters(arrow, inside) for arrow in arrows):
            wrong.append("an arrow crosses a box")
    for a, b in combinations(boxes, 2):
        if a.padded(-1).overlaps(b.padded(-1)):
            wrong.append("two boxes overlap")
    return wrong


@pytest.mark.parametrize("name", FIGURES)
def test_everything_in_a_diagram_can_be_read(name):
    figure = FIGURES[name]()
    assert figure.get_figwidth() == plots.WIDTH
    assert len(texts_of(figure)) >= 5
    assert misplaced(figure) == []


def test_what_cannot_be_read_is_found():
    sheet = diagrams.Sheet(2.0)
    sheet.box(diagrams.Box(1, 1, 1, 1), "one")
    assert misplaced(sheet.figure) == []
    sheet.text(1.1, 1, "over it")
    sheet.text(1.5, 0.7, "across")
    sheet.text(6, 1, "beyond the edge")
    sheet.box(diagrams.Box(1.8, 1, 1, 1), "two")
    sheet.arrow((0.1, 1), (1.2, 1))
    assert misplaced(sheet.figure) == [
        "'one' overlaps 'over it'",
        "'one' is crossed by an arrow",
        "'over it' is crossed by an arrow",
        "'across' crosses the outline of a box",
        "'beyond the edge' leaves the figure",
        "an arrow crosses a box",
        "two boxes overlap",
    ]


def test_a_diagram_is_the_same_every_time(tmp_path):
    for name in ("first", "second"):
        diagrams.project_files().savefig(tmp_path / name, format="svg", metadata={"Date": None})
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()


def test_every_module_stands_on_its_floor():
    """The names in a box are below its title, and above the next box's."""
    texts = sorted(diagrams.project_files().axes[0].texts, key=lambda text: -text.get_position()[1])
    floors, names = {"": set()}, set()
    for text in texts:
        if text.get_weight() == "bold":
            floors[text.get_text()] = names = set()
        else:
            names |= set(re.findall(r"\w+", text.get_text()))
    for module in fingerprint.source_files().keys() - {"", "report", "analysis", "runs"}:
        floor, _, name = module.rpartition(".")
        if name != "__main__":
            assert name in floors[f"{floor}/" if floor else "agents"], module


@pytest.mark.parametrize("agent", AGENTS)
def test_layers_are_those_that_a_forward_pass_meets(agent):
    network, observation = AGENTS[agent].network(4, 18), torch.zeros(1, 84, 84, 4).byte()
    met = {}
    for name, module in network.named_modules():
        if isinstance(module, torch.nn.Conv2d | torch.nn.Linear):
            module.register_forward_hook(
                lambda module, inputs, output, name=name: met.update({name: output.shape[1:]})
            )
    network(observation)
    layers = diagrams.network_layers(network, observation)
    assert [layer.name for layer in layers] == list(met)
    for layer in layers:
        channels, *sides = met[layer.name]
        assert layer.shape == (*sides, channels)
        assert layer.rectified == ("output" not in layer.name)
    assert sum(layer.weights for layer in layers) == count(network)


def count(network):
    return sum(weight.numel() for weight in network.parameters())


def test_a_dueling_network_has_two_streams():
    network = AGENTS["dueling_double_dqn"].network(4, 18)
    found = diagrams.network_layers(network, torch.zeros(1, 84, 84, 4).byte())
    inputs = {layer.name: layer.inputs for layer in found}
    assert inputs["value_hidden"] == inputs["advantage_hidden"] == ("convolutions.4",)
    assert inputs["value_output"] == ("value_hidden",)
    assert inputs["advantage_output"] == ("advantage_hidden",)


@pytest.mark.parametrize("agent", AGENTS)
def test_a_layers_output_is_written_beside_the_arrow_that_it_takes(agent):
    figure = diagrams.layers(agent)
    arrows = np.concatenate([points_of(path) for path in paths_of(figure, FancyArrowPatch)])
    outputs = [
        place
        for text, place in texts_of(figure)
        if re.fullmatch(r"\d+ × \d+ × \d+(, .* values)?|\d+ values?", text)
    ]
    assert len(outputs) >= 6
    for place in outputs:
        height = (place.y0 + place.y1) / 2
        level = arrows[np.abs(arrows[:, 1] - height) < place.height / 2]
        nearest = level[np.argmin(np.abs(level[:, 0] - place.x0)), 0]
        assert 0 < place.x0 - nearest < place.height


@pytest.mark.parametrize("agent", AGENTS)
def test_layers_are_drawn_with_their_real_numbers(agent):
    written = [text for text, _ in texts_of(diagrams.layers(agent))]
    for shape in ("84 × 84 × 4", "20 × 20 × 32", "9 × 9 × 64"):
        assert written.count(shape) == 1
    assert "7 × 7 × 64, flattened to 3,136 values" in written
    assert "kernel 8 × 8, stride 4, 4 → 32 channels, ReLU" in written
    numbers = [text.removesuffix(" weights") for text in written if text.endswith(" weights")]
    total = count(AGENTS[agent].network(4, 18))
    assert sum(int(number.replace(",", "")) for number in numbers) == total
    assert any(f"{total:,} weights in all" in text for text in written)
    smaller = [text for text, _ in texts_of(diagrams.layers(agent, stack=2, actions=6))]
    assert "84 × 84 × 2" in smaller
    assert "fully connected, 512 → 6" in smaller
