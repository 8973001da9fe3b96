#!/usr/bin/env python3
"""Locate the same touches again and again, and track a slide to and fro. Memory must not grow, nor answers change.

Resident memory and open files are read at the end, and after a tenth of the work, when libraries have allocated their
memory. Each answer must equal the first answer for its touch, to the bit. After tracking, a new tracker must track the
slide as at the beginning. The exit code is 1 if memory grew by more than 2 %, a file stayed open, or an answer changed.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tactile_loc_benchmark.sliding_touches import Frame, SlidingTouches
from tactile_loc_cli.console import make_progress

from tactile_loc import Localizer, RobotTouches, StageStore, Touch, Tracker, format_markdown
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.plugin import registry

MOST_GROWTH = 0.02
WARM = 10  # the first of these parts of the work is not measured
RATE_HZ, SLIDE = 100, 300  # frames per second, and frames of a slide
COLUMNS = ["", "times", "s", "memory once warm, MiB", "at the end", "growth", "files open", "at the end",
           "answers changed"]  # fmt: skip


class Held(NamedTuple):
    """The resources of the process: resident memory, bytes, and open files."""

    memory: int
    files: int

    @classmethod
    def now(cls) -> Held:
        """Return the resources that the process uses now."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return cls(pages * os.sysconf("SC_PAGE_SIZE"), len(os.listdir("/proc/self/fd")))


class Soaked(NamedTuple):
    """A work done `count` times: the resources after the warm-up and at the end, and the number of changed answers."""

    name: str
    count: int
    warm: Held
    end: Held
    changed: int
    seconds: float

    @property
    def growth(self) -> float:
        """The share by which memory grew."""
        return self.end.memory / self.warm.memory - 1

    @property
    def is_good(self) -> bool:
        """Whether memory and files did not grow, and no answer changed."""
        return self.growth <= MOST_GROWTH and self.end.files <= self.warm.files and not self.changed

    def list_cells(self) -> list[str]:
        """Return the cells of the table's row."""
        warm, end = (f"{held.memory / 2**20:.0f}" for held in (self.warm, self.end))
        cells = (self.name, self.count, f"{self.seconds:.0f}", warm, end, f"{self.growth:+.2%}", self.warm.files,
                 self.end.files, self.changed)  # fmt: skip
        return [str(cell) for cell in cells]


def soak(name: str, count: int, changes: Iterator[bool]) -> Soaked:
    """Take `count` items, each true if an answer has changed, and measure the resources."""
    start, warm, changed = time.monotonic(), Held.now(), 0
    with make_progress().task(name, count) as advance:
        for number, has_changed in enumerate(itertools.islice(changes, count), start=1):
            changed += has_changed
            if number == max(1, count // WARM):
                warm = Held.now()
            advance(1)
    return Soaked(name, count, warm, Held.now(), changed, time.monotonic() - start)


def locate(localizer: Localizer, touches: list[Touch]) -> Iterator[bool]:
    """Locate touches in turn, without end. Yield whether each answer differs from the first answer for its touch."""
    first: dict[int, NDArray[np.float64]] = {}
    for k in itertools.cycle(range(len(touches))):
        poses = np.stack([hypothesis.T_sensor_object for hypothesis in localizer.localize(touches[k]).hypotheses])
        yield not np.array_equal(first.setdefault(k, poses), poses)


def track(localizer: Localizer, frames: list[Frame], count: int) -> Iterator[bool]:
    """Track a slide to and fro. Yield False for each frame except the last.

    For the last frame, yield whether the poses of a new tracker differ from the poses of the first tracker.
    """
    first, tracker = _track_once(localizer, frames), _start_tracker(localizer, frames)
    for number, frame in zip(range(count), itertools.cycle([*frames, *frames[-2:0:-1]]), strict=False):
        tracker.update(number / RATE_HZ, frame.touch, frame.T_base_sensor)
        yield number == count - 1 and not np.array_equal(first, _track_once(localizer, frames))


def _start_tracker(localizer: Localizer, frames: list[Frame]) -> Tracker:
    tracker = Tracker(localizer)
    tracker.start(frames[0].T_base_sensor @ frames[0].T_sensor_object, np.diag([1e-6] * 3 + [3e-4] * 3))
    return tracker


def _track_once(localizer: Localizer, frames: list[Frame]) -> NDArray[np.float64]:
    tracker = _start_tracker(localizer, frames)
    poses = [tracker.update(frame.time_s, frame.touch, frame.T_base_sensor).T_sensor_object for frame in frames]
    return np.stack([pose for pose in poses if pose is not None])


def main() -> int:
    """Soak, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="pin")
    parser.add_argument("--localisations", type=int, default=50_000)
    parser.add_argument("--seconds", type=float, default=2000.0, help=f"seconds of tracking, {RATE_HZ} frames each")
    parser.add_argument("--touches", type=int, default=50, help="number of different touches")
    parser.add_argument("--seed", type=int, default=0)
    given, results = parser.parse_args(), []
    with tempfile.TemporaryDirectory() as folder:
        settings = {"sensor": "gelsight-mini", "grid": {"name": "face", "spacing_mm": 4.0}, "temperature": 0.05}
        localizer = Localizer.create(given.object, store=StageStore(Path(folder)), **settings)
        renderer = registry().create("renderer", "zbuffer", {})
        source = RobotTouches(localizer.object, localizer.sensor.geometry, renderer, noise=NOISE["mild"])
        if given.localisations:
            touches = localizer.simulate(given.touches, seed=given.seed)
            results.append(soak("localisations", given.localisations, locate(localizer, touches)))
        if count := round(given.seconds * RATE_HZ):
            frames = SlidingTouches(source).draw_example(SLIDE, np.random.default_rng(given.seed))
            results.append(soak("frames tracked", count, track(localizer, frames, count)))
    print(format_markdown([COLUMNS, *(result.list_cells() for result in results)]), end="")
    return 0 if all(result.is_good for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())
