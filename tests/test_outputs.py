"""What a notebook shows in JupyterLab is what the report shows, in Markdown that it can read."""

from types import SimpleNamespace

import pytest
from matplotlib import pyplot as plt

from atari_dqn.report import outputs


@pytest.mark.parametrize(
    ("pandoc", "jupyter"),
    [
        ("::: {.badge .partial}\n**1 of 3**\n\n`run` it.\n:::", "> **1 of 3**\n> \n> `run` it."),
        ("::: {#fig-one .absent}\nA curve follows.\n:::", "A curve follows.\n"),
        ("[]{#fig-one .absent} []{#tbl-two .absent}", ""),
        ("| a |\n\n: A caption. {#tbl-one}", "| a |\n\n*A caption.*"),
        ("See @fig-one [@mnih2015], and me@home.", "See fig-one (mnih2015), and me@home."),
        ("[@one; @two] and [-@three] in `@code`", "(one; two) and (three) in `@code`"),
        ("```python\n@cache\n```", "```python\n@cache\n```"),
        (":::: {.board}\n::: {.tile .open}\n**23** points\n:::\n::::", "**23** points\n"),
    ],
)
def test_pandocs_markdown_is_put_into_jupyters(pandoc, jupyter):
    assert outputs.for_jupyter(pandoc).strip(" ") == jupyter


def test_a_figure_has_its_caption_in_jupyter_and_once_in_the_report(monkeypatch):
    shown = []
    monkeypatch.setattr(
        outputs, "display", lambda what, metadata: shown.append(SimpleNamespace(**locals()))
    )
    monkeypatch.setattr(outputs, "_names", lambda: {"fig-any": "Figure 7"})
    figure = plt.figure()
    outputs.show_figure(figure, "fig-any", "Scores [@mnih2015].", "A picture of nothing at all.")
    drawn, below = shown
    assert drawn.what is figure
    assert drawn.metadata["image/svg+xml"]["caption"] == "Scores [@mnih2015]."
    assert below.what.data == "*Figure 7. Scores (mnih2015).*"
    assert below.metadata["text/markdown"]["report"] == ""


def test_computed_text_reaches_the_report_as_it_was_written(monkeypatch):
    shown = {}
    monkeypatch.setattr(outputs, "display", lambda what, metadata: shown.update(metadata))
    outputs.show_text("See @fig-one.")
    assert shown["text/markdown"]["report"] == "See @fig-one."
