"""Progress of long work: by default nobody watches."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class Progress:
    """The null watcher. The command line passes one that draws bars."""

    @contextmanager
    def task(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Open a task of `total` steps; call what is yielded with the number of steps just done."""
        yield lambda steps: None

    def note(self, text: str) -> None:
        """Show one line about the running task, such as a loss; the next replaces it."""


def rank() -> int:
    """Return this process's number among those that torchrun started together; 0 when it did not."""
    return int(os.environ.get("RANK", "0"))


def timed(seconds: dict[str, float], stage: str, work: Callable[[], Any]) -> Any:
    """Return what `work` returns, and note in `seconds` how long the stage took, seconds."""
    start = time.perf_counter()
    result = work()
    seconds[stage] = time.perf_counter() - start
    return result
