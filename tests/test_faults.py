"""What goes wrong around a run: it is named, and nothing that was good is lost."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
import safetensors.numpy
from conftest import SMALL
from safetensors.torch import load_file

from atari_dqn import params
from atari_dqn.native import NativeLearner
from atari_dqn.params import Parameters
from atari_dqn.runs import checkpoints, dataset, evaluations, models, recorder, value_checks
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import Run


@pytest.mark.native
def test_a_loss_that_is_not_finite_stops_the_run_and_the_last_checkpoint_is_kept(
    tmp_path, small, monkeypatch
):
    run, learn = Run(small(learner="native"), tmp_path), NativeLearner.learn

    def diverging(self, batch):
        loss, q = learn(self, batch)
        return (float("nan"), q) if self.updates == 6 else (loss, q)

    with monkeypatch.context() as broken:
        broken.setattr(recorder, "CHECKPOINT_SECONDS", 0.0)
        broken.setattr(NativeLearner, "learn", diverging)
        with pytest.raises(RunError, match=r"no longer finite .* learning_rate below 0\.0001"):
            recorder.train(run, None)
    assert run.state() == "failed"
    saved = checkpoints.load(run.state_folder)
    assert 0 < saved["trainer"]["learner"]["updates"] < 6
    recorder.train(run, None)
    assert run.state() == "complete"


@pytest.fixture(scope="module")
def model():
    """The bytes of a small network's file, and its network."""
    from atari_dqn.networks import NatureNetwork

    return models.model_bytes(NatureNetwork(1, 2).state_dict(), 3000)


@pytest.mark.parametrize("place", [0.02, 0.3, 0.5, 0.999])
def test_a_flipped_bit_of_a_models_weights_is_noticed(tmp_path, model, place):
    path = tmp_path / "model.safetensors"
    path.write_bytes(model)
    weights = models.read_model(path)
    assert set(weights) == set(load_file(path))
    damaged = bytearray(model)
    damaged[int(place * len(model))] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(RunError, match=r"model\.safetensors is damaged: it does not have"):
        models.read_model(path)


def test_a_flipped_bit_of_the_number_of_its_games_is_noticed(tmp_path, model):
    path = tmp_path / "model.safetensors"
    path.write_bytes(model.replace(b" 3000", b" 2000", 1))
    assert models.trained_games(path) == 2000
    with pytest.raises(RunError, match="does not have the checksum"):
        models.read_model(path)


@pytest.mark.parametrize("content", [b"", b"no weights", b"\xff" * 64])
def test_what_is_no_model_is_named(tmp_path, content):
    path = tmp_path / "model.safetensors"
    path.write_bytes(content)
    for read in (models.read_model, models.trained_games):
        with pytest.raises(RunError, match=r"model\.safetensors cannot be read: "):
            read(path)


@pytest.mark.parametrize(
    "about",
    [
        *(f'{{"games": {games}, "sha256": "0"}}' for games in ("1e400", "-1", '"x"', "1.5", "[1]")),
        *("[" * 50_000, "[]", "{}"),
    ],
)
def test_what_a_model_says_of_itself_is_a_number_of_games_or_is_refused(tmp_path, about):
    path = tmp_path / "model.safetensors"
    path.write_bytes(safetensors.numpy.save({}, {"about": about}))
    for read in (models.read_model, models.trained_games):
        with pytest.raises(RunError, match=r"model\.safetensors cannot be read: ") as error:
            read(path)
        assert len(str(error.value).splitlines()) == 1


def test_the_weights_of_another_network_are_refused_in_one_line(tmp_path, model, small):
    path = tmp_path / "model.safetensors"
    path.write_bytes(model)  # for a picture and two actions, where there are four and eighteen
    with pytest.raises(RunError, match=r"model\.safetensors cannot be read: .*size mism") as error:
        models.load_model(path, small(agents=["dqn"]))
    assert len(str(error.value).splitlines()) == 1


def test_no_game_is_played_whose_result_could_not_be_stored(tmp_path, small, monkeypatch):
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run, None)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # a superuser may write everywhere
    monkeypatch.setattr(evaluations.evaluation, "play", None)
    with pytest.raises(RunError, match="cannot be written to"):
        evaluations.evaluate(run.folder, {})


# ---- Disks ---------------------------------------------------------------------------------------


