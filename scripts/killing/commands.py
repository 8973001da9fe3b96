"""The commands that are killed and starved: small ones, each in a place of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

FLAT = 'camera = "orthographic"\nimage_size_px = [80, 80]\nmax_depth_mm = 2.0\nmm_per_px = 0.35\n'
SMALL = 'camera = "orthographic"\nimage_size_px = [48, 40]\nmax_depth_mm = 2.0\nmm_per_px = 0.4\n'
GRID = "--sensor flat.toml --grid face -o grid.spacing_mm=8"
SURE = "-o temperature=0.001"  # which need not be fitted then
MOCO = "--encoder moco -o encoder.epochs=4 -o encoder.queries=64 -o encoder.batch=32 -o encoder.channels=4"
HANGS_S = 900


@dataclass(frozen=True)
class Command:
    """A command that is killed, by its words; it writes into its folder and into a store."""

    name: str
    line: str
    resumes: bool = True
    """Whether it goes on where it was; a camera's frames, for one, are located anew."""

    @property
    def words(self) -> list[str]:
        """The words after the program's name."""
        return self.line.split()


COMMANDS = (
    Command("build", f"build --object pin {GRID}"),
    Command("run", f"run --object head {GRID} --seed 7 --report --out found"),
    Command("train", f"build --object pin {GRID} {MOCO} {SURE}"),
    Command("calibrate", "calibrate --simulated --presses 40 --sensor small.toml --estimator cnn -o channels=4 "
            "-o epochs=6 --out mine"),
    Command("evaluate", f"evaluate --object pin --object head {GRID} --refiner none --count 6 --out measured"),
    Command("sweep", "sweep --object pin,head --sensor flat.toml --refiner none,icp --count 2 -o grid.spacing_mm=8 "
            "--workers 1 --out swept"),
    Command("live", f"live touches --object pin {GRID} {SURE} --once --no-view --out found.jsonl", resumes=False),
    Command("replay", f"replay slide.mcap --object head {GRID} {SURE} --base-frame base --out poses.mcap"),
)  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Where a command is run: `work` is where it stands, `store` its store, `temporary` the system's temporary files.

    Both may be on disks of their own.
    """

    root: Path
    elsewhere: Path | None = None
    """The store, where it is not in the place."""
    said: Path | None = None
    """Where what the command says is kept, where that is not in the place."""

    @property
    def work(self) -> Path:
        """The folder in which the command is run."""
        return self.root / "work"

    @property
    def store(self) -> Path:
        """The folder of the store."""
        return self.elsewhere or self.root / "store"

    @property
    def temporary(self) -> Path:
        """The folder of temporary files."""
        return self.root / "tmp"

    def make(self, inputs: Path) -> Place:
        """Make it anew, with nothing but the inputs in it, and return it."""
        for folder in (self.work, self.store, self.temporary):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(inputs, self.work)
        self.temporary.mkdir()
        return self

    def outputs(self) -> tuple[Path, Path]:
        """The files of what the command says, and of its errors."""
        folder = self.said or self.root
        return folder / "out.txt", folder / "err.txt"

    def environment(self) -> dict[str, str]:
        """The variables with which a command is run here; one thread, so that its answers can be had again."""
        own = {"TACTILE_LOC_STORE": str(self.store), "TACTILE_LOC_PLUGINS": "", "TMPDIR": str(self.temporary),
               "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "cli")])}  # fmt: skip
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        return {**os.environ, **own, **threads}


def program(*words: str) -> list[str]:
    """The command line of a process of its own."""
    return [sys.executable, "-m", "tactile_loc_cli.main", *words]


def begin(place: Place, words: list[str], prefix: tuple[str, ...] = (), **more: str) -> subprocess.Popen[str]:
    """Start a command in a group of processes of its own; what it says goes to the place's `outputs`."""
    said, complained = place.outputs()
    with said.open("w") as out, complained.open("w") as err:
        return subprocess.Popen([*prefix, *program(*words)], cwd=place.work, env={**place.environment(), **more},
                                stdout=out, stderr=err, text=True, start_new_session=True)  # fmt: skip


@dataclass(frozen=True)
class Done:
    """What a command came to: its exit code, minus a signal's number where it was killed, and what it said."""

    code: int
    out: str
    err: str

    @property
    def is_refusal(self) -> bool:
        """Whether it said one sentence, and what is told beside that, with the exit code of bad input."""
        lines = [line for line in self.err.splitlines() if not line.startswith("warning: ")]
        return self.code == 2 and len(lines) == 1 and lines[0].startswith("error: ") and lines[0].isprintable()


def ended(place: Place, process: subprocess.Popen[str]) -> Done:
    """Wait for a command of this place and return what it came to."""
    code = process.wait(timeout=HANGS_S)
    out, err = (path.read_text(encoding="utf-8", errors="replace") for path in place.outputs())
    return Done(code, out, err)


def whole(place: Place, words: list[str], prefix: tuple[str, ...] = (), **more: str) -> Done:
    """Run a command to its end; keywords are environment variables, `prefix` stands before it, as `nice`."""
    return ended(place, begin(place, words, prefix, **more))


def make_inputs(folder: Path) -> Path:
    """Write, once, what the commands read: sensors, touches and a recording. Return their folder."""
    if not folder.is_dir():
        making = Place(folder.with_name(f".{folder.name}"))
        shutil.rmtree(making.root, ignore_errors=True)
        making.work.mkdir(parents=True)
        making.temporary.mkdir()
        for name, text in (("flat.toml", FLAT), ("small.toml", SMALL)):
            (making.work / name).write_text(text, encoding="utf-8")
        touches = f"simulate --object pin {GRID} --count 8 --seed 1 --out touches"
        slide = f"simulate --object head {GRID} --renderer zbuffer --seed 3 --count 30 --recording slide.mcap"
        for line in (touches, slide):
            done = whole(making, line.split())
            if done.code:
                sys.exit(f"{line} does not work: {done.err}")
        (making.work / "touches" / "touches.png").unlink()
        making.work.rename(folder)
        shutil.rmtree(making.root)
    return folder


def command(name: str) -> Command:
    """Return the command of this name."""
    return next(one for one in COMMANDS if one.name == name)
