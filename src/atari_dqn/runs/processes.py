"""Processes that work for another one."""

import multiprocessing.process
import os
import threading


def end_with_parent() -> None:
    """Ends this process when the one that started it has ended, though that was killed: one of a
    pool would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch(parent: multiprocessing.process.BaseProcess) -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, args=(parent,), daemon=True).start()
