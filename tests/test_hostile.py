"""Input that nobody means well: it is refused in one line, soon, and nothing is created for it."""

import contextlib
import io
import json
import os
import signal
import sys
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from atari_dqn import __main__
from atari_dqn.analysis.study import Section
from atari_dqn.params import ParameterError, Parameters
from atari_dqn.report import notebook
from atari_dqn.runs import recorder
from atari_dqn.runs.run import Run

SECONDS = 2  # of processor time, since other processes may keep the cores busy

hostile = settings(
    derandomize=True,  # the same examples every time
    database=None,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The working folder; what training would be given is `taken`, and not trained."""
    monkeypatch.setattr(recorder, "train", lambda run, **_: f"taken: {run.name}")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "notes").write_text("of somebody's own")
    (tmp_path / "mine.yaml").write_text("gamma: 0.9\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


def command(folder, *arguments):
    """(exit status, stdout, stderr) of the command line, which must be fast and leave the folder
    as it is."""
    before, began = contents(folder), time.process_time()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        patch.setattr(sys, "argv", ["atari_dqn", *arguments])
        with pytest.raises(SystemExit) as ended:
            __main__.main()
    assert time.process_time() - began < SECONDS
    assert contents(folder) == before
    return ended.value.code, out.getvalue(), err.getvalue()


def is_one_line(text):
    """Of the length of a paragraph at most, without what a terminal would obey."""
    return text.removesuffix("\n").isprintable() and 0 < len(text) < 3000


def refusal(folder, *arguments):
    """The line in which a command line is refused."""
    status, out, err = command(folder, *arguments)
    assert (status, out) == (2, ""), out + err
    assert err.startswith("error: ")
    assert is_one_line(err), err
    return err


def train(folder, content, *arguments):
    """What becomes of a parameter file, in bytes or as text: the line in which it is refused, or
    nothing if it is taken."""
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    (folder / "mine.yaml").write_bytes(data)
    status, out, err = command(folder, "train", "mine.yaml", "--results", "results", *arguments)
    if status:
        assert (status, out) == (2, "")
        assert err.startswith("error: ")
        assert is_one_line(err), err
        return err
    assert "taken: " in out
    return ""


# ---- Files ---------------------------------------------------------------------------------------

TENFOLD = "a: &a [x]\n" + "".join(
    f"{key}: &{key} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, key in zip("abcdefghi", "bcdefghij", strict=True)
)
FILES = {
    "a bomb of aliases": (TENFOLD, "an anchor or alias (a) is not allowed"),
    "a bomb in a key": ("? [&a [x, x], [*a, *a]]\n: 1", "a key must be a name"),
    "a list that holds itself": ("seeds: &a [*a]", "line 1: an anchor or alias (a)"),
    "a mapping merged with itself": ("<<: &a {<<: *a}", "an anchor or alias (a)"),
    "an anchor used again and again": ("seeds: [" + "&a , " * 1500 + "]", "an anchor or alias"),
    "a hundred thousand keys": ("".join(f"k{i}: 1\n" for i in range(100_000)), "10,000 bytes"),
    "a thousand keys": ("".join(f"k{i}: 1\n" for i in range(1000)), "and 995 more"),
    "brackets": ("seeds: " + "[" * 5000, "line 1: more than 8 lists and mappings"),
    "braces": ("variations: " + "{a: " * 400, "more than 8 lists and mappings"),
    "dashes": ("- " * 4000, "more than 8 lists and mappings"),
    "indentation": ("".join(" " * i + "a:\n" for i in range(99)), "more than 8 lists"),
    "a long list": ("gamma: [" + "1," * 4900 + "]", "gamma: [1, 1, "),
    "a long text": ("game: " + "x" * 9000, "line 1: a value of more than 500 characters"),
    "a long number": ("batch_size: " + "9" * 5000, "a value of more than 500 characters"),
    "a long hexadecimal number": ("batch_size: 0x" + "f" * 490, "batch_size: "),
    "a Python object": ("gamma: !!python/object/apply:os.system [ls]", "a tag (tag:yaml.org"),
    "a tag of a number": ("batch_size: !!int x", "line 1: a tag (tag:yaml.org,2002:int)"),
    "a tag of one's own": ("gamma: 0.9\ngame: !mine pong", "line 2: a tag (!mine)"),
    "a date that is none": ("game: 2001-99-99", "line 1: '2001-99-99' is not allowed"),
    "a date": ("game: 2001-01-01", "game: datetime.date(2001, 1, 1) is not allowed"),
    "Latin-1": (b"game: b\xf6xing", "can't decode byte 0xf6"),
    "UTF-16": ("gamma: 0.9".encode("utf-16"), "can't decode byte"),
    "a null byte": ("gamma: \0", "unacceptable character #x0000"),
    "a terminal's commands": ("'\x1b[31m': 1", "unacceptable character #x001b"),
    "the same, in other words": (r'"\e[31m": 1', r"unknown key '\x1b[31m'"),
    "several lines": (r'game: "a\nb"', r"game: 'a\nb' is not allowed"),
    "half a character": (r'game: "\ud800"', r"game: '\ud800' is not allowed"),
    "right to left": (r'"\u202egamma": 1', r"unknown key '\u202egamma'"),
    "nothing": ("", "expected lines of 'key: value'"),
    "a key that is a number": ("1: 2", "expected lines of 'key: value'"),
    "only a word": ("gamma", "expected lines of 'key: value'"),
    "two documents": ("gamma: 0.9\n---\ngamma: 0.8", "line 2: but found another document"),
    "a key twice": ("gamma: 0.9\ngamma: 0.8", 'line 2: found duplicate key "gamma"'),
    "another's name": ("experiment: ../mine", "experiment: '../mine' is not allowed"),
    "a path of a model": ("initial_weights: ../../other", "initial_weights: '../../other' is not"),
    "its own model": ("initial_weights: mine", "initial_weights: 'mine' is not allowed"),
    "a path of a profile": ("profile: ../other", "profile: '../other' is not allowed"),
    "markup": ("variations: {<script>: {gamma: 0.5}}", "variations: '<script>' is not allowed"),
    "a path of a label": ("variations: {../x: {gamma: 0.5}}", "variations: '../x' is not allowed"),
    "too many variations": (
        "variations:\n" + "".join(f" v{i}: {{batch_size: {i + 1}}}\n" for i in range(101)),
        "variations: ",
    ),
    "a null byte in a base": (r'base: "a\0"', r"base: 'a\x00' is not allowed"),
    "a base of devices": ("base: /dev/zero", "base: '/dev/zero' is not allowed"),
    "a base without end": ("base: " + "x" * 300, "name too long"),
}


@pytest.mark.parametrize(("content", "said"), FILES.values(), ids=FILES)
def test_a_hostile_file_is_refused_by_its_name(folder, content, said):
    line = train(folder, content)
    assert said in line
    assert "mine" in line or "name too long" in line


def test_many_files_behind_one_are_refused(folder):
    """Two bases of two bases each, and so on: five hundred after eight floors."""
    for floor in range(8):
        for side in "ab":
            above = f"base: [{floor + 1}a.yaml, {floor + 1}b.yaml]" if floor < 7 else "gamma: 0.5"
            (folder / f"{floor}{side}.yaml").write_text(above)
    assert "more than 20 files are behind this one" in train(folder, "base: 0a.yaml")


def test_a_device_that_never_ends_is_refused(folder):
    assert "must be a regular file" in refusal(folder, "train", "/dev/zero")


def test_a_pipe_that_says_nothing_is_refused_and_not_waited_for(folder):
    os.mkfifo(folder / "pipe.yaml")
    (folder / "on_it.yaml").write_text("base: pipe.yaml")
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it waits"))
    signal.alarm(300)
    try:
        assert "pipe.yaml: must be a regular file" in refusal(folder, "train", "pipe.yaml")
        assert "base: 'pipe.yaml' is not allowed" in refusal(folder, "train", "on_it.yaml")
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


LISTS = ("seeds", "snapshot_games")  # of numbers
NUMBERS = [
    key
    for key, field in Parameters.model_fields.items()
    if field.annotation in (int, float) or key in LISTS
]


def test_every_number_is_tried():
    assert len(NUMBERS) == 29
    assert {"noop_max", "batch_size", "replay_capacity", "learning_rate"} <= set(NUMBERS)


@pytest.mark.parametrize("key", NUMBERS)
def test_a_number_far_out_of_range_is_refused_by_its_key(folder, key):
    for number in ("1" + "0" * 11, "1" + "0" * 400, "-1" + "0" * 20, "1.0e+300", "-.inf"):
        line = train(folder, f"{key}: [{number}]" if key in LISTS else f"{key}: {number}")
        assert f"mine.yaml: {key}" in line, number
        assert "is not allowed: " in line


@hostile
@given(
    st.sampled_from(sorted(Parameters.model_fields)),
    st.sampled_from(["", "[[1]]", "{a: {b: 1}}", "[{}]", "2001-01-01", "'<b>..</b>'", "[null]"]),
)
def test_a_value_of_another_type_is_refused_by_its_key(folder, key, value):
    line = train(folder, f"{key}: {value}")
    assert f"mine.yaml: {key}" in line
    assert "is not allowed: " in line


SPECIAL = st.text("[]{}&*!|>'\"%@`#,:?-<= \n\t\\0a1.e~\0\x1b\u2028\ud800é", max_size=60)
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_subnormal=False)
    | st.text(max_size=20),
    lambda values: st.lists(values, max_size=3) | st.dictionaries(st.text(max_size=5), values),
    max_leaves=5,
)
KEYS = st.sampled_from(sorted(Parameters.model_fields))


@hostile
@given(
    SPECIAL
    | st.binary(max_size=100)
    | st.builds("{}: {}".format, KEYS, SPECIAL)
    | st.dictionaries(KEYS | st.text(max_size=9), VALUES, max_size=4).map(json.dumps)
)
def test_any_file_is_taken_whole_or_refused_in_a_line(folder, content):
    line = train(folder, content)
    assert not line or "mine" in line


# ---- Command lines -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train"], "Missing argument"),
        (["train", "mine.yaml", "mine.yaml"], "unexpected extra argument"),
        (["train", "mine.yaml", "--sed", "1"], "No such option: --sed"),
        (["trian", "mine.yaml"], "No such command 'trian'"),
        (["train", "no\nwhere.yaml"], r"no\nwhere.yaml: no such file"),
        (["train", "\x1b[31m.yaml"], r"\x1b[31m.yaml: no such file"),
        (["train", "\udcff.yaml"], r"\udcff.yaml: no such file"),
        (["train", ""], "is a directory"),
        (["train", "x" * 300], "name too long"),
        (["train", "mine.yaml", "--agent", "../dqn"], "agent: '../dqn' is not allowed"),
        (["train", "mine.yaml", "--seed", "9" * 300], "seed: 999"),
        (["train", "mine.yaml", "--seed", "9" * 5000], "'--seed'"),
        (["train", "mine.yaml", "--seed", "1.5"], "'--seed'"),
        (["train", "mine.yaml", "--set", "gamma=" + "[" * 5000], "more than 8 lists"),
        (["train", "mine.yaml", "--set", "gamma=" + "x" * 100_000], "10,000 characters at most"),
        (["train", "mine.yaml", "--set", "seeds=&a [*a]"], "an anchor or alias"),
        (["train", "mine.yaml", "--set", "batch_size=!!int x"], "a tag"),
        (["train", "mine.yaml", "--set", "\udcff=1"], r"unknown key '\udcff'"),
        (["train", "mine.yaml", "--set", "base=mine.yaml"], "unknown key 'base'"),
        (["train", "mine.yaml", "--set", "game=\udcff"], "unacceptable character"),
        (["train", "mine.yaml", "--results", "mine.yaml/x"], "mine.yaml is no folder"),
        (["evaluate", "no\nwhere"], r"no\nwhere: there is no such folder"),
        (["evaluate", ".", "--games", "9" * 30], "'--games'"),
        (["evaluate", ".", "--video", "a\nb.avi"], r"--video 'a\nb.avi'"),
        (["watch", ".", "--difficulty", "easy"], "'--difficulty'"),
        (["replay", "no\nwhere", "--episode", "1"], r"no\nwhere/params.yaml: no such file"),
        (["replay", ".", "--episode", "9" * 400], "'--episode'"),
        (["export", ".", "games.npz", "--first", "9" * 400], "'--first'"),
        (["verify", ".", "--episodes", "9" * 400], "'--episodes'"),
        (["export", ".", "games.txt"], "path 'games.txt'"),
        (["verify", "nowhere"], "nowhere/params.yaml: no such file"),
        (["report", "--profile", "../other"], "profile: '../other' is not allowed"),
        (["report", "--profile", "huge", "--results", "results"], "profile: 'huge' is not allowed"),
        (["experiments", "status", "--profile", "huge"], "profile: 'huge' is not allowed"),
        (["experiments", "run", "--profile", "huge"], "profile: 'huge' is not allowed"),
        (["experiments", "run", "--workers", "9" * 10], "'--workers'"),
        (
            ["experiments", "run", "--scheduler", "tcp://here:99999"],
            "--scheduler 'tcp://here:99999'",
        ),
        (["experiments", "run", "--scheduler", "here"], "expected tcp://HOST:PORT"),
    ],
)
def test_a_hostile_command_line_is_refused(folder, arguments, said):
    assert said in refusal(folder, *arguments)


OPTIONS = ("--seed", "--agent", "--set", "--results", "--restart", "--help", "--", "-")
WORDS = st.sampled_from([*OPTIONS, "1", "dqn", "gamma=0.5", "seeds=[1, 2]", "mine.yaml", "results"])
WORDS |= st.text(max_size=15)


@hostile
@given(st.lists(WORDS, max_size=4))
def test_any_command_line_is_obeyed_or_refused_in_a_line(folder, words):
    status, _, err = command(folder, "train", "mine.yaml", *words)
    assert status in (0, 2)
    assert not status or (err.startswith("error: ") and is_one_line(err))


MORE = ("--games", "--episode", "--episodes", "--first", "--last", "--all", "--profile", "--video")
MORE += ("--difficulty", "--sticky", "--epsilon", "0.5", "-1", "nan", "1e400", "a.mp4", "a.npz")


@hostile
@given(
    st.sampled_from(["evaluate", "watch", "replay", "export", "restore", "verify"]),
    st.lists(WORDS | st.sampled_from(MORE), max_size=4),
)
@example("export", ["a.npz"])
@example("replay", ["--episode", "1"])
def test_any_command_line_about_a_folder_that_holds_no_run_is_refused(folder, name, words):
    status, out, err = command(folder, name, "results", *words)
    assert status == (0 if out else 2)
    assert not status or (err.startswith("error: ") and all(map(is_one_line, err.splitlines())))
    assert not out or out.startswith("Usage: "), "it was asked for help"


def test_folders_may_be_named_with_spaces_and_letters_of_any_alphabet(folder):
    there = folder / "a  folder, Übung 'й'"
    there.mkdir()
    (there / "mine.yaml").write_text("gamma: 0.5")
    status, out, _ = command(folder, "train", str(there / "mine.yaml"), "--results", str(there))
    assert (status, "taken: mine/dqn/seed-1" in out) == (0, True)


def test_help_is_no_error_and_is_whole(folder):
    status, out, _ = command(folder, "--help")
    assert (status, "evaluate" in out) == (0, True)
    status, _, err = command(folder)
    assert status == 2
    assert err.startswith("Usage: ")
    assert "evaluate" in err


# ---- Notebooks -----------------------------------------------------------------------------------


def run_from_notebook(values):
    """The run that a notebook's parameters name, or the line in which they are refused."""
    return made_or_refused(lambda: notebook.run_from_notebook(values))


def made_or_refused(make):
    began, said = time.process_time(), "made"
    try:
        return make()
    except ParameterError as error:
        said = str(error)
        return said
    finally:
        assert time.process_time() - began < SECONDS
        assert is_one_line(said), said


def nested(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


endless = []
endless.append(endless)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"experiment": "../params/boxing_final"}, "experiment: '../params/boxing_final' is not"),
        ({"experiment": "x" * 300}, "experiment: 'xxx"),
        ({"experiment": "a\0b"}, r"experiment: 'a\x00b' is not allowed"),
        ({"profile": "../full"}, "profile: '../full' is not allowed"),
        ({"batch_size": 10**5000}, "batch_size: this int is not allowed"),
        ({"seeds": nested(100_000)}, "seeds.0: this list is not allowed"),
        ({"seeds": endless}, "seeds.0: [[...]] is not allowed"),
        ({"seeds": np.eye(2)}, "seeds: array("),
        ({"gamma": np.float64("nan")}, "gamma: "),
        ({"seed": 10**5000}, "seed: this int is not allowed"),
        ({"seed": True}, "seed: True is not allowed"),
        ({"agent": ["dqn"]}, "agent: ['dqn'] is not allowed"),
        ({"results_dir": 3}, "results: 3 is not allowed"),
        ({"results_dir": "a\0b"}, r"results: 'a\x00b' is not allowed"),
        ({"base": "../../mine.yaml"}, "base: '../../mine.yaml' is not allowed"),
        ({"base": endless}, "base: "),
        ({"gamma\n": 0.5}, r"unknown parameter 'gamma\n'"),
        ({"initial_weights": "../other"}, "initial_weights: '../other' is not allowed"),
    ],
)
def test_hostile_parameters_of_a_notebook_are_refused(values, said, monkeypatch):
    monkeypatch.chdir(__file__.rpartition("/")[0])
    assert said in run_from_notebook({"experiment": "boxing_final", "profile": "smoke", **values})


