"""A game that can be looked at step by step, and played on from any of them.

Moment `t` of a game is what there is to see before its action `t`; the last moment is its end, or
where it was left. Pictures are those of the videos (video.py).
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from PIL import Image

from atari_dqn.envs import EpisodeRecord
from atari_dqn.evaluation import EpisodeInProgress
from atari_dqn.params import Parameters
from atari_dqn.report.video import Critic, Recording, Stage

UP, DOWN, LEFT, RIGHT, FIRE = "UP", "DOWN", "LEFT", "RIGHT", "FIRE"

SOME = 100  # moments that are judged at once, since a network is faster with several
Changes = dict[int, dict[str, Any]]  # by moment: what `Playthrough.branch` set there


@dataclass(frozen=True)
class Sight:
    """What there is to see at a moment."""

    screen: bytes  # the television's picture, PNG: a fiftieth of its size in memory
    image: np.ndarray  # uint8 [84*84], what the network is given; it sees the last few
    score: float  # points so far
    places: tuple[tuple[int, int], ...]  # pixels: x, y of the agent's boxer and of its rival


class Playthrough:
    """A game from its record, and what a network makes of every moment of it.

    `changes` are settings that were changed in the course of it. `known` is a game that begins in
    the same way, of which what was seen is taken over. `progress` is told the share that is done.
    """

    def __init__(
        self,
        critic: Critic,
        params: Parameters,
        record: EpisodeRecord,
        title: str,
        changes: Changes | None = None,
        known: "Playthrough | None" = None,
        progress: Callable[[float], None] = lambda share: None,
    ):
        self.critic, self.params, self.title = critic, params, title
        self.record, self.ended = replace(record, actions=b""), False  # actions: `actions`
        self.changes = changes or {}
        self.actions = list(record.actions)
        count = len(self.actions) + 1
        self.sights: list[Sight] = known.sights[:count] if known else []
        self.q_values: list[np.ndarray] = known.q_values[:count] if known else []  # float32 [A]
        self.values: list[float] = known.values[:count] if known else []
        self.episode = EpisodeInProgress(params)
        self.names = [action.name for action in self.episode.env.actions]
        self.episode.replay(self.record)
        for moment in range(count):
            if moment > 0:
                self.ended = self.episode.step(self.actions[moment - 1])
            self._change(moment)
            if moment == len(self.sights):
                self._look()
            if moment % SOME == 0:
                self._judge()
                progress(moment / count)
        self._judge()

    @property
    def last(self) -> int:
        """The number of the last moment."""
        return len(self.actions)

    def planes(self, moment: int) -> np.ndarray:
        """The images of the observation, oldest first, uint8 [stack, 84*84]."""
        first = moment - self.params.frame_stack + 1
        return np.stack([self.sights[max(0, at)].image for at in range(first, moment + 1)])

    def screen(self, moment: int) -> np.ndarray:
        """The television's picture, uint8 [210, 160, 3]."""
        return np.asarray(Image.open(io.BytesIO(self.sights[moment].screen)))

    def best(self, moment: int) -> int:
        """The action that the network values most."""
        return int(self.q_values[moment].argmax())

    def play(self, action: int) -> bool:
        """Plays an action; true when the game has ended. Raises ValueError if it had before."""
        if self.ended:
            raise ValueError("the game has ended")
        self.ended = self.episode.step(action)
        self.actions.append(action)
        self._look()
        self._judge()
        return self.ended

    def branch(
        self,
        moment: int,
        critic: Critic | None = None,
        title: str | None = None,
        settings: dict[str, Any] | None = None,
    ) -> "Playthrough":
        """The same game up to a moment, to be played on: by another network, if one is given, and
        from there with other `settings`: difficulty, sticky_actions (a probability), clock (seconds
        left). Raises ValueError if the game does not have such a setting."""
        changes = {at: changed for at, changed in self.changes.items() if at <= moment}
        changes[moment] = changes.get(moment, {}) | (settings or {})
        return Playthrough(
            critic or self.critic,
            self.params,
            replace(self.record, actions=bytes(self.actions[:moment])),
            title or self.title,
            changes,
            self if critic is None else None,
        )

    def recording(self) -> Recording:
        """The game so far, as videos draw it; if it goes on, with the action that the network would
        choose next."""
        actions, scores = [*self.actions], [sight.score for sight in self.sights]
        if not self.ended:
            actions.append(self.best(-1))
            scores.append(scores[-1])
        return Recording(
            self.params.model_copy(update={"agents": self.critic.agents}),
            self.episode.result(seed=0),
            self.critic.symbol,
            np.array(actions),
            np.array(self.q_values[: len(actions)]),
            np.array(self.values[: len(actions)]),
            np.array(scores),
            otherwise="played",
        )

    def _change(self, moment: int) -> None:
        """Makes the changes of settings at a moment that has been reached."""
        env, changed = self.episode.env, self.changes.get(moment, {})
        if "difficulty" in changed:
            env.set_difficulty(changed["difficulty"])
        if "sticky_actions" in changed:
            env.sticky_actions = changed["sticky_actions"]
            env.np_random = np.random.default_rng(moment)  # the same whenever it is played again
        if "clock" in changed:
            env.set_clock(changed["clock"])

    def _look(self) -> None:
        env, image = self.episode.env, self.episode.planes[-1].copy()
        self.sights.append(Sight(png(env.render()), image, env.score, env.places()))

    def _judge(self) -> None:
        """Lets the network judge the moments that it has not judged yet."""
        moments = range(len(self.values), len(self.sights))
        if moments:
            planes = np.stack([self.planes(moment) for moment in moments], axis=1)
            q_values, values = self.critic(planes)
            self.q_values += list(q_values)
            self.values += values.tolist()


def png(drawn: np.ndarray) -> bytes:
    """A picture, uint8 [height, width, 3], as a PNG that is made fast rather than small."""
    return cv2.imencode(".png", drawn[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def picture(games: Sequence[Playthrough], moment: int) -> np.ndarray:
    """A moment of a game with its instruments, or of several side by side, each with its own title;
    uint8 [height, width, 3]. Games that are over wait with their last picture."""
    stage = Stage({game.title: game.recording() for game in games})
    for game, column in zip(games, stage.columns, strict=True):
        now = min(moment, game.last)
        column.draw(game.screen(now), now)
        if stage.mind is not None:
            stage.mind.draw(game.planes(now), now)
    return stage.canvas


def action_of(pressed: set[str], names: Sequence[str]) -> int:
    """The action of a joystick that is held so: `pressed` has UP, DOWN, LEFT, RIGHT and FIRE.

    Opposites cancel. A cartridge that does not read all of it (`names` are its actions) gets as
    much as it reads, and steps to the side rather than anything else.
    """
    opposites = [pair for pair in ({UP, DOWN}, {LEFT, RIGHT}) if pair <= pressed]
    held = pressed.difference(*opposites)

    def fit(action: int) -> tuple[bool, int, bool]:
        parts = {part for part in (UP, DOWN, LEFT, RIGHT, FIRE) if part in names[action]}
        return parts <= held, len(parts), not parts.isdisjoint({LEFT, RIGHT})

    return max(range(len(names)), key=fit)
