"""From notebooks to the written report: papermill executes, nbconvert extracts, pandoc and Typst
typeset. Every part comes from pip packages; nothing is fetched.

The previous report stays in place until a whole new one has been made.
"""

import base64
import json
import os
import shutil
import struct
import tempfile
import tomllib
import warnings
from collections.abc import Collection
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import nbformat
import pypandoc
import typst
from filelock import FileLock, Timeout
from nbconvert import MarkdownExporter
from tqdm import tqdm

from atari_dqn.analysis.study import SNAPSHOT
from atari_dqn.report import catalogue, crossrefs, fingerprint, kernels
from atari_dqn.report.execution import execute
from atari_dqn.runs import plan, records, robustness, scheduler, styles, tables
from atari_dqn.runs.files import RunError, project_root, results_folder
from atari_dqn.runs.run import stored_json

STAMP = {"full": "", "quick": "QUICK RUN, NOT EVIDENCE", "smoke": "SMOKE RUN, NOT EVIDENCE"}
TITLE = "Deep Q-Networks learn to box"
SUBTITLE = "A reproducible study of DQN, Double DQN and Dueling Double DQN on two Atari games"
AUTHOR = "The atari-dqn project"
DESCRIPTION = (
    "DQN, Double DQN and Dueling Double DQN learn Atari Boxing and Breakout from pixels, and the "
    "claims of an earlier study are tested on runs whose every game can be replayed."
)
KEYWORDS = "deep reinforcement learning, DQN, Double DQN, Dueling DQN, Atari, reproducibility"
TEMPLATES = Path(__file__).parent / "templates"


def build(profile: str, results: Path | None = None) -> Path:
    """Makes the report of a profile and returns its folder.

    `full` renders what is stored, and trains nothing; the other profiles first train what is
    missing of their small runs. Sections whose notebook, code, parameters and runs are those of
    the last time are not executed again. Raises RunError if a run or a section fails, or if the
    report is being built by another process.
    """
    folder = results_folder(profile, results)
    (folder / "notebooks").mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / "notebooks" / ".lock", timeout=0):
            return _build(profile, folder)
    except Timeout:
        raise RunError(f"the report in {folder} is being built by another process") from None


def _build(profile: str, folder: Path) -> Path:
    if profile != "full":
        wanted, refused = plan.planned(profile, [], folder)
        failures = scheduler.train_all(wanted) + refused
        if failures:
            raise RunError("; ".join(failures))
    for line in plan.damaged(profile, [], folder):
        warnings.warn(f"{line}; left out", stacklevel=2)
    _measure(profile, folder)
    snapshot = _snapshot(folder)
    executed = _execute(profile, folder, snapshot)
    data = project_root() / "notebooks" / "data"
    with tempfile.TemporaryDirectory() as temporary:
        made = Path(temporary)
        waiting_for = _without_runs(profile, folder)
        text = "\n\n".join(_section(path, made, waiting_for) for path in executed)
        listed, waiting = crossrefs.check_completeness(text, data / "completeness.yaml")
        print(f"{listed} things of the source report have their places; {waiting} wait for runs")
        called = json.dumps(crossrefs.names(text), indent=0, ensure_ascii=False)
        (made / "names.json").write_text(called, encoding="utf-8")
        text = crossrefs.finish(text) + "\n\n# References {.unnumbered}\n"
        _typeset(text, STAMP[profile], made, _moment(folder))
        target = folder / "report"
        target.mkdir(parents=True, exist_ok=True)
        names = ("index.html", "report.pdf", "names.json")
        for name in names:  # all of them, before the first takes its place
            shutil.copyfile(made / name, target / f".{name}")
        for name in names:
            (target / f".{name}").replace(target / name)
    if profile == "full":  # the others' agents are no evidence, and nobody's to take
        catalogue.write(profile, snapshot, folder)
    return target


