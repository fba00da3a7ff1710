"""The pipeline from notebooks to the report, on smoke runs of the real games."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from ast import literal_eval
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from unittest.mock import Mock

import browser
import nbformat
import papermill
import psutil
import pytest

from atari_dqn import params
from atari_dqn.report import build, crossrefs, execution, kernels, notebook
from atari_dqn.runs import plan, recorder
from atari_dqn.runs.files import RunError, write_atomically

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PATIENCE = 1800  # seconds; only what hangs takes so long, even on a busy machine


def test_a_snapshot_stays_as_it_was_while_training_goes_on(tmp_path, monkeypatch):
    folder = tmp_path / "runs" / "any" / "dqn" / "seed-1"
    folder.mkdir(parents=True)
    for name in ("episodes.csv", "model.safetensors", ".lock"):
        (folder / name).write_text("before")
    for linking in (True, False):
        if not linking:  # as between two file systems
            monkeypatch.setattr(build.os, "link", Mock(side_effect=OSError))
        snapshot = build._snapshot(tmp_path) / "runs" / "any" / "dqn" / "seed-1"
        with (folder / "episodes.csv").open("a") as file:
            file.write(", after")
        write_atomically(folder / "model.safetensors", b"after")
        assert {path.name: path.read_text() for path in snapshot.iterdir()} == {
            "episodes.csv": "before",
            "model.safetensors": "before",
        }
        (folder / "episodes.csv").write_text("before")
        (folder / "model.safetensors").write_text("before")


def test_a_snapshot_has_the_styles_of_the_runs(tmp_path):
    styles = tmp_path / "styles" / "any" / "dqn" / "seed-1.csv"
    styles.parent.mkdir(parents=True)
    styles.write_text("episode\n")
    found = build._snapshot(tmp_path) / styles.relative_to(tmp_path)
    assert found.read_text() == "episode\n"


def test_text_about_runs_that_have_not_begun_is_left_out_and_an_abstract_is_one(tmp_path):
    texts = {"What it is.": ["abstract"], "Of its runs.": ["needs:boxing_expert"], "Else.": []}
    cells = [
        nbformat.v4.new_markdown_cell(text, metadata={"tags": tags}) for text, tags in texts.items()
    ]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), tmp_path / "01_any.ipynb")
    waiting = build._section(tmp_path / "01_any.ipynb", tmp_path, {"boxing_expert"})
    begun = build._section(tmp_path / "01_any.ipynb", tmp_path, {"boxing_final"})
    assert "Of its runs." not in waiting
    assert "Of its runs." in begun
    for text in (waiting, begun):
        assert "::: {.abstract}\nWhat it is.\n:::" in text
        assert "\nElse.\n" in text


def test_a_new_section_is_found_and_what_it_shows_is_numbered(tmp_path, monkeypatch):
    """By the steps that CONTRIBUTING.md gives, in a project of no other sections."""
    folder, made = tmp_path / "notebooks", tmp_path / "made"
    for path in (tmp_path / "params", folder, made):
        path.mkdir()
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.chdir(tmp_path)
    text, code = nbformat.v4.new_markdown_cell, nbformat.v4.new_code_cell
    needs = {"tags": ["needs:boxing_expert"]}
    copied = nbformat.read(ROOT / "notebooks" / "05_boxing_expert.ipynb", as_version=4)
    copied.cells = [
        text("# New <!-- {#sec-new} -->\n\nSee [Figure 9](#fig-new) and [below](#tbl-new)."),
        copied.cells[1],  # its parameters
        code(
            "import pandas as pd\nfrom matplotlib import pyplot as plt\n"
            "from atari_dqn.report import outputs\n\noutputs.start()\n"
            "figure, axes = plt.subplots()\naxes.plot([1, 2], [3, 4])\n"
            "outputs.show_figure(figure, 'fig-new', 'It rises.', 'A line from 3 to 4, rising.')\n"
            "table = pd.DataFrame({'profile': [profile]})\n"
            "outputs.show_table(table, 'tbl-new', 'What it was given.')"
        ),
        text("Of runs that may not have begun.", metadata=needs),
    ]
    notebook = folder / "42_new.ipynb"
    nbformat.write(copied, notebook)
    nbformat.write(nbformat.v4.new_notebook(), folder / "draft.ipynb")  # without a number
    assert build._sections() == [notebook]
    assert [path for path, _ in build._stale("smoke", tmp_path, tmp_path)] == [notebook]
    execution.execute(notebook, made, "smoke", tmp_path)
    section = build._section(made / notebook.name, made, {"boxing_expert"})
    assert "Of runs" not in section
    names = crossrefs.names(section)
    assert {name: called.replace("\xa0", " ") for name, called in names.items()} == {
        **{"sec-new": "Section 1", "fig-new": "Figure 1", "tbl-new": "Table 1"},
    }
    finished = crossrefs.finish(section)
    link = r"\[Figure\s1\]\(#fig-new\)"
    assert re.search(link, finished)
    (picture,) = re.findall(r"!\[It rises\.\]\(([^)]*)\){#fig-new", finished)
    assert (made / picture).read_bytes().startswith(b"<?xml")
    assert re.search(r"\| smoke +\|\n\n: What it was given\. {#tbl-new}", finished)
    assert crossrefs.renumber(notebook, names)
    assert re.search(link, nbformat.read(notebook, as_version=4).cells[0].source)


def test_an_experiment_has_begun_when_any_of_its_runs_is_stored(tmp_path):
    everything = set(plan.ORDER)
    assert build._without_runs("full", tmp_path) == everything
    run = next(run for run in plan.planned("full", ["boxing_sensitivity"], tmp_path)[0])
    run.folder.mkdir(parents=True)
    assert build._without_runs("full", tmp_path) == everything - {"boxing_sensitivity"}


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


def execute(output, parameters, folder, name="experiment"):
    papermill.execute_notebook(
        ROOT / "notebooks" / f"{name}.ipynb",
        output,
        parameters,
        cwd=folder,
        kernel_name="python3",
        progress_bar=False,
        kernel_manager_class=kernels.Kernels,
    )
    return nbformat.read(output, as_version=4)


def one_cell(folder, code):
    """A notebook of one cell beside its parameters, and a folder for what comes of it."""
    parameters = nbformat.v4.new_code_cell(metadata={"tags": ["parameters"]})
    cells = [parameters, nbformat.v4.new_code_cell(code)]
    about = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    notebook = nbformat.v4.new_notebook(cells=cells, metadata=about)
    nbformat.write(notebook, folder / "01_any.ipynb")
    (folder / "made").mkdir()
    return folder / "01_any.ipynb", folder / "made"


def test_a_kernel_has_the_environment_and_the_folder_of_its_own_report(tmp_path, monkeypatch):
    """Not those of the process that it is forked from, which may be of an earlier one."""
    path, made = one_cell(tmp_path, "import os\nos.environ['ANY'], os.getcwd()")
    for given in "ab":
        monkeypatch.setenv("ANY", given)
        execution.execute(path, made, "smoke", tmp_path)
        (output,) = nbformat.read(made / path.name, as_version=4).cells[-1].outputs
        assert literal_eval(output.data["text/plain"]) == (given, str(tmp_path))


@pytest.mark.skipif(not kernels.FORKED, reason="kernels are forked on Linux only")
@pytest.mark.skipif(sys.version_info >= (3, 14), reason="each starts a server of its own")
def test_what_executes_notebooks_and_their_kernels_are_forked_from_one_process(tmp_path):
    path, made = one_cell(tmp_path, "import os\nos.getppid()")
    environment = (dict(os.environ),)
    with ProcessPoolExecutor(1, kernels.context(), kernels.begin, environment) as pool:
        server = pool.submit(os.getppid).result()
        pool.submit(execution.execute, path, made, "smoke", tmp_path).result()
    (output,) = nbformat.read(made / path.name, as_version=4).cells[-1].outputs
    assert int(output.data["text/plain"]) == server


@pytest.mark.parametrize("failures", [1, 2])
def test_a_kernel_that_does_not_start_is_started_again_a_few_times(tmp_path, monkeypatch, failures):
    launch, launches = kernels.Kernels._async_launch_kernel, []

    async def launch_and_kill(self, command, **options):
        await launch(self, command, **options)
        launches.append(command)
        if len(launches) <= failures:
            self.provisioner.process.send_signal(signal.SIGKILL)

    monkeypatch.setattr(kernels.Kernels, "_async_launch_kernel", launch_and_kill)
    path, made = one_cell(tmp_path, "pass")
    monkeypatch.setattr(execution, "STARTS", 2)
    if failures == 2:
        with pytest.raises(RunError, match=r"section 01_any\.ipynb: Kernel died before replying"):
            execution.execute(path, made, "smoke", tmp_path)
        assert list(made.iterdir()) == []
    else:
        execution.execute(path, made, "smoke", tmp_path)
        assert [path.name for path in made.iterdir()] == [path.name]
    assert len(launches) == 2


def test_a_kernel_does_not_outlive_a_report_that_is_killed(tmp_path):
    code = "import os, time\nfrom pathlib import Path\nPath('pid').write_text(str(os.getpid()))\n"
    path, made = one_cell(tmp_path, code + "time.sleep(3600)")
    environment = (dict(os.environ),)
    with ProcessPoolExecutor(1, kernels.context(), kernels.begin, environment) as pool:
        executing = pool.submit(os.getpid).result()
        job = pool.submit(execution.execute, path, made, "smoke", tmp_path)
        end = time.monotonic() + PATIENCE
        while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
            assert not job.done()
            assert time.monotonic() < end, "it does not start"
            time.sleep(0.05)
        kernel = psutil.Process(int((tmp_path / "pid").read_text()))
        os.kill(executing, signal.SIGKILL)
        while kernel.is_running() and kernel.status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() < end, "it goes on for nobody"
            time.sleep(0.05)


SMOKE = {"experiment": "boxing_final", "profile": "smoke", "agent": "double_dqn"}


def test_the_experiment_notebook_trains_draws_and_stores_a_run(tmp_path):
    parameters = {**SMOKE, "results_dir": str(tmp_path), "episodes": 3}
    notebook = execute(tmp_path / "out.ipynb", parameters, ROOT / "notebooks")
    (folder,) = (tmp_path / "runs").glob("boxing_final+*/double_dqn/seed-1")
    assert json.loads((folder / "status.json").read_text())["state"] == "complete"
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/svg+xml" in output.get("data", {}) for output in outputs)


def test_an_unknown_parameter_of_the_notebook_names_the_nearest_one():
    with pytest.raises(params.ParameterError, match="did you mean 'episodes'"):
        notebook.run_from_notebook({**SMOKE, "epsiodes": 3})


def test_an_experiment_of_several_runs_is_refused_by_the_notebook_for_one():
    with pytest.raises(params.ParameterError, match="'boxing_sensitivity' is not allowed"):
        notebook.run_from_notebook({"experiment": "boxing_sensitivity", "profile": "smoke"})


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A smoke report of all experiments, made from nothing."""
    folder = tmp_path_factory.mktemp("report")
    os.environ["ATARI_DQN_STATE"] = str(folder / "state")
    # Trained here, since a process per run takes far longer; `build` trains those that start from
    # others.
    for run in plan.planned("smoke", [], folder)[0]:
        if run.source() is None:
            recorder.train(run)
    return build.build("smoke", folder)


