"""Whether a section of the report must be executed again: a digest of all it is made from."""

import ast
import hashlib
import json
import re
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from atari_dqn import params
from atari_dqn.params import ParameterError
from atari_dqn.report import crossrefs
from atari_dqn.runs import plan
from atari_dqn.runs.files import project_root
from atari_dqn.runs.run import Run, runs_of


def fingerprint(notebook: Path, profile: str, results: Path) -> str:
    """SHA-256 (hex) of a notebook and what it depends on: the modules that it imports, directly
    or through others; the data files beside it; the stored benchmarks, if any of that code reads
    them; the stored runs of the experiments that it names.
    """
    source = notebook.read_text(encoding="utf-8")
    code = "\n".join(
        "".join(cell["source"])
        for cell in json.loads(source)["cells"]
        if cell["cell_type"] == "code"
    )
    digest = hashlib.sha256(f"{profile}\n{crossrefs.from_notebook(source)}".encode())
    if "project_files" in code:  # a drawing of their names
        digest.update("\n".join(source_files()).encode())
    modules = _modules(code)
    paths = [*modules, *_data(notebook), *_stored(code, profile, results)]
    sources = [code, *(path.read_text(encoding="utf-8") for path in modules)]
    if any(READS_BENCHMARKS.search(source) for source in sources):
        paths += sorted((project_root() / "results" / "benchmarks").glob("*.*"))
    for path in paths:
        digest.update(f"{path.parent.name}/{path.name}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


READS_BENCHMARKS = re.compile(r"""["'](results/)?benchmarks\b""")  # a part of a path, not of a text


def _modules(code: str) -> list[Path]:
    """The source files of what `code` imports, directly or through others."""
    files = source_files()
    seen: set[str] = set()
    waiting = set(imports(code, files))
    while waiting:
        name = waiting.pop()
        seen.add(name)
        waiting |= imports(files[name].read_text(encoding="utf-8"), files) - seen
    return [files[name] for name in sorted(seen)]


def _data(notebook: Path) -> list[Path]:
    return sorted((notebook.parent / "data").glob("*.yaml"))


def _stored(code: str, profile: str, results: Path) -> Iterator[Path]:
    """The parameter files of every experiment that the code names, of all that the report is about
    if it asks for a study of none in particular; and, if it shows any runs, those that are stored
    of them, and what these start from; or all that are stored."""
    shows_runs = re.search(r"\b(Section|Study)\(", code)
    of_all = re.search(r"\bStudy\((?![^)]*names)", code)
    for path in plan.files(profile):
        named = re.search(rf"""["']{path.stem}["']""", code)
        if not named and not (of_all and path.stem in plan.ORDER):
            continue
        yield from params.files_behind(path)
        for run in runs_of(params.load(path), results) if shows_runs else ():
            yield from _files(run)
            with suppress(ParameterError):  # of a damaged file, which the section names
                if source := run.source():
                    yield from _files(source)
    if "plan.stored(" in code:
        for run in plan.known(profile, [], results)[0]:  # damaged ones are named
            yield from _files(run)


def _files(run: Run) -> list[Path]:
    files = [*run.folder.rglob("[!.]*"), run.styles, run.robustness]
    return sorted(file for file in files if file.is_file())


PACKAGE = Path(__file__).parents[1]


def source_files() -> dict[str, Path]:
    """{module: file} of the project's own, such as "agents" and "runs.plan"."""
    files = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


def imports(code: str, modules: Collection[str]) -> frozenset[str]:
    """Those of the project's modules that some code imports."""
    return _imported(code).intersection(modules)


@cache  # by the code: sections import much the same, and parsing it is most of the work
def _imported(code: str) -> frozenset[str]:
    """The names that some code imports from the project, be they modules or what is in them."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module:
            package, _, module = node.module.partition(".")
            if package == "atari_dqn":
                found |= {module, *(f"{module}.{name.name}".strip(".") for name in node.names)}
    return frozenset(found)
