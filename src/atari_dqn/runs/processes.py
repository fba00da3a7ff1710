"""Processes that work for another one."""

import multiprocessing.process
import os
import signal
import threading


def end_with_parent(saving: bool = False) -> None:
    """Ends this process when the one that started it has ended, though that was killed: one of a
    pool would wait for work for ever. With `saving` it is told to stop, as by SIGTERM."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch(parent: multiprocessing.process.BaseProcess) -> None:
        parent.join()
        if saving:
            os.kill(os.getpid(), signal.SIGTERM)
        else:
            os._exit(1)

    threading.Thread(target=watch, args=(parent,), daemon=True).start()
