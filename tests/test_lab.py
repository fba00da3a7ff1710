"""The two notebooks in a real JupyterLab, in a real browser; and what saving them there leaves."""

import json
import os
import re
import shlex
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import browser
import nbformat
import papermill
import pytest
from nbformat.v4 import new_output

from atari_dqn.report import lab

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
SAVING = re.findall(r"--FileContentsManager\S+", (ROOT / "Makefile").read_text())
MAIN = "[...jupyterapp.shell.widgets('main')][0]"


def saved(path, content):
    manager = SimpleNamespace(_get_os_path=lambda name: str(path.parent / name))
    model = {"type": "notebook", "content": content}
    lab.without_outputs(model=model, path=path.name, contents_manager=manager)
    return model["content"]


@pytest.mark.parametrize("name", ["explore", "experiment", "03_results"])
def test_what_jupyter_saves_of_an_own_notebook_is_what_was_committed(name, tmp_path):
    path = NOTEBOOKS / f"{name}.ipynb"
    used = nbformat.read(path, as_version=4)
    used.metadata["kernelspec"]["display_name"] = "Python 3 (ipykernel)"
    used.metadata["language_info"] |= {"version": "3.99", "file_extension": ".py"}
    for cell in used.cells:
        cell.metadata["collapsed"] = True
        if cell.cell_type == "code":
            cell.execution_count = 7
            cell.outputs = [new_output("stream", text="much")]
    assert nbformat.writes(saved(path, used)) + "\n" == path.read_text(encoding="utf-8")


def test_a_copy_keeps_its_outputs():
    copy = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(execution_count=7)])
    assert saved(NOTEBOOKS / "explore-Copy1.ipynb", copy).cells[0].execution_count == 7
    assert saved(ROOT / "docs" / "explore.ipynb", copy).cells[0].execution_count == 7


