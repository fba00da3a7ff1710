"""What the page shows of curves at the pointer, and what its buttons switch, in a real browser."""

import io
import json

import nbformat
import numpy as np
import pandas as pd
import pytest
from browser import running
from matplotlib import pyplot as plt
from PIL import Image

from atari_dqn.games import GAMES
from atari_dqn.report import build, interactive, plots
from atari_dqn.report.interactive import described, named

SLOPES = {"dqn": 0.05, "double_dqn": 0.1}  # points per episode
FRAMES, SECONDS = 5_000, 90.0  # per episode
PUBLISHED = {"frames": [1, 2], "Rainbow": [3.0, 6.0]}
SOURCE = pd.DataFrame({"agent": ["dqn"], "episode": [200], "score": [70.0], "window": [50]})


def episodes(count=400, seeds=(1,)):
    """Scores that rise by a slope, so that a mean of ten is known everywhere."""
    number = np.arange(1, count + 1)
    tables = [
        pd.DataFrame(
            {
                "episode": number,
                "frames": number * FRAMES,
                "cpu_seconds": number * SECONDS,
                "score": number * slope + seed,
                "agent": agent,
                "seed": seed,
            }
        )
        for agent, slope in SLOPES.items()
        for seed in seeds
    ]
    return pd.concat(tables, ignore_index=True)


@pytest.fixture
def figure():
    plots.style()
    yield plots.learning_curves(episodes(), GAMES["boxing"], 10, PUBLISHED, SOURCE)
    plt.close("all")


def value(agent, episode):
    """The mean of the last ten scores at an episode."""
    return SLOPES[agent] * (episode - 4.5) + 1


def test_each_panel_has_its_own_axis_place_and_curves(figure):
    panels = {panel["x_label"]: panel for panel in described(figure)["panels"]}
    units = {"training games": 1, "million frames": FRAMES / 1e6}
    units["hours of processor time"] = SECONDS / 3600
    assert list(panels) == list(units)
    for axes, (label, unit) in zip(figure.axes, units.items(), strict=True):
        panel = panels[label]
        assert (panel["x_min"], panel["x_max"]) == pytest.approx(axes.get_xlim(), abs=1e-3)
        box = axes.get_window_extent().transformed(figure.transFigure.inverted())
        place = [panel[name] for name in ("left", "top", "width", "height")]
        assert place == pytest.approx([box.x0, 1 - box.y1, box.width, box.height], abs=1e-3)
        curves = {one["name"]: one for one in panel["artists"] if "name" in one}
        for agent, title in (("dqn", "DQN"), ("double_dqn", "Double DQN")):
            xs, ys = np.array(curves[title]["xs"]), np.array(curves[title]["ys"])
            assert len(xs) <= interactive.POINTS
            assert xs[-1] > 0.98 * 400 * unit
            assert ys == pytest.approx(value(agent, xs / unit), abs=0.02)


def test_an_artist_is_switched_by_its_agent_and_by_its_origin(figure):
    found = described(figure)
    assert [one["name"] for one in found["switches"]] == [
        "DQN",
        "Double DQN",
        "source report",
        "Dopamine",
    ]
    main, frames, hours = found["panels"]
    switched = {one.get("name"): one["switches"] for one in main["artists"]}
    assert switched["DQN, source report"] == ["DQN", "source report"]
    assert {one.get("name") for one in frames["artists"]} == {
        "DQN",
        "Double DQN",
        "Rainbow, Dopamine",
    }
    assert {one.get("name") for one in hours["artists"]} == {"DQN", "Double DQN"}
    identities = [one["id"] for panel in found["panels"] for one in panel["artists"]]
    assert len(set(identities)) == len(identities)
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg")
    assert all(f'id="{identity}"' in buffer.getvalue() for identity in identities)


def test_seeds_and_bands_are_switched_and_only_the_mean_has_values():
    plots.style()
    drawn = plots.learning_curves(episodes(seeds=(1, 2, 3)), GAMES["boxing"], 10, None, SOURCE[:0])
    main, *lower = described(drawn)["panels"]
    assert [one.get("name") for one in main["artists"]].count("DQN") == 1
    assert len(main["artists"]) == 2 * (3 + 1 + 1)  # seeds, mean and band of each agent
    seeds = [one["name"] for one in lower[0]["artists"]]
    assert seeds[:3] == ["DQN, seed 1", "DQN, seed 2", "DQN, seed 3"]
    plt.close("all")


