"""The commands that are killed and starved, the places where they run, and the moments at which they are killed."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from record import OURS, PROGRAM, Done

FLAT = 'camera = "orthographic"\nimage_size_px = [80, 80]\nmax_depth_mm = 2.0\nmm_per_px = 0.35\n'
SMALL = 'camera = "orthographic"\nimage_size_px = [48, 40]\nmax_depth_mm = 2.0\nmm_per_px = 0.4\n'
GRID = "--sensor flat.toml --grid face -o grid.spacing_mm=8"
SURE = "-o temperature=0.001"  # no temperature is fitted then
MOCO = "--encoder moco -o encoder.epochs=4 -o encoder.queries=64 -o encoder.batch=32 -o encoder.channels=4"
COMMANDS = {
    "build": f"build --object pin {GRID}",
    "run": f"run --object head {GRID} --seed 7 --report --out found",
    "train": f"build --object pin {GRID} {MOCO} {SURE}",
    "calibrate": "calibrate --simulated --presses 40 --sensor small.toml --estimator cnn -o channels=4 -o epochs=6 "
                 "--out mine",
    "evaluate": f"evaluate --object pin --object head {GRID} --refiner none --count 6 --out measured",
    "sweep": "sweep --object pin,head --sensor flat.toml --refiner none,icp --count 2 -o grid.spacing_mm=8 "
             "--workers 1 --out swept",
    "live": f"live touches --object pin {GRID} {SURE} --once --no-view --out found.jsonl",
    "replay": f"replay slide.mcap --object head {GRID} {SURE} --base-frame base --out poses.mcap",
}  # fmt: skip
INPUTS = (
    f"simulate --object pin {GRID} --count 8 --seed 1 --out touches",
    f"simulate --object head {GRID} --renderer zbuffer --seed 3 --count 30 --recording slide.mcap",
)
HANGS_S = 900
GLANCE_S = 0.003  # between two looks at the disk
AFTER_S = 0.02  # at most, between a change that was seen and the kill
GONE_S = 10.0  # at most, until a killed group is gone


@dataclass(frozen=True)
class Life:
    """An undisturbed run: when its first change is seen, when it ends, and how often the disk changes."""

    first_s: float
    whole_s: float
    changes: int


@dataclass(frozen=True)
class Moment:
    """When to kill: after so many seen changes, and then so many seconds."""

    seconds: float
    changes: int = 0

    @classmethod
    def drawn(cls, life: Life, draw: np.random.Generator) -> Moment:
        """Draw a moment of a life: half of them by the time, half of them just after a change of the disk."""
        if draw.random() < 0.5:
            return cls(float(draw.uniform(0.8 * life.first_s, life.whole_s)))
        return cls(float(draw.uniform(0, AFTER_S)), 1 + int(life.changes * draw.random() ** 2))


class Place:
    """Where a command runs: its folder, its store, its temporary files, and the folder of its output."""

    def __init__(self, root: Path, store: Path | None = None, said: Path | None = None) -> None:
        self.root, self.work, self.temporary = root, root / "work", root / "tmp"
        self.store, self.said = store or root / "store", said or root

    def make(self, inputs: Path) -> Place:
        """Make it anew, with nothing but the inputs in it, and return it."""
        for folder in (self.work, self.store, self.temporary):
            shutil.rmtree(folder, ignore_errors=True)
        for folder in (self.root, self.said):
            folder.mkdir(parents=True, exist_ok=True)
        shutil.copytree(inputs, self.work)
        self.temporary.mkdir()
        return self

    def renew_work(self, inputs: Path) -> None:
        """Make the folder of the command anew, and keep the store."""
        shutil.rmtree(self.work)
        shutil.copytree(inputs, self.work)

    def outputs(self) -> tuple[Path, Path]:
        """Return the files of the command's output and of its errors."""
        return self.said / "out.txt", self.said / "err.txt"

    def begin(self, line: str) -> subprocess.Popen[str]:
        """Start a command in a group of processes of its own."""
        own = {"TACTILE_LOC_STORE": str(self.store), "TMPDIR": str(self.temporary)}
        said, complained = self.outputs()
        with said.open("w") as out, complained.open("w") as err:
            return subprocess.Popen(
                [*PROGRAM, *line.split()], cwd=self.work, env={**os.environ, **OURS, **own},
                stdout=out, stderr=err, text=True, start_new_session=True,
            )  # fmt: skip

    def ended(self, process: subprocess.Popen[str]) -> Done:
        """Wait for a command of this place."""
        code = process.wait(timeout=HANGS_S)
        return Done(code, *(path.read_text(encoding="utf-8", errors="replace") for path in self.outputs()))

    def whole(self, line: str) -> Done:
        """Run a command to its end."""
        return self.ended(self.begin(line))

    def lived(self, line: str) -> tuple[Done, Life]:
        """Run a command to its end, and watch it."""
        start_s = time.monotonic()
        process = self.begin(line)
        seen = [time.monotonic() - start_s for _ in self._changes(process)]
        done, whole_s = self.ended(process), time.monotonic() - start_s
        return done, Life(seen[0] if seen else whole_s, whole_s, len(seen))

    def killed(self, line: str, moment: Moment) -> Done:
        """Run a command and kill its group of processes at a moment, unless it has ended before."""
        process = self.begin(line)
        if moment.changes:
            for number, _ in enumerate(self._changes(process), start=1):
                if number == moment.changes:
                    break
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=moment.seconds)
        end_group(process)
        return self.ended(process)

    def _changes(self, process: subprocess.Popen[str]) -> Iterator[None]:
        """Yield whenever the folders have changed since the last look, as long as the process runs."""
        before = self._state()
        while process.poll() is None:
            time.sleep(GLANCE_S)
            if (state := self._state()) != before:
                before = state
                yield

    def _state(self) -> set[tuple[str, int, int]]:
        found = set()
        for folder, folders, files in (step for root in (self.work, self.store) for step in os.walk(root)):
            for name in folders + files:
                with suppress(OSError):
                    stat = os.lstat(path := f"{folder}/{name}")
                    found.add((path, stat.st_mtime_ns, stat.st_size))
        return found


def end_group(process: subprocess.Popen[str]) -> None:
    """Kill a command with all that it has started, and wait until all of it is gone."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    end_s = time.monotonic() + GONE_S
    while _alive(process.pid) and time.monotonic() < end_s:
        time.sleep(0.01)


def _alive(group: int) -> bool:
    """Whether a process of a group lives; zombies do not count."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):
            state, _, of, *_ = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(of) == group and state not in "ZX":
                return True
    return False


def make_inputs(folder: Path) -> Path:
    """Write, once, the sensors, touches and recording that the commands read. Return their folder."""
    if not folder.is_dir():
        making, empty = Place(folder.with_name(f".{folder.name}")), folder.with_name(".empty")
        empty.mkdir(parents=True, exist_ok=True)
        making.make(empty)
        for name, text in (("flat.toml", FLAT), ("small.toml", SMALL)):
            (making.work / name).write_text(text, encoding="utf-8")
        for line in INPUTS:
            if (done := making.whole(line)).code:
                sys.exit(f"{line} does not work: {done.err}")
        (making.work / "touches" / "touches.png").unlink()
        making.work.rename(folder)
        shutil.rmtree(making.root)
        empty.rmdir()
    return folder
