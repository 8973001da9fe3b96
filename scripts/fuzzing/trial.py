"""One damaged input, and what its reader makes of it: an answer, a refusal in one sentence, or a finding."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import sys
import traceback
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fuzzing.damage import damaged
from fuzzing.readers import Reader
from tactile_loc.core.errors import TactileLocError

SECONDS = 60
MOST_BYTES = 3 * 2**30  # of address space, beyond what the libraries take by themselves
MOST_TAKEN = 2**30  # bytes of memory by which the most that was ever taken may grow
LONGEST = 1600  # letters of a sentence
WRITES = re.compile(r"[wxa+]")
CACHES = re.compile(r"__pycache__|/dev/null|/matplotlib|\.cache/")  # of what is compiled, not of what is read
MOVES = {"os.rename": 2, "os.remove": 1, "os.rmdir": 1, "os.mkdir": 2, "os.symlink": 2, "shutil.rmtree": 1}
READ, REFUSED = "read", "refused"


@dataclass(frozen=True)
class Verdict:
    """What became of an input: READ or REFUSED, or a finding: its kind in a few words, and all there is to say."""

    outcome: str
    details: str = ""

    @property
    def is_finding(self) -> bool:
        """Whether the reader did what it must not do."""
        return self.outcome not in (READ, REFUSED)


class TooLongError(BaseException):
    """A reader took longer than SECONDS; no `except Exception` may swallow this."""


def make_input(reader: Reader, pristine: Path, folder: Path, seed: int, number: int) -> None:
    """Copy the files of `pristine` to `folder`, one of them damaged, seldom two."""
    shutil.copytree(pristine, folder)
    draw = np.random.default_rng([seed, zlib.crc32(reader.name.encode()), number])
    files = reader.files(folder)
    count = 2 if draw.random() < 0.1 else 1
    for place in draw.permutation(len(files))[:count]:
        path, other = files[int(place)], files[int(draw.integers(len(files)))]
        path.write_bytes(damaged(path.name, path.read_bytes(), other.read_bytes(), draw))


def judged(reader: Reader, folder: Path) -> Verdict:
    """Have a reader read a folder, and judge what it does."""
    outside = _listing(folder.parent, folder)
    written.clear()
    taken = _taken()
    try:
        with _deadline():
            reader.read(folder)
        verdict = Verdict(READ)
    except TactileLocError as error:
        verdict = _of_sentence(error, folder, reader.names_file)
    except (Exception, TooLongError) as error:  # noqa: BLE001 - whatever a reader lets through is a finding
        verdict = Verdict(_kind(error), traceback.format_exc())
    if _taken() - taken > MOST_TAKEN:
        verdict = Verdict("memory", f"{(_taken() - taken) / 2**30:.2f} GiB more than ever before")
    strange = _listing(folder.parent, folder) ^ outside
    strange |= {path for path in written if not path.startswith(str(folder)) and not CACHES.search(path)}
    return Verdict("writes elsewhere", str(sorted(strange))) if strange else verdict


def _of_sentence(error: TactileLocError, folder: Path, names_file: bool) -> Verdict:
    """A refusal must be one sentence that says where, and not be due to memory that was asked for."""
    text = str(error)
    if any(isinstance(one, MemoryError) for one in _causes(error)):
        return Verdict("memory", traceback.format_exc())
    if not text or not text.isprintable() or len(text) > LONGEST:
        return Verdict("no sentence", repr(text[:2000]))
    names = {folder.name, "/dev/zero", *(path.name for path in folder.rglob("*"))}
    if names_file and not any(name in text for name in names):
        return Verdict("says not where", text)
    return Verdict(REFUSED, text)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _kind(error: BaseException) -> str:
    """The exception and the line of ours that it passed last."""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "/tactile_loc" in frame.filename]
    where = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
    return f"{type(error).__name__}{where}"


def _taken() -> int:
    """The most bytes of memory that this process ever took."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _listing(folder: Path, but: Path) -> set[str]:
    return {str(path) for path in folder.rglob("*") if but not in (path, *path.parents)}


@contextmanager
def _deadline() -> Iterator[None]:
    def give_up(*_: object) -> None:
        raise TooLongError

    signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


written: list[str] = []


def watch_writes() -> None:
    """Note from now on, in `written`, every file that Python opens for writing, and each that it moves or removes."""

    def note(event: str, values: tuple[object, ...]) -> None:
        if event == "open" and isinstance(values[0], (str, bytes)):
            mode, flags = values[1:3]
            writes = bool(WRITES.search(mode)) if isinstance(mode, str) else bool(isinstance(flags, int) and flags & 3)
            if writes:
                written.append(os.path.abspath(os.fsdecode(values[0])))
        elif event in MOVES and not any(isinstance(value, int) and value >= 0 for value in values[MOVES[event] :]):
            written.append(os.path.abspath(str(values[0])))  # what is named relative to a folder is within it

    sys.addaudithook(note)


def limit_memory() -> None:
    """Let this process take MOST_BYTES more than it has now; beyond, allocation fails."""
    taken = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MOST_BYTES,) * 2)
