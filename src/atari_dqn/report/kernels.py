"""Kernels of notebooks, forked from a process that has loaded what they need.

To load it takes each of them seconds, and a report has twenty.
"""

import multiprocessing
import os
import sys
from multiprocessing import forkserver
from multiprocessing.context import BaseContext, ForkServerProcess
from typing import Any

from jupyter_client import AsyncKernelManager

from atari_dqn.runs.processes import end_with_parent

FORKED = sys.platform == "linux"  # elsewhere libraries may not bear it


def context() -> BaseContext:
    """Of the processes that execute notebooks."""
    if not FORKED:
        return multiprocessing.get_context("spawn")
    found = multiprocessing.get_context("forkserver")
    found.set_forkserver_preload(["atari_dqn.report.loaded"])
    return found


def begin(environment: dict[str, str]) -> None:
    """Begins a process: one that is forked has the environment of when the first of them was."""
    os.environ.clear()
    os.environ.update(environment)
    end_with_parent()
    if forkserver.get_inherited_fds() is not None and sys.version_info < (3, 14):
        # A forked process knows the server that it comes from, but would start another for its own
        # children, which takes seconds (CPython gh-86354)
        forkserver._forkserver.ensure_running = lambda: None  # type: ignore[method-assign]


class _Forking(AsyncKernelManager):
    """Forks its kernel; all else is as ever."""

    async def _async_launch_kernel(self, kernel_cmd: list[str], **options: Any) -> None:
        context()
        _, _, _, *arguments = kernel_cmd  # python -m ipykernel_launcher
        kernel = _Kernel(arguments, options["env"])
        kernel.start()
        provisioner: Any = self.provisioner
        provisioner.process, provisioner.pgid = kernel, kernel.pid


class _Kernel(ForkServerProcess):
    """A kernel's process, with what Jupyter asks of a `subprocess.Popen`."""

    stdin = stdout = stderr = None

    def __init__(self, arguments: list[str], environment: dict[str, str]):
        super().__init__()
        self.arguments, self.environment = arguments, environment

    def poll(self) -> int | None:
        return self.exitcode

    def wait(self) -> int | None:
        self.join()
        return self.exitcode

    def send_signal(self, number: int) -> None:
        if self.pid and self.is_alive():
            os.kill(self.pid, number)

    def run(self) -> None:
        from ipykernel.kernelapp import IPKernelApp

        os.setsid()  # Ctrl-C is for the report's own process
        begin(self.environment)
        parent = f"--IPKernelApp.parent_handle={os.getppid()}"  # else it prints how to end it
        IPKernelApp.launch_instance(argv=[*self.arguments, parent])


Kernels = _Forking if FORKED else AsyncKernelManager
