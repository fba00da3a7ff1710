"""What is read from files is data: none of it is run, here or in a browser; and what is installed
is what was meant."""

import ast
import json
import re
from pathlib import Path

import pytest
from synthetic import SESSION, store

from atari_dqn.analysis import study
from atari_dqn.runs import audit, plan, tables
from atari_dqn.runs.files import RunError

ROOT = Path(__file__).parents[1]
CODE = sorted(path for name in ("src", "benchmarks") for path in (ROOT / name).rglob("*.py"))
RUN_WHAT_THEY_READ = {"pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "yaml"}
UNSAFE = {
    *("eval", "exec", "os.system", "os.popen", "torch.load", "torch.save", "torch.jit.load"),
    *("pandas.read_pickle", "pd.read_pickle", "__import__", "importlib.import_module"),
}
OPTIONS = {"allow_pickle", "shell"}


def unsafe(source):
    """What in a module could run what stands in a file: modules, functions and their options."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = {name.name.split(".")[0] for name in node.names}
            found += names & RUN_WHAT_THEY_READ
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            found += {module.split(".")[0]} & RUN_WHAT_THEY_READ
            found += {f"{module}.{name.name}" for name in node.names} & UNSAFE
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func).removeprefix("builtins.")
            given = {word.arg: ast.unparse(word.value) for word in node.keywords}
            found += {name} & UNSAFE
            if name in ("np.load", "numpy.load") and len(node.args) > 2:
                found.append("allow_pickle")  # by its place
            found += {word for word in OPTIONS if given.get(word, "False") != "False"}
            if name.split(".")[-1] == "YAML" and given.get("typ") != "'safe'":
                found.append(name)
    return found


def test_no_file_is_run_for_being_read():
    assert len(CODE) > 50
    assert {path.name: found for path in CODE if (found := unsafe(path.read_text("utf-8")))} == {}


@pytest.mark.parametrize(
    "source",
    [
        *("import pickle", "from pickle import load", "import yaml", "import joblib as j"),
        *("from torch import load", "torch.load(path)", "torch.load(path, weights_only=True)"),
        *("np.load(path, allow_pickle=True)", "np.load(path, allow_pickle=maybe)"),
        *("YAML()", "YAML(typ='unsafe')", "ruamel.yaml.YAML(pure=True)"),
        *("eval(text)", "exec(text)", "subprocess.run(text, shell=True)", "pd.read_pickle(path)"),
        *("builtins.eval(text)", "np.load(path, None, True)", "__import__('pickle')"),
        *("importlib.import_module(name)", "from importlib import import_module"),
    ],
)
def test_what_runs_what_it_reads_is_found(source):
    assert unsafe(source)


@pytest.mark.parametrize(
    "source", ["np.load(path)", "YAML(typ='safe')", "network.eval()", "json.loads(text)"]
)
def test_what_only_reads_is_no_fault(source):
    assert not unsafe(source)


def without_hashes(lock):
    """The entries of a lock file that are not of one version with the hashes of its files."""
    entries = re.sub(r"\\\n", " ", re.sub(r"^#.*\n", "", lock, flags=re.MULTILINE)).splitlines()
    whole = re.compile(r"[\w.\[\]-]+==[\w.!+]+( ; [^\\]*?)?(\s+--hash=sha256:[0-9a-f]{64})+\s*")
    return [entry for entry in entries if entry.strip() and not whole.fullmatch(entry)]


def test_every_package_is_installed_by_its_hash():
    lock = (ROOT / "environment.lock").read_text("utf-8")
    assert lock.count("==") > 100
    assert without_hashes(lock) == []
    installs = re.findall(r"^.*environment\.lock$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert [line for line in installs if "install" in line and "--require-hashes" not in line] == []


@pytest.mark.parametrize(
    "entry",
    ["numpy==2.0", "numpy>=2 --hash=sha256:" + "0" * 64, "numpy==2 --hash=md5:" + "0" * 32],
)
def test_a_package_without_its_hash_is_found(entry):
    assert without_hashes(f"a==1 \\\n    --hash=sha256:{'0' * 64}\n{entry}\n") == [entry]


def provenance(**changes):
    return json.dumps(
        {"training_version": 3, "identity": "0", "agent_steps": 1, "resumes": 0} | changes
    )


PROVENANCES = [
    *(provenance(sessions=sessions) for sessions in ([], [1], [{}], {}, None)),
    *(
        provenance(sessions=[SESSION | changes])
        for changes in (
            *({"started": when} for when in ("yesterday", "2026-01-02T03:04:05", 5)),
            *({name: None} for name in ("commit", "processor", "device", "versions")),
            *({"versions": {}}, {"restored_after": "x"}, {"restored_after": -1}),
            *({"peak_memory_megabytes": number} for number in (float("nan"), float("inf"))),
        )
    ),
    *(provenance(sessions=[SESSION], **{name: "x"}) for name in ("agent_steps", "resumes")),
]


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("status.json", '{"state": "<script>", "episodes_done": 1}'),
        ("status.json", '{"state": "complete", "episodes_done": "<script>"}'),
        ("status.json", "[]"),
        ("status.json", "[" * 100_000),
        ("provenance.json", '{"training_version": 1}'),
        ("provenance.json", "\xff"),
        ("status.json", '{"state": "complete", "episodes_done": -1}'),
        *(("provenance.json", text) for text in PROVENANCES),
    ],
)
def test_what_is_no_status_or_provenance_is_named_as_damage(tmp_path, name, content):
    run = store(tmp_path, "boxing_final", "dqn", [1.0])
    assert run.state() == "interrupted"
    (run.folder / name).write_text(content, "latin-1")
    with pytest.raises(RunError, match=rf"{name} is missing or damaged \(") as error:
        run.state()
    assert "<script>" not in str(error.value).replace("'<script>'", "")
    assert len(str(error.value).splitlines()) == 1
    assert tables.damage(run) == str(error.value)


def test_what_a_run_says_of_itself_is_text_in_a_table(tmp_path):
    """test_page.py has the same in a browser."""
    session = {"processor": "<b>|`x`\n$y$", "commit": "`<b>", "device": "cpu"}
    run = store(tmp_path, "boxing_final", "dqn", [1.0], sessions=[session])
    row = study.run_table([run]).iloc[0]
    assert row["trained on"] == "&#60;b&#62;&#124;&#96;x&#96; &#36;y&#36;"
    assert row.commits == "`??b?`"
    plain = store(tmp_path, "boxing_final", "double_dqn", [1.0])
    assert study.run_table([plain]).iloc[0]["trained on"] == "a processor"


def test_no_run_of_the_repository_is_damaged_and_games_of_a_sample_play_again_as_stored():
    results = ROOT / "results"
    assert plan.damaged("full", [], results) == []
    sample = plan.stored("full", [], results)[::4]
    assert sample
    for run in sample:
        assert len(list(audit.verify(run.folder, 2))) == 2