def test_a_typo_is_an_error_of_one_line_in_the_notebook(tmp_path):
    with pytest.raises(papermill.PapermillExecutionError):
        papermill.execute_notebook(
            NOTEBOOKS / "experiment.ipynb",
            tmp_path / "out.ipynb",
            {"profile": "smoke", "results_dir": str(tmp_path), "gama": 0.9},
            cwd=NOTEBOOKS,
            kernel_name="python3",
            progress_bar=False,
        )
    notebook = nbformat.read(tmp_path / "out.ipynb", as_version=4)
    (error,) = (
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output.output_type == "error"
    )
    line = "ParameterError: unknown parameter 'gama'; did you mean 'gamma'?"
    assert error.traceback == [line]


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """A JupyterLab, as `make lab` starts it, on copies of the notebooks; the experiment is a small
    one."""
    folder = tmp_path_factory.mktemp("lab")
    browser.command(folder)  # which skips the tests where there is no browser
    text = (NOTEBOOKS / "explore.ipynb").read_text(encoding="utf-8")
    (folder / "explore.ipynb").write_text(text, encoding="utf-8")
    text = (NOTEBOOKS / "experiment.ipynb").read_text(encoding="utf-8")
    for before, after in (
        ('profile = \\"quick\\"', 'profile = \\"smoke\\"'),
        ("results_dir = None", f"results_dir = {json.dumps(str(folder))}".replace('"', '\\"')),
    ):
        assert text.count(before) == 1
        text = text.replace(before, after)
    (folder / "experiment.ipynb").write_text(text, encoding="utf-8")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [
            *(sys.executable, "-m", "jupyter", "lab", str(folder / "explore.ipynb"), *SAVING),
            *("--no-browser", "--allow-root", f"--port={port}", "--IdentityProvider.token=t"),
            "--LabApp.expose_app_in_browser=True",
        ],
        env={
            **os.environ,
            **{f"JUPYTER_{name}_DIR": str(folder / name) for name in ("CONFIG", "RUNTIME")},
            "ATARI_DQN_STATE": str(folder / "state"),
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"
    try:
        end = time.monotonic() + browser.PATIENCE
        while True:
            try:
                urllib.request.urlopen(f"{address}/api/status?token=t").close()
                break
            except OSError:
                assert server.poll() is None, "JupyterLab has ended"
                assert time.monotonic() < end, "JupyterLab does not start"
                time.sleep(0.2)
        yield address
    finally:
        server.terminate()
        server.wait()


@pytest.fixture
def tab(tmp_path):
    with browser.running(tmp_path / "profile") as tab:
        yield tab


def run(tab, address, name):
    """Opens a notebook and runs its cells, to the last."""
    tab.resize(1300, 2400)
    tab.command("Page.navigate", url=f"{address}/lab/tree/{name}?token=t&reset")
    kernel = f"{MAIN}?.sessionContext?.session?.kernel"
    tab.wait(f"window.jupyterapp !== undefined && {kernel}?.status === 'idle'")
    tab("jupyterapp.commands.execute('notebook:run-all-cells'), 1")
    prompts = "[...document.querySelectorAll('.jp-CodeCell .jp-InputPrompt')]"
    tab.wait(f"{prompts}.every(each => /\\[\\d+\\]/.test(each.textContent))")
    assert not errors(tab)


def errors(tab):
    failed = "[data-mime-type='application/vnd.jupyter.error']"
    return tab(f'[...document.querySelectorAll("{failed}")].map(each => each.textContent)')


def facts(tab):
    return tab(
        "[...document.querySelectorAll('.widget-html-content')].map(each => each.textContent)"
        ".find(text => / step \\d/.test(text))"
    )


def picture(tab):
    """The colours of the panel's picture, as the browser shows it."""
    return tab("document.querySelector('img.widget-image').src")


def button(tab, text):
    tab(
        "[...document.querySelectorAll('button.jupyter-button')]"
        f".find(each => each.textContent === {json.dumps(text)}).click()"
    )


def test_a_stored_game_is_looked_through_and_played_on_in_jupyterlab(address, tab):
    run(tab, address, "explore.ipynb")
    tab.wait("document.querySelector('img.widget-image')?.naturalWidth === 720")
    before, seen = facts(tab), picture(tab)
    assert ": step 0 of " in before
    drag(tab, 0.5)
    tab.wait("document.body.textContent.match(/: step (\\d+) of/)?.[1] > 100")
    tab.wait(f"document.querySelector('img.widget-image').src !== {json.dumps(seen)}")
    cells = tab("document.querySelectorAll('.jp-Cell').length")
    step = int(re.search(r"step (\d+) of", facts(tab).replace(",", ""))[1])
    button(tab, "play yourself")
    tab.hover("img.widget-image")
    tab.press("ArrowRight")
    tab.wait(f"document.body.textContent.match(/: step (\\d+) of/)?.[1] > {step + 20}")
    assert "; played" not in facts(tab), "the newest step"
    button(tab, "stop")
    tab.wait(
        "[...document.querySelectorAll('button.jupyter-button')]"
        ".find(each => each.textContent === 'stop').disabled"
    )
    assert tab("document.querySelectorAll('.jp-Cell').length") == cells, "keys are the game's"
    keep(tab, "explore")
    assert not errors(tab)


def drag(tab, share):
    """Moves the first slider's handle to a share of its way."""
    handle, way = (
        tab(
            f"(() => {{ const box = document.querySelector('.widget-slider {name}')"
            ".getBoundingClientRect(); return [box.left, box.top, box.width, box.height]; })()"
        )
        for name in (".noUi-handle", ".noUi-target")
    )
    y, start = handle[1] + handle[3] / 2, handle[0] + handle[2] / 2
    for kind, x in (
        ("mousePressed", start),
        ("mouseMoved", start + 10),
        ("mouseMoved", way[0] + share * way[2]),
        ("mouseReleased", way[0] + share * way[2]),
    ):
        tab.command(
            "Input.dispatchMouseEvent",
            **{"type": kind, "x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 1},
        )


def test_an_experiment_is_trained_and_shown_in_jupyterlab(address, tab):
    run(tab, address, "experiment.ipynb")
    tab.wait("document.body.textContent.includes('This repeats it from nothing')")
    text = tab("document.body.textContent")
    assert "boxing_final/dqn/seed-1 is complete: 4 games" in text
    assert "did you mean" not in text
    tab.wait("document.querySelector('video')?.videoWidth > 0")
    pictures = "document.querySelectorAll('.jp-RenderedSVG img, .jp-RenderedSVG svg').length"
    assert tab(pictures) == 2, "while it trained, and beside others"
    assert tab("document.querySelectorAll('.jp-RenderedMarkdown table tr').length") > 3
    keep(tab, "experiment")


def keep(tab, name):
    """Leaves a screenshot for whoever asks for them."""
    if folder := os.environ.get("ATARI_DQN_SCREENSHOTS"):
        (Path(folder) / f"{name}.png").write_bytes(tab.picture())


def answer(url):
    """The status with which a server answers, 0 if none does."""
    try:
        with urllib.request.urlopen(url) as found:
            return found.status
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:
        return 0


def test_what_make_lab_starts_answers_this_machine_alone_and_only_to_its_token(tmp_path):
    command = subprocess.run(
        ["make", "--dry-run", "lab"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    (options,) = re.findall(r"/jupyter (lab .*)", command.stdout.replace("\\\n", " "))
    folders = {f"JUPYTER_{name}_DIR": str(tmp_path / name) for name in ("CONFIG", "RUNTIME")}
    server = subprocess.Popen(
        [sys.executable, "-m", "jupyter", *shlex.split(options), "--no-browser"],
        cwd=ROOT,
        env={**os.environ, **folders},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        end = time.monotonic() + browser.PATIENCE
        while not (found := list(tmp_path.glob("RUNTIME/jpserver-*.json"))):
            assert server.poll() is None, "JupyterLab has ended"
            assert time.monotonic() < end, "JupyterLab does not start"
            time.sleep(0.2)
        told = json.loads(found[0].read_text())
        port, token = told["port"], told["token"]
        while not answer(f"http://127.0.0.1:{port}/api/status?token={token}"):
            assert time.monotonic() < end, "JupyterLab does not answer"
            time.sleep(0.2)
        assert len(token) >= 32
        contents = f"http://127.0.0.1:{port}/api/contents"
        assert [answer(contents), answer(f"{contents}?token={token}")] == [403, 200]
        assert answer(f"http://127.0.0.2:{port}/api/contents?token={token}") == 0, "another address"
    finally:
        server.terminate()
        server.wait()