@pytest.fixture
def written_over():
    """The files that are opened to be written, but not at their end."""
    found, watching = [], [True]

    def watch(event, arguments):
        if watching and event == "open" and not isinstance(arguments[0], int):
            name, _, flags = arguments
            if flags & (os.O_WRONLY | os.O_RDWR) and not flags & os.O_APPEND:
                found.append(Path(os.fsdecode(name)))

    sys.addaudithook(watch)  # for good: no hook can be taken away
    yield found
    watching.clear()


def test_no_file_of_a_run_is_written_over_where_it_stands(tmp_path, small, written_over):
    """Each is written beside, and takes the old one's place when it is whole: a process that is
    killed, or reads meanwhile, would come upon half of it."""
    run = Run(small(snapshot_games=[1]), tmp_path)
    recorder.train(run, None)
    evaluations.evaluate(run.folder, {"difficulty": 1}, 1)
    dataset.export(run.folder, 1, 2, tmp_path / "games.npz")
    inside = [path for path in written_over if path.is_relative_to(tmp_path)]
    beside = [path for path in inside if path.name[0] == "." or path.parent.name[:4] == "tmp-"]
    assert len(beside) > 20
    assert [path for path in inside if path not in beside] == []


def test_what_takes_the_place_of_another_is_on_the_disk_before(tmp_path, small, monkeypatch):
    """Else, when the power fails, the name may be there and what it names not."""
    synced, moved, early = set(), [], []
    fsync, rmtree = os.fsync, shutil.rmtree

    def version(stat):
        return stat.st_ino, stat.st_mtime_ns

    def sync(descriptor):
        fsync(descriptor)
        synced.add(version(os.fstat(descriptor)))

    def check(*paths):
        early.extend(path for path in paths if version(path.stat()) not in synced)

    def moving(move):
        def checked(path, target):
            check(path, *path.rglob("*"))
            moved.append(path)
            return move(path, target)

        return checked

    def remove(path, **options):
        if path.name.startswith("checkpoint-"):  # an older one
            check(path.parent)
            moved.append(path)
        rmtree(path, **options)

    for method in ("rename", "replace"):
        monkeypatch.setattr(Path, method, moving(getattr(Path, method)))
    monkeypatch.setattr(os, "fsync", sync)
    monkeypatch.setattr(shutil, "rmtree", remove)
    monkeypatch.setattr(recorder, "CHECKPOINT_SECONDS", 0.0)
    recorder.train(Run(small(episodes=1), tmp_path), None)
    assert {path.name[:4] for path in moved} >= {"tmp-", "chec", ".sta", ".mod"}
    assert early == []