def test_the_report_has_every_section_and_every_experiment(built):
    html = (built / "index.html").read_text()
    for path in NOTEBOOKS:
        if not path.name[0].isdigit():
            continue
        title = nbformat.read(path, as_version=4).cells[0].source
        assert f'id="{re.search("{#(sec-[a-z-]+)", title)[1]}"' in html, path
    for name in plan.ORDER:
        assert name in html
    assert "SMOKE RUN, NOT EVIDENCE" in html
    assert "runs complete" in html
    assert (built / "report.pdf").read_bytes().startswith(b"%PDF")


def test_the_background_says_what_its_measurements_say(built):
    text = re.sub(r"<[^>]+>|\s+", " ", (built / "index.html").read_text())
    text = re.sub(" +", " ", text)
    with (ROOT / "results" / "benchmarks" / "punches.csv").open() as file:
        rows = list(csv.DictReader(file))
    two = [row for row in rows if row["points"] == "2"]
    far = [row for row in rows if int(row["dx"]) >= 18]
    bent = [row for row in far if row["points"] == "2"]
    near = len(two) - len(bent), len(rows) - len(far)
    assert f"Of {len(rows):,} punches, {len(two)} scored two points" in text
    share = f"{near[0] / near[1]:.0%} of the punches gave two points"
    assert f"less than 18 pixels apart horizontally, {share}" in text
    assert f"and so did {len(bent)} of the {len(far):,} others" in text
    assert "two games of Boxing are identical after each of 1,000 steps" in text
    assert "the goal in 13 steps" in text, "the shortest way along the cliff"


