"""What people see on the terminal: results on stdout; errors, warnings and progress on stderr."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tactile_loc.core.progress import Progress, rank

if TYPE_CHECKING:
    from rich.console import Console

PACKAGES = ("tactile_loc", "tactile_loc_cli")


def output() -> Console:
    """Return a console for results. Made anew, so that it writes to the stdout of the moment."""
    from rich.console import Console

    console = Console(highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console.width = 160
    return console


def say(text: str = "") -> None:
    """Write a line of results as it is, never wrapped; of processes that work together, the first does."""
    if rank() == 0:
        sys.stdout.write(text + "\n")


def say_table(rows: Sequence[Sequence[str]], left: int = 2) -> None:
    """Write rows of cells, the first `left` columns to the left, the others to the right; never cut to the window."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [c.ljust(w) if i < left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))]
        say(" ".join(cells).rstrip())


def complain(kind: str, text: str) -> None:
    """Write "kind: text" as one line on stderr."""
    sys.stderr.write(f"{kind}: {' '.join(text.split())}\n")
    sys.stderr.flush()


class OneLineHandler(logging.Handler):
    """Shows a warning of the library as one line."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write the record to the stderr of the moment."""
        complain(record.levelname.lower(), record.getMessage())


@contextmanager
def warnings_shown() -> Iterator[None]:
    """Show the library's log from WARNING on, and hush what other libraries say to their developers."""
    handler = OneLineHandler(logging.WARNING)
    loggers = [logging.getLogger(name) for name in PACKAGES]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        with warnings.catch_warnings():
            if not sys.warnoptions:
                warnings.simplefilter("ignore")
            yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)


def _unseen(text: str) -> None:
    """Take a note that no bar can show."""


class Bars(Progress):
    """Progress bars on stderr that vanish when their task ends."""

    def __init__(self) -> None:
        self._note: Callable[[str], None] = _unseen

    @contextmanager
    def task(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Open a bar of `total` steps; call what is yielded with the number of steps just done."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with RichProgress(*columns, console=Console(stderr=True), transient=True) as bars:
            number = bars.add_task(description, total=total)
            self._note = lambda text: bars.update(number, description=f"{description}: {text}")
            try:
                yield lambda steps: bars.advance(number, steps)
            finally:
                self._note = _unseen

    def note(self, text: str) -> None:
        """Show a line beside the bar that is open."""
        self._note(text)


def progress() -> Progress:
    """Return progress bars where somebody watches, and the null watcher otherwise."""
    return Bars() if sys.stderr.isatty() and rank() == 0 else Progress()
