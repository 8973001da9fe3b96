"""Output on the terminal: results on stdout; errors, warnings and progress on stderr."""

import json
import logging
import math
import os
import re
import shutil
import sys
import textwrap
import time
import warnings
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.core.runtime.progress import NOTE, Progress

logger = logging.getLogger(__name__)

_FLAGS: ContextVar[Mapping[str, str]] = ContextVar("flags", default=MappingProxyType({}))
PACKAGES = ("tactile_loc", "tactile_loc_cli")
LEVELS = {-1: logging.ERROR, 0: NOTE, 1: logging.INFO, 2: logging.DEBUG}  # by verbosity
EVERY_S = 10.0  # least time between two lines of progress
REASONS = 5  # number of shown reasons why frames have no pose
VERDICTS = {  # key of the count, and what is written
    "certain": "certain",
    "ambiguous": "ambiguous",
    "poor_fit": "poor fit",
    "not_found": "not found",
    "no_contact": "without contact",
    "refused": "refused",
}
UNKNOWN_WIDTH, NARROWEST = 160, 20  # characters: width without a terminal, and least width of a folded column


def say(text: str = "") -> None:
    """Write a line of results, without wrapping it.

    Line breaks and other characters that cannot be printed, which come from names of files, are escaped.
    """
    sys.stdout.write(show_name(text) + "\n")


def say_written(paths: Iterable[Path]) -> list[str]:
    """List the written files, if any, and return their paths as JSON values."""
    written = [str(path) for path in paths]
    if written:
        say(f"written: {', '.join(written)}")
    return written


def format_count(number: int, noun: str) -> str:
    """Write a number with its noun: 1 touch, 2 touches, 3 entries."""
    endings = {"ch": "ches", "y": "ies", "sis": "ses", "ss": "sses"}
    short = next((end for end in endings if noun.endswith(end)), "")
    plural = noun.removesuffix(short) + endings.get(short, "s")
    return f"{number} {noun if number == 1 else plural}"


def say_reasons(reasons: Sequence[tuple[str, int]]) -> int:
    """Write the first few reasons why frames have no pose, and return the number of other reasons."""
    for reason, count in reasons[:REASONS]:
        say(f"{count} without a pose: {write_flags(reason)}")
    return max(0, len(reasons) - REASONS)


def list_verdicts(counts: Mapping[str, int]) -> str:
    """Return the number of frames with each verdict, from `count_frames`, as text."""
    return ", ".join(f"{counts[name]} {word}" for name, word in VERDICTS.items() if counts[name]) or "none"


def warn_of_uncertain(counts: Mapping[str, int]) -> None:
    """Warn if frames have a pose, but no frame is certain."""
    if counts["located"] and not counts["certain"]:
        logger.warning("no pose is certain; check the object, the sensor and the unit")


def say_table(rows: Sequence[Sequence[str]], left: int | Container[int] = 2, gap: int = 1, fold: bool = False) -> None:
    """Write a table: rows of cells, the header first. Lines are not cut to the width of the window.

    `left` is the number of left-aligned columns, or their indices. The other columns are right-aligned. Columns are
    `gap` blanks apart. In a row with fewer cells than the header, the last cell may be longer than its column. With
    `fold`, the last column is broken into lines if the window is too narrow.
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
    """Break a line between words if the line is wider than the window. Further lines begin at the column `indent`."""
    width = shutil.get_terminal_size((UNKNOWN_WIDTH, 1)).columns if sys.stdout.isatty() else UNKNOWN_WIDTH
    parts = textwrap.wrap(line[indent:], max(width - indent, NARROWEST)) or [""]
    return [line[:indent] + parts[0], *(" " * indent + part for part in parts[1:])]


@contextmanager
def name_flags(flags: Mapping[str, str]) -> Iterator[None]:
    """Let `write_flags` know the flags and arguments of the running command by their settings, such as touch_unit."""
    before = _FLAGS.set(flags)
    try:
        yield
    finally:
        _FLAGS.reset(before)


def write_flags(text: str) -> str:
    """Replace the settings that a message of the library names, such as `touch_unit`, with the command's flags."""
    return re.sub(r"`(\w+)`", lambda found: _FLAGS.get().get(found[1], found[0]), text)


