"""What makes a section of the report out of date, and what does not."""

import json
import shutil
from pathlib import Path

import pytest

from atari_dqn import params
from atari_dqn.report import fingerprint
from atari_dqn.runs.run import runs_of

ROOT = Path(__file__).parents[1]


@pytest.fixture
def notebook(tmp_path):
    """A section that draws a diagram and shows the runs of one experiment."""
    cells = [
        "from atari_dqn import schedules",
        'section = sections.Section("boxing_final", profile)',
    ]
    path = tmp_path / "notebooks" / "01_one.ipynb"
    path.parent.mkdir()
    listed = [{"cell_type": "code", "source": [cell]} for cell in cells]
    path.write_text(json.dumps({"cells": listed}))
    return path


def test_a_section_depends_on_what_its_runs_start_from(notebook, tmp_path):
    notebook.write_text(notebook.read_text().replace("boxing_final", "boxing_transfer"))
    before = fingerprint.fingerprint(notebook, "smoke", tmp_path)
    transfer = params.load(ROOT / "params" / "smoke" / "boxing_transfer.yaml")
    source = runs_of(transfer, tmp_path)[0].source().folder
    source.mkdir(parents=True)
    (source / "status.json").write_text("{}")
    assert fingerprint.fingerprint(notebook, "smoke", tmp_path) != before


def test_a_section_depends_on_the_styles_of_its_runs(notebook, tmp_path):
    before = fingerprint.fingerprint(notebook, "smoke", tmp_path)
    boxing = params.load(ROOT / "params" / "smoke" / "boxing_final.yaml")
    styles = runs_of(boxing, tmp_path)[0].styles
    styles.parent.mkdir(parents=True)
    styles.write_text("episode\n")
    assert fingerprint.fingerprint(notebook, "smoke", tmp_path) != before


def test_a_section_that_shows_no_runs_depends_on_none(notebook, tmp_path):
    notebook.write_text(notebook.read_text().replace("sections.Section(", "plan.files("))
    before = fingerprint.fingerprint(notebook, "smoke", tmp_path)
    folder = run_folder("boxing_final", tmp_path)
    folder.mkdir(parents=True)
    (folder / "episodes.csv").write_text("episode\n")
    assert fingerprint.fingerprint(notebook, "smoke", tmp_path) == before


def test_only_what_a_section_is_made_from_makes_it_stale(notebook, tmp_path, monkeypatch):
    package = tmp_path / "package"
    shutil.copytree(ROOT / "src" / "atari_dqn", package)
    monkeypatch.setattr(fingerprint, "PACKAGE", package)

    def now():
        return fingerprint.fingerprint(notebook, "smoke", tmp_path)

    def changes(path, text="x = 1\n"):
        before = now()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(path.read_text() + text if path.exists() else text)
        return now() != before

    assert now() == now()
    assert changes(package / "schedules.py"), "imported"
    assert changes(package / "params.py"), "imported by what is imported"
    assert not changes(package / "runs" / "cluster.py"), "not imported"
    assert changes(notebook.parent / "data" / "facts.yaml")
    of = {name: run_folder(name, tmp_path) for name in ("boxing_final", "breakout_final")}
    assert changes(of["boxing_final"] / "episodes.csv"), "its experiment's"
    assert not changes(of["breakout_final"] / "episodes.csv"), "another's"
    assert changes(notebook, "\n")
    notebook.write_text(notebook.read_text().replace("schedules", "params; project_files()"))
    assert not changes(package / "runs" / "cluster.py"), "of which only the name is drawn"
    assert changes(package / "runs" / "another.py")


def test_imports_are_those_of_the_sources():
    sources = {name: path.read_text() for name, path in fingerprint.source_files().items()}
    imports = {name: fingerprint.imports(source, sources) for name, source in sources.items()}
    assert "agents" in imports["training"]  # from atari_dqn.agents import ...
    assert "runs.records" in imports["runs.audit"]  # from atari_dqn.runs import ...
    assert "evaluation" in imports["runs.audit"]  # from atari_dqn import ...
    assert "runs.cluster" in imports["__main__"]  # within a function
    assert imports["games"] == set()
    assert "training" not in imports["agents"]


def test_a_small_section_depends_on_the_bases_of_its_file_too(notebook, tmp_path, monkeypatch):
    shutil.copytree(ROOT / "params", tmp_path / "params")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    monkeypatch.chdir(tmp_path)
    before = fingerprint.fingerprint(notebook, "smoke", tmp_path)
    base = tmp_path / "params" / "base" / "atari.yaml"
    base.write_text(base.read_text().replace("evaluation_epsilon: 0.001", "evaluation_epsilon: 0"))
    assert fingerprint.fingerprint(notebook, "smoke", tmp_path) != before


@pytest.mark.parametrize("by", ["itself", "a module", "nothing"])
def test_measurements_count_where_they_are_read(notebook, tmp_path, monkeypatch, by):
    shutil.copytree(ROOT / "params", tmp_path / "params")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    monkeypatch.chdir(tmp_path)
    code = notebook.read_text()
    if by == "itself":
        code = code.replace("schedules", "params; read('results/benchmarks/speed.csv')")
    elif by == "a module":
        code = code.replace("atari_dqn import schedules", "atari_dqn.report import cost")
    notebook.write_text(code)
    before = fingerprint.fingerprint(notebook, "smoke", tmp_path)
    speed = tmp_path / "results" / "benchmarks" / "speed.csv"
    speed.parent.mkdir(parents=True)
    speed.write_text("steps\n1\n")
    changed = fingerprint.fingerprint(notebook, "smoke", tmp_path) != before
    assert changed == (by != "nothing")


def run_folder(name, results):
    parameters = params.load(ROOT / "params" / "smoke" / f"{name}.yaml")
    return runs_of(parameters, results)[0].folder


@pytest.mark.parametrize(("named", "all_of_them"), [("", True), (", names=names", False)])
def test_a_section_on_the_whole_study_depends_on_every_experiment(
    notebook, tmp_path, named, all_of_them
):
    text = notebook.read_text().replace("sections.Section(", "sections.Study(")
    notebook.write_text(text.replace("profile)", f"profile{named})"))
    before = fingerprint.fingerprint(notebook, "smoke", tmp_path)
    folder = run_folder("breakout_late", tmp_path)
    folder.mkdir(parents=True)
    (folder / "episodes.csv").write_text("episode\n")
    assert (fingerprint.fingerprint(notebook, "smoke", tmp_path) != before) == all_of_them
