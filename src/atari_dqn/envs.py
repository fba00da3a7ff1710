"""The games: an Atari cartridge as a Gymnasium environment, and several of them stepped in turn.

`AtariEnv` does in one class what `gymnasium.wrappers.AtariPreprocessing` does around
`ale_py.AtariEnv` (tests/test_envs.py compares the two pixel by pixel). It exists because the whole
state of a game must be savable at any moment, because the score must be that of the whole game,
and because it is faster.

What an agent sees of 12 emulator frames, with frame_skip 4 and frame_stack 3:

    frame        1  2  3  4  5  6  7  8  9 10 11 12
    action       a  a  a  a  b  b  b  b  c  c  c  c      held for 4 frames
    image              max(3,4)    max(7,8)  max(11,12)  grey, 84x84; undoes sprite flicker
    observation                              [4, 8, 12]  the last 3 images, oldest first
"""

import atexit
import weakref
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import gymnasium
import numpy as np
from ale_py import ALEInterface, ALEState, LoggerMode, roms

from atari_dqn.games import GAMES, boxing_points
from atari_dqn.params import Parameters

SIZE = 84  # pixels; the side of the square image that the networks see
FIRE = 1  # index of FIRE among the actions of the games that are served with it

ALEInterface.setLoggerMode(LoggerMode.Error)
cv2.setNumThreads(1)


@dataclass(frozen=True)
class EpisodeRecord:
    """What a game can be played again from, frame by frame: the emulator knows no chance of its
    own, so that a fresh one with any seed does the same."""

    idle_frames: int  # before the first action
    actions: bytes  # a byte an agent step: the action's index among the cartridge's
    rng: dict[str, Any] | None  # where actions are sticky, the generator of that chance when the
    # game began (as numpy's PCG64 gives its state)


@dataclass(frozen=True)
class Emulator:
    """An emulator with a cartridge in it, and its state when it was switched on."""

    ale: ALEInterface
    switched_on: ALEState


# By cartridge, those that no game uses any more. An `ale` must not be kept longer than its game.
_LEFT: dict[str, list[Emulator]] = {}
atexit.register(_LEFT.clear)  # the binding complains of objects that outlive it


def _emulator(game: str) -> Emulator:
    """One that another game has left, if there is one: inserting a cartridge takes a tenth of a
    second."""
    with suppress(IndexError):
        return _LEFT.setdefault(game, []).pop()
    ale = ALEInterface()
    ale.setFloat("repeat_action_probability", 0.0)  # see AtariEnv._act
    rom = roms.get_rom_path(game)
    if rom is None:
        raise FileNotFoundError(f"ale-py has no cartridge named {game!r}")
    ale.loadROM(rom)
    return Emulator(ale, ale.cloneState(include_rng=True))


