"""What readers see: a small report through the real templates, on paper and in a real browser."""

import base64
import io
import json
import re
from datetime import UTC, datetime

import av
import browser
import nbformat
import numpy as np
import pytest
import typst
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from PIL import Image
from synthetic import store

from atari_dqn.analysis.study import run_table
from atari_dqn.report import build, crossrefs, outputs
from atari_dqn.runs.run import Run

GREEN = (0, 160, 0)  # of a picture in a drawing, as the game's are
RED = (200, 0, 0)  # of the half of a film that has a layer
LAYER = 'a "layer" & more'
WORDS = "The agent plays on, and the score says how well. " * 12
LONG = r"$$" + " + ".join(rf"\gamma^{{{power}}} r_{{t+{power}}}" for power in range(20)) + "$$"
TEXT = rf"""
# Start {{#sec-start}}

The share $\varepsilon$, or more, is random. {WORDS} An image has 84 × 84 pixels.

See @fig-tall, @fig-wide, @vid-hero, @tbl-long, @eq-long, @sec-rules, @sec-more and
[@mnih2015; @greydanus2018].

{LONG} {{#eq-long}}

$$a = b$$ {{#eq-short}}

[Only the page says this.]{{.page}} [Only paper says this.]{{.paper}}

::: {{.badge .partial}}
Half done.
:::

``` python
def first():
    return "{"long " * 40}"


def second():
    return 2
```

# Rules {{#sec-rules}}

``` text
no sentence
```

With $\gamma$ near 1 the agent is patient, e.g. in Boxing. That is another sentence.

::: {{.board}}
::: {{.tile .yes verdict="in these runs: yes"}}
**1** The first claim.

Source: 51.6. Here: 48.2 (45.0 to 51.3).

@sec-rules
:::
::: {{.tile .no verdict="contradicted"}}
**2** The second claim.

Source: 3.1. Here: 0.5.

@sec-rules
:::
::: {{.tile .unclear verdict="inconclusive"}}
**3** The third claim.

Source: 3.1. Here: 0.5.

@sec-rules
:::
::: {{.tile .open verdict="open"}}
**4** The fourth claim.

Source: 51.6. Here: not yet.

@sec-rules
:::
:::

| row | value |
|-----|-------|
{chr(10).join(f"| {row} | {row * row} |" for row in range(80))}

: Many rows. {{#tbl-long}}
"""
APPENDIX = """
# More {#sec-more .appendix}

Something more.

## Most

# References {.unnumbered}
"""


def drawing(width, height):
    """An SVG as matplotlib draws it: a white ground, something black and a green picture."""
    stream = io.BytesIO()
    Image.new("RGB", (8, 8), GREEN).save(stream, "png")
    picture = base64.b64encode(stream.getvalue()).decode()
    return f"""<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"
width="{width}pt" height="{height}pt" viewBox="0 0 {width} {height}" version="1.1">
<rect width="{width}" height="{height}" fill="#ffffff"/>
<rect width="{width}" height="{height / 4}" y="{height / 4}" fill="#000000"/>
<image width="{width}" height="{height / 4}" y="{height / 2}" preserveAspectRatio="none"
xlink:href="data:image/png;base64,{picture}"/></svg>"""


def film(layer=""):
    """A video of 64 x 48 pixels that lasts three seconds, and its poster, which is white; with a
    layer, beside it another, which is red."""
    width = 128 if layer else 64
    stream = io.BytesIO()
    with av.open(stream, "w", format="mp4") as file:
        track = file.add_stream("libx264", rate=10)
        track.width, track.height, track.pix_fmt = width, 48, "yuv420p"
        for level in range(30):
            pixels = np.full((48, width, 3), level * 8, np.uint8)
            pixels[:, 64:] = RED
            file.mux(track.encode(av.VideoFrame.from_ndarray(pixels)))
        file.mux(track.encode())
    poster = io.BytesIO()
    still = Image.new("RGB", (width, 48), "white")
    still.paste(RED, (64, 0, width, 48))
    still.save(poster, "png")
    return tuple(base64.b64encode(one.getvalue()).decode() for one in (stream, poster))


def figure(label, width, height):
    info = {"label": label, "caption": f"A *{label}*.", "alt": f"A drawing of {label} in it"}
    data = {"image/svg+xml": drawing(width, height)}
    return new_output("display_data", data, metadata={"image/svg+xml": info})


