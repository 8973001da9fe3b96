"""The commands to kill and starve, their folders, and the moments of the kills."""

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
from itertools import islice
from pathlib import Path

import numpy as np
import trimesh
from record import OURS, PROGRAM, Done

FLAT = 'camera = "orthographic"\nimage_size_px = [80, 80]\nmax_depth_mm = 2.0\nmm_per_px = 0.35\n'
SMALL = 'camera = "orthographic"\nimage_size_px = [80, 80]\nmax_depth_mm = 2.0\nmm_per_px = 0.2\n'
GRID = "--sensor flat.toml --grid face -o grid.spacing_mm=8"
SURE = "-o temperature=0.001"  # instead of fitting a temperature
MOCO = "--encoder moco -o encoder.epochs=4 -o encoder.queries=64 -o encoder.batch=32 -o encoder.channels=4"
COMMANDS = {
    "build": f"build --object pin {GRID}",
    "run": f"run --object head {GRID} --seed 7 --report --out found",
    "train": f"build --object pin {GRID} {MOCO} {SURE}",
    "calibrate": "calibrate balls --ball-radius 3 --mm-per-px 0.2 -o steps=300 --out mine",
    "paper": f"paper --object pin --object head {GRID} --refiner none --count 6 --out measured",
    "sweep": "sweep --object pin,head --sensor flat.toml --refiner none,icp --count 2 -o grid.spacing_mm=8 "
             "--workers 1 --out swept",
    "live": f"live touches --object pin {GRID} {SURE} --once --no-view --out found.jsonl",
    "replay": f"replay slide.mcap --object head {GRID} {SURE} --base-frame base --out poses.mcap",
    "library": "library build parts --units mm --directions 100 --workers 2 --out library",
}  # fmt: skip
PARTS = {"block": (9, 7, 4), "slab": (16, 12, 2), "bar": (22, 3, 3), "cube": (5, 5, 5)}  # sizes of boxes, mm
INPUTS = (
    f"simulate --object pin {GRID} --count 8 --seed 1 --out touches",
    f"simulate --object head {GRID} --renderer zbuffer --seed 3 --count 30 --recording slide.mcap",
    "simulate --object ball.stl --units mm --sensor small.toml --images --count 12 --out balls",
)
HANGS_S = 900
GLANCE_S = 0.003  # time between two looks at the disk
AFTER_S = 0.02  # longest time between a change and the kill
GONE_S = 10.0  # longest time until a killed group has ended


@dataclass(frozen=True)
class Life:
    """An undisturbed run: the times of its first change and of its end, and the number of changes on the disk."""

    first_s: float
    whole_s: float
    changes: int


@dataclass(frozen=True)
class Moment:
    """The moment of a kill: a number of seconds after a number of changes on the disk."""

    seconds: float
    changes: int = 0

    @classmethod
    def draw(cls, life: Life, generator: np.random.Generator) -> Moment:
        """Draw a moment of a run: with equal probability a random time, or just after a change on the disk."""
        if generator.random() < 0.5:
            return cls(float(generator.uniform(0.8 * life.first_s, life.whole_s)))
        return cls(float(generator.uniform(0, AFTER_S)), 1 + int(life.changes * generator.random() ** 2))