ON_A_DISK = """
import json, os, shutil, subprocess
from pathlib import Path

from atari_dqn import native, params
from atari_dqn.runs import audit, checkpoints, dataset, evaluations, files, plan, recorder
from atari_dqn.runs.run import Run

disk, told = Path("disk"), {}
os.environ["ATARI_DQN_STATE"] = "disk/state"
run = Run(params.load("small.yaml"), disk)
built = native.load()
native.load = lambda library=None: built
native.SOURCE = Path("quick.cpp").resolve()
os.environ["XDG_CACHE_HOME"] = str(disk.resolve() / "cache")

def tell(name, what):
    try:
        told[name] = str(what())
    except Exception as error:
        told[name] = f"{type(error).__name__}: {error}"

def mount(options):
    subprocess.run(["mount", "-o", f"remount,{options}", "disk"], check=True)

def fill():
    with open("disk/fill", "wb", buffering=0) as file:
        while True:
            try:
                file.write(bytes(4096))
            except OSError:
                return

def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

# Room for the first checkpoint, and for half of the second
tell("trained", lambda: recorder.train(run, None))
told["state"] = run.state()
told["games in the checkpoint"] = checkpoints.load(run.state_folder)["episodes"]
mount("size=200m")
tell("trained with room", lambda: recorder.train(run, None))
shutil.copytree(run.folder, "kept")

fill()
before = contents(run.folder)
tell("evaluated", lambda: evaluations.evaluate(run.folder, {"difficulty": 1}, 1))
tell("exported", lambda: dataset.export(run.folder, 1, 2, disk / "games.npz"))
tell("compiled", native.compiled)
told["kept"] = contents(run.folder) == before
told["half files"] = [str(path) for path in disk.rglob("*") if "games.npz" in path.name]

os.remove("disk/fill")
status = run.folder / "status.json"
status.write_text(status.read_text().replace("complete", "running"))
mount("ro")
tell("status", lambda: plan.status([run]).state[0])
tell("verified", lambda: len(list(audit.verify(run.folder, None))))
tell("evaluated there", lambda: evaluations.evaluate(run.folder, {}, 1))
tell("trained there", lambda: recorder.train(run, None))
tell("compiled there", native.compiled)
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def on_a_disk(tmp_path_factory):
    """What `ON_A_DISK` tells of a small disk that gets full and of one that is read-only: a file
    system of its own, since a superuser may write wherever there is room."""
    if shutil.which("unshare") is None:
        pytest.skip("no `unshare` here: a file system of its own needs Linux")
    folder = tmp_path_factory.mktemp("disk")
    (folder / "disk").mkdir()
    own = ["unshare", "--map-root-user", "--mount", "sh", "-c"]
    mount = 'mount -t tmpfs -o size=28m tmpfs disk && exec "$@"'
    tried = subprocess.run([*own, mount, "sh", "true"], cwd=folder, capture_output=True, text=True)
    if tried.returncode:
        pytest.skip(f"no file system of one's own can be mounted here: {tried.stderr.strip()}")
    (folder / "small.yaml").write_text(params.text(Parameters(**SMALL)))
    (folder / "quick.cpp").write_text('extern "C" void nothing() {}')  # compiles at once
    command = [*own, mount, "sh", sys.executable, "-c", ON_A_DISK]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return SimpleNamespace(folder=folder, told=json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.native
def test_a_run_on_a_full_disk_says_so_and_goes_on_when_there_is_room(
    on_a_disk, tmp_path, monkeypatch
):
    told = on_a_disk.told
    assert re.fullmatch(
        "CheckpointError: cannot write the checkpoint .*: No space left on device.*",
        told["trained"],
    )
    assert (told["state"], told["games in the checkpoint"]) == ("failed", 0)
    assert told["trained with room"] == "small/double_dqn/seed-1 is complete: 3 games"
    monkeypatch.setenv("ATARI_DQN_STATE", str(tmp_path / "state"))
    undisturbed = Run(Parameters(**SMALL), tmp_path)
    recorder.train(undisturbed, None)
    for name in ("episodes.csv", "evaluations.csv", "model.safetensors", "games.jsonl.zst"):
        assert (on_a_disk.folder / "kept" / name).read_bytes() == (
            undisturbed.folder / name
        ).read_bytes(), name


@pytest.mark.native
def test_what_is_made_of_a_run_on_a_full_disk_is_whole_or_not_there(on_a_disk):
    told = on_a_disk.told
    for name, file in (("evaluated", "games.jsonl.zst"), ("exported", "games.npz")):
        assert re.fullmatch(
            rf"RunError: cannot write \S*{file}: No space left on device", told[name]
        )
    assert re.fullmatch("Unavailable: .*No space left on device.*", told["compiled"])
    assert told["kept"], "what was stored is no longer as it was"
    assert told["half files"] == []


@pytest.mark.native
def test_a_folder_that_cannot_be_written_to_is_read_all_the_same(on_a_disk):
    told = on_a_disk.told
    assert told["status"] == "interrupted"
    assert told["verified"] == "5", "games of training and of the evaluation"
    assert re.fullmatch("RunError: .* cannot be written to, .*", told["evaluated there"])
    for name in ("trained there", "compiled there"):
        assert "Read-only file system" in told[name]


# ---- Time and death ------------------------------------------------------------------------------


def test_a_clock_that_is_set_back_disturbs_nothing(tmp_path, small, monkeypatch):
    """A run's times are of a clock that only goes on, and checkpoints are told by their numbers."""
    run, back = Run(small(), tmp_path), iter(range(2_000_000_000, 0, -3600))
    monkeypatch.setattr(time, "time", lambda: float(next(back)))
    with pytest.raises(KeyboardInterrupt):
        recorder.train(run, None, asked_to_stop=lambda: run.status()["episodes_done"] == 2)
    newest = max(run.state_folder.glob("checkpoint-*"))
    os.utime(newest, (1, 1))
    recorder.train(run, None)
    timing = pd.read_csv(run.folder / "timing.csv")
    assert timing.episode.tolist() == [1, 2, 3]
    assert (timing.seconds > 0).all()
    assert timing.seconds.is_monotonic_increasing
    provenance = run.provenance()
    assert 0 < timing.seconds.iloc[-1] <= provenance["wall_clock_seconds"] < 600
    assert [stretch["first_episode"] for stretch in provenance["sessions"]] == [1, 3]