def video(label, layer=""):
    mp4, poster = film(layer)
    info = {"caption": f"A *film*. {'[Page.]{.page} [Paper.]{.paper}'}", "video": mp4}
    info |= {"label": label, "alt": "A film of nothing in grey", "poster": poster, "layer": layer}
    data = {"text/html": "<video></video>", "image/png": poster}
    return new_output("display_data", data, metadata={"image/png": info})


HOSTILE = (
    "<script>window.injected = 1</script><img src=x onerror='injected = 1'> "
    "</table><b>b</b> | `a` *c* $d$ [e](javascript:1) {#sec-start} @fig-none [-@none] &lt; \\"
)


def hostile_table(folder):
    """What a notebook shows of a run whose files say what they should not."""
    session = {"processor": HOSTILE, "commit": "`<b>`<i>", "device": "cpu"}
    run = store(folder, "boxing_final", "dqn", [1.0], sessions=[session], identity="`<b>`<i>")
    shown = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "state", lambda run: "complete")  # else it is stale
        patch.setattr(outputs, "display", lambda data, metadata: shown.append((data, metadata)))
        outputs.show_table(run_table([run]), label="tbl-hostile", caption="A run.")
    ((data, metadata),) = shown
    return new_output("display_data", {"text/markdown": data.data}, metadata=metadata)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a small report."""
    folder = tmp_path_factory.mktemp("page")
    shown = [figure("fig-wide", 450, 250), figure("fig-tall", 200, 900), video("vid-hero")]
    cells = [
        new_markdown_cell("What was *found*.", metadata={"tags": ["abstract"]}),
        new_markdown_cell(TEXT),
        *(new_code_cell("show()", outputs=[one]) for one in [*shown, video("vid-second", LAYER)]),
        new_markdown_cell("[]{#fig-later .absent}"),
        new_code_cell("show()", outputs=[hostile_table(folder / "results")]),
        new_markdown_cell(APPENDIX),
    ]
    nbformat.write(new_notebook(cells=cells), folder / "00_small.ipynb")
    text = crossrefs.finish(build._section(folder / "00_small.ipynb", folder))
    build._typeset(text, "", folder, datetime(2020, 2, 3, tzinfo=UTC))
    return folder


@pytest.fixture(scope="module")
def html(made):
    return (made / "index.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    with browser.running(tmp_path_factory.mktemp("browser")) as tab:
        yield tab


@pytest.fixture
def show(made, tab):
    """Opens the page, and returns the browser."""

    def opened(**how):
        tab.open(made / "index.html", **how)
        return tab

    return opened


def pixel(page, selector, down):
    """The colour in the middle of an element's width, at a share of its height."""
    x, y = page(
        f"""(() => {{
          const one = document.querySelector("{selector}");
          one.scrollIntoView({{ block: "center", behavior: "instant" }});
          const box = one.getBoundingClientRect();
          return [box.left + Math.min(box.width, 300) / 2, box.top + box.height * {down}];
        }})()"""
    )
    page("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return Image.open(io.BytesIO(page.picture())).convert("RGB").getpixel((int(x), int(y)))


# The page


def test_a_reference_to_an_equation_shows_the_formula_and_not_its_source(show):
    page = show()
    page.hover("a.ref[href='#eq-long']")
    assert page("tip.querySelector('math').getBoundingClientRect().width") > 100
    assert "\\" not in page("tip.innerText")


def test_a_reference_to_a_table_shows_its_caption_and_first_rows(show):
    page = show()
    page.hover("a.ref[href='#tbl-long']")
    assert "Many rows." in page("tip.innerText")
    assert page("[...tip.querySelectorAll('td')].map((cell) => cell.innerText).join()").startswith(
        "0,0,1,1,2,4"
    )
    assert 2 < page("tip.querySelectorAll('tr').length") < 10
    assert page("document.querySelectorAll('#tbl-long').length") == 1


def test_a_reference_to_a_section_shows_its_title_and_first_sentence(show):
    page = show()
    page.hover("a.ref[href='#sec-rules']")
    title, sentence = page("[...tip.querySelectorAll('p')].map((one) => one.innerText)")
    assert title.split() == ["2", "Rules"]
    assert " ".join(sentence.split()) == "With γ near 1 the agent is patient, e.g. in Boxing."
    page.hover("a.ref[href='#sec-more']")
    assert page("tip.querySelector('p').innerText").split() == ["A", "More"]


def test_a_reference_to_a_figure_shows_it_and_a_citation_its_entry(show):
    page = show()
    page.hover("a.ref[href='#vid-hero']")
    assert page("tip.querySelector('img').naturalWidth") == 64
    assert "A film." in page("tip.innerText")
    page.hover("a[href='#ref-mnih2015']")
    assert "Human-Level Control" in page("tip.innerText")
    page.move(0, 0)
    assert page("tip.hidden")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("name", ["fig-tall", "fig-wide"])
def test_the_light_box_shows_a_whole_figure_and_a_button_that_closes_it(show, width, dark, name):
    page = show(width=width, dark=dark)
    page(f"document.querySelector('#{name} img').click()")
    page.wait("lighted.complete")
    left, top, right, bottom = page(
        "(({ left, top, right, bottom }) => [left, top, right, bottom])"
        "(lighted.getBoundingClientRect())"
    )
    assert left >= 0
    assert top >= 0
    assert right <= width
    assert bottom <= 800
    assert right - left > 0.9 * width or bottom - top > 0.9 * 800, "as large as there is room for"
    page.click("#light img")
    assert page("lighted.getBoundingClientRect().width") > 1.5 * (right - left)
    page.click("#light button")  # by its place: whatever covers it would be clicked
    assert not page("light.open")


@pytest.mark.parametrize("inside", ["figure img", ".formula", "pre"])
def test_what_is_too_wide_for_a_phone_scrolls_within_itself_and_shows_it(show, inside):
    page = show(width=390)
    assert page("document.documentElement.scrollWidth") == 390
    page(f"window.wide = document.querySelector('main {inside}').closest('.wide')")
    page.wait("wide.matches('.after:not(.before)')")
    assert page("getComputedStyle(wide, '::after').content") != "none"
    assert page("wide.firstChild.tabIndex") == 0, "the keyboard scrolls it"
    page("wide.firstChild.scrollTo(1e6, 0)")
    page.wait("wide.matches('.before:not(.after)')")
    assert page("getComputedStyle(wide, '::after').content") == "none"


def test_figures_keep_a_readable_scale_on_a_phone_and_fit_a_desktop(show):
    page = show(width=390)
    assert page("document.querySelector('#fig-wide img').getBoundingClientRect().width") > 500
    page = show(width=1280)
    page.wait("!document.querySelector('#fig-wide .wide').matches('.after')")


@pytest.mark.parametrize("width", [1280, 390])
def test_equations_carry_their_numbers_at_the_margin(show, width):
    page = show(width=width)
    ends = page(
        """[...document.querySelectorAll(".equation .number")].map((number) => [
          number.innerText, number.getBoundingClientRect().right,
          number.closest(".equation").getBoundingClientRect().right])"""
    )
    assert [number for number, _, _ in ends] == ["(1)", "(2)"]
    for _, right, margin in ends:
        assert right == pytest.approx(margin, abs=1)
        assert right < width


def test_no_line_begins_with_the_comma_after_a_formula(show):
    page = show()
    breaks = page(
        """(() => {
          const formula = document.querySelector("main p math[display=inline]");
          const paragraph = formula.closest("p");
          const comma = document.createRange();
          comma.setStart(formula.nextSibling, 0);
          comma.setEnd(formula.nextSibling, 1);
          const found = [];
          for (let width = 60; width < 400; width += 1) {
            paragraph.style.width = `${width}px`;
            found.push(comma.getBoundingClientRect().left < formula.getBoundingClientRect().left);
          }
          return [comma.toString(), found.filter(Boolean).length, found.length];
        })()"""
    )
    assert breaks == [",", 0, 340]


@pytest.mark.parametrize("width", [1280, 390])
def test_in_the_dark_drawings_lie_on_the_page_and_pictures_keep_their_colours(show, width):
    page = show(width=width, dark=True)
    ground = tuple(
        int(part)
        for part in re.findall(r"\d+", page("getComputedStyle(document.body).backgroundColor"))
    )
    image = "#fig-wide img"
    assert pixel(page, image, 0.12) == pytest.approx(ground, abs=3)
    assert min(pixel(page, image, 0.37)) > 245, "black lines become white"
    assert pixel(page, image, 0.62) == pytest.approx(GREEN, abs=40)


@pytest.mark.parametrize("width", [1280, 390])
def test_in_the_dark_nothing_light_shows_around_a_listing(show, width):
    """Neither at its corners nor, where it is faded since there is more of it, at its edge."""
    page = show(width=width, dark=True)
    page.wait("document.querySelector('div.sourceCode .wide.after') !== null")
    left, top, right, bottom = page(
        """(() => {
          const block = document.querySelector("div.sourceCode");
          block.scrollIntoView({ block: "center", behavior: "instant" });
          const box = block.getBoundingClientRect();
          return [box.left, box.top, box.right, box.bottom].map(Math.round);
        })()"""
    )
    page("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    seen = np.asarray(Image.open(io.BytesIO(page.picture())).convert("L"))[top:bottom, left:right]
    edges = (seen[:3], seen[-3:], seen[:12, -40:], seen[:, :3])  # a sign at the right is the page's
    assert max(edge.max() for edge in edges) < 60


def test_in_the_light_drawings_are_as_they_were_drawn(show):
    page = show()
    assert pixel(page, "#fig-wide img", 0.12) == (255, 255, 255)
    assert pixel(page, "#fig-wide img", 0.37) == (0, 0, 0)
    assert pixel(page, "#fig-wide img", 0.62) == pytest.approx(GREEN, abs=3)


IN_VIEW = (
    "document.querySelector('#vid-hero').scrollIntoView({ block: 'center', behavior: 'instant' })"
)
HERO, SECOND = (f"document.querySelector('#vid-{name} video')" for name in ("hero", "second"))


def test_the_first_video_plays_by_itself_while_it_is_in_view(show):
    page = show()
    assert page(f"{HERO}.paused")
    page(IN_VIEW)
    page.wait(f"!{HERO}.paused && {HERO}.currentTime > 0")
    assert page(f"{HERO}.muted && {HERO}.loop")
    assert page(f"{SECOND}.paused")
    page("window.scrollTo({ top: 0, behavior: 'instant' })")
    page.wait(f"{HERO}.paused")
    page(IN_VIEW)
    page.wait(f"!{HERO}.paused")
    page(f"{HERO}.pause()")  # as its reader does
    page("window.scrollTo({ top: 0, behavior: 'instant' })")
    page("new Promise((done) => setTimeout(done, 300))")  # it is seen to leave
    page(IN_VIEW)
    page("new Promise((done) => setTimeout(done, 300))")
    assert page(f"{HERO}.paused")


def test_no_video_plays_by_itself_for_who_wants_no_motion(show):
    page = show(motion=False)
    page(IN_VIEW)
    page("new Promise((done) => setTimeout(done, 300))")
    assert page(f"{HERO}.paused")


def test_videos_show_their_controls_only_to_who_points_at_them(show, html):
    page = show()
    assert page("[...document.querySelectorAll('video')].map((one) => one.controls)") == [False] * 2
    page.hover("#vid-second video")
    assert page(f"{SECOND}.controls")
    page.move(0, 0)
    assert not page(f"{SECOND}.controls")
    page(f"{SECOND}.focus()")
    assert page(f"{SECOND}.controls")
    assert len(re.findall("<video[^>]* controls", html)) == 2, (
        "where there is no JavaScript they are always there"
    )


def test_a_video_has_its_room_before_it_is_loaded(html):
    assert len(re.findall('<video[^>]* width="64" height="48"', html)) == 2


HALF = "#vid-second video"  # of whose pictures the page shows one half
SWITCH = "document.querySelector('#vid-second .switches button')"


def test_a_videos_layer_is_switched_by_keyboard_while_it_plays_on(show):
    page = show()
    names = "[...document.querySelectorAll('.video .switches button')].map(one => one.textContent)"
    assert page(names) == [LAYER], "no switch where there is no layer"
    assert page(f"{SWITCH}.closest('[role=group]').ariaLabel") == "Layers shown"
    page(f"{SECOND}.play()")
    page.wait(f"{SECOND}.currentTime > 0")
    page(f"{SECOND}.playbackRate = 1 / 16")  # it does not begin anew while it is watched
    listen = f"{SECOND}.addEventListener(kind, () => disturbed.push(kind))"
    page(f"window.disturbed = []; for (const kind of ['pause', 'seeking', 'emptied']) {listen}")
    page(f"{SWITCH}.focus()")
    for key, pressed in ((" ", "true"), ("Enter", "false"), ("Enter", "true")):
        page.press(key)
        assert page(f"{SWITCH}.ariaPressed") == pressed
        red, green, _ = pixel(page, HALF, 0.5)
        assert (red > green + 100) == (pressed == "true")
    at = page(f"{SECOND}.currentTime")
    page.wait(f"{SECOND}.currentTime !== {at}")
    assert page("disturbed") == []


@pytest.mark.parametrize("width", [1280, 390])
def test_before_it_plays_a_video_with_a_layer_shows_the_half_that_is_chosen(show, width):
    page = show(width=width)
    assert page(f"{SECOND}.paused && {SECOND}.controls === false")
    box = f"(({{ width, height }}) => width / height)({SECOND}.getBoundingClientRect())"
    for off, colour in ((False, (255, 255, 255)), (True, RED)):
        if off:
            page.click("#vid-second .switches button")
            page.move(0, 0)
        assert page(box) == pytest.approx(64 / 48, abs=0.01), "of one half, once it is loaded too"
        for down in (0.1, 0.9):
            assert pixel(page, HALF, down) == pytest.approx(colour, abs=6)


def test_without_javascript_a_video_with_a_layer_is_the_one_without_it(show):
    page = show()
    page.command("Emulation.setScriptExecutionDisabled", value=True)
    try:
        page.command("Page.reload")
        page.wait("document.readyState === 'complete' && !document.querySelector('.switches')")
    finally:
        page.command("Emulation.setScriptExecutionDisabled", value=False)  # none has run
    assert page(f"{SECOND}.controls")
    for down in (0.1, 0.5):
        assert pixel(page, HALF, down) == pytest.approx((255, 255, 255), abs=6)


def test_a_tile_of_the_board_is_a_link_as_a_whole_and_says_its_verdict_in_a_word(show):
    page = show(width=390)
    tiles = page(
        """[...document.querySelectorAll(".tile")].map((tile) => {
          tile.scrollIntoView({ block: "center", behavior: "instant" });
          const box = tile.getBoundingClientRect();
          const [x, y] = [box.left + 6, box.bottom - 6];
          return [tile.innerText, document.elementFromPoint(x, y).getAttribute("href"), box.left];
        })"""
    )
    words = ["✓ in these runs: yes", "✗ contradicted", "≈ inconclusive", "○ open"]
    assert [text.splitlines()[0] for text, _, _ in tiles] == words
    assert {link for _, link, _ in tiles} == {"#sec-rules"}
    assert {text.splitlines()[-1] for text, _, _ in tiles} == {"Section\N{NO-BREAK SPACE}2"}
    assert len({left for _, _, left in tiles}) == 2, "columns on a phone"
    page = show(width=1280, dark=True)
    assert (
        len(set(page("[...document.querySelectorAll('.tile')].map((tile) => tile.offsetTop)"))) == 1
    )


def test_a_product_stays_on_one_line_in_both_media(made, html):
    product = "84 × 84".replace(" ", "\N{NO-BREAK SPACE}")
    assert product in html
    paper = (made / "report.typ").read_text(encoding="utf-8")
    assert product in paper.replace("~", "\N{NO-BREAK SPACE}")


def test_the_page_says_of_itself_what_it_is(html):
    head = dict(re.findall(r'<meta (?:name|property)="([^"]+)" content="([^"]*)"', html))
    assert head["author"] == "The atari-dqn project"
    assert head["date"] == "2020-02-03"
    assert head["og:title"] == build.TITLE
    assert head["description"] == head["og:description"] == build.DESCRIPTION
    assert "og:image" not in head
    assert "3 February 2020" in html


def test_a_report_of_unfinished_runs_says_that_it_is_preliminary(made, html, tmp_path):
    byline = re.compile(r'class="byline">(.*?)</p>')
    assert "preliminary" in byline.search(html)[1]
    assert "preliminary" in (made / "report.typ").read_text(encoding="utf-8")
    build._typeset("# Done", "", tmp_path, datetime(2020, 2, 3, tzinfo=UTC))
    assert "preliminary" not in byline.search((tmp_path / "index.html").read_text("utf-8"))[1]


def test_the_contents_show_the_readers_place_and_the_subsections_of_no_other(show):
    page = show(width=1280)
    inner = """[...document.querySelectorAll("#contents ul ul a")]
      .map((link) => [link.offsetParent !== null, link.getBoundingClientRect().bottom])"""
    page("window.scrollTo({ top: 0, behavior: 'instant' })")
    assert [seen for seen, _ in page(inner)] == [False]
    page("document.getElementById('contents').style.maxHeight = '6rem'")
    page("document.body.style.paddingBottom = '100vh'")  # so that it can be at the top
    page("document.querySelector('main h2').scrollIntoView({ behavior: 'instant' })")
    page("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    ((seen, bottom),) = page(inner)
    assert seen
    assert bottom <= page("document.getElementById('contents').getBoundingClientRect().bottom")


def test_references_link_to_their_papers_in_both_media(made, html):
    address = "https://doi.org/10.1038/nature14236"
    assert f'href="{address}"' in html
    assert f'#link("{address}")' in (made / "report.typ").read_text(encoding="utf-8")


def test_each_medium_has_the_words_meant_for_it(made, html):
    paper = (made / "report.typ").read_text(encoding="utf-8")
    for text, own, other in ((html, "page", "paper"), (paper, "paper", "page")):
        assert f"Only the {own} says".replace("the paper", "paper") in text
        assert f"Only the {other} says".replace("the paper", "paper") not in text
        assert f"{own.title()}." in text
        assert f" {other.title()}." not in text


def test_the_abstract_comes_first(made, html):
    for text, chapter in ((html, "<h1 data"), ((made / "report.typ").read_text(), "= Start")):
        assert len(re.findall("What was", text)) == 1
        assert text.index("What was") < text.index(chapter)


# Paper


def asked(made, code):
    """What Typst answers to a question about the document, once it is laid out."""
    source = (made / "report.typ").read_text(encoding="utf-8")
    (made / "asked.typ").write_text(f"{source}\n#context [#metadata({code}) <answer>]")
    found = typst.query(
        str(made / "asked.typ"), "<answer>", root=str(made), field="value", one=True
    )
    return json.loads(found)


def test_figures_float_and_have_text_alternatives_on_paper(made):
    figures = asked(
        made,
        "query(figure.where(kind: image)).map(f => (str(f.label), f.body.alt, repr(f.placement)))",
    )
    assert figures == [
        ["fig-wide", "A drawing of fig-wide in it", "auto"],
        ["fig-tall", "A drawing of fig-tall in it", "top"],
        ["vid-hero", "A film of nothing in grey", "top"],
        ["vid-second", "A film of nothing in grey", "top"],
    ]


def shelved(heights, sections=2):
    """Sections with a line of text and figures of these heights (points), and a short table."""
    for number in range(sections):
        yield f"## Section {number}\n\n{WORDS}\n"
        for place, height in enumerate(heights):
            name = f"fig-{number}-{place}"
            yield f'![A drawing.](drawing-{height}.svg){{#{name} alt="Nothing at all"}}\n'
        yield "| a |\n|---|\n| 1 |\n\n: One row. {#tbl-" + f"{number}}}\n"


WHERE = ".map(one => (one.location().page(), one.location().position().y.pt()))"
PLACES = (
    f"(query(heading.where(level: 2)){WHERE}, query(<caption-mark>){WHERE})"  # floats' captions
)


@pytest.mark.parametrize("heights", [(80, 150, 150), (150, 60, 60, 60)])
def test_no_figure_strays_into_the_next_section_and_no_short_table_from_its_text(tmp_path, heights):
    for height in heights:
        (tmp_path / f"drawing-{height}.svg").write_text(drawing(200, height))
    build._typeset("# All\n\n" + "\n".join(shelved(heights, 5)), "", tmp_path, None)
    source = tmp_path / "report.typ"
    marked = source.read_text(encoding="utf-8").replace(
        "left-aligned(text(size: 9pt, it))",
        "left-aligned(text(size: 9pt, [#metadata(0)<caption-mark>#it]))",
    )
    source.write_text(marked, encoding="utf-8")
    headings, captions = asked(tmp_path, PLACES)
    each = len(heights) + 1
    assert (len(headings), len(captions)) == (5, 5 * each)
    for number, following in enumerate(headings[1:]):
        assert max(captions[number * each : (number + 1) * each]) < following
    tables = asked(tmp_path, "query(figure.where(kind: table)).map(f => repr(f.placement))")
    assert tables == ["none"] * 5


def test_two_tall_strips_of_pictures_fit_a_page(tmp_path):
    strip = tmp_path / "strip.png"
    Image.new("RGB", (300, 270)).save(strip)
    div = ':::: {{#vid-{} .video strip="strip.png" alt="Nothing"}}\n<p></p>\n\nA film.\n::::\n'
    text = f"# Films\n\n{div.format('one')}\n\n{div.format('two')}"
    build._typeset(text, "", tmp_path, None)
    pages = asked(tmp_path, "(locate(<vid-one>).page(), locate(<vid-two>).page())")
    widths = re.findall(
        r'image\("strip.png", width: ([\d.]+)%', (tmp_path / "report.typ").read_text()
    )
    assert [float(width) for width in widths] == pytest.approx([100 * 0.66 / 0.9] * 2, abs=0.1)
    assert len(set(pages)) == 1


@pytest.mark.parametrize("count", [10, 38, 44])
def test_the_contents_fit_the_first_page_with_few_headings_and_with_many(tmp_path, count):
    sections = "## One\n\nText.\n\n## Two\n\nText."
    text = "\n\n".join(f"# Chapter {number}\n\n{sections}" for number in range(count))
    build._typeset(text, "", tmp_path, None)
    pages = asked(tmp_path, "query(heading.where(level: 1)).map(h => h.location().page())")
    assert pages[:2] == [1, 2]


def test_equations_are_numbered_on_paper_as_on_the_page(made):
    numbers = asked(
        made,
        "query(math.equation.where(block: true)).map("
        "e => (str(e.label), numbering(e.numbering, ..counter(math.equation).at(e.location()))))",
    )
    assert numbers == [["eq-long", "(1)"], ["eq-short", "(2)"]]


def test_a_held_place_takes_no_label_from_what_stands_before_it(made):
    kinds = asked(made, "(query(<vid-second>).first(), query(<fig-later>).first())")
    assert [one["func"] for one in kinds] == ["figure", "metadata"]


def test_appendices_are_lettered_in_both_media(made, html):
    numbers = asked(
        made,
        "query(heading).map(h => if h.numbering == none { none } else "
        "{ numbering(h.numbering, ..counter(heading).at(h.location())) })",
    )
    assert numbers == [None, "1", "2", "A", "A.1", None]  # the first is that of the contents
    assert re.findall(r'<h[12][^>]*data-number="([^"]+)"', html) == ["1", "2", "A", "A.1"]
    assert "Appendix\N{NO-BREAK SPACE}A</a>" in html


def test_a_long_table_goes_on_over_pages_under_its_header(made):
    assert "table.header(" in (made / "report.typ").read_text(encoding="utf-8")
    pages = asked(made, "(locate(<tbl-long>).page(), locate(<sec-more>).page())")
    assert pages[1] > pages[0]


def test_the_first_page_has_the_contents_and_who_wrote_it_when(made):
    assert asked(made, "query(heading.where(level: 1)).map(h => h.location().page())")[:2] == [1, 2]
    assert asked(made, "query(outline).map(o => o.location().page())") == [1]
    pdf = (made / "report.pdf").read_bytes()
    assert b"The atari-dqn project" in pdf
    assert b"D:20200203" in pdf
    assert b"reproducibility" in pdf


def test_a_listing_breaks_between_definitions_and_nowhere_else(made):
    paper = (made / "report.typ").read_text(encoding="utf-8")
    listings = re.findall(r"^#Skylighting\(\((.*?)\)\);$", paper, re.MULTILINE | re.DOTALL)
    assert [len(re.findall("Tok..def", one)) for one in listings[:2]] == [1, 1]
    assert "breakable: lines.len() > 60" in paper


# Trust


def test_what_a_run_has_stored_is_shown_as_it_is_and_never_obeyed(show, made):
    page = show()
    cells = page("[...document.querySelectorAll('#tbl-hostile td')].map(td => td.textContent)")
    assert HOSTILE in cells
    assert cells.count("??b???i?") == 2, "the commit and the hash"
    inside = page("[...document.querySelectorAll('#tbl-hostile td *')].map(one => one.localName)")
    assert set(inside) == {"code"}, "of names and hashes"
    assert page("typeof window.injected") == "undefined"
    assert page("document.querySelectorAll('script:not([type])').length") == 1, "the report's own"
