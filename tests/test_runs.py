"""A run as a user sees it: its folder, its states, and the command line."""

import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from conftest import SMALL
from safetensors.torch import load_file

from atari_dqn import __main__, evaluation, params
from atari_dqn.runs import checkpoints, evaluations, recorder
from atari_dqn.runs.files import RunError, write_atomically
from atari_dqn.runs.models import load_model, read_model, untrained
from atari_dqn.runs.run import Run
from atari_dqn.training import Episode, Trainer

ROOT = Path(__file__).parents[1]
FILES = {
    *(
        "params.yaml",
        "episodes.csv",
        "timing.csv",
        "values.csv",
        "evaluations.csv",
        "model.safetensors",
        "games.jsonl.zst",
    ),
    *("status.json", "provenance.json"),
}


def command(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "atari_dqn", *map(str, arguments)],
        capture_output=True,
        text=True,
        **options,
    )


def write(folder, parameters):
    path = folder / f"{parameters.experiment}.yaml"
    path.write_text(params.text(parameters))
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run, made through the command line."""
    folder = tmp_path_factory.mktemp("finished")
    path = write(folder, params.Parameters(**SMALL))
    environment = {**os.environ, "ATARI_DQN_STATE": str(folder / "state")}
    result = command("train", path, "--results", folder, "--seed", 3, env=environment)
    assert result.returncode == 0, result.stderr
    return folder / "runs" / "small" / "double_dqn" / "seed-3", result, environment


@pytest.mark.native
def test_a_finished_runs_folder_holds_all_it_promises(finished):
    folder, result, _ = finished
    found = {path.name for path in folder.iterdir()}
    assert {name for name in found if not name.endswith(".lock")} == FILES
    assert "complete: 3 games" in result.stdout
    assert json.loads((folder / "status.json").read_text()) == {
        "state": "complete",
        "episodes_done": 3,
        "episodes": 3,
    }
    episodes = pd.read_csv(folder / "episodes.csv")
    assert list(episodes) == Episode.columns()
    assert episodes.episode.tolist() == [1, 2, 3]
    assert episodes.loss.notna().all()
    assert (episodes.score % 1 == 0).all()
    evaluations = pd.read_csv(folder / "evaluations.csv")
    assert evaluations.game.tolist() == [0, 1]
    assert {"score", "length", "won", "knockout", "difficulty"} <= set(evaluations)
    provenance = json.loads((folder / "provenance.json").read_text())
    assert provenance["resumes"] == 0
    (session,) = provenance["sessions"]
    assert session["threads"] == 1
    assert session["learner"] == provenance["learner"] == "native"
    assert session["versions"]["torch"]
    assert 100 < session["peak_memory_megabytes"] < 2000


def test_the_published_model_is_the_trained_one_in_half_precision(finished, small):
    folder, _, _ = finished
    weights = load_file(folder / "model.safetensors")
    assert {str(value.dtype) for value in weights.values()} == {"torch.float16"}
    trainer = Trainer(small(), "double_dqn", 3)
    for episode in trainer.run():
        if episode is not None and episode.episode == 3:
            break
    for name, value in trainer.learner.weights().items():
        assert (weights[name] == value.half()).all(), name


def test_a_complete_run_is_not_trained_again(finished):
    folder, _, environment = finished
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    result = command(
        "train", folder.parents[3] / "small.yaml", "--results", folder.parents[3], "--seed", 3,
        env=environment,
    )  # fmt: skip
    assert result.returncode == 0
    assert "is complete" in result.stdout
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_evaluate_stores_games_beside_those_of_other_settings(finished, tmp_path):
    source, _, environment = finished
    folder = tmp_path / "seed-3"
    shutil.copytree(source, folder)
    video = tmp_path / "game.mp4"
    arguments = ["evaluate", folder, "--games", 3, "--difficulty", 3, "--sticky", 0.25]
    result = command(*arguments, "--video", video, env=environment)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("3 games: mean score")
    assert video.read_bytes()[4:8] == b"ftyp"
    stored = pd.read_csv(folder / "evaluations.csv")
    assert stored.difficulty.tolist() == [0, 0, 3, 3, 3]
    first = (folder / "evaluations.csv").read_bytes()
    __main__.app([*map(str, arguments)], standalone_mode=False)
    assert (folder / "evaluations.csv").read_bytes() == first, "the same games, once"


def test_evaluation_games_do_not_depend_on_how_many_are_played_at_once(finished, monkeypatch):
    folder, _, _ = finished
    parameters = params.parse(params.read_values(folder / "params.yaml"), "stored")
    network = load_model(folder / "model.safetensors", parameters)
    player, played = evaluation.player_of(network, parameters), {}
    for emulators in (1, 3):
        monkeypatch.setattr(evaluation, "EMULATORS", emulators)
        games = list(evaluation.play(player, parameters, 4, seed=1))
        played[emulators] = sorted(games, key=lambda game: game.game)
    assert played[1] == played[3]
    assert len({(game.score, game.length) for game in played[1]}) > 1


def bad(*arguments):
    result = command(*arguments)
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    return result.stderr.strip().splitlines()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--set", "epsiodes=3"], "unknown key 'epsiodes': did you mean 'episodes'?"),
        (["--agent", "ddqn"], "agent: 'ddqn' is not allowed"),
        (["--set", "gamma=2"], "gamma: 2 is not allowed"),
        (["--seed", "-4"], "seed: -4 is not allowed"),
    ],
)
def test_bad_input_is_one_line_and_creates_nothing(tmp_path, small, arguments, said):
    path = write(tmp_path, small())
    lines = bad("train", path, "--results", tmp_path / "results", *arguments)
    assert len(lines) == 1
    assert said in lines[0]
    assert not (tmp_path / "results").exists()


def test_evaluating_what_is_no_run_is_a_clear_error(tmp_path):
    result = command("evaluate", tmp_path)
    assert result.returncode == 2
    assert "no model.safetensors here" in result.stderr
    assert "Traceback" not in result.stderr


def test_overrides_go_to_a_folder_of_their_own(tmp_path, small):
    path = write(tmp_path, small(episodes=1))
    result = command("train", path, "--results", tmp_path, "--set", "gamma=0.5")
    assert result.returncode == 0, result.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name == f"small+{small(episodes=1, gamma=0.5).variant()}"


def test_raising_the_number_of_games_continues_a_finished_run(tmp_path, small):
    def trained(folder, *lengths):
        for episodes in lengths:
            run = Run(small(episodes=episodes), tmp_path / folder)
            os.environ["ATARI_DQN_STATE"] = str(tmp_path / folder / "state")
            recorder.train(run)
        return run

    stepwise, at_once = trained("stepwise", 2, 5), trained("at_once", 5)
    for name in ("episodes.csv", "model.safetensors"):
        assert (stepwise.folder / name).read_bytes() == (at_once.folder / name).read_bytes()
    provenance = json.loads((stepwise.folder / "provenance.json").read_text())
    assert provenance["resumes"] == 1
    kept, one = (pd.read_csv(run.folder / "evaluations.csv") for run in (stepwise, at_once))
    assert set(kept.trained_games) == {2, 5}
    pd.testing.assert_frame_equal(kept[kept.trained_games == 5].reset_index(drop=True), one)


def test_a_run_that_no_longer_matches_is_stale_and_stays_untouched(tmp_path, small):
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run)
    other = Run(small(episodes=1, gamma=0.5), tmp_path)
    assert (run.state(), other.state()) == ("complete", "stale")
    before = (run.folder / "episodes.csv").read_bytes()
    with pytest.raises(RunError, match=r"no longer matches: gamma was 0\.99, now 0\.5"):
        recorder.train(other)
    assert (run.folder / "episodes.csv").read_bytes() == before


def test_a_run_of_another_training_version_is_stale(tmp_path, small, monkeypatch):
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run)
    monkeypatch.setattr("atari_dqn.runs.run.TRAINING_VERSION", 99)
    assert run.state() == "stale"


STOPPED = params.Parameters(
    **{**SMALL, "episodes": 8, "max_game_frames": 120, "replay_capacity": 60}
)


@pytest.fixture(scope="module")
def unstopped(tmp_path_factory):
    """The folder of a run that nobody stopped."""
    folder = tmp_path_factory.mktemp("unstopped")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        recorder.train(Run(STOPPED, folder))
    return Run(STOPPED, folder).folder


def stop(run, how, interval, games=2):
    """Trains a run in a process of its own that checkpoints every `interval` seconds; sends it the
    signal `how` after so many games."""
    program = (
        "import sys; from pathlib import Path; from atari_dqn import params;"
        "from atari_dqn.runs import recorder; from atari_dqn.runs.run import Run;"
        f"recorder.CHECKPOINT_SECONDS = {interval};"
        "recorder.train(Run(params.load(sys.argv[1]), Path(sys.argv[2])))"
    )
    run.results.mkdir()
    path = write(run.results, run.params)
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(path), str(run.results)], start_new_session=True
    )
    while not checkpoints.exist(run.state_folder) or run.status()["episodes_done"] < games:
        assert process.poll() is None, "ended before it could be stopped"
        time.sleep(0.02)
    os.killpg(process.pid, how)  # as a terminal does, and `timeout`
    process.wait()


def assert_same_results(folder, other):
    for name in ("episodes.csv", "model.safetensors", "evaluations.csv", "games.jsonl.zst"):
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name


@pytest.mark.parametrize("games", [0, 2])
def test_a_killed_run_continues_as_if_nothing_had_happened(tmp_path, unstopped, games):
    """A checkpoint at every step, so that most kills fall into the writing of one."""
    run = Run(STOPPED, tmp_path / "killed")
    stop(run, signal.SIGKILL, 0.0, games)
    assert run.status()["state"] == "running", "it had no chance to say otherwise"
    assert run.state() == "interrupted"
    provenance = json.loads((run.folder / "provenance.json").read_text())
    saved = checkpoints.load(run.state_folder)["trainer"]["agent_steps"]
    assert saved - 2 * STOPPED.environments <= provenance["agent_steps"] <= saved
    recorder.train(run)
    assert_same_results(run.folder, unstopped)


class FullDisk(io.RawIOBase):
    def writable(self):
        return True

    def write(self, data):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_no_room_for_a_row_is_a_clear_error_and_the_run_continues_later(
    tmp_path, unstopped, monkeypatch
):
    run, opened = Run(STOPPED, tmp_path / "full"), recorder.Recorder.__init__

    def open_on_a_full_disk(self, run):
        opened(self, run)
        self.files["episodes.csv"].close()
        self.files["episodes.csv"] = io.BufferedWriter(FullDisk())

    with monkeypatch.context() as patch:
        patch.setattr(recorder.Recorder, "__init__", open_on_a_full_disk)
        with pytest.raises(RunError, match=r"cannot write .*episodes.csv: No space left"):
            recorder.train(run)
    assert run.status()["state"] == "failed"
    recorder.train(run)
    assert_same_results(run.folder, unstopped)


@pytest.mark.parametrize(("how", "processes"), [(signal.SIGTERM, 2), (signal.SIGINT, 1)])
def test_a_run_told_to_stop_saves_where_it_is_and_says_so(tmp_path, unstopped, how, processes):
    stopped = STOPPED.model_copy(update={"emulator_processes": processes})
    run = Run(stopped, tmp_path / "stopped")
    stop(run, how, interval=3600.0)
    status, saved = run.status(), checkpoints.load(run.state_folder)
    assert status["state"] == "interrupted"
    assert saved["episodes"] == status["episodes_done"] >= 2, "the first checkpoint holds none"
    assert saved["trainer"]["agent_steps"] > 0
    recorder.train(run)
    assert_same_results(run.folder, unstopped)


def test_value_checks_and_snapshots_are_the_same_after_a_stop_and_a_crash(
    tmp_path, small, monkeypatch
):
    monkeypatch.setattr(params, "VALUES_PERIOD", 2)
    monkeypatch.setattr(evaluation, "HELD_OUT_STATES", 16)
    monkeypatch.setattr(evaluation, "VALUE_GAMES", 1)
    parameters = small(
        episodes=6, max_game_frames=100, evaluation_games=1, snapshot_games=[1, 4, 5]
    )

    def outputs(run):
        paths = [run.folder / "values.csv", *sorted(run.folder.glob("snapshots/*"))]
        return {path.name: path.read_bytes() for path in paths}

    whole, run = Run(parameters, tmp_path / "whole"), Run(parameters, tmp_path / "resumed")
    recorder.train(whole)
    monkeypatch.setenv("ATARI_DQN_STATE", str(tmp_path / "resumed" / "state"))
    with pytest.raises(KeyboardInterrupt):
        recorder.train(run, asked_to_stop=lambda: run.status()["episodes_done"] == 3)
    with pytest.raises(ZeroDivisionError):  # the checks after the checkpoint are made again
        recorder.train(run, asked_to_stop=lambda: 1 / (5 - run.status()["episodes_done"]) < 0)
    assert pd.read_csv(run.folder / "values.csv").episode.tolist() == [2, 4]
    recorder.train(run)
    assert pd.read_csv(run.folder / "values.csv").episode.tolist() == [2, 4, 6]
    names = [f"games-{games:05d}.safetensors" for games in (1, 4, 5)]
    assert list(outputs(run)) == ["values.csv", *names]
    assert outputs(run) == outputs(whole)


def test_games_without_their_checkpoint_are_not_overwritten(tmp_path, small):
    run = Run(small(episodes=2), tmp_path)
    recorder.train(run)
    shutil.rmtree(run.state_folder)
    before = (run.folder / "episodes.csv").read_bytes()
    with pytest.raises(RunError, match="holds 2 games, but their checkpoint is not in"):
        recorder.train(Run(small(episodes=4), tmp_path))
    assert (run.folder / "episodes.csv").read_bytes() == before


def test_restart_keeps_what_cannot_be_continued_and_moves_nothing_else(tmp_path, small):
    run, longer = Run(small(episodes=2), tmp_path), Run(small(episodes=4), tmp_path)
    assert run.back_up() is None, "missing"
    recorder.train(run)
    before = (run.folder / "episodes.csv").read_bytes()
    assert run.back_up() is None, "complete"
    assert longer.back_up() is None, "can be continued"
    shutil.rmtree(run.state_folder)
    aside = longer.back_up()
    assert aside == run.folder.with_name("seed-1.aside-1")
    assert (aside / "episodes.csv").read_bytes() == before
    recorder.train(longer)
    assert (run.folder / "episodes.csv").read_bytes().startswith(before)
    assert Run(small(gamma=0.5), tmp_path).back_up().name == "seed-1.aside-2", "stale"


def test_restart_begins_again_though_a_checkpoint_of_the_same_settings_is_left(tmp_path, small):
    first, other = Run(small(episodes=1), tmp_path), Run(small(episodes=1, gamma=0.5), tmp_path)
    recorder.train(first)
    other.back_up()
    recorder.train(other)
    with pytest.raises(RunError, match="--restart"):
        recorder.train(first)
    assert first.back_up().name == "seed-1.aside-2"
    recorder.train(first)
    assert first.state() == "complete"
    assert json.loads((first.folder / "provenance.json").read_text())["resumes"] == 0
    kept = first.state_folder.with_name(f"{first.state_folder.name}.aside-1")
    assert checkpoints.exist(kept)


def test_restart_begins_again_when_every_checkpoint_is_damaged(tmp_path, small):
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run)
    for checkpoint in run.state_folder.glob("checkpoint-*"):
        checkpoint.rename(checkpoint.with_name(checkpoint.name.replace("checkpoint", "damaged")))
    longer = Run(small(episodes=2), tmp_path)
    with pytest.raises(checkpoints.CheckpointError, match="damaged"):
        recorder.train(longer)
    assert longer.back_up().name == "seed-1.aside-1"
    recorder.train(longer)
    assert longer.state() == "complete"


def test_restart_begins_again_when_neither_a_status_nor_a_checkpoint_is_left(tmp_path, small):
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run)
    (run.folder / "status.json").unlink()
    shutil.rmtree(run.state_folder)
    with pytest.raises(RunError, match="--restart"):
        recorder.train(run)
    assert (run.back_up() / "episodes.csv").exists()
    recorder.train(run)
    assert run.state() == "complete"


def test_a_run_whose_folder_was_lost_comes_back_whole_from_its_checkpoint(tmp_path, small):
    run = Run(small(episodes=2, snapshot_games=[1]), tmp_path)
    recorder.train(run)
    names = ("episodes.csv", "evaluations.csv", "model.safetensors")
    before = {name: (run.folder / name).read_bytes() for name in names}
    shutil.rmtree(run.folder)
    recorder.train(run)
    assert {name: (run.folder / name).read_bytes() for name in names} == before
    assert (run.folder / "snapshots" / "games-00001.safetensors").exists()


@pytest.mark.native
def test_a_resume_that_may_give_other_bits_is_told(tmp_path, small, monkeypatch):
    """PyTorch's depend on the processor, the native learner's do not."""
    run = Run(small(episodes=1, learner="torch"), tmp_path)
    recorder.train(run)
    monkeypatch.setattr(recorder, "processor", lambda: "another one")
    with pytest.warns(UserWarning, match="goes on with another one"):
        recorder.train(Run(small(episodes=2, learner="torch"), tmp_path))
    with pytest.warns(UserWarning, match="began with learner torch and goes on with native"):
        recorder.train(Run(small(episodes=3), tmp_path))


@pytest.mark.native
def test_a_native_run_may_go_on_on_another_processor(tmp_path, small, monkeypatch):
    recorder.train(Run(small(episodes=1), tmp_path))
    monkeypatch.setattr(recorder, "processor", lambda: "another one")
    recorder.train(Run(small(episodes=2), tmp_path))  # a warning would be an error


def test_a_run_is_not_trained_by_two_processes_at_once(tmp_path, small):
    run = Run(small(), tmp_path)
    with run.lock(), pytest.raises(RunError, match="being trained by another process"):
        recorder.train(run)


def test_a_failing_run_says_so_in_its_status(tmp_path, small, monkeypatch):
    run = Run(small(), tmp_path)
    monkeypatch.setattr(Trainer, "_learn", lambda self: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        recorder.train(run)
    assert run.state() == "failed"
    assert "ZeroDivisionError" in run.status()["error"]


@pytest.mark.parametrize("name", ["status.json", "provenance.json"])
@pytest.mark.parametrize("damage", [None, "{<<<<<<< conflict"])
def test_a_damaged_run_is_named_and_comes_back_from_its_checkpoint(tmp_path, small, name, damage):
    run = Run(small(episodes=1), tmp_path)
    recorder.train(run)
    games, path = (run.folder / "episodes.csv").read_bytes(), run.folder / name
    if damage is None and name == "status.json":
        path.unlink()
        assert run.state() == "missing"
    else:
        path.unlink() if damage is None else path.write_text(damage)
        with pytest.raises(RunError, match=rf"{name} is missing or damaged .*restore it, or move"):
            run.state()
        shutil.move(run.folder, tmp_path / "away")
    recorder.train(run)
    assert run.state() == "complete"
    assert (run.folder / "episodes.csv").read_bytes() == games


def test_a_run_too_short_to_learn_anything_says_so(tmp_path, small):
    run = Run(small(learning_starts=10_000, episodes=1), tmp_path)
    with pytest.warns(UserWarning, match="has learned nothing: its 1 games are .* 10,000"):
        recorder.train(run)


def test_a_gpu_that_is_not_there_is_refused_in_one_line(tmp_path, small, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(params.ParameterError, match="device: 'cuda' is not allowed"):
        recorder.train(Run(small(device="cuda"), tmp_path))


def test_a_run_that_a_gpu_trained_plays_where_there_is_none(finished, tmp_path, monkeypatch):
    folder, *_ = finished
    copy = shutil.copytree(folder, tmp_path / "seed-3")
    path = copy / "params.yaml"
    text = path.read_text().replace('device: "auto"', 'device: "cuda"')
    path.write_text(text.replace("emulator_processes: 1", "emulator_processes: 2"))
    assert path.read_text().count("cuda") == 1
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert len(evaluations.evaluate(copy, {"difficulty": 2}, 2)) == 2
    assert params.stored_parameters(copy).emulator_processes == 1


def test_a_transfer_run_starts_from_the_finished_model_it_names(tmp_path, small):
    transfer = small(experiment="transfer", game="breakout", initial_weights="small", episodes=1)
    run = Run(transfer, tmp_path)
    with pytest.raises(RunError, match="starts from small/double_dqn/seed-1, which"):
        recorder.train(run)
    assert not (run.folder / "episodes.csv").exists()
    source = Run(small(episodes=1), tmp_path)
    recorder.train(source)
    recorder.train(run)
    assert run.state() == "complete"
    learned, began = read_model(source.folder / "model.safetensors"), untrained(run).state_dict()
    assert [name for name in began if not began[name].equal(learned[name])] == [
        "output.weight",
        "output.bias",
    ]


def test_the_network_that_a_run_began_with_can_be_had_again(tmp_path, small):
    for seed in (1, 2):
        run = Run(small(seeds=[seed]), tmp_path)
        weights = Trainer(run.params, run.agent, seed).learner.weights()
        network = untrained(run).state_dict()
        assert network.keys() == weights.keys()
        assert all(network[name].equal(weights[name]) for name in weights)


@pytest.mark.parametrize(
    ("arguments", "slow", "said"),
    [
        (["--help"], {"torch", "pandas", "cv2"}, "Usage"),
        (
            ["train", "params/boxing_final.yaml", "--set", "gama=0.9"],
            {"torch", "pandas", "cv2"},
            "'gamma'",
        ),
        (["evaluate", "params"], {"torch", "pandas", "cv2"}, "no model.safetensors here"),
        (
            ["replay", "params", "--episode", "1"],
            {"torch", "pandas"},
            "params/params.yaml: no such",
        ),
        (["verify", "params"], {"torch", "pandas"}, "params/params.yaml: no such file"),
    ],
)
def test_help_and_refusals_wait_for_no_slow_imports(arguments, slow, said):
    code = (
        "import atexit, sys; from atari_dqn.__main__ import main\n"
        f"atexit.register(lambda: print('slow:', sys.modules.keys() & {slow}))\n"
        f"sys.argv[1:] = {arguments}; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.endswith("slow: set()\n")
    assert said in done.stdout + done.stderr


def test_numbers_are_computed_without_pytorch_and_without_a_drawing_library():
    folder = ROOT / "src" / "atari_dqn" / "analysis"
    names = [f"atari_dqn.analysis.{path.stem}" for path in folder.glob("[!_]*.py")]
    assert "atari_dqn.analysis.verdicts" in names
    code = (
        f"import sys, {', '.join(names)}\n"
        "print(sys.modules.keys() & {'torch', 'matplotlib', 'seaborn', 'IPython', 'cv2', 'PIL'})\n"
        "import atari_dqn.report.plots\n"
        "print(sorted(sys.modules.keys() & {'matplotlib', 'seaborn'}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "set()\n['matplotlib', 'seaborn']\n", "the floor above loads them"


def made(*arguments):
    """The commands that make would run."""
    command = ["make", "--dry-run", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True).stdout


@pytest.mark.parametrize("arguments", [["train", "EXPERIMENT=boxing_final"], ["experiments"]])
def test_make_begins_runs_again_only_when_told_to(arguments):
    assert "--restart" not in made(*arguments)
    assert "--restart" in made(*arguments, "RESTART=1")


def test_jupyterlab_starts_as_root_where_one_is_root():
    assert ("--allow-root" in made("lab")) == (os.getuid() == 0)


def test_a_write_that_is_interrupted_leaves_the_old_file_and_nothing_beside(tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(b"old")

    def interrupted(file):
        file.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, interrupted)
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [
        ("table.csv", b"old")
    ]


def test_what_a_killed_writer_leaves_is_not_committed_with_the_results():
    run = "results/runs/boxing_final/dqn"
    left = [f"{run}/seed-1/.model.safetensors.99", f"{run}/seed-1.aside-1/episodes.csv"]
    stored = [f"{run}/seed-1/{name}" for name in ("model.safetensors", "episodes.csv")]
    asked = subprocess.run(
        ["git", "check-ignore", "--no-index", *left, *stored],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
    )
    assert asked.stdout.splitlines() == left