def _measure(profile: str, folder: Path) -> None:
    """Brings up to date what is measured in the records of runs."""
    compared, tried = (
        plan.planned(profile, list(kind.EXPERIMENTS), folder)[0] for kind in (styles, robustness)
    )
    wanted = [(styles.measure, run) for run in compared if (run.folder / records.FILE).exists()]
    wanted += [(robustness.measure, run) for run in tried]
    for measure, run in wanted:
        if tables.damage(run):
            continue
        try:
            measure(run)
        except RunError as error:
            warnings.warn(f"{error}; left out", stacklevel=2)


def _snapshot(folder: Path) -> Path:
    """A copy of the stored runs, so that all sections speak of the same games though training may
    go on. Returns the folder to give notebooks as that of the results."""
    snapshot = folder / SNAPSHOT
    shutil.rmtree(snapshot, ignore_errors=True)

    def copy(source: str, target: str) -> None:
        # A table may be appended to; others are replaced, if ever, and what is no file, such as a
        # pipe, is not to be read
        if not source.endswith(".csv") or not os.path.isfile(source):
            with suppress(OSError):  # no links between these folders
                os.link(source, target)
                return
        shutil.copyfile(source, target)

    ignored = shutil.ignore_patterns(".*", "tensorboard")
    for name in ("runs", "styles", "robustness"):
        (folder / name).mkdir(parents=True, exist_ok=True)
        shutil.copytree(folder / name, snapshot / name, ignore=ignored, copy_function=copy)
    return snapshot


def _sections() -> list[Path]:
    return sorted((project_root() / "notebooks").glob("[0-9]*.ipynb"))


def _stale(profile: str, folder: Path, results: Path) -> list[tuple[Path, str]]:
    """The sections that are not executed as they are now, with the fingerprints of that."""
    stale = []
    for notebook in _sections():
        fresh = fingerprint.fingerprint(notebook, profile, results)
        stamp = folder / "notebooks" / f"{notebook.stem}.inputs"
        executed = folder / "notebooks" / notebook.name
        if not (executed.exists() and stamp.exists() and stamp.read_text() == fresh):
            stale.append((notebook, fresh))
    return stale


def _execute(profile: str, folder: Path, results: Path) -> list[Path]:
    """Runs the numbered notebooks that are out of date into results/notebooks, one a core.

    A failing one leaves no output there.
    """
    target = folder / "notebooks"
    stale = _stale(profile, folder, results)
    begin, environment = kernels.begin, (dict(os.environ),)
    with ProcessPoolExecutor(scheduler.cores(), kernels.context(), begin, environment) as pool:
        jobs = {
            pool.submit(execute, notebook, target, profile, results): (notebook, fresh)
            for notebook, fresh in stale
        }
        for job in tqdm(as_completed(jobs), total=len(jobs), desc="sections"):
            notebook, fresh = jobs[job]
            try:
                job.result()
            except RunError:
                pool.shutdown(cancel_futures=True)
                raise
            (target / f"{notebook.stem}.inputs").write_text(fresh)
    return [target / notebook.name for notebook in _sections()]


def _moment(folder: Path) -> datetime | None:
    """When the report's content is from: SOURCE_DATE_EPOCH or the start of the newest stored run's
    last session, so that the same runs give the same report. None without either."""
    if "SOURCE_DATE_EPOCH" in os.environ:
        return datetime.fromtimestamp(int(os.environ["SOURCE_DATE_EPOCH"]), UTC)
    sessions: list[dict[str, str]] = []
    for path in (folder / "runs").rglob("provenance.json"):
        with suppress(RunError):  # a damaged one, which has been named
            sessions += stored_json(path.parent, path.name)["sessions"]
    return max((datetime.fromisoformat(one["started"]) for one in sessions), default=None)


def _size(png: str, halves: int = 1) -> str:
    """The size of a PNG image (base64), or of one of its halves, in HTML's words: a page that knows
    it does not jump."""
    width, height = struct.unpack(">II", base64.b64decode(png)[16:24])
    width //= halves
    return f'width="{width}" height="{height}" style="aspect-ratio: {width} / {height}"'


# In a dark page a drawing is seen in negative, hues kept; pictures within it are turned back.
DARK = (
    b"<style>@media (prefers-color-scheme: dark) "
    b"{ svg, image { filter: invert(1) hue-rotate(180deg) } }</style></svg>"
)