def complain(kind: str, text: str) -> None:
    """Write "kind: text" as one line on stderr, with the command's flags."""
    sys.stderr.write(f"{kind}: {show_name(' '.join(write_flags(text).split()))}\n")
    sys.stderr.flush()


class OneLineHandler(logging.Handler):
    """Log handler that writes each record of the library as one line.

    Lines below the level of notes begin with the seconds since the start.
    """

    def __init__(self) -> None:
        super().__init__()
        self._start_s = time.perf_counter()
        self._warned: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Write the record to stderr, unless it repeats a warning."""
        text = record.getMessage()
        if record.levelno < NOTE:
            text = f"[{time.perf_counter() - self._start_s:.1f} s] {text}"
        elif text in self._warned:
            return
        self._warned.add(text)
        complain("note" if record.levelno == NOTE else record.levelname.lower(), text)


@contextmanager
def show_log(verbosity: int = 0) -> Iterator[None]:
    """Show the library's log, and hide Python warnings of other libraries.

    `verbosity` -1 shows only errors, 0 also warnings and notes, 1 also each step, and 2 all details.
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
    """Return whether log messages of a level, such as logging.DEBUG, are shown."""
    return logging.getLogger(PACKAGES[1]).isEnabledFor(level)


@contextmanager
def hide_results() -> Iterator[None]:
    """Discard everything that the block writes to stdout."""
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
        yield


def say_json(value: Mapping[str, Any]) -> None:
    """Write a value as a JSON document; numbers that are not finite become null."""
    for line in json.dumps(_make_plain(value), indent=1, allow_nan=False).splitlines():
        say(line)


def _make_plain(value: Any) -> Any:
    """Return a copy of a value in JSON's types; values of other types, such as paths, become text."""
    if isinstance(value, Mapping):
        return {str(key): _make_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_make_plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's numbers and arrays
        return _make_plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int) else str(value)


class Bars(Progress):
    """Progress bars on stderr that vanish when their task ends."""

    def __init__(self) -> None:
        self._note: Callable[[str], None] | None = None

    @contextmanager
    def task(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show a bar of `total` steps. Yield a function; call it with the number of steps just done."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
        )
        with RichProgress(*columns, console=Console(stderr=True), transient=True) as bars:
            number = bars.add_task(show_name(description), total=total)
            self._note = lambda text: bars.update(number, description=show_name(f"{description}: {text}"))
            try:
                yield lambda steps: bars.advance(number, steps)
            finally:
                self._note = None

    def note(self, text: str) -> None:
        """Show a text beside the bar, if a bar is open."""
        if self._note is not None:
            self._note(text)


@dataclass
class _RunningTask:
    """A task whose progress is written as lines, at most one in EVERY_S seconds. Times are in seconds."""

    description: str
    total: int
    done: int = 0
    note: str = ""
    started_s: float = field(default_factory=lambda: time.monotonic())
    shown_s: float = field(default_factory=lambda: time.monotonic())

    def advance(self, steps: int) -> None:
        """Count the steps just done, and write a line if the last one is old."""
        self.done += steps
        now_s = time.monotonic()
        if now_s - self.shown_s >= EVERY_S and self.done < self.total:
            self.shown_s = now_s
            spent_s = now_s - self.started_s
            left = f", about {spent_s * (self.total - self.done) / self.done:.0f} s left" if self.done else ""
            about = f" ({self.note})" if self.note else ""
            complain("note", f"{self.description}: {self.done} of {self.total} in {spent_s:.0f} s{left}{about}")


class Lines(Progress):
    """Progress as lines on stderr, for logs and pipes. A task shorter than EVERY_S seconds writes no line."""

    def __init__(self) -> None:
        self._running: _RunningTask | None = None

    @contextmanager
    def task(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Open a task of `total` steps. Yield a function; call it with the number of steps just done."""
        outer, self._running = self._running, _RunningTask(description, total)
        try:
            yield self._running.advance
        finally:
            self._running = outer

    def note(self, text: str) -> None:
        """Add a text to the next line of the running task."""
        if self._running is not None:
            self._running.note = text


def make_progress() -> Progress:
    """Return progress bars if stderr is a terminal, and otherwise progress lines.

    With -q, return a Progress that shows nothing.
    """
    if not is_shown(logging.WARNING):
        return Progress()
    return Bars() if sys.stderr.isatty() else Lines()
