"""The drawn diagrams of the report: what the agents are, and how this project is built.

Whatever can be computed is: the layers come from the networks themselves, the names of the
modules from their files, epsilon from the function that training calls.
"""

import textwrap
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import seaborn as sns
import torch
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path
from torch import fx, nn
from torch.fx.passes.shape_prop import ShapeProp

from atari_dqn.agents import AGENTS
from atari_dqn.envs import SIZE
from atari_dqn.params import Parameters
from atari_dqn.report import fingerprint
from atari_dqn.report.plots import WIDTH
from atari_dqn.schedules import epsilon

TITLE, TEXT = 10, 9  # points
LINE = 0.155  # inches from one line of text to the next
INK = "0.2"
_PALETTE = sns.color_palette("colorblind")
ROLES = {  # what a colour means; none stands for an agent in the plots
    "game": _PALETTE[7],
    "network": _PALETTE[9],
    "data": _PALETTE[8],
    "learning": _PALETTE[4],
}
DEFAULTS = Parameters(experiment="defaults")
DUELING = r"Q(s, a) = V(s) + A(s, a) - \overline{A}(s)"  # the overline: mean over the actions

Point = tuple[float, float]


@dataclass(frozen=True)
class Box:
    """A rectangle by its centre and size; arrows begin and end on its sides."""

    x: float
    y: float
    width: float
    height: float

    def left(self, dy: float = 0) -> Point:
        return self.x - self.width / 2, self.y + dy

    def right(self, dy: float = 0) -> Point:
        return self.x + self.width / 2, self.y + dy

    def top(self, dx: float = 0) -> Point:
        return self.x + dx, self.y + self.height / 2

    def bottom(self, dx: float = 0) -> Point:
        return self.x + dx, self.y - self.height / 2


class Sheet:
    """A new figure to draw on; coordinates are inches from its lower left corner."""

    def __init__(self, height: float):
        self.height = height
        self.figure = plt.figure(figsize=(WIDTH, height), layout="none")
        self.axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set(xlim=(0, WIDTH), ylim=(0, height))
        self.axes.axis("off")

    def text(self, x: float, y: float, text: str, **how) -> None:
        style: dict[str, Any] = {"size": TEXT, "color": INK, "ha": "center", "va": "center"}
        self.axes.text(x, y, text, **style | how)

    def title(self, x: float, y: float, text: str, **how) -> None:
        self.text(x, y, text, size=TITLE, weight="bold", **how)

    def frame(self, box: Box, role: str, rounding: float = 0.08) -> Box:
        """Draws a box's tint and outline."""
        style: dict[str, Any] = {
            "facecolor": _shade(role, white=0.75),
            "edgecolor": _shade(role, black=0.4),
        }
        style["boxstyle"] = f"round,pad=0,rounding_size={rounding}"
        corner = (box.left()[0], box.bottom()[1])
        self.axes.add_patch(FancyBboxPatch(corner, box.width, box.height, linewidth=1, **style))
        return box

    def box(self, box: Box, title: str, detail: str = "", role: str = "") -> Box:
        """Draws a box with a bold title, and lines of detail below it."""
        above, below = (text.count("\n") + 1 if text else 0 for text in (title, detail))
        self.title(box.x, box.y + below * LINE / 2, title)
        self.text(box.x, box.y - above * LINE / 2, detail)
        return self.frame(box, role)

    def line(self, path: Path, role: str = "", dashed: bool = False, head: bool = True) -> None:
        style: dict[str, Any] = {"linewidth": 1.1, "linestyle": (0, (3, 2)) if dashed else "-"}
        style |= {"arrowstyle": "-|>" if head else "-", "mutation_scale": 9}
        self.axes.add_patch(FancyArrowPatch(path=path, color=_shade(role, black=0.3), **style))

    def arrow(self, *points: Point, label: str = "", side: int = 1, **how) -> None:
        """Draws an arrow through `points`, with a label beside its longest piece.

        The label is above or to the right of the piece; with `side` -1 below or to the left.
        """
        self.line(_rounded(points), **how)
        (x0, y0), (x1, y1) = max(pairwise(points), key=lambda ends: np.hypot(*np.subtract(*ends)))
        if abs(x1 - x0) > abs(y1 - y0):
            self.text((x0 + x1) / 2, y0 + side * 0.05, label, va="bottom" if side > 0 else "top")
        else:
            self.text(x0 + side * 0.07, (y0 + y1) / 2, label, ha="left" if side > 0 else "right")


