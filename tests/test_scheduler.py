"""The runner: what it says of the runs that an experiment needs, and how it trains them."""

import hashlib
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import pandas as pd
import pytest
from distributed import LocalCluster
from filelock import FileLock, Timeout

from atari_dqn import params
from atari_dqn.params import ParameterError
from atari_dqn.runs import checkpoints, cluster, plan, recorder, scheduler
from atari_dqn.runs.checkpoints import CheckpointError
from atari_dqn.runs.files import RunError
from atari_dqn.runs.run import Run, runs_of
from atari_dqn.training import Trainer


@pytest.fixture
def transfer(small):
    """A run that needs another's finished model."""
    return small(experiment="transfer", game="breakout", initial_weights="small", episodes=1)


def states(wanted):
    return plan.status(wanted).state.tolist()


def test_status_tells_what_is_done_what_waits_and_how_long_it_will_take(tmp_path, small, transfer):
    wanted = [Run(small(seeds=[seed]), tmp_path) for seed in (1, 2)] + [Run(transfer, tmp_path)]
    assert states(wanted) == ["missing", "missing", "waiting for small"]
    assert "0 of 7 games (0%)" in plan.summary(plan.status(wanted))
    assert plan.summary(plan.status(wanted)).endswith(
        "how long it takes shows when the first games have been played"
    )
    recorder.train(wanted[0])
    table = plan.status(wanted)
    assert table.state.tolist() == ["complete", "missing", "missing"]
    assert table.games.tolist() == [3, 0, 0]
    assert table.score[0] == pd.read_csv(wanted[0].folder / "episodes.csv").score.mean()
    seconds = pd.read_csv(wanted[0].folder / "timing.csv").seconds
    pace = (seconds.iloc[-1] - seconds.iloc[0]) / 2
    assert table.hours_left[0] == 0
    assert table.hours_left[1] == pytest.approx(3 * pace / 3600), "of another run of the game"
    assert pd.isna(table.hours_left[2]), "no other run of Breakout"
    said = plan.summary(table)
    assert said.startswith("3 runs: 2 missing, 1 complete; 3 of 7 games (43%); about 0.0 core-h")
    assert said.endswith("left, and 1 other run whose pace is not known yet")
    assert plan.summary(table[:1]).endswith(
        "1 run: 1 complete; 3 of 3 games (100%); nothing left to train"
    )
    assert plan.summary(table[:2]).endswith("core-hours left")