@hostile
@given(st.dictionaries(KEYS | st.sampled_from([*notebook.OWN, "base"]), VALUES, max_size=3))
def test_any_parameters_of_a_notebook_are_a_run_or_refused_in_a_line(values):
    found = run_from_notebook({"experiment": "own", "game": "pong", **values})
    assert isinstance(found, Run | str)


# ---- Nothing is left behind ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"device": "cuda"}, "device: 'cuda' is not allowed"),
        ({"device": "cuda", "learner": "native"}, "learner: 'native' is not allowed"),
        (
            {"initial_weights": "other"},
            "starts from other/double_dqn/seed-1, which is missing; train that one to its end "
            "first: `python -m atari_dqn experiments run other` does, or `train` with its file, "
            "--agent double_dqn and --seed 1",
        ),
    ],
)
def test_a_run_that_cannot_begin_here_leaves_no_folder(folder, small, monkeypatch, changes, said):
    monkeypatch.undo()  # training as it is
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setenv("ATARI_DQN_STATE", str(folder / "state"))
    before = contents(folder)
    with pytest.raises((ParameterError, recorder.RunError), match=said):
        recorder.train(Run(small(**changes), folder / "results"))
    assert contents(folder) == before


OF_SECTIONS = st.sampled_from(["profile", "results_dir", "agents", "seeds"])


@hostile
@given(st.dictionaries(OF_SECTIONS, VALUES, max_size=2))
@example({"profile": 7})
@example({"profile": ["full"]})
@example({"results_dir": "a\0b"})
@example({"results_dir": 3})
@example({"agents": "dqn"})
@example({"agents": {"dqn": 1}})
def test_any_parameters_of_a_section_are_its_runs_or_refused_in_a_line(values):
    given = {"profile": "smoke", **values}
    found = made_or_refused(lambda: Section("boxing_expert", **given))
    assert isinstance(found, Section | str)
