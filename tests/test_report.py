"""The pipeline from notebooks to the report, on smoke runs of the real games."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import nbformat
import papermill
import pytest

from atari_dqn import report, runs

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_notebooks_are_stripped_tagged_and_free_of_classes_and_loops(path):
    notebook = nbformat.read(path, as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in cells)
    assert sum("parameters" in cell.metadata.get("tags", []) for cell in cells) == 1
    identifiers = [cell.id for cell in notebook.cells]
    assert len(set(identifiers)) == len(identifiers)
    assert all(re.fullmatch("[a-z-]+", identifier) for identifier in identifiers)
    for cell in cells:
        assert len(cell.source.splitlines()) <= 15, cell.id
        assert not re.search(r"^\s*(class|def|while) ", cell.source, re.MULTILINE), cell.id


def execute(output, parameters, folder):
    papermill.execute_notebook(
        ROOT / "notebooks" / "experiment.ipynb",
        output,
        parameters,
        cwd=folder,
        kernel_name="python3",
        progress_bar=False,
    )
    return nbformat.read(output, as_version=4)


SMOKE = {"experiment": "boxing_final", "profile": "smoke", "agent": "double_dqn"}


@pytest.mark.parametrize("folder", [ROOT, ROOT / "notebooks"], ids=["root", "notebooks"])
def test_the_experiment_notebook_trains_draws_and_stores_a_run(tmp_path, folder):
    parameters = {**SMOKE, "results_dir": str(tmp_path), "episodes": 3}
    notebook = execute(tmp_path / "out.ipynb", parameters, folder)
    (folder,) = (tmp_path / "runs").glob("boxing_final+*/double_dqn/seed-1")
    assert json.loads((folder / "status.json").read_text())["state"] == "complete"
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/svg+xml" in output.get("data", {}) for output in outputs)


def test_an_unknown_parameter_of_the_notebook_names_the_nearest_one(tmp_path):
    with pytest.raises(papermill.PapermillExecutionError, match="did you mean 'episodes'"):
        execute(tmp_path / "out.ipynb", {**SMOKE, "epsiodes": 3}, ROOT)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A smoke report, and the environment variables it was made with."""
    folder = tmp_path_factory.mktemp("report")
    os.environ["ATARI_DQN_STATE"] = str(folder / "state")
    return report.build("smoke", folder)


def test_the_report_shows_every_agent_on_both_games(built):
    html = (built / "index.html").read_text()
    for words in ("Boxing", "Breakout", "Dueling Double DQN", "Double DQN"):
        assert words in html
    assert html.count("<figure") == 5
    assert html.count("3 of 3 runs complete") == 2
    assert "SMOKE RUN, NOT EVIDENCE" in html
    assert (built / "report.pdf").read_bytes().startswith(b"%PDF")


def test_the_page_needs_no_network(built):
    html = (built / "index.html").read_text()
    assert not re.search(r"""(src|srcset|href)=["'](https?:)?//""", html)
    assert "@import" not in html
    assert not re.search(r"url\(['\"]?http", html)


def test_every_figure_has_a_text_alternative(built):
    images = re.findall(r"<img[^>]*>", (built / "index.html").read_text())
    assert images
    assert all(re.search(r'alt="[^"]{20,}"', image) for image in images)


def test_rendering_again_gives_the_same_bytes(built):
    before = {name: (built / name).read_bytes() for name in ("index.html", "report.pdf")}
    report.build("smoke", built.parent)
    assert {name: (built / name).read_bytes() for name in before} == before


def test_a_failing_section_is_named_and_the_last_report_stays(built, monkeypatch, tmp_path):
    before = (built / "index.html").read_bytes()
    shutil.copytree(ROOT / "notebooks", tmp_path / "notebooks")
    shutil.copytree(ROOT / "params", tmp_path / "params")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    broken = tmp_path / "notebooks" / "07_boxing_final.ipynb"
    broken.write_text(broken.read_text().replace("section.badge()", "section.no_such_thing()"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(runs.RunError, match=r"07_boxing_final\.ipynb, cell 3: AttributeError"):
        report.build("smoke", built.parent)
    assert (built / "index.html").read_bytes() == before


def test_the_page_opens_in_a_browser_without_console_errors(built, tmp_path):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        if os.environ.get("ATARI_DQN_BROWSER") == "required":
            pytest.fail("no browser found, and one is required")
        pytest.skip("no Chromium on this machine")
    result = subprocess.run(
        [
            *(browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"),
            *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
            *("--proxy-server=127.0.0.1:9", f"--user-data-dir={tmp_path}"),
            *("--enable-logging=stderr", "--dump-dom", (built / "index.html").as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert "</html>" in result.stdout
    assert "CONSOLE" not in result.stderr