def _shade(role: str, white: float = 0, black: float = 0) -> np.ndarray | str:
    """A role's colour mixed with white or black; white or grey where there is no role."""
    if not role:
        return "white" if white else "0.4"
    return np.array(ROLES[role]) * (1 - white - black) + white


def _rounded(points: tuple[Point, ...], radius: float = 0.08) -> Path:
    """The path through `points`, its corners curved."""
    vertices, codes = [points[0]], [Path.MOVETO]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        ends = [np.subtract(end, corner) for end in (before, after)]
        start, stop = (corner + end * min(0.5, radius / np.hypot(*end)) for end in ends)
        vertices += [start, corner, stop]
        codes += [Path.LINETO, Path.CURVE3, Path.CURVE3]
    return Path([*vertices, points[-1]], [*codes, Path.LINETO])


def interaction() -> Figure:
    """Reinforcement learning: an agent acts on its environment, and is told reward and state."""
    sheet = Sheet(1.6)
    policy, rival = "its policy chooses\nan action\nin every state", "the game and\nthe rival in it"
    agent = sheet.box(Box(0.85, 0.8, 1.5, 1.4), "Agent", policy, "network")
    game = sheet.box(Box(WIDTH - 0.85, 0.8, 1.5, 1.4), "Environment", rival, "game")
    action = "action  $a_t$:  a position of the joystick"
    sheet.arrow(agent.right(0.4), game.left(0.4), label=action)
    reward = "reward  $r_{t+1}$:  points won or lost"
    sheet.arrow(game.left(-0.05), agent.right(-0.05), label=reward)
    state = "state  $s_{t+1}$:  what is seen next"
    sheet.arrow(game.left(-0.5), agent.right(-0.5), label=state)
    return sheet.figure


def q_learning_steps() -> Figure:
    """Tabular Q-learning: its steps, and the two loops that they form."""
    sheet = Sheet(2.3)
    table, start, choose, act = (Box(0.72 + 1.62 * k, 1.85, 1.3, 0.75) for k in range(4))
    observe = Box(act.x, 0.45, 1.3, 0.75)
    update = Box((start.x + choose.x) / 2, 0.45, choose.x - start.x + 1.3, 0.75)
    rule = r"$Q(s, a) \leftarrow Q(s, a) + \alpha\,[\,r + \gamma\,\mathrm{max}_{a′} Q(s′, a′)"
    rule += r" - Q(s, a)\,]$"
    sheet.box(table, "Initialise", "$Q(s, a) = 0$ for all\nstates and actions", "data")
    sheet.box(start, "Begin a game", "see its first\nstate $s$", "game")
    sheet.box(choose, "Choose", "an action $a$,\n$\\varepsilon$-greedily", "network")
    sheet.box(act, "Act", "play $a$ for\none step", "network")
    sheet.box(observe, "Observe", "the reward $r$ and\nthe next state $s′$", "game")
    sheet.box(update, "Update the table", rule, "learning")
    for one, other in pairwise((table, start, choose, act)):
        sheet.arrow(one.right(), other.left())
    sheet.arrow(act.bottom(), observe.top())
    sheet.arrow(observe.left(), update.right())
    goes_on, over = "the game goes on:\n$s \\leftarrow s′$", "the game\nis over"
    sheet.arrow(update.top(choose.x - update.x), choose.bottom(), label=goes_on)
    sheet.arrow(update.top(start.x - update.x), start.bottom(), label=over, side=-1)
    return sheet.figure


def epsilon_greedy() -> Figure:
    """Choosing an action epsilon-greedily, and how epsilon falls from game to game."""
    sheet = Sheet(2.2)
    draw = sheet.box(Box(0.75, 1.1, 1.3, 0.7), "Draw", "a number $u$\nbetween 0 and 1")
    explore, exploit = Box(3.1, 1.65, 1.7, 0.7), Box(3.1, 0.55, 1.7, 0.7)
    sheet.box(explore, "Explore", "a random action,\nall equally likely")
    sheet.box(exploit, "Exploit", "the action of the\nhighest value $Q(s, a)$", "network")
    for choice, label, side in ((explore, "<", 1), (exploit, r"\geq", -1)):
        points = [draw.right(), (1.6, draw.y), (1.6, choice.y), choice.left()]
        sheet.arrow(*points, label=rf"$u {label} \varepsilon$", side=side)

    panel = sheet.figure.add_axes((4.75 / WIDTH, 0.22, 1.4 / WIDTH, 0.64))
    games, floor = np.arange(1201), DEFAULTS.epsilon_floor
    panel.plot(games, [epsilon(DEFAULTS, int(game)) for game in games], color=INK, lw=1.4)
    panel.set(xlim=(0, games[-1]), ylim=(0, 1.02), xticks=[0, 500, 1000], yticks=[0, 0.5, 1])
    panel.text(games[-1], floor + 0.06, f"at least {floor:g}", ha="right", color=INK, size=TEXT)
    panel.set_xlabel("training games", size=TEXT)
    panel.set_title(r"$\varepsilon$, share of random actions", size=TEXT, color=INK)
    panel.tick_params(labelsize=TEXT)
    return sheet.figure


