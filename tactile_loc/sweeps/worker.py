"""A local worker process: `python -m tactile_loc.sweeps.worker FD` gets jobs from a connection and sends outcomes."""

from __future__ import annotations

import faulthandler
import os
import pickle
import queue
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection

PATIENCE_S = 10  # with libraries that swallow an interrupt, when the sweep has ended


def main(descriptor: int) -> None:
    """Work until the other side closes the connection, or is gone; then stop at once, as by Ctrl-C.

    Whatever is stored is whole at any moment, so that nothing is lost but the combination at hand.
    """
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # children of a background job would ignore it
    connection = Connection(descriptor)
    jobs: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(connection, jobs), daemon=True).start()
    try:
        from tactile_loc.sweeps.work import work

        while True:
            connection.send(work(*pickle.loads(jobs.get())))
    except (KeyboardInterrupt, OSError):
        return


def _receive(connection: Connection, jobs: queue.SimpleQueue) -> None:
    """Hand on what comes; when nothing can come any more, interrupt the main thread until it ends."""
    try:
        while True:
            jobs.put(connection.recv_bytes())
    except (EOFError, OSError):
        for _ in range(PATIENCE_S):
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            time.sleep(1)
        os._exit(1)


if __name__ == "__main__":
    main(int(sys.argv[1]))
