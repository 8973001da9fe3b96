"""A damaged input and the verdict of its reader: an answer, a refusal in one sentence, or a finding."""

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

from fuzzing.damage import damage
from fuzzing.readers import READERS, Reader
from tactile_loc.core.runtime.errors import TactileLocError

Job = tuple[str, int | None]  # a reader, and the number of its input, or None for its correct files
Verdict = tuple[str, str]  # READ, REFUSED or the kind of a finding, and details

SECONDS = 60
MOST_BYTES = 3 * 2**30  # address space in addition to that of the libraries
MOST_TAKEN = 2**30  # largest growth of the peak memory, bytes
LONGEST = 1600  # letters of a sentence
WRITES = re.compile(r"[wxa+]")
CACHES = re.compile(r"__pycache__|/dev/null|/matplotlib|\.cache/")  # files that libraries write
MOVES = {"os.rename": 2, "os.remove": 1, "os.rmdir": 1, "os.mkdir": 2, "os.symlink": 2, "shutil.rmtree": 1}
READ, REFUSED = "read", "refused"
written: list[str] = []  # files written, moved or removed since `watch_writes`


class TooLongError(BaseException):
    """Raised if a reader takes longer than `SECONDS`. `except Exception` must not catch this error."""


def make_input(reader: Reader, pristine: Path, folder: Path, seed: int, number: int) -> None:
    """Copy the files of `pristine` to `folder`, and damage one file, sometimes two."""
    shutil.copytree(pristine, folder)
    draw, files = Random(f"{seed} {reader.name} {number}"), reader.files(folder)
    for path in draw.sample(files, min(len(files), 2 if draw.random() < 0.1 else 1)):
        path.write_bytes(damage(path.name, path.read_bytes(), draw.choice(files).read_bytes(), draw))


def judge(reader: Reader, folder: Path) -> Verdict:
    """Give a folder to a reader, and judge the outcome."""
    outside, peak = _list_beside(folder), _read_peak()
    written.clear()
    signal.signal(signal.SIGALRM, _give_up)
    try:
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        reader.read(folder)
        verdict = READ, ""
    except TactileLocError as error:
        verdict = _judge_refusal(error, folder, reader.names_file)
    except (Exception, TooLongError) as error:  # noqa: BLE001 - any other exception is a finding
        ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "/tactile_loc" in frame.filename]
        where = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
        verdict = f"{type(error).__name__}{where}", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    if _read_peak() - peak > MOST_TAKEN:
        verdict = "memory", f"{(_read_peak() - peak) / 2**30:.2f} GiB more than before"
    strange = _list_beside(folder) ^ outside
    strange |= {path for path in written if not path.startswith(str(folder)) and not CACHES.search(path)}
    return ("writes elsewhere", str(sorted(strange))) if strange else verdict


def _judge_refusal(error: TactileLocError, folder: Path, names_file: bool) -> Verdict:
    """Judge a refusal, which must be one sentence that names a file, and must not come from a lack of memory."""
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


def _read_peak() -> int:
    """Return the peak memory of this process, in bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _list_beside(folder: Path) -> set[str]:
    """Return the paths beside a folder."""
    return {str(path) for path in folder.parent.rglob("*") if folder not in (path, *path.parents)}


def _give_up(*_: object) -> None:
    raise TooLongError


def watch_writes() -> None:
    """From now on, add to `written` each file that Python opens for writing, moves or removes."""

    def note(event: str, values: tuple[object, ...]) -> None:
        if event == "open" and isinstance(values[0], (str, bytes)):
            mode, flags = values[1:3]
            if WRITES.search(mode) if isinstance(mode, str) else isinstance(flags, int) and flags & 3:
                written.append(os.path.abspath(os.fsdecode(values[0])))
        elif event in MOVES and not any(isinstance(value, int) and value >= 0 for value in values[MOVES[event] :]):
            written.append(os.path.abspath(str(values[0])))  # a name in an open folder lies within it

    sys.addaudithook(note)


def read_all(jobs: list[Job], seed: int, whole: Path, folder: Path, said: Connection) -> None:
    """Read one input after another in `folder`, and send the verdicts.

    Correct files come first, so that imports and compilation happen before the memory is limited.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)  # takes the output of libraries
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
        said.send(judge(READERS[name], folder))
        shutil.rmtree(folder)
