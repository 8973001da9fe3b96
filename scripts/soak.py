#!/usr/bin/env python3
"""The same touches located again and again, and a slide tracked to and fro, in one process: nothing may grow or change.

Memory (resident) and open files are read before the last nine tenths and after, once libraries have taken what they
keep. Every answer must be the first one of its touch, to the bit; after tracking, a new tracker must track the slide as
the first one did. Ends with 1 where memory grew by more than 2 %, a file stayed open, or an answer changed.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tactile_loc_cli.console import make_progress

from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.simulation.noise import NOISE
from tactile_loc.core.slots.registry import registry
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.evaluation.sequences import Frame, SlidingTouches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.store.store import StageStore
from tactile_loc.tasks.tracker import Tracker

MOST_GROWTH = 0.02
WARM = 10  # one part of so many is not measured
RATE_HZ, SLIDE = 100, 300  # frames a second, and frames of a slide


class Held(NamedTuple):
    """What the process holds: memory, bytes, and open files."""

    memory: int
    files: int

    @classmethod
    def now(cls) -> Held:
        """Read it from the system."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return cls(pages * os.sysconf("SC_PAGE_SIZE"), len(os.listdir("/proc/self/fd")))


class Soaked(NamedTuple):
    """The outcome of a work done `count` times: what is held once warm and at the end, and how many answers changed."""

    name: str
    count: int
    warm: Held
    end: Held
    changed: int
    seconds: float

    @property
    def growth(self) -> float:
        """By what share memory grew."""
        return self.end.memory / self.warm.memory - 1

    @property
    def is_good(self) -> bool:
        """Whether nothing grew and nothing changed."""
        return self.growth <= MOST_GROWTH and self.end.files <= self.warm.files and not self.changed

    def row(self) -> str:
        """Return a row of the table."""
        warm, end = (f"{held.memory / 2**20:.0f}" for held in (self.warm, self.end))
        cells = (self.name, self.count, f"{self.seconds:.0f}", warm, end, f"{self.growth:+.2%}", self.warm.files,
                 self.end.files, self.changed)  # fmt: skip
        return f"| {' | '.join(map(str, cells))} |"


def soaked(name: str, count: int, once: Callable[[int], bool]) -> Soaked:
    """Do a work `count` times, each with its number, and say what is held; it returns whether its answer changed."""
    start, warm, changed = time.monotonic(), Held.now(), 0
    with make_progress().task(name, count) as advance:
        for number in range(count):
            if number == max(1, count // WARM):
                warm = Held.now()
            changed += once(number)
            advance(1)
    return Soaked(name, count, warm, Held.now(), changed, time.monotonic() - start)


def located(localizer: Localizer, touches: list[Touch], count: int) -> Soaked:
    """Locate touches in turn, each answer against the first of that touch."""
    first: dict[int, NDArray[np.float64]] = {}

    def once(number: int) -> bool:
        k = number % len(touches)
        found = localizer.localize(touches[k])
        poses = np.stack([hypothesis.T_sensor_object for hypothesis in found.hypotheses])
        return not np.array_equal(first.setdefault(k, poses), poses)

    return soaked("localisations", count, once)


def tracked(localizer: Localizer, frames: list[Frame], count: int) -> Soaked:
    """Track a slide to and fro; at the end a new tracker is to find what the first one did."""
    first = _poses(localizer, frames)
    tracker, going = _started(localizer, frames), itertools.cycle([*frames, *frames[-2:0:-1]])

    def once(number: int) -> bool:
        frame = next(going)
        tracker.update(number / RATE_HZ, frame.touch, frame.T_base_sensor)
        return number == count - 1 and not np.array_equal(first, _poses(localizer, frames))

    return soaked("frames tracked", count, once)


def _started(localizer: Localizer, frames: list[Frame]) -> Tracker:
    tracker = Tracker(localizer)
    tracker.start(frames[0].T_base_sensor @ frames[0].T_sensor_object, np.diag([1e-6] * 3 + [3e-4] * 3))
    return tracker


def _poses(localizer: Localizer, frames: list[Frame]) -> NDArray[np.float64]:
    tracker = _started(localizer, frames)
    some = [tracker.update(frame.time_s, frame.touch, frame.T_base_sensor).T_sensor_object for frame in frames]
    return np.stack([pose for pose in some if pose is not None])


def main() -> int:
    """Soak, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="pin")
    parser.add_argument("--localisations", type=int, default=50_000)
    parser.add_argument("--seconds", type=float, default=2000.0, help=f"of tracking, {RATE_HZ} frames each")
    parser.add_argument("--touches", type=int, default=50, help="that differ")
    parser.add_argument("--seed", type=int, default=0)
    given, results = parser.parse_args(), []
    with tempfile.TemporaryDirectory() as folder:
        settings = {"sensor": "gelsight-mini", "grid": {"name": "face", "spacing_mm": 4.0}, "temperature": 0.05}
        localizer = Localizer.create(given.object, store=StageStore(Path(folder)), **settings)
        renderer = registry().create("renderer", "raycast", {})
        source = RobotTouches(localizer.object, localizer.sensor.geometry, renderer, noise=NOISE["mild"])
        if given.localisations:
            results.append(located(localizer, localizer.simulate(given.touches, seed=given.seed), given.localisations))
        if given.seconds:
            frames = SlidingTouches(source).example(SLIDE, np.random.default_rng(given.seed))
            results.append(tracked(localizer, frames, round(given.seconds * RATE_HZ)))
    print("| | times | s | memory once warm, MiB | at the end | growth | files open | at the end | answers changed |")
    print("\n".join(["|---" * 9 + "|", *(result.row() for result in results)]))
    return 0 if all(result.is_good for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())
