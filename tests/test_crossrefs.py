"""Labels, numbers and completeness of the report's text."""

import json
import re
from pathlib import Path

import pypandoc
import pytest

from atari_dqn.report import crossrefs
from atari_dqn.report.build import TEMPLATES
from atari_dqn.runs.files import RunError

ROOT = Path(__file__).parents[1]
FIGURE = '![A caption.](a.svg){#fig-one alt="A picture of something."}'
TEXT = f"""
# First {{#sec-first}}

See @fig-one, @tbl-one and @eq-one; @sec-second-part is later, and [@mnih2015] is a citation.

{FIGURE}

``` python
# A comment, no heading {{#sec-no}}
```

## Inner

# Second {{#sec-second}}

## Part {{#sec-second-part}}

$$a = b$$ {{#eq-one}}

: A caption. {{#tbl-one}}

::: {{#fig-later .absent}}
Nothing yet.
:::

`````{{=html}}
<figure id="vid-any"></figure>
`````

Compare @vid-any with @fig-later.
"""


def test_references_become_links_with_numbers_in_the_order_of_the_text():
    text = crossrefs.finish(TEXT)
    for link in (
        "[Figure\N{NO-BREAK SPACE}1](#fig-one){.ref}",
        "[Figure\N{NO-BREAK SPACE}2](#vid-any){.ref}",
        "[Table\N{NO-BREAK SPACE}1](#tbl-one){.ref}",
        "[Equation\N{NO-BREAK SPACE}1](#eq-one){.ref}",
        "[Section\N{NO-BREAK SPACE}2.1](#sec-second-part){.ref}",
    ):
        assert link in text
    assert '[$$a = b$$]{#eq-one .equation number="1"}' in text
    assert "[@mnih2015]" in text, "citations are pandoc's"


def test_what_is_still_absent_has_no_number_but_can_be_referred_to():
    assert "[figure still to come](#fig-later){.ref}" in crossrefs.finish(TEXT)


APPENDICES = """
# Runs {#sec-runs .appendix}

See @sec-table.

## Table {#sec-table}

## Rest

# Speed {.appendix}

# References {.unnumbered}
"""


def test_appendices_are_lettered_and_called_so():
    text = crossrefs.finish(TEXT + APPENDICES)
    headings = re.findall("^#.*", text.partition("# Runs")[1] + text.partition("# Runs")[2], re.M)
    assert headings == [
        '# Runs {#sec-runs .appendix number="A"}',
        '## Table {#sec-table number="A.1"}',
        '## Rest {number="A.2"}',
        '# Speed {.appendix number="B"}',
        "# References {.unnumbered}",
    ]
    assert "[Appendix\N{NO-BREAK SPACE}A.1](#sec-table){.ref}" in text
    assert "# Second {#sec-second}\n" in text, "chapters are pandoc's to number"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (TEXT + APPENDICES + "\n# Late\n", "a chapter after the appendices is none itself: Late"),
        (TEXT + "\nAnd @fig-nowhere.", "labels that do not exist: fig-nowhere"),
        (TEXT + FIGURE, "labels given twice: fig-one"),
        (TEXT.replace(' alt="A picture of something."', ""), "text alternative .*: fig-one"),
        (TEXT.replace("A picture of something.", "Short."), "text alternative .*: fig-one"),
    ],
)
def test_a_bad_label_or_a_silent_figure_fails_and_is_named(text, said):
    with pytest.raises(RunError, match=said):
        crossrefs.finish(text)


def test_what_the_report_does_not_show_fails_and_is_named(tmp_path):
    path = tmp_path / "completeness.yaml"
    path.write_text("figures:\n  - {what: a loop, labels: [fig-one]}\n")
    assert crossrefs.check_completeness(TEXT, path) == (1, 0)
    waiting = TEXT + "\n\n::: {#tbl-later .absent}\nNot yet.\n:::\n"
    path.write_text("figures:\n  - {what: a loop, labels: [fig-one, tbl-later]}\n")
    assert crossrefs.check_completeness(waiting, path) == (1, 1)
    path.write_text("figures:\n  - {what: a ring, labels: [fig-ring]}\n")
    with pytest.raises(RunError, match=r"figures: a ring \(fig-ring\)"):
        crossrefs.check_completeness(TEXT, path)
    path.write_text("goals:\n  - {what: a goal, labels: []}\n")
    with pytest.raises(RunError, match=r"goals: a goal \(no label\)"):
        crossrefs.check_completeness(TEXT, path)


