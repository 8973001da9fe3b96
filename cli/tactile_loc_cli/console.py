"""What people see on the terminal: results on stdout; errors, warnings and progress on stderr."""

from __future__ import annotations

import json
import logging
import math
import os
import shutil
import sys
import textwrap
import time
import warnings
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

from tactile_loc.core.progress import Progress, rank

PACKAGES = ("tactile_loc", "tactile_loc_cli")
LEVELS = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO, 2: logging.DEBUG}  # by verbosity
REASONS = 5  # why frames were refused, that are written
UNKNOWN_WIDTH, NARROWEST = 160, 20  # characters: of a window that is none, and of a folded column


def say(text: str = "") -> None:
    """Write a line of results as it is, never wrapped; of processes that work together, the first does."""
    if rank() == 0:
        sys.stdout.write(text + "\n")


def say_written(paths: Iterable[Path]) -> list[str]:
    """Write which files were written, if any, and return their paths as JSON values."""
    written = [str(path) for path in paths]
    if written:
        say(f"written: {', '.join(written)}")
    return written


def say_reasons(reasons: Sequence[tuple[str, int]]) -> int:
    """Write why frames were refused, the most frequent reasons, and return how many more there are."""
    for reason, count in reasons[:REASONS]:
        say(f"refused {count}: {reason}")
    return max(0, len(reasons) - REASONS)


def say_table(rows: Sequence[Sequence[str]], left: int | Container[int] = 2, gap: int = 1, fold: bool = False) -> None:
    """Write rows of cells, the first one the header; never cut to the window.

    The first `left` columns, or those of these numbers, are set to the left, the others to the right, `gap` blanks
    apart. Of a row with fewer cells than the header the last runs on. With `fold` the last column is broken into lines
    where the window is too narrow.
    """
    to_left = range(left) if isinstance(left, int) else left
    whole = [row for row in rows if len(row) == len(rows[0])]
    widths = [max(map(len, column)) for column in zip(*whole, strict=True)]
    indent = sum(widths[:-1]) + gap * (len(widths) - 1)
    for row in rows:
        cells = [c.ljust(w) if i in to_left else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=False))]
        if len(row) < len(widths):
            cells[-1] = row[-1]
        line = (" " * gap).join(cells).rstrip()
        for part in _fold_line(line, indent) if fold else [line]:
            say(part)


def _fold_line(line: str, indent: int) -> list[str]:
    """A line, broken between words after the column where its last cell begins, if it is wider than the window."""
    width = shutil.get_terminal_size((UNKNOWN_WIDTH, 1)).columns if sys.stdout.isatty() else UNKNOWN_WIDTH
    parts = textwrap.wrap(line[indent:], max(width - indent, NARROWEST)) or [""]
    return [line[:indent] + parts[0], *(" " * indent + part for part in parts[1:])]


def complain(kind: str, text: str) -> None:
    """Write "kind: text" as one line on stderr."""
    sys.stderr.write(f"{kind}: {' '.join(text.split())}\n")
    sys.stderr.flush()


class OneLineHandler(logging.Handler):
    """Shows the library's log, one line a record; warnings as they are, the rest with the seconds since it began."""

    def __init__(self) -> None:
        super().__init__()
        self._start_s = time.perf_counter()
        self._warned: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Write the record to the stderr of the moment; a warning that was given already is not repeated."""
        text = record.getMessage()
        if record.levelno < logging.WARNING:
            text = f"[{time.perf_counter() - self._start_s:.1f} s] {text}"
        elif text in self._warned:
            return
        self._warned.add(text)
        complain(record.levelname.lower(), text)


@contextmanager
def show_log(verbosity: int = 0) -> Iterator[None]:
    """Show the library's log, and hush what other libraries say to their developers.

    `verbosity` -1 shows errors, 0 warnings, 1 what is being done, 2 all details.
    """
    handler = OneLineHandler()
    loggers = [logging.getLogger(name) for name in PACKAGES]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(LEVELS[min(max(verbosity, -1), 2)])
    try:
        with warnings.catch_warnings():
            if not sys.warnoptions:
                warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)


def is_shown(level: int) -> bool:
    """Whether the log of this level, such as logging.DEBUG, is shown."""
    return logging.getLogger(PACKAGES[1]).isEnabledFor(level)


@contextmanager
def hide_results() -> Iterator[None]:
    """Let nothing that the block writes reach stdout, whoever writes it."""
    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere):
        yield


def say_json(value: Mapping[str, Any]) -> None:
    """Write a value as the one JSON document of a command; numbers that are not finite are null."""
    say(json.dumps(_make_plain(value), indent=1, allow_nan=False))


def _make_plain(value: Any) -> Any:
    """A deep copy made of JSON's own types; what it does not know, such as a path, as text."""
    if isinstance(value, Mapping):
        return {str(key): _make_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_make_plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's numbers and arrays
        return _make_plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int) else str(value)


def _ignore_note(text: str) -> None:
    """Take a note that no bar can show."""


class Bars(Progress):
    """Progress bars on stderr that vanish when their task ends."""

    def __init__(self) -> None:
        self._note: Callable[[str], None] = _ignore_note

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
                self._note = _ignore_note

    def note(self, text: str) -> None:
        """Show a line beside the bar that is open."""
        self._note(text)


def make_progress() -> Progress:
    """Return progress bars where somebody watches and did not ask for quiet, and the null watcher otherwise."""
    return Bars() if sys.stderr.isatty() and rank() == 0 and is_shown(logging.WARNING) else Progress()
