"""What TensorBoard is given, read back with its own reader."""

import io
import sys

import numpy as np
import pandas as pd
import pytest
from conftest import SMALL
from PIL import Image
from synthetic import put_evaluations
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

from atari_dqn import __main__, evaluation, params
from atari_dqn.report import build
from atari_dqn.report import tensorboard as module
from atari_dqn.report.tensorboard import Board, animated
from atari_dqn.runs import recorder, records
from atari_dqn.runs.run import Run


def read(run):
    """What a server would know of a run's events, all of them."""
    events = EventAccumulator(
        str(run.folder / "tensorboard"), {"scalars": 0, "images": 0}, purge_orphaned_data=False
    )
    return events.Reload()


def curve(events, tag):
    points = events.Scalars(tag)
    return [point.step for point in points], np.float32([point.value for point in points])


def hyper_parameters(events, kind):
    data = events.SummaryMetadata(f"_hparams_/{kind}").plugin_data.content
    return getattr(HParamsPluginData.FromString(data), kind)


def train(run, **options):
    board = Board(run)
    recorder.train(run, follow=board.update, **options)


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """A run that was stopped after 3 games, and killed after 5, whence it goes on after the third:
    without TensorBoard at first."""
    folder = tmp_path_factory.mktemp("interrupted")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATARI_DQN_STATE", str(folder / "state"))
        patch.setattr(params, "VALUES_PERIOD", 2)
        patch.setattr(evaluation, "HELD_OUT_STATES", 16)
        patch.setattr(evaluation, "VALUE_GAMES", 2)
        changes = {"episodes": 6, "max_game_frames": 100, "learning_starts": 80}
        run = Run(params.Parameters(**{**SMALL, **changes}), folder)
        with pytest.raises(KeyboardInterrupt):
            recorder.train(run, asked_to_stop=lambda: run.status()["episodes_done"] == 3)
        with pytest.raises(ZeroDivisionError):
            train(run, asked_to_stop=lambda: 1 / (5 - run.status()["episodes_done"]) < 0)
        begun = read(run)
        train(run)
    return run, begun, read(run)


def test_the_curves_are_those_of_the_tables_once_though_the_run_was_interrupted(interrupted):
    run, begun, whole = interrupted
    assert curve(begun, "score/game")[0] == [1, 2, 3, 4, 5], "those from before it was followed too"
    episodes = pd.read_csv(run.folder / "episodes.csv")
    learned = episodes.dropna()
    assert 0 < len(learned) < len(episodes) == 6
    for tag, column in (("loss", "loss"), ("mean_q", "mean_q"), ("epsilon", "epsilon")):
        rows = learned if column != "epsilon" else episodes
        steps, values = curve(whole, f"training/{tag}")
        assert steps == rows.episode.tolist()
        assert values.tolist() == rows[column].astype(np.float32).tolist()
    steps, scores = curve(whole, "score/game")
    assert (steps, scores.tolist()) == (episodes.episode.tolist(), episodes.score.tolist())
    steps, means = curve(whole, "score/mean_of_100")
    assert means == pytest.approx([np.mean(episodes.score[: n + 1]) for n in range(6)])
    values = pd.read_csv(run.folder / "values.csv")
    for tag, column in (
        ("score/greedy", "score"),
        ("values/held_out", "held_out_q"),
        ("values/predicted", "predicted"),
        ("values/realised", "realised"),
    ):
        steps, points = curve(whole, tag)
        assert steps == values.episode.tolist() == [2, 4, 6]
        assert points.tolist() == values[column].astype(np.float32).tolist()


def test_the_clock_is_that_of_training(interrupted):
    run, _, whole = interrupted
    timing = pd.read_csv(run.folder / "timing.csv")
    began = pd.Timestamp(run.provenance()["sessions"][0]["started"]).timestamp()
    times = [point.wall_time for point in whole.Scalars("score/game")]
    assert times == pytest.approx((began + timing.seconds).tolist(), abs=1e-3)
    steps = pd.read_csv(run.folder / "episodes.csv").agent_steps
    speeds = dict(zip(*curve(whole, "training/steps_per_second"), strict=True))
    assert speeds[6] == pytest.approx(steps.iloc[-1] / timing.seconds.iloc[-1])


