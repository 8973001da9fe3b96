"""Damaged inputs, and what their readers make of them: an answer, a refusal in one sentence, or a finding."""

from __future__ import annotations

import logging
import os
import re
import resource
import shutil
import signal
import sys
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

from fuzzing.damage import damaged
from fuzzing.readers import READERS, Reader
from tactile_loc.core.errors import TactileLocError

Job = tuple[str, int | None]  # a reader, and the number of its input; none: the files as they should be
Verdict = tuple[str, str]  # READ, REFUSED or the kind of a finding; and the details

SECONDS = 60
MOST_BYTES = 3 * 2**30  # of address space, beyond what the libraries take by themselves
MOST_TAKEN = 2**30  # bytes by which the peak of the memory may grow
LONGEST = 1600  # letters of a sentence
WRITES = re.compile(r"[wxa+]")
CACHES = re.compile(r"__pycache__|/dev/null|/matplotlib|\.cache/")  # of what is compiled, not of what is read
MOVES = {"os.rename": 2, "os.remove": 1, "os.rmdir": 1, "os.mkdir": 2, "os.symlink": 2, "shutil.rmtree": 1}
READ, REFUSED = "read", "refused"
written: list[str] = []  # files that were written, moved or removed, since `watch_writes`


class TooLongError(BaseException):
    """A reader took longer than SECONDS; no `except Exception` may swallow this."""


def make_input(reader: Reader, pristine: Path, folder: Path, seed: int, number: int) -> None:
    """Copy the files of `pristine` to `folder`, one of them damaged, seldom two."""
    shutil.copytree(pristine, folder)
    draw, files = Random(f"{seed} {reader.name} {number}"), reader.files(folder)
    for path in draw.sample(files, min(len(files), 2 if draw.random() < 0.1 else 1)):
        path.write_bytes(damaged(path.name, path.read_bytes(), draw.choice(files).read_bytes(), draw))


def judged(reader: Reader, folder: Path) -> Verdict:
    """Have a reader read a folder, and judge what it does."""
    outside, peak = _listing(folder), _peak()
    written.clear()
    signal.signal(signal.SIGALRM, _give_up)
    try:
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        reader.read(folder)
        verdict = READ, ""
    except TactileLocError as error:
        verdict = _of_sentence(error, folder, reader.names_file)
    except (Exception, TooLongError) as error:  # noqa: BLE001 - whatever a reader lets through is a finding
        ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "/tactile_loc" in frame.filename]
        where = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
        verdict = f"{type(error).__name__}{where}", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    if _peak() - peak > MOST_TAKEN:
        verdict = "memory", f"{(_peak() - peak) / 2**30:.2f} GiB more than ever before"
    strange = _listing(folder) ^ outside
    strange |= {path for path in written if not path.startswith(str(folder)) and not CACHES.search(path)}
    return ("writes elsewhere", str(sorted(strange))) if strange else verdict


def _of_sentence(error: TactileLocError, folder: Path, names_file: bool) -> Verdict:
    """Judge a refusal: one sentence that names a file, and not due to memory that was asked for."""
    text, cause = str(error), error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "memory", traceback.format_exc()
        cause = cause.__cause__ or cause.__context__
    if not text or not text.isprintable() or len(text) > LONGEST:
        return "no sentence", repr(text[:2000])
    names = {folder.name, "/dev/zero", *(path.name for path in folder.rglob("*"))}
    says_where = not names_file or any(name in text for name in names)
    return (REFUSED, text) if says_where else ("says not where", text)


def _peak() -> int:
    """Return the most bytes of memory that this process ever took."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _listing(folder: Path) -> set[str]:
    """Return all that lies beside a folder."""
    return {str(path) for path in folder.parent.rglob("*") if folder not in (path, *path.parents)}


def _give_up(*_: object) -> None:
    raise TooLongError


def watch_writes() -> None:
    """Note in `written`, from now on, each file that Python opens for writing, moves or removes."""

    def note(event: str, values: tuple[object, ...]) -> None:
        if event == "open" and isinstance(values[0], (str, bytes)):
            mode, flags = values[1:3]
            if WRITES.search(mode) if isinstance(mode, str) else isinstance(flags, int) and flags & 3:
                written.append(os.path.abspath(os.fsdecode(values[0])))
        elif event in MOVES and not any(isinstance(value, int) and value >= 0 for value in values[MOVES[event] :]):
            written.append(os.path.abspath(str(values[0])))  # a name relative to a folder lies within it

    sys.addaudithook(note)


def read_all(jobs: list[Job], seed: int, whole: Path, folder: Path, said: Connection) -> None:
    """Read one input after another, each in `folder`, and send the verdicts; the process may die of one.

    Those without damage come first: they import and compile.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)  # where libraries print to
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    logging.disable()
    warnings.simplefilter("ignore")
    is_limited = False
    for name, number in jobs:
        if number is None:
            shutil.copytree(whole / name, folder)
        else:
            if not is_limited:
                watch_writes()
                taken = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
                resource.setrlimit(resource.RLIMIT_AS, (taken + MOST_BYTES,) * 2)
                is_limited = True
            make_input(READERS[name], whole / name, folder, seed, number)
        said.send(judged(READERS[name], folder))
        shutil.rmtree(folder)
