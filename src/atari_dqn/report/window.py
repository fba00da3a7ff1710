"""A window that shows a game: the emulator's own, which Gymnasium's human rendering opens too.

It is in a process of its own, for whoever closes it ends the process. There a second emulator plays
the same actions, at the console's pace: a game is the same wherever it is played from its record.
"""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection

from ale_py import ALEInterface, roms

from atari_dqn.envs import AtariEnv, EpisodeRecord, make_env
from atari_dqn.params import Parameters
from atari_dqn.runs.files import RunError

DRIVERS = "x11,wayland,cocoa"  # else SDL draws where nobody sees it, and says nothing


class Window:
    """An open window. What it shows lags behind by a step, so that nothing waits for the player."""

    def __init__(self, process: multiprocessing.Process, connection: Connection):
        self.process, self.connection = process, connection

    def show(self, order: EpisodeRecord | int) -> bool:
        """Begins a game, or plays its next action, once the order before that is carried out.
        False if the window has been closed; raises RunError if it failed."""
        if not self.wait():
            return False
        with suppress(ConnectionError):  # closed just now, as the next order will find
            self.connection.send(order)
        return True

    def wait(self) -> bool:
        """Until the last order is carried out; False if there is no window."""
        try:
            return self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
        if self.process.exitcode:
            raise RunError(f"the window failed (exit code {self.process.exitcode})")
        return False


@contextmanager
def opened(params: Parameters) -> Iterator[Window | None]:
    """A window for games with these parameters, closed in the end; None where there is no display
    to open one on."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_show, args=(params, theirs), daemon=True)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one that plays
    process.start()
    signal.signal(signal.SIGINT, before)
    theirs.close()
    window = Window(process, ours)
    try:
        yield window if window.wait() else None
    finally:
        ours.close()  # which ends the process
        process.join()


def _show(params: Parameters, connection: Connection) -> None:
    """What the window's process does."""
    os.environ.setdefault("SDL_VIDEODRIVER", DRIVERS)
    ale = ALEInterface()
    ale.setFloat("repeat_action_probability", 0.0)
    ale.setBool("display_screen", True)
    try:
        ale.loadROM(roms.get_rom_path(params.game))
    except RuntimeError:  # no display
        connection.send(False)
        return
    env = make_env(params)
    env.ale, env._switched_on = ale, ale.cloneState(include_rng=True)
    connection.send(True)
    _obey(env, connection)


def _obey(env: AtariEnv, connection: Connection) -> None:
    """Plays what it is told to until the other end of the connection is closed."""
    with suppress(EOFError, ConnectionError):
        while True:
            connection.send(True)  # ready for the next
            order = connection.recv()
            if isinstance(order, EpisodeRecord):
                env.reset(options={"record": order})
            else:
                env.step(order)