def test_hyper_parameters_stand_beside_the_final_evaluation(interrupted):
    run, begun, whole = interrupted
    found = hyper_parameters(whole, "session_start_info").hparams
    assert found["agent"].string_value == "double_dqn"
    assert (found["gamma"].number_value, found["batch_size"].number_value) == (0.99, 4)
    metrics = hyper_parameters(whole, "experiment").metric_infos
    assert "score/evaluation" in {metric.name.tag for metric in metrics}
    evaluations = pd.read_csv(run.folder / "evaluations.csv")
    assert curve(whole, "score/evaluation") == ([6], [np.float32(evaluations.score.mean())])
    assert "score/evaluation" not in begun.Tags()["scalars"]
    with pytest.raises(KeyError):
        hyper_parameters(begun, "session_end_info")
    assert hyper_parameters(whole, "session_end_info")


def test_other_conditions_than_the_training_s_are_not_its_evaluation(interrupted):
    run, _, _ = interrupted
    path = run.folder / "evaluations.csv"
    before, table = path.read_bytes(), pd.read_csv(path)
    harder = table.assign(difficulty=3, score=-50)
    put_evaluations(path, pd.concat([table, harder, table.assign(sticky_actions=0.25, score=70)]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(params, "VALUES_PERIOD", 2)
        board = Board(run)
        board.update()
    board.close()
    path.write_bytes(before)
    assert curve(read(run), "score/evaluation")[1] == [np.float32(table.score.mean())]


def test_every_check_has_a_video_of_its_first_game(interrupted):
    run, _, whole = interrupted
    images = whole.Images("greedy_game")
    assert [image.step for image in images] == [2, 4, 6]
    (record,) = (
        record
        for heading, record in records.read_file(run.folder)
        if (heading["kind"], heading.get("game")) == ("values", 2 * 4)
    )
    screens = [game.render().copy() for game in records.replay(run.params, record)]
    pictures, milliseconds = decoded(images[1].encoded_image_string)
    assert (images[1].width, images[1].height) == (320, 420)
    assert (pictures[0] == screens[0].repeat(2, axis=0).repeat(2, axis=1)).all()
    assert (pictures[-1][::2, ::2] == screens[-1]).all()
    assert milliseconds == pytest.approx(1000 * len(screens) / 15, abs=5)


def decoded(gif):
    """Pictures uint8 [height, width, 3], and how long they last in all."""
    pictures, milliseconds = [], 0
    with Image.open(io.BytesIO(gif)) as image:
        assert image.format == "GIF"
        for number in range(image.n_frames):
            image.seek(number)
            pictures.append(np.asarray(image.convert("RGB")))
            milliseconds += image.info["duration"]
    return pictures, milliseconds


def test_a_video_is_cut_where_it_would_be_long(small, monkeypatch):
    monkeypatch.setattr(module, "SECONDS", 2)
    record = records.EpisodeRecord(5, bytes(range(18)) * 3, None)
    image = animated(records.replay(small(), record))
    assert decoded(image.encoded_image_string)[1] == 2000


def test_a_complete_run_is_written_without_training(interrupted, monkeypatch):
    run, _, whole = interrupted
    monkeypatch.setattr(recorder, "Recorder", None)
    monkeypatch.setattr(params, "VALUES_PERIOD", 2)  # its tables are read by it too
    train(run)
    sizes = [path.stat().st_size for path in (run.folder / "tensorboard").iterdir()]
    assert sum(size > 0 for size in sizes) == 1 < len(sizes), "the former files are emptied"
    assert curve(read(run), "score/game")[0] == curve(whole, "score/game")[0]


def test_without_the_package_nothing_begins_and_one_line_says_what_to_install(
    tmp_path, small, monkeypatch
):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    (tmp_path / "small.yaml").write_text(params.text(small()))
    with pytest.raises(params.ParameterError, match=r"^--tensorboard: .*pip install .*$"):
        __main__.train(tmp_path / "small.yaml", results=tmp_path / "results", tensorboard=True)
    assert not (tmp_path / "results").exists()


def test_the_report_reads_no_events(tmp_path):
    run = tmp_path / "runs" / "small" / "dqn" / "seed-1"
    (run / "tensorboard").mkdir(parents=True)
    (run / "tensorboard" / "events").write_text("much")
    (run / "episodes.csv").write_text("little")
    copy = build._snapshot(tmp_path) / "runs" / "small" / "dqn" / "seed-1"
    assert [path.name for path in copy.iterdir()] == ["episodes.csv"]
