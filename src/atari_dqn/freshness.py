"""Whether a section of the report must be executed again: a digest of all it is made from."""

import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path

from atari_dqn import experiments, params, runs, sources


def fingerprint(notebook: Path, profile: str, results: Path) -> str:
    """SHA-256 (hex) of a notebook and what it depends on: the modules that it imports, directly
    or through others; the data files beside it; the stored benchmarks; the stored runs of the
    experiments that it names.
    """
    source = notebook.read_text(encoding="utf-8")
    code = "\n".join(
        "".join(cell["source"])
        for cell in json.loads(source)["cells"]
        if cell["cell_type"] == "code"
    )
    digest = hashlib.sha256(f"{profile}\n{source}".encode())
    measured = sorted((runs.project_root() / "results" / "benchmarks").glob("*.*"))
    for path in [*_modules(code), *_data(notebook), *measured, *_stored(code, profile, results)]:
        digest.update(f"{path.parent.name}/{path.name}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _modules(code: str) -> list[Path]:
    """The source files of what `code` imports, directly or through others; all of them if it draws
    them."""
    files, graph = sources.modules(), sources.graph()
    if "project_files" in code:
        return list(files.values())
    seen: set[str] = set()
    waiting = sources.imports(code)
    while waiting:
        name = waiting.pop()
        seen.add(name)
        waiting |= graph[name] - seen
    return [files[name] for name in sorted(seen)]


def _data(notebook: Path) -> list[Path]:
    return sorted((notebook.parent / "data").glob("*.yaml"))


def _stored(code: str, profile: str, results: Path) -> Iterator[Path]:
    """The parameter files and stored runs of every experiment that the code names; of all of them
    if it asks for a study of no experiments in particular."""
    for path in experiments.files(profile):
        if not re.search(rf"""["']{path.stem}["']|\bStudy\((?![^)]*names)""", code):
            continue
        yield from params.files_behind(path)
        for run in runs.runs_of(params.load(path), results):
            yield from sorted(file for file in run.folder.rglob("[!.]*") if file.is_file())
