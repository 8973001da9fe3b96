"""Progress of long work: by default nobody watches."""

from __future__ import annotations

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