class Place:
    """The folders of a command: its working folder, its store, its temporary files, and its output."""

    def __init__(self, root: Path, store: Path | None = None, output: Path | None = None) -> None:
        self.root, self.work, self.temporary, self.store = root, root / "work", root / "tmp", store or root / "store"
        self.out, self.err = (output or root) / "out.txt", (output or root) / "err.txt"

    def reset(self, inputs: Path) -> Place:
        """Delete all files, copy the inputs, and return this place."""
        for folder in (self.work, self.store, self.temporary):
            shutil.rmtree(folder, ignore_errors=True)
        for folder in (self.root, self.out.parent):
            folder.mkdir(parents=True, exist_ok=True)
        shutil.copytree(inputs, self.work)
        self.temporary.mkdir()
        return self

    def count_bytes(self) -> int:
        """Return the number of bytes that the files take on the disk."""
        return sum(512 * path.lstat().st_blocks for path in self.root.rglob("*") if path.is_file())

    def start(self, line: str) -> subprocess.Popen[str]:
        """Start a command in its own group of processes."""
        own = {"TACTILE_LOC_STORE": str(self.store), "TMPDIR": str(self.temporary)}
        with self.out.open("w") as out, self.err.open("w") as err:
            return subprocess.Popen(
                [*PROGRAM, *line.split()], cwd=self.work, env={**os.environ, **OURS, **own},
                stdout=out, stderr=err, text=True, start_new_session=True,
            )  # fmt: skip

    def wait_for(self, process: subprocess.Popen[str]) -> Done:
        """Wait until a command of this place ends."""
        code = process.wait(timeout=HANGS_S)
        return Done(code, *(path.read_text(encoding="utf-8", errors="replace") for path in (self.out, self.err)))

    def run(self, line: str) -> Done:
        """Run a command to its end."""
        return self.wait_for(self.start(line))

    def watch(self, line: str) -> tuple[Done, Life]:
        """Run a command to its end, and watch its files."""
        start_s = time.monotonic()
        process = self.start(line)
        seen = [time.monotonic() - start_s for _ in self._find_changes(process)]
        done, whole_s = self.wait_for(process), time.monotonic() - start_s
        return done, Life(seen[0] if seen else whole_s, whole_s, len(seen))

    def run_and_kill(self, line: str, moment: Moment) -> Done:
        """Run a command, and kill its group of processes at a moment, unless the command ends before."""
        process = self.start(line)
        if moment.changes:
            next(islice(self._find_changes(process), moment.changes - 1, None), None)
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=moment.seconds)
        kill_group(process)
        return self.wait_for(process)

    def _find_changes(self, process: subprocess.Popen[str]) -> Iterator[None]:
        """Yield at each change of the files while the process runs."""
        before = self._list_files()
        while process.poll() is None:
            time.sleep(GLANCE_S)
            if (state := self._list_files()) != before:
                before = state
                yield

    def _list_files(self) -> set[tuple[str, int, int]]:
        found = set()
        for folder, folders, files in (step for root in (self.work, self.store) for step in os.walk(root)):
            for name in folders + files:
                with suppress(OSError):
                    stat = os.lstat(path := f"{folder}/{name}")
                    found.add((path, stat.st_mtime_ns, stat.st_size))
        return found


def kill_group(process: subprocess.Popen[str]) -> None:
    """Kill a command with all processes that it has started, and wait until these have ended."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    end_s = time.monotonic() + GONE_S
    while _is_alive(process.pid) and time.monotonic() < end_s:
        time.sleep(0.01)


def _is_alive(group: int) -> bool:
    """Return whether a process of a group is alive; zombies do not count."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):
            state, _, of, *_ = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(of) == group and state not in "ZX":
                return True
    return False


def make_inputs(folder: Path) -> Path:
    """Write the sensors, meshes, touches and recording that commands read, unless they exist. Return their folder."""
    if not (folder / "parts").is_dir():
        shutil.rmtree(folder, ignore_errors=True)
        making = Place(folder.with_name(f".{folder.name}"))
        shutil.rmtree(making.root, ignore_errors=True)
        for path in (making.work, making.store, making.temporary):
            path.mkdir(parents=True)
        for name, text in (("flat.toml", FLAT), ("small.toml", SMALL)):
            (making.work / name).write_text(text, encoding="utf-8")
        trimesh.creation.icosphere(4, 3.0).export(making.work / "ball.stl")
        (making.work / "parts").mkdir()
        for name, size_mm in PARTS.items():
            trimesh.creation.box(size_mm).export(making.work / "parts" / f"{name}.stl")
        for line in INPUTS:
            if (done := making.run(line)).code:
                sys.exit(f"{line} does not work: {done.err}")
        for name in ("touches", "balls"):
            (making.work / name / "touches.png").unlink()
        making.work.rename(folder)
        shutil.rmtree(making.root)
    return folder
