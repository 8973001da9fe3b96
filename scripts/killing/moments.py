"""Moments at which a command is killed: after a time, or as soon as it has changed the disk so many times."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from killing.commands import Done, Place, begin, ended

GLANCE_S = 0.003  # between two looks at the disk
AFTER_S = 0.02  # at most, between a change that was seen and the kill
GONE_S = 10.0  # at most, for a killed group to be gone


@dataclass(frozen=True)
class Life:
    """What an undisturbed run is like: when its first change is seen, when it ends, and how often the disk changes."""

    first_s: float
    whole_s: float
    changes: int


@dataclass(frozen=True)
class Moment:
    """When to kill: so many seconds after the start, and after so many changes were seen."""

    seconds: float
    changes: int


def drawn(life: Life, draw: np.random.Generator) -> Moment:
    """Draw a moment of a life: half of them by the time, half of them by a change, where things are most fragile."""
    if draw.random() < 0.5:
        return Moment(float(draw.uniform(0.8 * life.first_s, life.whole_s)), 0)
    return Moment(float(draw.uniform(0, AFTER_S)), 1 + int(life.changes * draw.random() ** 2))


def lived(place: Place, words: list[str]) -> tuple[Done, Life]:
    """Run a command to its end, and tell what it was like."""
    start_s, seen = time.monotonic(), []
    process = begin(place, words)
    for _ in _changes(place, process):
        seen.append(time.monotonic() - start_s)
    done, whole_s = ended(place, process), time.monotonic() - start_s
    return done, Life(seen[0] if seen else whole_s, whole_s, len(seen))


def killed(place: Place, words: list[str], moment: Moment) -> Done:
    """Run a command and kill its group of processes at a moment, unless it has ended before; return what it came to."""
    process = begin(place, words)
    if moment.changes:
        for number, _ in enumerate(_changes(place, process), start=1):
            if number == moment.changes:
                break
    with suppress(subprocess.TimeoutExpired):
        process.wait(timeout=moment.seconds)
    end_group(process)
    return ended(place, process)


def end_group(process: subprocess.Popen[str]) -> None:
    """Kill a command with all that it has started, and wait until nobody of it is left."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    end_s = time.monotonic() + GONE_S
    while _alive(process.pid) and time.monotonic() < end_s:
        time.sleep(0.01)


def _alive(group: int) -> bool:
    """Whether somebody of a group lives; the dead whom nobody has asked for do not count."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):
            state, _, of, *_ = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(of) == group and state not in "ZX":
                return True
    return False


def _changes(place: Place, process: subprocess.Popen[str]) -> Iterator[None]:
    """Yield whenever the folders have changed since the last look, as long as the process runs."""
    before = _state(place)
    while process.poll() is None:
        time.sleep(GLANCE_S)
        if (state := _state(place)) != before:
            before = state
            yield


def _state(place: Place) -> set[tuple[str, int, int]]:
    found: set[tuple[str, int, int]] = set()
    folders = [str(place.work), str(place.store)]
    while folders:
        with suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                with suppress(OSError):
                    stat = entry.stat(follow_symlinks=False)
                    found.add((entry.path, stat.st_mtime_ns, stat.st_size))
                    if entry.is_dir(follow_symlinks=False):
                        folders.append(entry.path)
    return found