def dueling_idea() -> Figure:
    """One stream of layers, and the two of a dueling network, whose results are added."""
    sheet, actions = Sheet(3.5), 5
    for middle, above, heading in (
        (2.75, 0.6, "One stream"),
        (1.1, 0.95, "Two streams: a dueling network"),
    ):
        sheet.title(0.1, middle + above, heading, ha="left")
        seen = sheet.box(Box(0.65, middle, 1.1, 0.5), "Observation", role="game")
        trunk = sheet.box(Box(2.1, middle, 1.2, 0.5), "Convolutions", role="network")
        sheet.arrow(seen.right(), trunk.left())
        q = _values(sheet, 5.35, middle, actions)
        sheet.text(q.right()[0] + 0.07, q.y, "$Q(s, a)$\nof every\naction", ha="left")
        if heading == "One stream":
            layer = sheet.box(Box(3.65, middle, 1.1, 0.5), "Fully\nconnected", role="network")
            sheet.arrow(trunk.right(), layer.left())
            sheet.arrow(layer.right(), q.left())
    plus = sheet.box(Box(4.95, middle, 0.3, 0.3), "+", role="network")
    sheet.arrow(plus.right(), q.left())
    for dy, count, symbol in ((0.5, 1, "$V(s)$"), (-0.5, actions, "$A(s, a)$")):
        layer = sheet.box(Box(3.65, middle + dy, 1.1, 0.5), "Fully\nconnected", role="network")
        values = _values(sheet, 4.45, layer.y, count)
        sheet.arrow(trunk.right(), (2.9, middle), (2.9, layer.y), layer.left())
        sheet.arrow(layer.right(), values.left())
        end = plus.top() if dy > 0 else plus.bottom()
        sheet.arrow(values.right(), (plus.x, layer.y), end)
        sheet.text(values.x, values.top()[1] + 0.11, symbol)
    rule = rf"${DUELING}$," + "\n" + r"where $\overline{A}(s)$ is the mean over actions"
    sheet.text(0.1, 0.42, rule, ha="left")
    return sheet.figure


def _values(sheet: Sheet, x: float, y: float, count: int) -> Box:
    """Draws numbers that a network gives: a column of squares."""
    side = 0.15
    column = Box(x, y, side, side * count)
    for k in range(count):
        square = Box(x, column.bottom()[1] + (k + 0.5) * side, side, side)
        sheet.frame(square, "data", rounding=0.02)
    return column