class AtariEnv(gymnasium.Env):
    """One cartridge in one emulator, preprocessed as in Mnih et al. (2015), Methods.

    Observation: uint8 [84, 84], the newest image only (stacking is the caller's, who keeps each
    image once). Action: index into the cartridge's minimal action set. Reward: raw game points.
    `terminated`: the game is over. `truncated`: it was cut after `max_game_frames`.

    A game starts with 1 to `noop_max` idle frames, as Gymnasium's wrapper draws them. Where the
    ball must be served, FIRE is pressed for the agent at the start and within the step that loses
    a life, so that a greedy agent cannot stall for ever.

    Raises ValueError if `difficulty` is one that the cartridge does not have.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012 (Gymnasium's)
    render_mode = "rgb_array"

    def __init__(
        self,
        game: str,
        *,
        frame_skip: int = 4,
        noop_max: int = 30,
        sticky_actions: float = 0.0,
        difficulty: int = 0,
        max_game_frames: int = 108_000,
    ):
        self.game, self.facts = game, GAMES[game]
        self.frame_skip, self.noop_max = frame_skip, noop_max
        self.max_game_frames = max_game_frames
        self.sticky_actions = sticky_actions
        emulator = _emulator(game)
        weakref.finalize(self, _LEFT[game].append, emulator).atexit = False
        self.ale, self._switched_on = emulator.ale, emulator.switched_on
        self.actions = self.ale.getMinimalActionSet()
        self.set_difficulty(difficulty)
        self.action_space = gymnasium.spaces.Discrete(len(self.actions))
        self.observation_space = gymnasium.spaces.Box(0, 255, (SIZE, SIZE), np.uint8)
        self._screens = np.zeros((2, 210, 160), np.uint8)  # the two frames that are maximised
        self.score, self.frames, self.length, self.lives = 0.0, 0, 0, 0
        self.last_action = 0  # the one executed in the last frame
        self.record = EpisodeRecord(0, b"", None)  # of the beginning; `played` has the actions
        self.chosen = bytearray()  # actions of this game

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Starts a game, with `options["record"]` the recorded one, whose actions are then to be
        stepped. Returns (image uint8 [84, 84], info)."""
        if seed is not None:  # as ale_py.AtariEnv derives it
            super().reset(seed=int(np.random.SeedSequence(seed).generate_state(1)[0]))
        # A reset draws the console's timer, on which the first frames of Boxing depend: without
        # the state of the generator before it, one game in fifteen would begin a frame later, and
        # could not be played again from its record.
        self.ale.restoreState(self._switched_on)
        self.ale.setDifficulty(self.difficulty)
        self.ale.reset_game()
        self.score, self.frames, self.length, self.last_action = 0.0, 0, 0, 0
        record = (options or {}).get("record")
        if record is None:
            idle = int(self.np_random.integers(1, self.noop_max + 1)) if self.noop_max else 0
            chance = self.np_random.bit_generator.state if self.sticky_actions else None
            record = EpisodeRecord(idle, b"", dict(chance) if chance else None)
        elif self.sticky_actions:
            self.np_random.bit_generator.state = record.rng
        self.record, self.chosen = record, bytearray()
        for _ in range(record.idle_frames):
            self._act(0)
        if self.facts.fire_to_serve:
            self._serve()
        self.lives = self.ale.lives()
        self.ale.getScreenGrayscale(self._screens[0])
        return self._image(self._screens[0]), {"lives": self.lives}

    def step(self, action: int):
        """Holds an action for `frame_skip` frames.

        Returns (image uint8 [84, 84], raw reward, terminated, truncated, info); info["life_lost"]
        tells whether a life was lost in this step.
        """
        reward, older, newest = 0.0, self._screens[1], self._screens[0]
        pooled = False
        self.chosen.append(action)
        for frame in range(self.frame_skip):
            reward += self._act(action)
            if self.ale.game_over():
                break
            if frame == self.frame_skip - 2:
                self.ale.getScreenGrayscale(older)
                pooled = True
        self.length += 1
        terminated = self.ale.game_over()
        lives, self.lives = self.lives, self.ale.lives()
        life_lost = self.lives < lives
        if life_lost and self.facts.fire_to_serve and not terminated:
            reward += self._serve()
            pooled = False  # the older screen is from before the serve
        self.ale.getScreenGrayscale(newest)
        if pooled:
            np.maximum(older, newest, out=newest)
        truncated = not terminated and self.frames >= self.max_game_frames
        info = {"lives": self.lives, "life_lost": life_lost}
        return self._image(newest), reward, terminated, truncated, info

    def played(self) -> EpisodeRecord:
        """The game so far."""
        return replace(self.record, actions=bytes(self.chosen))

    def render(self) -> np.ndarray:
        """The television's picture, uint8 [210, 160, 3]."""
        return self.ale.getScreenRGB()

    def ram(self) -> np.ndarray:
        """The console's memory, uint8 [128]."""
        return self.ale.getRAM()

    def knockout(self) -> int:
        """1 if the agent has knocked its rival out, -1 if it was knocked out itself, else 0."""
        if self.facts.score_cells is None:
            return 0
        agent, rival = (self.ram()[cell] == 0xC0 for cell in self.facts.score_cells)
        return int(agent) - int(rival)

    def points(self) -> tuple[float, float]:
        """What the agent and its rival have scored so far; without a rival, the score and 0."""
        if self.facts.score_cells is None:
            return self.score, 0.0
        agent, rival = (boxing_points(int(self.ram()[cell])) for cell in self.facts.score_cells)
        return float(agent), float(rival)

    def places(self) -> tuple[tuple[int, int], ...]:
        """Where the agent's boxer and its rival are, x and y in pixels; nothing in other games."""
        memory = self.ram()
        return tuple((int(memory[x]), int(memory[y])) for x, y in self.facts.boxers or ())

    def distance(self) -> float:
        """How far apart the two boxers stand, in pixels; nan in other games."""
        if self.facts.boxers is None:
            return float("nan")
        (x, y), (rival_x, rival_y) = self.places()
        return float(np.hypot(x - rival_x, y - rival_y))

    def set_difficulty(self, difficulty: int) -> None:
        """Sets the console's switches, also while a game goes on. Raises ValueError if the
        cartridge does not read such a setting."""
        if difficulty not in self.facts.difficulties:
            raise ValueError(f"{self.game} has no difficulty {difficulty}")
        self.difficulty = difficulty
        self.ale.setDifficulty(difficulty)

    def set_clock(self, seconds: int) -> None:
        """Sets the clock of a game with one to so many seconds, at most two minutes. Raises
        ValueError if it has none or they are too many."""
        if self.facts.clock_cells is None or not 0 <= seconds <= 120:
            raise ValueError(f"{self.game} has no clock that could be set to {seconds} seconds")
        minute, second = self.facts.clock_cells
        minutes, rest = divmod(seconds, 60)
        self.ale.setRAM(minute, minutes << 4 | self.ram()[minute] & 0xF)
        self.ale.setRAM(second, rest // 10 << 4 | rest % 10)

    def _act(self, action: int) -> float:
        """One frame. With probability `sticky_actions` the last action is executed once more
        (Machado et al., 2018, section 4.1). The emulator could do this itself, but then forgets
        the last action when its state is saved."""
        if self.sticky_actions and self.np_random.random() < self.sticky_actions:
            action = self.last_action
        self.last_action = action
        reward = self.ale.act(self.actions[action])
        self.score += reward
        self.frames += 1
        return reward

    def _serve(self) -> float:
        """Presses FIRE for a step. A sticky console repeats it, so that no serve is ever missed."""
        self.last_action = FIRE
        return sum(self._act(FIRE) for _ in range(self.frame_skip))

    @staticmethod
    def _image(screen: np.ndarray) -> np.ndarray:
        return cv2.resize(screen, (SIZE, SIZE), interpolation=cv2.INTER_AREA)

    def get_state(self) -> dict[str, Any]:
        """Everything that decides how the game goes on; bytes under "emulator", the rest JSON.

        The screen is not part of it: after `set_state` it is stale until the next `step`, so the
        caller keeps the images it has been given.
        """
        return {
            "emulator": self.ale.cloneState().serialize(),
            "rng": self.np_random.bit_generator.state,
            "score": self.score,
            "frames": self.frames,
            "length": self.length,
            "lives": self.lives,
            "last_action": self.last_action,
            "record": asdict(self.played()),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores what `get_state` returned, in a game of the same cartridge and settings."""
        emulator = ALEState.__new__(ALEState)
        emulator.__setstate__(state["emulator"])
        self.ale.restoreState(emulator)
        self.np_random.bit_generator.state = state["rng"]
        self.score, self.frames = state["score"], state["frames"]
        self.length, self.lives = state["length"], state["lives"]
        self.last_action = state["last_action"]
        self.record = EpisodeRecord(**state["record"])
        self.chosen = bytearray(self.record.actions)


def make_env(params: Parameters) -> AtariEnv:
    """A game as `params` set it up."""
    return AtariEnv(
        params.game,
        frame_skip=params.frame_skip,
        noop_max=params.noop_max,
        sticky_actions=params.sticky_actions,
        difficulty=params.difficulty,
        max_game_frames=params.max_game_frames,
    )


@dataclass(frozen=True)
class FinishedEpisode:
    """A whole game, from the first frame to the last."""

    score: float  # points, raw and unclipped
    length: int  # agent steps
    frames: int  # emulator frames, idle and serving ones included
    record: EpisodeRecord


@dataclass(frozen=True)
class VectorStep:
    """What one step of every game gave; arrays are [environments]."""

    images: np.ndarray  # uint8 [E, 84*84], the newest image
    ages: np.ndarray  # int32, agent steps since the game began; 0 = this step began it
    rewards: np.ndarray  # float32, what is learned from: clipped, less the life-loss penalty
    terminated: np.ndarray  # bool, the game is over (not merely cut)
    ended: np.ndarray  # bool, it is over or was cut, and restarts in the next step
    finished: list[FinishedEpisode]


class VectorEnv:
    """Several games stepped in turn, so that one forward pass selects all their actions.

    A game that ended restarts in the next step, whose action it ignores (Gymnasium's next-step
    autoreset): that step has age 0, and must never be learned from.

    `games` are those of the run's games that are played here, by default all.
    """

    def __init__(
        self, params: Parameters, seed: np.random.SeedSequence, games: slice | None = None
    ):
        self.params = params
        seeds = seed.generate_state(params.environments)[games or slice(None)]
        self.envs = [make_env(params) for _ in seeds]
        self.actions = len(self.envs[0].actions)
        # The last `frame_stack` images of every game, oldest first. Planes, since the newest are
        # the replay memory's and one call interleaves them into observations.
        self.planes = np.zeros((params.frame_stack, len(self.envs), SIZE * SIZE), np.uint8)
        self.ended = np.zeros(len(self.envs), bool)
        for index, env in enumerate(self.envs):
            self.planes[:, index] = env.reset(seed=int(seeds[index]))[0].reshape(-1)

    def observations(self) -> np.ndarray:
        """uint8 [E, 84, 84, frame_stack], the newest image last."""
        return interleave(self.planes)

    def step(self, actions: np.ndarray) -> VectorStep:
        """Steps every game by its action (int [E])."""
        count = len(self.envs)
        rewards, terminated = np.zeros(count, np.float32), np.zeros(count, bool)
        self.planes[:-1] = self.planes[1:]
        finished = []
        for index, env in enumerate(self.envs):
            if self.ended[index]:
                self.planes[:, index] = env.reset()[0].reshape(-1)
                self.ended[index] = False
                continue
            image, raw, terminated[index], truncated, info = env.step(int(actions[index]))
            self.planes[-1, index] = image.reshape(-1)
            rewards[index] = learned_reward(self.params, raw, info["life_lost"])
            if terminated[index] or truncated:
                self.ended[index] = True
                finished.append(FinishedEpisode(env.score, env.length, env.frames, env.played()))
        ages = np.array([env.length for env in self.envs], np.int32)
        return VectorStep(self.planes[-1], ages, rewards, terminated, self.ended, finished)

    def get_state(self) -> dict[str, Any]:
        return {
            "games": [env.get_state() for env in self.envs],
            "planes": self.planes,
            "ended": self.ended,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        for env, saved in zip(self.envs, state["games"], strict=True):
            env.set_state(saved)
        self.planes[:] = state["planes"]
        self.ended[:] = state["ended"]


def learned_reward(params: Parameters, raw: float, life_lost: bool) -> float:
    """What is learned from a step's game points: clipped, then less the life-loss penalty."""
    reward = float(np.sign(raw)) if params.clip_rewards else raw
    return reward - params.life_loss_penalty * life_lost


def interleave(planes: np.ndarray) -> np.ndarray:
    """Images [stack, N, 84*84] to observations [N, 84, 84, stack], in one vectorised pass."""
    stack, count, _ = planes.shape
    merged = cv2.merge(list(planes.reshape(stack, count * SIZE, SIZE)))
    return merged.reshape(count, SIZE, SIZE, stack)
