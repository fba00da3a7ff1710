"""What the page does with a figure beyond showing it: values under the pointer, and switches.

A drawing function names its artists with `named`; `described` reads their numbers off the finished
figure, so that what the page says is what is drawn. `templates/curves.js` does the rest. On paper,
and without JavaScript, everything is simply drawn.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

POINTS = 200  # of a curve, at most, that the page is told
BESIDE = "0.45"  # the colour of a switch that stands for no agent


def named(artist: Line2D | Collection, *switches: str, value: str = "") -> None:
    """Names an artist: `switches` turn it off and on, any of them; `value` is its name where its
    numbers are shown. An artist without one is switched only."""
    number = len(list(_of(artist.figure)))  # of those before it: no two have one id
    artist.set_gid("/".join((*switches, str(number))))
    artist.set_label(value or f"_{number}")


def described(figure: Figure) -> dict[str, Any] | None:
    """The named artists of a figure with at most `POINTS` of their numbers, where their panels lie
    (shares of the figure's size, from its upper left corner), and the switches; None without any.
    """
    artists = list(_of(figure))
    if not artists:
        return None
    figure.canvas.draw()
    panels = [axes for axes in figure.axes if any(artist.axes is axes for artist in artists)]
    return {
        "panels": [
            _panel(axes, [artist for artist in artists if artist.axes is axes]) for axes in panels
        ],
        "switches": [
            {"name": name, "colour": colour, "marks": _marks(artists, name)}
            for name, colour in switches(figure).items()
        ],
    }


def switches(figure: Figure) -> dict[str, str]:
    """The names of what a figure's switches turn off and on, each with the colour of its lines;
    of several colours, with that of none."""
    colours: dict[str, str] = {}
    seen: dict[str, set[str]] = {}
    for artist in _of(figure):
        *names, _ = str(artist.get_gid()).split("/")
        for name in names:
            colours.setdefault(name, to_hex(BESIDE))
        if len(names) == 1 and isinstance(artist, Line2D):
            own = seen.setdefault(names[0], set())
            own.add(to_hex(artist.get_color()))
            colours[names[0]] = next(iter(own)) if len(own) == 1 else to_hex(BESIDE)
    return colours


SIGNS = {"o": "○", "s": "□", "D": "◇", "^": "△"}


def _marks(artists: list[Line2D | Collection], name: str) -> str:
    """The marks that a switch stands for, where no line is among what it turns off and on."""
    own = [artist for artist in artists if name in str(artist.get_gid()).split("/")[:-1]]
    if not all(isinstance(one, Line2D) and one.get_linestyle() == "None" for one in own):
        return ""
    marks = (str(one.get_marker()) for one in own if isinstance(one, Line2D))
    return "".join(dict.fromkeys(SIGNS.get(mark, "") for mark in marks))


def _of(figure: Any) -> Iterator[Line2D | Collection]:
    for axes in figure.axes:
        yield from (artist for artist in (*axes.lines, *axes.collections) if artist.get_gid())


def _panel(axes: Axes, artists: list[Line2D | Collection]) -> dict[str, Any]:
    box, (x_min, x_max) = axes.get_position(), axes.get_xlim()
    return {
        "left": round(box.x0, 4),
        "top": round(1 - box.y1, 4),
        "width": round(box.width, 4),
        "height": round(box.height, 4),
        "x_min": round(x_min, 4),
        "x_max": round(x_max, 4),
        "x_label": axes.get_xlabel(),
        "artists": [_artist(artist) for artist in artists],
    }


def _artist(artist: Line2D | Collection) -> dict[str, Any]:
    identity, name = str(artist.get_gid()), str(artist.get_label())
    about: dict[str, Any] = {"id": identity, "switches": identity.split("/")[:-1]}
    if name.startswith("_") or not isinstance(artist, Line2D):
        return about
    xs, ys = np.asarray(artist.get_xdata(), float), np.asarray(artist.get_ydata(), float)
    every = max(1, -(-len(xs) // POINTS))
    return about | {
        "name": name,
        "points": artist.get_linestyle() == "None",
        "xs": xs[::every].round(4).tolist(),
        "ys": ys[::every].round(2).tolist(),
    }