def test_a_figure_that_names_nothing_has_nothing_to_tell():
    drawn, axes = plt.subplots()
    (line,) = axes.plot([1, 2], [3, 4], label="a line")
    assert described(drawn) is None
    named(line, "a line", value="a line")
    assert described(drawn)["panels"][0]["artists"][0]["ys"] == [3, 4]
    plt.close(drawn)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The learning curves on a page of the report's own making, in a browser."""
    plots.style()
    drawn = plots.learning_curves(episodes(), GAMES["boxing"], 10, PUBLISHED, SOURCE)
    folder, buffer = tmp_path_factory.mktemp("page"), io.StringIO()
    meta = {"label": "fig-curves", "caption": "Curves.", "alt": "Two curves.", "data": ""}
    meta = json.loads(json.dumps({**meta, "curves": described(drawn)}))
    drawn.savefig(buffer, format="svg")
    plt.close(drawn)
    output = nbformat.v4.new_output(
        "display_data",
        {"image/svg+xml": buffer.getvalue()},
        metadata={"image/svg+xml": meta},
    )
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("", outputs=[output])])
    nbformat.write(notebook, folder / "00_curves.ipynb")
    text = build._section(folder / "00_curves.ipynb", folder)
    build._typeset(f"# Curves {{#sec-curves}}\n\n{text}", "", folder, None)
    with running(tmp_path_factory.mktemp("browser")) as found:
        found.file = folder / "index.html"
        found.open(found.file)
        found(IN_VIEW)
        yield found, meta["curves"]["panels"]


IN_VIEW = "document.getElementById('fig-curves').scrollIntoView({behavior: 'instant'})"


BOX = """(() => { const image = document.querySelector('#fig-curves img');
  const box = image.getBoundingClientRect(), pad = parseFloat(getComputedStyle(image).paddingLeft);
  return [box.left + pad, box.top + pad, box.width - 2 * pad, box.height - 2 * pad]; })()"""
TIP = """(() => { const tip = document.getElementById('tip');
  return tip.hidden ? [] : [...tip.children].map((line) => line.textContent); })()"""


def point(page, panel, x, y=0.5):
    """Points at an x of a panel's own axis; returns the panel's edges in the window: left, top,
    right, bottom."""
    left, top, width, height = page.wait(BOX)
    share = (x - panel["x_min"]) / (panel["x_max"] - panel["x_min"])
    edges = [
        left + panel["left"] * width,
        top + panel["top"] * height,
        left + (panel["left"] + panel["width"]) * width,
        top + (panel["top"] + panel["height"]) * height,
    ]
    at = edges[0] + share * (edges[2] - edges[0])
    page.move(at, edges[1] + y * (edges[3] - edges[1]))
    return edges


@pytest.mark.parametrize(
    ("number", "x", "name", "unit"),
    [
        (0, 300.0, "training games", 1),
        (1, 1.4, "million frames", FRAMES / 1e6),
        (2, 6.0, "hours of processor time", SECONDS / 3600),
    ],
)
def test_the_values_are_those_of_the_panel_under_the_pointer(page, number, x, name, unit):
    browser, panels = page
    edges = point(browser, panels[number], x)
    head, *lines = browser.wait(TIP)
    assert head.startswith(f"{name}: ")
    assert float(head.rpartition(" ")[2]) == pytest.approx(x, rel=0.02)
    shown = dict(line.rsplit(": ", 1) for line in lines)
    assert list(shown) == ["DQN", "Double DQN"]
    for agent, title in (("dqn", "DQN"), ("double_dqn", "Double DQN")):
        assert float(shown[title]) == pytest.approx(value(agent, x / unit), abs=0.5)
    rectangle = "(({left, top, right, bottom}) => [left, top, right, bottom])"
    bounds = "document.querySelector('{}').getBoundingClientRect()"
    _, top, _, bottom = browser(rectangle + f"({bounds.format('#tip')})")
    assert bottom <= edges[1] or top >= edges[3], "the box covers the curves that it reads"
    left, top, _, bottom = browser(rectangle + f"({bounds.format('.marker')})")
    assert (top, bottom) == pytest.approx((edges[1], edges[3]), abs=1.5)
    share = (left - edges[0]) / (edges[2] - edges[0])
    low, high = (panels[number][end] for end in ("x_min", "x_max"))
    assert low + share * (high - low) == pytest.approx(x, rel=0.02)


