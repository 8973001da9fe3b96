"""Progress of long work, by default watched by nobody, and how long its stages take."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Progress:
    """The null watcher. The command line passes one that draws bars."""

    @contextmanager
    def task(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Open a task of `total` steps; call what is yielded with the number of steps just done."""
        yield lambda steps: None

    def note(self, text: str) -> None:
        """Show one line about the running task, such as a loss; the next replaces it."""


class StageTimes:
    """How long each stage took: `seconds` by name, in the order in which they first ran."""

    def __init__(self, seconds: dict[str, float] | None = None) -> None:
        self.seconds: dict[str, float] = {} if seconds is None else seconds

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the block's duration to that of the stage called `name`."""
        start_s = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start_s

    def shared_among(self, count: int) -> StageTimes:
        """Return new times, each a `count`-th: what one of so many that were worked on together took."""
        return StageTimes({name: seconds / count for name, seconds in self.seconds.items()})


def rank() -> int:
    """Return this process's number among those that torchrun started together; 0 when it did not."""
    return int(os.environ.get("RANK", "0"))