def test_the_exploring_notebook_shows_pictures_where_there_are_no_widgets(built, tmp_path):
    parameters = {"profile": "smoke", "results_dir": str(built.parent)}
    cells = execute(tmp_path / "out.ipynb", parameters, ROOT, "explore").cells
    found = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
    assert any("image/png" in data for data in found), "a step of a game"
    assert any("training game 4: step" in data.get("text/markdown", "") for data in found)
    assert any("image/svg+xml" in data for data in found), "the curves"
    assert not any("application/vnd.jupyter.widget-view+json" in data for data in found)


def test_figures_say_where_they_come_from_and_curves_show_their_values(built):
    html = (built / "index.html").read_text()
    assert html.count('class="origin"') >= html.count("<figure")
    found = re.findall(r'<script type="application/json" class="curves"[^>]*>(.*?)</script>', html)
    assert found
    for panel in (panel for curves in map(json.loads, found) for panel in curves["panels"]):
        assert 0 < panel["left"] < panel["left"] + panel["width"] <= 1
        assert 0 < panel["top"] < panel["top"] + panel["height"] <= 1
        assert panel["artists"]


def test_rendering_again_gives_the_same_bytes(built):
    before = {name: (built / name).read_bytes() for name in ("index.html", "report.pdf")}
    for section in ("00_summary", "05_boxing_expert"):  # one has a video, and one curves
        (built.parent / "notebooks" / f"{section}.inputs").unlink()
    build.build("smoke", built.parent)
    assert {name: (built / name).read_bytes() for name in before} == before


