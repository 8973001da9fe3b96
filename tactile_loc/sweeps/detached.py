"""Start of a local worker, which imports this module: its output goes to a file, and it ignores Ctrl-C."""

from __future__ import annotations

import faulthandler
import os
import signal

LOG = "TACTILE_LOC_WORKER_LOG"
"""The environment variable that names the file. Without it, the import does nothing."""


def detach(path: str) -> None:
    """Append this process's output to the file `path`, and ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(file, stream)
    os.close(file)
    faulthandler.enable()


if LOG in os.environ:
    detach(os.environ[LOG])