POOL = """
import os, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from atari_dqn.runs.processes import end_with_parent
if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, get_context("spawn"), end_with_parent)
    print(pool.submit(os.getpid).result(), flush=True)
    time.sleep(600)
"""


def test_a_process_of_a_pool_does_not_outlive_one_that_was_killed(tmp_path):
    (tmp_path / "pool.py").write_text(POOL)
    command = [sys.executable, str(tmp_path / "pool.py")]
    # what has become of the semaphores is told on stderr
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen(command, **quiet) as owner:
        worker = int(owner.stdout.readline())
        os.kill(worker, 0)  # it is there
        owner.kill()
    end = time.monotonic() + 300
    while alive(worker):
        assert time.monotonic() < end, "it waits for work that nobody will ever give it"
        time.sleep(0.05)


def alive(process):
    """Whether a process runs; one that has ended may wait for somebody to ask how."""
    try:
        stat = Path(f"/proc/{process}/stat")
        if stat.parent.parent.joinpath("self").exists():
            return stat.read_text().rpartition(")")[2].split()[0] != "Z"
        os.kill(process, 0)
    except (ProcessLookupError, FileNotFoundError):
        return False
    return True


def test_checks_beside_training_end_with_the_run(monkeypatch, small):
    called = []
    monkeypatch.setattr(value_checks, "end_with_parent", lambda: called.append("ends"))
    monkeypatch.setattr(value_checks.os, "setpgrp", lambda: None)
    checks = value_checks.ValueChecks(small(emulator_processes=2), 1)
    checks.pool._initializer()
    checks.close()
    assert called == ["ends"]


PUBLISH = """
import os, signal, sys
from pathlib import Path
from atari_dqn.report import build

NAMES = ("index.html", "report.pdf")
build._execute = lambda *given: []
build.plan.planned = build.plan.known = lambda *given: ([], [])
build.crossrefs.check_completeness = lambda *given: (0, 0)

def report(version):
    def typeset(text, stamp, made, moment):
        for name in NAMES:
            (made / name).write_text(version * 100_000)
    build._typeset = typeset
    return build.build("full", Path("results"))

def killed_at(call, owner, name):
    calls, real = [], getattr(owner, name)
    def call_or_die(*arguments):
        calls.append(arguments)
        if len(calls) == call:
            os.kill(os.getpid(), signal.SIGKILL)
        return real(*arguments)
    setattr(owner, name, call_or_die)

def kinds(folder):
    return "".join("+".join(sorted(set((folder / name).read_text()))) for name in NAMES)

report("a")
for call, owner, name in ((1, build.crossrefs, "finish"), (2, build.shutil, "copyfile"),
                          (3, build.shutil, "copyfile"), (1, Path, "replace"),
                          (2, Path, "replace")):
    child = os.fork()
    if child == 0:
        killed_at(call, owner, name)
        report("b")
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), kinds(Path("results/report")))
print(kinds(report("c")))
"""


def test_a_report_that_is_killed_leaves_the_last_one_and_the_next_is_whole(tmp_path):
    """Its files take their places when all of them are whole: before that nothing has changed."""
    (tmp_path / "params").mkdir()
    (tmp_path / "pyproject.toml").touch()
    done = subprocess.run(
        [sys.executable, "-c", PUBLISH], cwd=tmp_path, capture_output=True, text=True
    )
    said = [line for line in done.stdout.splitlines() if "things of the source" not in line]
    killed = -signal.SIGKILL
    assert said == [*[f"{killed} aa"] * 4, f"{killed} ba", "cc"], done.stderr


# ---- The table of faults -------------------------------------------------------------------------


def test_every_fault_is_shown_by_a_test_that_exists():
    tests = Path(__file__).parent
    rows = (tests.parent / "docs" / "faults.md").read_text("utf-8").splitlines()
    faults = [row for row in rows if row.startswith("| ")][1:]
    assert len(faults) > 20
    for row in faults:
        named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", row)
        assert named, row
        for file, test in named:
            assert f"def {test}(" in (tests / file).read_text("utf-8"), test