def whole_agent() -> Figure:
    """The whole agent as it trains: playing, remembering, and learning from what it remembers."""
    sheet = Sheet(4.56)
    left, middle, right = 0.85, 3.75, 5.45
    shape = f"grey, {SIZE} × {SIZE} pixels,\nthe last {DEFAULTS.frame_stack} images"
    game, images, memory, policy, online, target, adam, loss, batch = (
        sheet.box(Box(x, y, 0.9 if title == "Batch" else 1.5, 0.75), title, detail, role)
        for x, y, title, detail, role in (
            (left, 4.13, "Game", "an Atari console,\nemulated", "game"),
            (left, 2.93, "Preprocessing", shape, "game"),
            (left, 1.68, "Replay memory", "the latest steps\nof all games", "data"),
            (middle, 4.13, "Choice of action", r"$\varepsilon$-greedy", "network"),
            (middle, 2.93, "Online network", r"weights $\theta$", "network"),
            (middle, 0.43, "Target network", r"weights $\theta^-$", "network"),
            (right, 2.93, "Adam", "changes $\\theta$ to\nlessen the loss", "learning"),
            (right, 1.68, "Loss", "mean of\n$(y - Q(s, a))^2$", "learning"),
            (2.3, 1.68, "Batch", "drawn at\nrandom", "data"),
        )
    )
    step: dict[str, Any] = {}
    learn: dict[str, Any] = {"role": "learning"}
    copy: dict[str, Any] = {"dashed": True}
    sheet.arrow(game.bottom(), images.top(), label="frames, points", **step)
    sheet.arrow(images.right(0.17), online.left(0.17), label="state $s_t$", **step)
    sheet.arrow(online.top(), policy.bottom(), label="$Q(s_t, a)$ of every action $a$", **step)
    sheet.arrow(policy.left(), game.right(), label="action $a_t$", **step)
    transition = "transition\n$s_t, a_t, r_{t+1}, s_{t+1}$"
    sheet.arrow(images.bottom(), memory.top(), label=transition, **step)

    sheet.arrow(memory.right(), batch.left(), **learn)
    corner = (batch.x, online.y - 0.17)
    sheet.arrow(batch.top(), corner, online.left(-0.17), label="$s, a$", **learn)
    sheet.arrow(batch.bottom(), (batch.x, target.y), target.left(), label="$r, s′, d$", **learn)
    rule = r"$y = r + \gamma\,(1-d)\,Q(s′, a^+)$"
    for begin, dy, label in (
        (online.bottom(0.5), 0.17, "$Q(s, a)$"),
        (target.top(0.5), -0.17, rule),
    ):
        sheet.arrow(begin, (begin[0], loss.y + dy), loss.left(dy), label=label, **learn)
    sheet.arrow(loss.top(), adam.bottom(), label="gradient", **learn)
    sheet.arrow(adam.left(), online.right(), **learn)
    sheet.arrow(online.bottom(-0.5), target.top(-0.5), label="copied every\n$N$ updates", **copy)

    keys = (("every step", step), ("every update", learn), ("every $N$th update", copy))
    for row, (label, how) in enumerate(keys):
        y = target.y + (1 - row) * 0.25
        sheet.arrow((0.1, y), (0.5, y), **how)
        sheet.text(0.6, y, f"at {label}", ha="left")
    return sheet.figure


FLOORS = {  # from the top; a module imports from its own floor and from those below
    "report": ("report/", "figures, tables, videos, and the written report", "data"),
    "analysis": ("analysis/", "numbers and verdicts from stored runs", ""),
    "runs": ("runs/", "a run's folder: writing, resuming, verifying it", "game"),
    "": ("agents", "the algorithms; know nothing of runs, files or reports", "network"),
}


def project_files() -> Figure:
    """The four floors of the package, each with its modules."""
    floors: dict[str, list[str]] = {floor: [] for floor in FLOORS}
    for module in fingerprint.source_files():
        floor, _, name = module.rpartition(".")
        if module not in ("", "__main__", *FLOORS) and name != "__main__":
            floors[floor].append(name)
    height, gap = 0.75, 0.22
    sheet = Sheet(len(FLOORS) * (height + gap))
    boxes = []
    for row, (floor, (title, what, role)) in enumerate(reversed(FLOORS.items())):
        y = (row + 0.5) * (height + gap)
        boxes.append(sheet.frame(Box(WIDTH / 2, y, WIDTH - 0.1, height), role))
        sheet.title(0.2, y + 0.22, title, ha="left")
        sheet.text(1.1, y + 0.22, what, ha="left")
        lines = textwrap.wrap(", ".join(sorted(floors[floor])), 115)
        sheet.text(0.2, y - 0.1, "\n".join(lines), ha="left")
    for lower, upper in pairwise(boxes):
        sheet.arrow(upper.bottom(), lower.top())
    return sheet.figure


@dataclass(frozen=True)
class Layer:
    """A layer with weights, as it is met on the way through a network."""

    name: str  # of the network's attribute
    module: nn.Conv2d | nn.Linear
    inputs: tuple[str, ...]  # names of the layers before it; none for the first
    shape: tuple[int, ...]  # of its output: height, width, channels; or how many values
    rectified: bool  # whether a ReLU follows

    @property
    def weights(self) -> int:
        return sum(weight.numel() for weight in self.module.parameters())


class _Tracer(fx.Tracer):
    """Follows a network's forward pass into its innermost modules."""

    def is_leaf_module(self, m: nn.Module, module_qualified_name: str) -> bool:
        return not any(m.children())


