"""A run as TensorBoard shows it: curves, hyper-parameters, and now and then a video.

All of it comes from the run's tables and records, and is written afresh whenever following begins:
whatever a run has been through, what its tables say is there once. Steps are training games; the
clock is that of training, from the run's beginning and without its interruptions.
"""

import io
from collections.abc import Iterator
from datetime import datetime
from fractions import Fraction
from itertools import islice

import numpy as np
import pandas as pd
from PIL import Image
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import FileWriter
from torch.utils.tensorboard.summary import hparams, scalar

from atari_dqn.envs import AtariEnv, EpisodeRecord
from atari_dqn.params import NOT_TRAINING
from atari_dqn.runs import records, tables
from atari_dqn.runs.run import COMPLETE, Run, as_trained

FOLDER = "tensorboard"  # of a run's folder
WINDOW = 100  # games that the mean score and the speed are of
SECONDS = 20  # of a game in a video

# What becomes of the tables' columns
EPISODES = {
    "score/game": "score",
    "score/mean_of_100": "mean_score",
    "training/loss": "loss",
    "training/mean_q": "mean_q",
    "training/epsilon": "epsilon",
    "training/steps_per_second": "speed",
}
VALUES = {
    "score/greedy": "score",
    "values/held_out": "held_out_q",
    "values/predicted": "predicted",
    "values/realised": "realised",
}
EVALUATIONS = {"score/evaluation": "score"}
VIDEO = "greedy_game"
RESULTS = ("score/evaluation", "score/mean_of_100")  # shown beside the hyper-parameters


class Board:
    """Writes what a run's tables hold to its tensorboard/, and then what is added to them."""

    def __init__(self, run: Run):
        self.run, self.begun, self.ended = run, False, False
        self.done = dict.fromkeys(("episodes", "values", "evaluations"), 0)  # rows of tables

    def update(self) -> None:
        """Writes what is new in the tables; the first time, when nobody else may be training the
        run, all that is in them."""
        if not self.begun:
            self._begin()
        episodes = self._episodes()
        clock = episodes.set_index("episode").time
        self._write(self._new("episodes", episodes), EPISODES)
        values = tables.read(self.run.folder, tables.VALUES)
        checks = self._new("values", values.assign(time=values.episode.map(clock)))
        self._write(checks, VALUES)
        self._write_videos(checks)
        evaluations = self._evaluations()
        evaluations = evaluations.assign(time=evaluations.episode.map(clock)).dropna()
        self._write(self._new("evaluations", evaluations), EVALUATIONS)
        if not self.ended and self.run.status()["state"] == COMPLETE:
            self.ended = True
            self.writer.add_summary(self._hyper_parameters()[2])
        self.writer.flush()

    def close(self) -> None:
        if self.begun:
            self.writer.close()

    def _begin(self) -> None:
        folder = self.run.folder / FOLDER
        for former in folder.glob("events.*"):
            former.write_bytes(b"")  # a server that is reading it stumbles if it is gone
        self.writer, self.begun = FileWriter(folder), True
        # What a server has of the former files, it drops from this step on
        self.writer.add_event(Event(session_log=SessionLog(status=SessionLog.START)), step=0)
        for summary in self._hyper_parameters()[:2]:
            self.writer.add_summary(summary)

    def _hyper_parameters(self) -> tuple[Summary, Summary, Summary]:
        """The columns of TensorBoard's table, this run's values in them, and that it is over."""
        run = self.run
        named = {"experiment": run.params.experiment, "agent": run.agent, "seed": run.seed}
        values = run.params.model_dump(exclude=NOT_TRAINING)
        return hparams({**named, **values}, dict.fromkeys(RESULTS, 0.0))

    def _episodes(self) -> pd.DataFrame:
        """The games, each with when it ended (Unix seconds), and the mean score and the speed
        (agent steps per second) over the last ones."""
        folder, (first, *_) = self.run.folder, self.run.provenance()["sessions"]
        timing = tables.read(folder, tables.TIMING)
        table = tables.read(folder, tables.EPISODES).merge(timing, on="episode")
        table["time"] = datetime.fromisoformat(first["started"]).timestamp() + table.seconds
        table["mean_score"] = table.score.rolling(WINDOW, min_periods=1).mean()
        passed = table[["agent_steps", "seconds"]]
        passed = passed - passed.shift(WINDOW, fill_value=0)
        table["speed"] = passed.agent_steps / passed.seconds
        return table

    def _evaluations(self) -> pd.DataFrame:
        """The mean score of every model that was evaluated as it was trained."""
        table = as_trained(tables.read(self.run.folder, tables.EVALUATIONS), self.run.params)
        if table.empty:  # the run's end makes it
            return pd.DataFrame(columns=["episode", "score"])
        means = table.groupby("trained_games").score.mean()
        return means.rename_axis("episode").reset_index()

    def _new(self, name: str, table: pd.DataFrame) -> pd.DataFrame:
        """The rows that have not been written."""
        new = table.iloc[self.done[name] :]
        self.done[name] = len(table)
        return new

    def _write(self, rows: pd.DataFrame, tags: dict[str, str]) -> None:
        """A point per row and tag, where the column has a number."""
        for row in rows.to_dict("records"):
            for tag, column in tags.items():
                if np.isfinite(row[column]):
                    summary = scalar(tag, row[column])
                    self.writer.add_summary(summary, row["episode"], row["time"])

    def _write_videos(self, checks: pd.DataFrame) -> None:
        """The first of the greedy games behind each of these rows of values.csv."""
        if checks.empty:
            return
        first: dict[int, EpisodeRecord] = {}
        for heading, record in records.read_file(self.run.folder, torn=True):
            if heading["kind"] == records.VALUES:
                first.setdefault(heading["episode"], record)
        for episode, time in zip(checks.episode, checks.time, strict=True):
            image = animated(records.replay(self.run.params, first[episode]))
            summary = Summary(value=[Summary.Value(tag=VIDEO, image=image)])
            self.writer.add_summary(summary, episode, time)


def animated(games: Iterator[AtariEnv]) -> Summary.Image:
    """An animated GIF of the first seconds of a game that is being played, at its own pace and
    twice as large as the console draws it; TensorBoard shows nothing else that moves."""
    game = next(games)
    rate = Fraction(60, game.frame_skip)  # pictures per second
    palette, screens = np.zeros((256, 3), np.uint8), [game.ale.getScreen()]
    palette[screens[0]] = game.render()
    for now in islice(games, round(SECONDS * rate) - 1):
        screens.append(now.ale.getScreen())
        palette[screens[-1]] = now.render()
    pictures = [Image.fromarray(screen.repeat(2, axis=0).repeat(2, axis=1)) for screen in screens]
    for picture in pictures:
        picture.putpalette(palette.tobytes())
    ends = [10 * round(100 * number / rate) for number in range(len(pictures) + 1)]  # ms
    data = io.BytesIO()
    pictures[0].save(
        data,
        "GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=np.diff(ends).tolist(),
        loop=0,
    )
    width, height = pictures[0].size
    return Summary.Image(
        height=height, width=width, colorspace=3, encoded_image_string=data.getvalue()
    )
