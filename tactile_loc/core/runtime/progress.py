"""The progress of long work, which is not shown by default, and the durations of its stages."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

NOTE = (logging.INFO + logging.WARNING) // 2  # level of log messages that are no warning, but shown by default


class Progress:
    """Progress that is not shown. The command line uses a subclass that draws bars."""

    @contextmanager
    def task(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Open a task of `total` steps. Call the yielded function with the number of steps just done."""
        yield lambda steps: None

    def note(self, text: str) -> None:
        """Show one line about the running task, such as a loss. The next call replaces the line."""


@dataclass(frozen=True, eq=False)
class StageTimes:
    """Durations of stages: `seconds` by name, in the order in which the stages first ran."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the block's duration to that of the stage `name`."""
        start_s = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start_s