def network_layers(network: nn.Module, observation: torch.Tensor) -> list[Layer]:
    """The layers that an observation passes, in order."""
    graph = _Tracer().trace(network)
    with torch.no_grad():
        ShapeProp(fx.GraphModule(network, graph)).propagate(observation)
    modules = dict(network.named_modules())
    called = {
        node: modules[node.target] if node.op == "call_module" else node.target
        for node in graph.nodes
    }
    layers: list[Layer] = []
    sources: dict[fx.Node, tuple[str, ...]] = {}  # layers that its values come from
    for node, what in called.items():
        names = dict.fromkeys(name for before in node.all_input_nodes for name in sources[before])
        sources[node] = tuple(names)
        if isinstance(what, nn.Conv2d | nn.Linear):
            _, channels, *sides = node.meta["tensor_meta"].shape
            after = [called[user] for user in node.users]
            rectified = any(user is torch.relu or isinstance(user, nn.ReLU) for user in after)
            layers.append(Layer(node.target, what, sources[node], (*sides, channels), rectified))
            sources[node] = (node.target,)
    return layers


def layers(agent: str, stack: int = 4, actions: int = 18) -> Figure:
    """The layers of an agent's network, traced through the network itself."""
    with torch.device("meta"):  # shapes without numbers
        network = AGENTS[agent].network(stack, actions)
        observation = torch.zeros(1, SIZE, SIZE, stack, dtype=torch.uint8)
    found = network_layers(network, observation)
    depth = {"": 0}  # the observation's
    for layer in found:
        depth[layer.name] = 1 + max(depth[name] for name in layer.inputs or [""])
    last = max(depth.values()) + 1
    beside = {level: [one for one in found if depth[one.name] == level] for level in range(1, last)}
    split = next((level for level, others in beside.items() if len(others) > 1), last + 1)
    pitch, height = 0.63, 0.46
    room = 0.2 * (split <= last)  # above streams, for the fork that leads to them
    sheet = Sheet(pitch * last + height + 0.1 + room)

    def middle(level: int) -> float:
        return sheet.height - height / 2 - 0.05 - pitch * level - room * (level >= split)

    boxes = {"": Box(WIDTH / 2, middle(0), 2.95, height)}
    sheet.box(boxes[""], "Observation", f"{stack} grey images", "game")
    for level, layers_there in beside.items():
        for place, layer in enumerate(layers_there):
            x = WIDTH * (place + 0.5) / len(layers_there)
            boxes[layer.name] = Box(x, middle(level), 2.95, height)
            _layer_box(sheet, boxes[layer.name], layer)
    end = Box(WIDTH / 2, middle(last), 4.4, height)
    rule = DUELING if len(beside[last - 1]) > 1 else "Q(s, a)"
    total = sum(weight.numel() for weight in network.parameters())
    sheet.box(end, "Action values", f"${rule}$;  {total:,} weights in all", "data")

    shapes = {"": (SIZE, SIZE, stack)} | {layer.name: layer.shape for layer in found}
    for name, box in boxes.items():
        following = [layer for layer in found if name in (layer.inputs or [""])]
        label = " × ".join(f"{size:,}" for size in shapes[name])
        if len(shapes[name]) == 1:
            label += " value" if shapes[name] == (1,) else " values"
        elif isinstance(following[0].module, nn.Linear):
            label += f", flattened to {following[0].module.in_features:,} values"
        stem = box.bottom()[1] - (pitch - height)
        for below in [boxes[layer.name] for layer in following] or [end]:
            if len(following) > 1:
                sheet.arrow(box.bottom(), (box.x, stem), (below.x, stem), below.top())
            else:
                sheet.arrow(box.bottom(), below.top(box.x - below.x))
        sheet.text(box.x + 0.08, (box.bottom()[1] + stem) / 2, label, ha="left")
    return sheet.figure


def _layer_box(sheet: Sheet, box: Box, layer: Layer) -> None:
    """Draws a layer: its name and number of weights above what it does."""
    module, title = layer.module, layer.name.replace("_", ": ").capitalize()
    if isinstance(module, nn.Conv2d):
        kernel, channels = module.kernel_size, f"{module.in_channels} → {module.out_channels}"
        title = "Convolution"
        work = f"kernel {kernel[0]} × {kernel[1]}, stride {module.stride[0]}, {channels} channels"
    else:
        work = f"fully connected, {module.in_features:,} → {module.out_features:,}"
    left, right = box.left()[0] + 0.1, box.right()[0] - 0.1
    sheet.title(left, box.y + LINE / 2, title, ha="left")
    sheet.text(right, box.y + LINE / 2, f"{layer.weights:,} weights", ha="right")
    sheet.text(left, box.y - LINE / 2, work + ", ReLU" * layer.rectified, ha="left")
    sheet.frame(box, "network")