def _without_runs(profile: str, folder: Path) -> set[str]:
    """The experiments of which no run has begun."""
    planned, _ = plan.planned(profile, [], folder)
    return {run.experiment for run in planned} - {
        run.experiment for run in planned if run.folder.exists()
    }


NEEDS = "needs:"  # a cell's tag says by this that its text is about the runs of an experiment


def _section(path: Path, made: Path, waiting_for: Collection[str] = ()) -> str:
    """An executed notebook as pandoc's Markdown; its figures go to `made`. Cells that are tagged
    as needing an experiment in `waiting_for` are left out."""
    exporter = MarkdownExporter(template_name="section", extra_template_basedirs=[str(TEMPLATES)])
    exporter.register_filter("size", _size)
    notebook = nbformat.read(path, as_version=4)
    early = {NEEDS + name for name in waiting_for}
    notebook.cells = [
        cell for cell in notebook.cells if early.isdisjoint(cell.metadata.get("tags", []))
    ]
    names = {
        "output_files_dir": f"{path.stem}_figures",
        "unique_key": path.stem,
        "notebook": path.name,
    }
    body, resources = exporter.from_notebook_node(notebook, names)
    for name, data in resources["outputs"].items():
        (made / name).parent.mkdir(exist_ok=True)
        if name.endswith(".svg"):
            data = data.replace(b"</svg>", DARK)
        (made / name).write_bytes(data)
    return crossrefs.from_notebook(body)


def _script() -> str:
    """What runs in the page: `curves.js` uses functions of `report.js`."""
    parts = ("report.js", "curves.js")
    return "\n".join((TEMPLATES / part).read_text(encoding="utf-8") for part in parts)


def _metadata(moment: datetime | None) -> dict[str, str]:
    """What the report says of itself before its text begins."""
    project = tomllib.loads((project_root() / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    facts = {
        "title": TITLE,
        "subtitle": SUBTITLE,
        "author": AUTHOR,
        "description": DESCRIPTION,
        "keywords": KEYWORDS,
        "lang": "en-GB",
        "version": project["version"],
        "repository": project.get("urls", {}).get("Repository", ""),
    }
    if moment:
        facts |= {"date": f"{moment:%Y-%m-%d}", "day": f"{moment.day} {moment:%B %Y}"}
    return facts


def _typeset(text: str, stamp: str, made: Path, moment: datetime | None) -> None:
    """Markdown to `made`/index.html and report.pdf."""
    facts = _metadata(moment) | {"stamp": stamp, "link-citations": "true"}
    if "{.badge .partial}" in text:
        facts["preliminary"] = "yes"
    bibliography = project_root() / "notebooks" / "references.bib"
    shared = [
        "--standalone",
        "--fail-if-warnings",  # such as a citation of nothing
        "--columns=10000",  # no table line is too long for columns as wide as their contents
        "--citeproc",
        f"--bibliography={bibliography}",
        f"--resource-path={made}",
        "--number-sections",
        "--syntax-highlighting=tango",
        f"--lua-filter={TEMPLATES / 'report.lua'}",
        *(f"--metadata={name}:{value}" for name, value in facts.items() if value),
    ]
    source = "markdown"
    html = [
        *shared,
        "--embed-resources",
        "--mathml",
        "--toc",
        "--toc-depth=2",
        f"--variable=script:{_script()}",
        f"--css={TEMPLATES / 'report.css'}",
        f"--css={TEMPLATES / 'curves.css'}",
        f"--template={TEMPLATES / 'report.html'}",
    ]
    pypandoc.convert_text(
        text, "html5", source, extra_args=html, outputfile=str(made / "index.html")
    )
    paper = [
        *shared,
        f"--template={TEMPLATES / 'report.typ'}",
    ]
    pypandoc.convert_text(
        text, "typst", source, extra_args=paper, outputfile=str(made / "report.typ")
    )
    typst.compile(
        str(made / "report.typ"),
        output=str(made / "report.pdf"),
        root=str(made),
        ignore_system_fonts=True,
        timestamp=int(moment.timestamp()) if moment else 0,
    )
