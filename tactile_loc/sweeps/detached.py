"""The start of a local worker: a worker that imports this module writes its output to a file and ignores Ctrl-C."""

from __future__ import annotations

import faulthandler
import os
import signal

LOG = "TACTILE_LOC_WORKER_LOG"
"""The environment variable that names the file. Without it, the import does nothing."""


def detach(path: str) -> None:
    """Append the output of this process to the file `path`, and ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(file, stream)
    os.close(file)
    faulthandler.enable()


if LOG in os.environ:
    detach(os.environ[LOG])
