"""Watching a stored run's model play: in a window, on video, and in figures in the terminal."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tqdm import tqdm

from atari_dqn.envs import AtariEnv
from atari_dqn.evaluation import EpisodeInProgress, EvaluationEpisode, Player, player_of, q_of
from atari_dqn.params import Parameters
from atari_dqn.report import window
from atari_dqn.report.video import television
from atari_dqn.report.window import Window
from atari_dqn.runs.files import write_atomically
from atari_dqn.runs.models import stored_agent
from atari_dqn.runs.recorder import stop_signals
from atari_dqn.schedules import epsilon_greedy
from atari_dqn.training import prepare_process

FPS = 60  # the console's frames per second


def watch(folder: Path, overrides: dict[str, Any], games: int, video: Path | None) -> None:
    """Plays the first evaluation games of a stored run's model, with `overrides` of its parameters,
    and stores nothing of them among its results.

    They are shown in a window; where there is no display, on a video, named after the run unless
    `video` says otherwise. Ctrl-C, or whoever closes the window, ends it. Raises what
    `models.stored_agent` does, or RunError if the video cannot be written.
    """
    prepare_process()
    network, params = stored_agent(folder, overrides)
    player = player_of(network, params)
    with stop_signals() as stopped, window.opened(params) as shown:
        if shown is None:
            video = video or _free(f"{params.experiment}-{params.agents[0]}-seed-{params.seeds[0]}")
            print(f"no display to open a window on: what is played goes to {video}")
        playing = _play(player, params, games, shown, stopped)
        if video is None:
            for _ in playing:
                pass
        else:
            write_atomically(video, television(playing))
            print(f"video: {video}")


def _free(name: str) -> Path:
    """A video's path in the working folder that is not taken."""
    path, number = Path(f"{name}.mp4"), 1
    while path.exists():
        number += 1
        path = Path(f"{name}-{number}.mp4")
    return path


def _play(
    player: Player,
    params: Parameters,
    games: int,
    shown: Window | None,
    stopped: Callable[[], bool],
) -> Iterator[AtariEnv]:
    """Each game before its first action, and after each; says what it comes to."""
    episode, seed = EpisodeInProgress(params), params.seeds[0]
    with tqdm(bar_format="{desc}", leave=False, disable=None) as line:  # none but in a terminal
        for game in range(games):
            episode.start(game, seed)
            yield episode.env
            visible = shown is None or shown.show(episode.env.played())
            ended = False
            while not ended:
                if stopped() or not visible:
                    why = "the window was closed" if not visible else "stopped"
                    tqdm.write(f"{why} in {_standing(episode)}")
                    return
                q_value = q_of(player, episode.planes[:, None])
                action = int(epsilon_greedy(q_value, params.evaluation_epsilon, episode.rng)[0])
                visible = shown is None or shown.show(action)
                ended = episode.step(action)
                said = f"{_standing(episode)}, value {q_value.max():.2f}"
                line.set_description_str(said, refresh=False)
                line.update()
                yield episode.env
            tqdm.write(_standing(episode) + _ending(episode.result(seed)))


def _standing(episode: EpisodeInProgress) -> str:
    minutes, seconds = divmod(episode.env.frames // FPS, 60)
    return f"game {episode.game}: {episode.env.score:g} points, {minutes}:{seconds:02}"


def _ending(result: EvaluationEpisode) -> str:
    if result.knockout:
        return ", knock-out" if result.knockout == 1 else ", knocked out"
    return ", won" if result.won else ""
