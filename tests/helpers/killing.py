"""Kill workers while they work."""

import os
import signal
import threading
import time
from contextlib import contextmanager


def loky_workers():
    """The worker processes that loky has started for this process."""
    import psutil

    found = []
    for child in psutil.Process().children():
        try:
            if any("popen_loky" in word for word in child.cmdline()):
                found.append(child.pid)
        except psutil.Error:  # it has just ended
            continue
    return found


@contextmanager
def killing(workers, times):
    """Kill a worker as soon as there is one, and others one after another.

    Parameters
    ----------
    workers : callable
        Returns the processes of workers.
    times : int

    Yields
    ------
    set of int
        Processes that were killed.
    """
    killed, over = set(), threading.Event()

    def kill():
        while not over.is_set() and len(killed) < times:
            for process in list(set(workers()) - killed)[:1]:
                os.kill(process, signal.SIGKILL)
                killed.add(process)
                over.wait(0.3)
            time.sleep(0.005)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()
