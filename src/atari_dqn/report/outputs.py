"""Labelled output of the report's notebooks: text, figures, tables and videos.

Each carries its caption, label, text alternative and origin with it, in the notebook's own output,
from where `build` takes them into HTML and PDF. JupyterLab shows the same, as far as its Markdown
goes: captions below figures, badges as quotations, labels and citations in words.
"""

import base64
import json
import re
from functools import cache
from typing import TYPE_CHECKING, Any

import pandas as pd
from IPython.core.getipython import get_ipython
from IPython.display import Markdown, display
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib_inline.backend_inline import set_matplotlib_formats

from atari_dqn.params import ParameterError
from atari_dqn.report import crossrefs, interactive, plots
from atari_dqn.runs.files import RunError, project_root

if TYPE_CHECKING:  # what plays and draws videos takes seconds to import
    from atari_dqn.report.video import Video


def start() -> None:
    """Prepares a notebook: figures in the project's style, as vector graphics; and from now on,
    what a user can mend is an error of one line, as it is on the command line."""
    plots.style()
    # bbox_inches: a figure keeps its size, so that places on it can be told beforehand
    set_matplotlib_formats("svg", bbox_inches=None, metadata={"Date": None, "Creator": None})
    if shell := get_ipython():
        shell.set_custom_exc((ParameterError, RunError, OSError), _one_line)


def _one_line(
    shell: Any, kind: type, error: BaseException, traceback: Any, tb_offset: int | None = None
) -> list[str]:
    line = f"{kind.__name__}: {error}"
    shell._showtraceback(kind, error, [line])  # to the notebook's front end
    return [line]


def show_text(markdown: str) -> None:
    """Shows computed text in pandoc's Markdown."""
    display(Markdown(for_jupyter(markdown)), metadata={"text/markdown": {"report": markdown}})


def for_jupyter(markdown: str) -> str:
    """Pandoc's Markdown in JupyterLab's, which knows no divisions, labels and citations."""
    badge = re.compile(r"^::: \{\.badge[^}]*\}\n(.*?)\n:::$", re.MULTILINE | re.DOTALL)
    text = badge.sub(lambda match: re.sub("^", "> ", match[1], flags=re.MULTILINE), markdown)
    text = re.sub(r"^:{3,}( \{[^}]*\})?\n?", "", text, flags=re.MULTILINE)
    text = re.sub(r" ?\[[^\[\]]*\]\{\.paper\}", "", text)
    text = re.sub(r"\[([^\[\]]*)\]\{\.page\}", r"\1", text)
    text = re.sub(r"^: (.*) \{#tbl-[\w-]+\}$", r"*\1*", text, flags=re.MULTILINE)
    text = re.sub(r"(\[\])? ?\{#[\w-]+( \.\w+)*\}", "", text)
    text = re.sub(r"\[(-?@[^\]]+)\]", r"(\1)", text)
    code = r"```.*?```|`[^`]*`"

    def plain(match: re.Match[str]) -> str:
        return match[1] or _names().get(match[2], match[2])

    return re.sub(rf"({code})|-?(?<![\w@])@([\w-]+)", plain, text, flags=re.DOTALL)


@cache
def _names() -> dict[str, str]:
    """What the last report called each label: "Figure 7"."""
    path = project_root() / crossrefs.NAMES
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def _show_caption(label: str, caption: str) -> None:
    """A figure's caption in JupyterLab; the report takes it from the figure's own metadata."""
    text = Markdown(f"*{_names().get(label, 'Figure')}. {for_jupyter(caption)}*")
    display(text, metadata={"text/markdown": {"report": ""}})


def show_absent(label: str, why: str) -> None:
    """Holds the place of a figure or table that has nothing to show yet, and says why."""
    show_text(f"::: {{#{label} .absent}}\n{why}\n:::")


def show_placeholders(*labels: str) -> None:
    """Holds the places of figures and tables without a word, where a badge has said it all."""
    show_text(" ".join(f"[]{{#{label} .absent}}" for label in labels))


def show_figure(figure: Figure, label: str, caption: str, alt: str, data: str = "") -> None:
    """Shows a figure with its caption; `label` (fig-...) is what the text refers to.

    `data` says which files it is drawn from. What `interactive` tells of it goes to the page.
    Raises ValueError if it is taller than a page of the PDF, which would cut it off.
    """
    width, height = figure.get_size_inches()
    if (tall := plots.WIDTH * height / width) > plots.TALLEST:
        raise ValueError(f"{label}: {tall:.1f} inches are more than a page's {plots.TALLEST:g}")
    meta: dict[str, Any] = {"label": label, "caption": caption, "alt": alt, "data": data}
    meta["curves"] = interactive.described(figure)
    display(figure, metadata={"image/svg+xml": meta})
    plt.close(figure)
    _show_caption(label, caption)


def show_video(
    video: "Video", label: str, caption: str, alt: str, data: str = "", layer: str = ""
) -> None:
    """Shows a video on the page; on paper, a strip of its pictures. `label` is vid-...

    `layer` is the name of the layer that its right half has and the left half lacks: the page shows
    one of them, and has a switch of that name.
    """
    meta = {
        "label": label,
        "caption": caption,
        "alt": alt,
        "data": data,
        "video": base64.b64encode(video.mp4).decode(),
        "poster": base64.b64encode(video.poster).decode(),
        "layer": layer,
    }
    bundle = {
        "text/html": f'<video controls loop src="data:video/mp4;base64,{meta["video"]}"></video>',
        "image/png": base64.b64encode(video.strip).decode(),  # what the report is made from
    }
    display(bundle, metadata={"image/png": meta}, raw=True)
    _show_caption(label, caption)


def show_table(table: pd.DataFrame, label: str, caption: str, decimals: int = 2) -> None:
    """Shows a table with its caption; missing numbers are dashes."""
    shown = table.astype(object).where(table.notna(), "–")
    shown = shown.map(lambda cell: fixed(cell, decimals) if isinstance(cell, float) else cell)
    right = tuple("right" if kind.kind in "if" else "left" for kind in table.dtypes)
    text = shown.to_markdown(index=False, disable_numparse=True, colalign=right)
    head, _, *rows = text.splitlines()
    # Where a row is longer than a line, pandoc shares the width out by these dashes.
    dashes = (
        "-" * width + "-:" if side == "right" else ":-" + "-" * width
        for width, side in zip(_widths(shown), right, strict=True)
    )
    text = "\n".join([head, f"|{'|'.join(dashes)}|", *rows])
    show_text(f"{text}\n\n: {caption} {{#{label}}}")


def fixed(number: float, decimals: int, sign: str = "") -> str:
    """A number with so many decimals and, if `sign` is "+", always with its sign; what is rounded
    to zero has none."""
    text = f"{number:{sign}z.{decimals}f}"
    return text.removeprefix("+") if float(text) == 0 else text


def varying(table: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """A table without those of the columns that have one value alone: they tell no rows apart."""
    return table.drop(columns=[name for name in columns if table[name].nunique() == 1])


WIDEST = 44  # letters; a longer cell is broken into lines


def _widths(shown: pd.DataFrame) -> list[int]:
    """Letters that each column needs: those of its longest cell, within reason, and of the longest
    word of its heading, which may take several lines."""
    return [
        min(WIDEST, max(map(len, [*str(name).split(), *map(str, column)])))
        for name, column in shown.items()
    ]
