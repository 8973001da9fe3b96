"""Imported by a local worker as it begins: its output goes to a file, and it ends with the sweep, not by Ctrl-C."""

from __future__ import annotations

import faulthandler
import os
import signal

LOG = "TACTILE_LOC_WORKER_LOG"
"""The variable that names the file; without it nothing happens."""


def detach(path: str) -> None:
    """Send this process's output to the file `path`, added to its end, and have it ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(file, stream)
    os.close(file)
    faulthandler.enable()


if LOG in os.environ:
    detach(os.environ[LOG])