def test_status_tells_why_a_run_does_not_go_on(tmp_path, small, monkeypatch):
    run = Run(small(episodes=1), tmp_path)
    with monkeypatch.context() as broken:
        broken.setattr(Trainer, "_learn", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            recorder.train(run)
    assert states([run]) == ["failed (ZeroDivisionError: division by zero)"]
    recorder.train(run)
    shutil.rmtree(run.state_folder)
    longer = [Run(small(episodes=2), tmp_path)]
    assert states(longer) == ["interrupted (no checkpoint here: restore or --restart)"]
    assert "1 interrupted;" in plan.summary(plan.status(longer))


def test_variations_are_runs_of_their_own_with_their_labels(tmp_path, small):
    varied = small(variations={"short sight": {"gamma": 0.5}, "big": {"batch_size": 8}})
    path = tmp_path / "small.yaml"
    path.write_text(params.text(varied))
    wanted = runs_of(params.load(path), tmp_path)
    assert [run.variation for run in wanted] == ["short sight", "big"]
    assert [(run.params.gamma, run.params.batch_size) for run in wanted] == [(0.5, 4), (0.99, 8)]
    assert len({run.folder for run in wanted}) == 2
    assert plan.status(wanted).experiment.tolist() == ["small: short sight", "small: big"]


def test_a_run_that_needs_anothers_model_is_trained_after_it(tmp_path, small, transfer):
    wanted = [Run(transfer, tmp_path), Run(small(), tmp_path)]  # listed before its source
    assert scheduler.train_all(wanted, workers=2) == []
    assert states(wanted) == ["complete", "complete"]
    provenance = json.loads((wanted[0].folder / "provenance.json").read_text())
    model = (wanted[1].folder / "model.safetensors").read_bytes()
    assert provenance["sessions"][0]["initial_weights"] == hashlib.sha256(model).hexdigest()


def test_a_transfer_whose_source_has_changed_is_stale(tmp_path, small, transfer):
    run, source = Run(transfer, tmp_path), Run(small(), tmp_path)
    for one in (source, run):
        recorder.train(one)
    assert states([run]) == ["complete"]
    recorder.train(Run(small(episodes=4), tmp_path))
    assert states([run]) == ["stale"]
    assert run.changes() == ["small/double_dqn/seed-1 has another model now"]


def test_runs_are_trained_in_the_order_in_which_they_are_named():
    named = ["breakout_late", "boxing_final"]
    found = [run.params.experiment for run in plan.planned("full", named, None)[0]]
    assert list(dict.fromkeys(found)) == named


def test_a_run_whose_source_is_not_trained_is_named_at_the_end(tmp_path, transfer):
    (line,) = scheduler.train_all([Run(transfer, tmp_path)])
    assert line == (
        "transfer/double_dqn/seed-1 waits for small/double_dqn/seed-1, which is missing"
    )


def test_nothing_is_trained_over_or_from_a_stale_run_here_or_on_a_cluster(
    tmp_path, small, transfer
):
    recorder.train(Run(small(), tmp_path))
    before = (Run(small(), tmp_path).folder / "episodes.csv").read_bytes()
    changed = [Run(small(gamma=0.5), tmp_path), Run(transfer, tmp_path)]
    pending, failures = scheduler.startable(changed)
    assert pending == []
    assert "holds a run that no longer matches: gamma was 0.99, now 0.5; --restart" in failures[0]
    assert failures[1] == f"{changed[1].name} starts from {changed[0].name}, which is stale"
    assert scheduler.train_all(changed) == failures
    assert (changed[0].folder / "episodes.csv").read_bytes() == before


def test_a_run_whose_files_are_damaged_is_named_and_the_others_go_on(tmp_path, small, transfer):
    damaged, other = Run(small(), tmp_path), Run(small(seeds=[2]), tmp_path)
    recorder.train(damaged)
    (damaged.folder / "status.json").write_text("<<<<<<< conflict")
    table = plan.status([damaged, other])
    assert table.state[0].startswith("damaged")
    assert table.state[1] == "missing"
    lines = scheduler.train_all([damaged, Run(transfer, tmp_path), other], workers=1)
    assert len(lines) == 2
    assert all("status.json is missing or damaged" in line for line in lines)
    assert lines[1].startswith("transfer/double_dqn/seed-1: ")
    assert other.state() == "complete"


def test_what_a_user_can_mend_is_one_line_and_the_rest_names_its_kind(tmp_path, small):
    run = Run(small(), tmp_path)
    assert scheduler.error_line(run, CheckpointError("no space")) == f"{run.name}: no space"
    assert scheduler.error_line(run, RunError(f"{run.name} is away")) == f"{run.name} is away"
    assert scheduler.error_line(run, ValueError("odd")) == f"{run.name}: ValueError: odd"


def test_an_unknown_experiment_to_start_from_is_refused_before_anything_is_trained(
    tmp_path, monkeypatch, transfer
):
    (tmp_path / "transfer.yaml").write_text(params.text(transfer))
    monkeypatch.setattr(plan, "files", lambda profile: [tmp_path / "transfer.yaml"])
    with pytest.raises(ParameterError, match=r"transfer.yaml: initial_weights: 'small' is not"):
        plan.planned("smoke", ["transfer"], tmp_path)
    runs, (line,) = plan.planned("smoke", [], tmp_path)
    assert (runs, "no such run is stored" in line) == ([], True)
    (tmp_path / "runs" / "small").mkdir(parents=True)  # stored, though no file asks for it
    assert len(plan.planned("smoke", [], tmp_path)[0]) == 1


def test_a_model_to_start_from_that_cannot_be_read_is_named(tmp_path, small, transfer):
    recorder.train(Run(small(), tmp_path))
    (Run(small(), tmp_path).folder / "model.safetensors").write_bytes(b"no weights")
    with pytest.raises(RunError, match=r"seed-1 starts from small/.*model\.safetensors cannot be"):
        recorder.train(Run(transfer, tmp_path))


def test_a_failing_run_does_not_stop_the_others_and_its_error_is_told(tmp_path, small):
    damaged, other = Run(small(), tmp_path), Run(small(seeds=[2]), tmp_path)
    recorder.train(Run(small(episodes=1), tmp_path))
    for path in damaged.state_folder.glob("checkpoint-*"):
        shutil.rmtree(path)
    (line,) = scheduler.train_all([damaged, other], workers=1)
    assert line.startswith(f"{damaged.folder} holds 1 games, but their checkpoint is not in")
    assert other.state() == "complete"


@pytest.fixture
def project(tmp_path, small):
    """A project folder with one experiment of two agents, long enough to be interrupted."""
    (tmp_path / "params").mkdir()
    (tmp_path / "pyproject.toml").touch()
    ask_for(tmp_path, small(profile="full", agents=["dqn", "double_dqn"], episodes=20))
    return tmp_path


def ask_for(project, parameters):
    (project / "params" / "small.yaml").write_text(params.text(parameters))


def runner(project, *options):
    """`experiments run` in a process of its own."""
    command = [sys.executable, "-m", "atari_dqn", "experiments", "run", *map(str, options)]
    return subprocess.Popen(command, cwd=project, stderr=subprocess.PIPE, text=True)


PATIENCE = 1800  # seconds; only what hangs takes so long, even on a busy machine


def wait_until(condition, process=None):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        assert process is None or process.poll() is None, process.stderr.read()
        time.sleep(0.1)


def lockable(run):
    with suppress(Timeout), FileLock(run.state_folder / ".lock", timeout=0):
        return True
    return False


def planned(project):
    parameters = params.load(project / "params" / "small.yaml")
    return runs_of(parameters, project / "results")


def test_ctrl_c_leaves_all_runs_resumable_and_the_same_command_ends_them(project):
    wanted = planned(project)
    process = runner(project)
    wait_until(lambda: plan.status(wanted).games.min() >= 2, process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert "interrupted; the same command continues" in errors
    assert states(wanted) == ["interrupted", "interrupted"]
    again = runner(project)
    again.communicate(timeout=PATIENCE)
    assert again.returncode == 0
    assert states(wanted) == ["complete", "complete"]


def test_two_runners_do_not_train_the_same_run_twice_and_that_of_a_killed_one_is_saved(
    project, small
):
    ask_for(project, small(profile="full", agents=["dqn"], episodes=1000))  # no end soon
    (run,) = planned(project)
    first = runner(project)
    wait_until(lambda: run.state() == "running", first)
    second = runner(project)
    _, errors = second.communicate(timeout=PATIENCE)
    assert second.returncode == 1
    assert "is being trained by another process" in errors
    assert run.state() == "running"
    games = saved_games([run])
    first.kill()
    first.communicate(timeout=PATIENCE)
    wait_until(lambda: lockable(run))
    assert run.status()["state"] == "interrupted", "it says so itself"
    assert saved_games([run]) > games
    assert json.loads((run.folder / "provenance.json").read_text())["resumes"] == 0


def answers(port):
    with socket.socket() as there:
        return there.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def dask(project):
    """A scheduler and three workers that share a state folder: real processes on loopback."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    port = address.rpartition(":")[2]
    quiet = {"cwd": project, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    start = [sys.executable, "-m", "dask"]
    processes = [
        subprocess.Popen(
            [*start, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"], **quiet
        )
    ]
    wait_until(lambda: answers(int(port)))
    for _ in range(3):
        worker = [*start, "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        processes.append(subprocess.Popen(worker, **quiet))
    yield address, processes[1:]
    for process in processes:
        process.kill()
        process.wait()


def saved_games(wanted):
    return [(checkpoints.load(run.state_folder) or {"episodes": 0})["episodes"] for run in wanted]


def test_cluster_runs_survive_ctrl_c_and_lost_workers(project, dask, small, monkeypatch):
    address, workers = dask
    ask_for(project, small(profile="full", agents=["dqn", "double_dqn"], episodes=40))
    wanted = planned(project)
    process = runner(project, "--scheduler", address)
    wait_until(lambda: all(checkpoints.load(run.state_folder) for run in wanted), process)
    assert states(wanted) == ["running", "running"]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    wait_until(lambda: all(map(lockable, wanted)))
    assert states(wanted) == ["missing", "missing"], "results come back when they are whole"
    saved = saved_games(wanted)
    assert 0 < max(saved) < 40

    process = runner(project, "--scheduler", address)
    wait_until(lambda: not any(map(lockable, wanted)), process)
    workers[0].terminate()  # as at the end of a walltime: it saves, and lets go
    workers[1].kill()
    process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert states(wanted) == ["complete", "complete"]
    for run, games in zip(wanted, saved, strict=True):
        provenance = json.loads((run.folder / "provenance.json").read_text())
        begins = [stretch["first_episode"] for stretch in provenance["sessions"]]
        assert begins[:2] == [1, games + 1]

    monkeypatch.setenv("ATARI_DQN_STATE", str(project / "elsewhere"))
    here = Run(wanted[0].params, project / "here")
    recorder.train(here)
    for name in ("episodes.csv", "evaluations.csv", "model.safetensors"):
        assert (wanted[0].folder / name).read_bytes() == (here.folder / name).read_bytes()


def test_a_cluster_loses_nothing_that_is_stored(tmp_path, small):
    run, longer = Run(small(episodes=1), tmp_path), Run(small(episodes=2), tmp_path)
    recorder.train(run)
    before = (run.folder / "episodes.csv").read_bytes()
    state = run.state_folder.rename(tmp_path / "elsewhere")
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as here:
        (line,) = cluster.train_all([longer], here.scheduler_address)
        assert "holds 1 games, but their checkpoint is not in" in line
        assert (run.folder / "episodes.csv").read_bytes() == before
        shutil.rmtree(run.state_folder)
        state.rename(run.state_folder)  # which the worker shares
        assert cluster.train_all([longer], here.scheduler_address) == []
    assert longer.state() == "complete"
    assert (run.folder / "episodes.csv").read_bytes().startswith(before)
    evaluated = pd.read_csv(run.folder / "evaluations.csv")
    assert set(evaluated.trained_games) == {1, 2}, "those of the earlier model are kept"


def test_a_scheduler_that_does_not_answer_is_a_clear_error(tmp_path, small, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 1)
    with pytest.raises(RunError, match=r"no Dask scheduler answers"):
        cluster.train_all([Run(small(), tmp_path)], "tcp://127.0.0.1:9")