def test_the_page_shows_the_figure_and_none_of_the_numbers_behind_it(page):
    browser, _ = page
    text = browser("document.body.innerText")
    assert "Curves." in text
    assert "panels" not in text


def test_points_are_told_where_they_stand_only(page):
    browser, (main, frames, _) = page
    point(browser, main, 200)
    assert "DQN, source report: 70.0" in browser.wait(TIP)
    point(browser, main, 250)
    assert not any("source" in line for line in browser.wait(TIP))
    point(browser, frames, 2.0)
    assert "Rainbow, Dopamine: 6.0" in browser.wait(TIP)


def test_between_the_panels_and_beside_them_nothing_is_shown(page):
    browser, (main, *_) = page
    point(browser, main, 200)
    assert browser.wait(TIP)
    for x, y in ((200, 1.08), (-20, 0.5)):
        point(browser, main, x, y)
        assert browser(TIP) == []
        assert browser("document.querySelector('.marker').hidden")


def test_a_switch_of_lines_of_several_colours_has_none_of_these():
    figure, axes = plt.subplots()
    for colour, switch in (("red", "both"), ("blue", "both"), ("red", "one"), ("red", "one")):
        interactive.named(axes.plot([0, 1], color=colour)[0], switch)
    found = interactive.switches(figure)
    plt.close(figure)
    assert found["one"] == "#ff0000"
    assert found["both"] not in {"#ff0000", "#0000ff"}


def test_buttons_switch_curves_and_their_values_by_keyboard(page):
    browser, (main, *_) = page
    buttons = "[...document.querySelectorAll('.switches button')]"
    assert browser(f"{buttons}.map((one) => one.textContent)") == [
        "DQN",
        "Double DQN",
        "source report",
        "Dopamine",
    ]
    marks = browser(f"{buttons}.map((one) => one.dataset.marks || '')")
    assert marks == ["", "", "○", "□"], "what is a line in the picture has the colour of one"
    source = "document.querySelector('#fig-curves img').src"
    before = browser(source)
    browser(f"{buttons}[0].focus()")
    browser.press("Enter")
    pressed = f"{buttons}.map((one) => one.getAttribute('aria-pressed'))"
    assert browser(pressed) == ["false", "true", "true", "true"]
    drawn = browser(f"decodeURIComponent({source})")
    hidden = {one["id"] for one in main["artists"] if "DQN" in one["switches"]}
    assert len(hidden) == 3  # its curve, the source report's points of it and ours beside them
    for one in main["artists"]:
        tag = drawn[drawn.index(f'id="{one["id"]}"') :].partition(">")[0]
        assert ("display: none" in tag) == (one["id"] in hidden)
    point(browser, main, 200)
    assert [line.partition(":")[0] for line in browser.wait(TIP)[1:]] == ["Double DQN"]
    browser.press("Enter")
    assert browser(pressed) == ["true"] * 4
    assert "display: none" not in browser(f"decodeURIComponent({source})")
    assert browser(source) != before  # an image of its own now
    point(browser, main, 200)
    assert len(browser.wait(TIP)) == 5


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_a_buttons_swatch_has_the_colour_that_its_curve_is_seen_in(page, dark):
    browser, (main, *_) = page
    browser.open(browser.file, width=1280, dark=dark)
    browser(IN_VIEW)
    browser.wait("document.querySelectorAll('.switches button').length === 4")
    left, top, right, bottom = map(round, point(browser, main, 300))
    browser.move(0, 0)  # no marker over the curves
    browser("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    seen = np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB")).astype(int)
    middle = (left + right) // 2
    curves = seen[top:bottom, middle : middle + 40].reshape(-1, 3)
    for number in (0, 1):
        x, y = browser(
            f"""(() => {{
              const button = document.querySelectorAll(".switches button")[{number}];
              const box = button.getBoundingClientRect(), how = getComputedStyle(button);
              const inner = parseFloat(how.paddingLeft) + parseFloat(how.borderLeftWidth);
              return [box.left + inner + 4, (box.top + box.bottom) / 2];
            }})()"""
        )
        swatch = seen[int(y), int(x)]
        assert np.abs(curves - swatch).max(axis=1).min() < 8