PLACE = "[]{#fig-empty .absent} []{#tbl-empty .absent}"
LISTED = "figures:\n  - {what: a loop, labels: [fig-empty]}\n"


@pytest.mark.parametrize(
    "text",
    [
        "# One\n\n::: {.badge .partial}\nRuns are missing.\n:::\n\n## Part\n\n" + PLACE,
        "# One\n\n::: {#fig-empty .absent}\nIt follows after more runs.\n:::\n",
    ],
    ids=["a badge says it", "the place says it"],
)
def test_an_empty_place_needs_a_reason_and_waits(tmp_path, text):
    path = tmp_path / "completeness.yaml"
    path.write_text(LISTED)
    assert crossrefs.check_completeness(text, path) == (1, 1)


@pytest.mark.parametrize(
    "text",
    [
        "# One\n\n" + PLACE,
        "# One\n\n::: {.badge}\nAll runs are complete.\n:::\n\n" + PLACE,
        "# One\n\n::: {.badge .partial}\nRuns are missing.\n:::\n\n# Two\n\n" + PLACE,
        "::: {.badge .partial}\nFew.\n:::\n\n::: {.badge}\nAll.\n:::\n\n" + PLACE,
        "# One\n\n::: {#fig-empty .absent}\n:::\n",
        "# One\n\n::: {#fig-empty .absent}\n \n:::\n",
    ],
    ids=["no badge", "complete runs", "another chapter", "a later badge", "nothing", "a space"],
)
def test_an_empty_place_without_a_reason_fails_and_is_named(tmp_path, text):
    path = tmp_path / "completeness.yaml"
    path.write_text(LISTED)
    with pytest.raises(RunError, match=r"figures: a loop \(fig-empty\)"):
        crossrefs.check_completeness(text, path)


@pytest.mark.parametrize("made", ["html5", "typst"])
def test_computed_numbers_get_a_minus_sign_and_names_keep_their_hyphens(made):
    text = "-12.8 (-16.5 to -9.2), 2026-01 seed-1 games 1-500 `-5`"
    result = pypandoc.convert_text(
        text, made, "markdown", extra_args=[f"--lua-filter={TEMPLATES / 'report.lua'}"]
    )
    assert "−12.8 (−16.5 to −9.2), 2026-01 seed-1 games 1-500" in result
    assert re.search(r"[`>]-5[`<]", result)  # in code


def test_a_notebooks_own_text_reads_in_jupyterlab_and_becomes_the_reports():
    own = "# Title <!-- {#sec-any .appendix} -->\n\nSee [Figure 7](#fig-one), [a page](#top)."
    assert crossrefs.from_notebook(own) == (
        "# Title {#sec-any .appendix}\n\nSee @fig-one, [a page](#top)."
    )
    more = "[Section](#sec-any){.more} <!-- a remark -->"
    assert crossrefs.from_notebook(more) == more, "neither is a reference or a label"


def test_the_numbers_of_the_last_report_are_written_into_the_notebooks(tmp_path):
    names = crossrefs.names(TEXT)
    assert (names["fig-one"], names["sec-second-part"]) == (
        "Figure\N{NO-BREAK SPACE}1",
        "Section\N{NO-BREAK SPACE}2.1",
    )
    notebook = tmp_path / "01_any.ipynb"
    notebook.write_text('"source": ["[Figure 9](#fig-one) and [Table](#tbl-new)"]')
    assert crossrefs.renumber(notebook, names)
    assert notebook.read_text() == (
        '"source": ["[Figure\N{NO-BREAK SPACE}1](#fig-one) and [below](#tbl-new)"]'
    )
    assert not crossrefs.renumber(notebook, names)


@pytest.mark.parametrize(
    "path", sorted((ROOT / "notebooks").glob("[0-9]*.ipynb")), ids=lambda path: path.name
)
def test_the_notebooks_own_text_has_no_reference_that_jupyterlab_cannot_show(path):
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "markdown":
            text = "".join(cell["source"])
            assert not re.search(r"(?<![\w@-])@(fig|vid|tbl|sec|eq)-", text), cell["id"]
            assert not re.search(r"(?<!<!-- )\{#", text), cell["id"]
