"""What a notebook shows in JupyterLab is what the report shows, in Markdown that it can read."""

from types import SimpleNamespace

import pandas as pd
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


@pytest.mark.parametrize(("width", "height", "fits"), [(6.3, 9, True), (6.3, 9.2, False)])
def test_a_figure_that_a_page_would_cut_off_is_refused(monkeypatch, width, height, fits):
    monkeypatch.setattr(outputs, "display", lambda what, metadata: None)
    figure = plt.figure(figsize=(width, height))
    if fits:
        outputs.show_figure(figure, "fig-tall", "All of it.", "A tall picture of nothing at all.")
    else:
        with pytest.raises(ValueError, match=r"fig-tall: 9\.2 inches"):
            outputs.show_figure(figure, "fig-tall", "Not all of it.", "Nothing at all.")
    plt.close(figure)


def test_a_figure_is_as_tall_as_it_is_where_it_has_the_texts_width(monkeypatch):
    monkeypatch.setattr(outputs, "display", lambda what, metadata: None)
    outputs.show_figure(plt.figure(figsize=(12.6, 17)), "fig-large", "Shrunk.", "Nothing at all.")
    with pytest.raises(ValueError, match=r"fig-narrow: 12\.0"):
        outputs.show_figure(plt.figure(figsize=(3.15, 6)), "fig-narrow", "Stretched.", "Nothing.")
    plt.close("all")


@pytest.mark.parametrize(
    ("number", "decimals", "sign", "text"),
    [
        *((-0.04, 1, "", "0.0"), (-0.04, 1, "+", "0.0"), (0.0, 0, "+", "0"), (-0.4, 0, "", "0")),
        *((-0.06, 1, "", "-0.1"), (27.0, 1, "", "27.0"), (2.55, 1, "+", "+2.5"), (5, 0, "+", "+5")),
    ],
)
def test_zero_has_no_sign(number, decimals, sign, text):
    assert outputs.fixed(number, decimals, sign) == text


def test_a_table_has_no_minus_zero(shown):
    table = pd.DataFrame({"agent": ["DQN", "Double DQN"], "gain": [-0.001, -1.0]})
    outputs.show_table(table, label="tbl-gains", caption="Gains.", decimals=1)
    assert [row["gain"] for row in shown.tables["tbl-gains"]] == ["0.0", "-1.0"]


def test_a_column_that_tells_no_rows_apart_is_left_out():
    table = pd.DataFrame({"agent": ["DQN", "Double DQN"], "seed": [1, 1]})
    assert list(outputs.varying(table, "seed")) == ["agent"]
    assert list(outputs.varying(table.assign(seed=[1, 2]), "seed")) == ["agent", "seed"]


def test_computed_text_reaches_the_report_as_it_was_written(monkeypatch):
    shown = {}
    monkeypatch.setattr(outputs, "display", lambda what, metadata: shown.update(metadata))
    outputs.show_text("See @fig-one.")
    assert shown["text/markdown"]["report"] == "See @fig-one."
