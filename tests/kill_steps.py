"""Kill a process before each of its file operations."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from itertools import count

import pytest

STEPS = ("open", "os.", "shutil.", "ctypes.")  # the audit events before which a process is killed


def killed_at_every_step(act: Callable[[], object]) -> Iterator[int]:
    """Run `act` in a child process, kill the child at its n-th step, and yield n, for n = 1, 2, ...

    The last n is that of a child that finished: `act` has fewer than n steps.
    """
    if not hasattr(os, "fork"):
        pytest.skip("this system starts no process by a fork")
    for number in count(1):
        child = os.fork()
        if child == 0:
            _run(act, number)
        _, status = os.waitpid(child, 0)
        yield number
        if os.waitstatus_to_exitcode(status) != -signal.SIGKILL:
            assert os.waitstatus_to_exitcode(status) == 0
            return


def _run(act: Callable[[], object], last: int) -> None:
    taken = count(1)

    def watch(event: str, _: object) -> None:
        if event.startswith(STEPS) and next(taken) == last:
            os.kill(os.getpid(), signal.SIGKILL)

    try:
        sys.addaudithook(watch)
        act()
    except BaseException:  # noqa: BLE001
        os._exit(1)
    os._exit(0)