def test_a_section_is_executed_again_only_if_something_of_its_own_changed(built):
    results = built.parent
    row_of = results / "runs" / "boxing_expert" / "dueling_double_dqn" / "seed-1" / "episodes.csv"
    executed = results / "notebooks" / "05_boxing_expert.ipynb"
    assert build._stale("smoke", results, build._snapshot(results)) == []
    assert "857.00" not in executed.read_text()
    header, first, *rest = row_of.read_text().splitlines(keepends=True)
    cells = first.split(",")
    cells[3] = "857"  # the score
    row_of.write_text(header + ",".join(cells) + "".join(rest))
    snapshot = build._snapshot(results)
    stale = {path.stem: path for path, _ in build._stale("smoke", results, snapshot)}
    on_all_runs = {
        "00_summary",
        "13_evaluation",
        "14_discussion",
        "16_speed",
        "17_dataset",
        "19_runs",
    }
    of_its_networks = {"12_saliency"}
    assert set(stale) == {"05_boxing_expert"} | of_its_networks | on_all_runs
    execution.execute(stale["05_boxing_expert"], executed.parent, "smoke", snapshot)
    assert "857.00" in executed.read_text()


def test_the_page_needs_no_network(built):
    html = (built / "index.html").read_text()
    assert not re.search(r"""(src|srcset)=["'](https?:)?//""", html)
    assert not re.search(r"""<link[^>]* href=["'](https?:)?//""", html)
    assert "@import" not in html
    assert not re.search(r"url\(['\"]?http", html)


def test_every_figure_has_a_text_alternative(built):
    images = re.findall(r"<img [^>]*src=[^>]*>", (built / "index.html").read_text())
    assert images
    assert all(re.search(r'alt="[^"]{20,}"', image) for image in images)
    videos = re.findall(r"<video[^>]*>", (built / "index.html").read_text())
    assert videos
    assert all(re.search(r'aria-label="[^"]{20,}"', video) for video in videos)
    assert all('poster="data:image/png' in video for video in videos)
    assert (built / "index.html").read_text().count('class="video"') == len(videos)


def test_a_failing_section_is_named_and_the_last_report_stays(built, monkeypatch, tmp_path):
    before = (built / "index.html").read_bytes()
    (tmp_path / "notebooks").mkdir()
    shutil.copy(ROOT / "notebooks" / "05_boxing_expert.ipynb", tmp_path / "notebooks")
    shutil.copytree(ROOT / "notebooks" / "data", tmp_path / "notebooks" / "data")
    shutil.copytree(ROOT / "params", tmp_path / "params")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    broken = tmp_path / "notebooks" / "05_boxing_expert.ipynb"
    broken.write_text(broken.read_text().replace("show_badge(section)", "no_such_thing(section)"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunError, match=r"05_boxing_expert\.ipynb, cell 3: AttributeError"):
        build.build("smoke", built.parent)
    assert (built / "index.html").read_bytes() == before


def test_the_page_opens_in_a_browser_without_console_errors(built, tmp_path):
    page = (built / "index.html").as_uri()
    result = subprocess.run(
        browser.command(tmp_path, "--enable-logging=stderr", "--dump-dom", page),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert "</html>" in result.stdout
    assert "CONSOLE" not in result.stderr
