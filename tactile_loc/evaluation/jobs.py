"""Jobs that are done once: their rows are kept in files, so that an interrupted sweep or benchmark resumes."""

import logging
import threading
import traceback
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from tactile_loc.core.runtime.errors import TactileLocError, fold_line
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.store.files import read_json, remove_abandoned, write_json, write_text
from tactile_loc.store.store import StageStore

ROWS, ERRORS = "rows", "errors"  # folders of the results
# A Dask worker may have several threads, but OpenGL contexts and numba's workqueue allow only one at a time.
_ALONE = threading.Lock()

log = logging.getLogger(__name__)


class Job(Protocol):
    """Work for one process: it measures one subject. A job is pickled, so it holds only plain values.

    A subject, such as an `ObjectModel`, has a `name`. Subjects with equal names are equal.
    """

    @property
    def key(self) -> str:
        """A hash of all inputs of the job."""
        ...

    @property
    def store(self) -> Path:
        """The folder of the stage store that all workers share."""
        ...

    def measure(self, subject: Any, store: StageStore, /) -> dict[str, Any]:
        """Return the measured values, as JSON values. Raises TactileLocError if the job is impossible."""
        ...


@dataclass(frozen=True)
class JobOutcome:
    """The outcome of a job: the values `measured`, or an `error` in one sentence.

    `trace` is the traceback of an unexpected error. `built` has the names, "stage digest", of the stages that were
    built for the job.
    """

    key: str
    measured: dict[str, Any] | None
    built: tuple[str, ...] = ()
    error: str = ""
    trace: str = ""


JobOutcomes = Generator[JobOutcome, None, None]


class Workers(Protocol):
    """Runs jobs: `LocalWorkers` or `DaskWorkers`."""

    def run_jobs(self, jobs: Sequence[Job], subjects: Mapping[str, Any], /) -> JobOutcomes:
        """Yield the outcome of every job when it ends; `subjects` maps each job's key to its subject."""
        ...


@dataclass(frozen=True, eq=False)
class QueuedJob:
    """A job with its subject, a short `note` for people, and JSON values `about` it for the file of its row."""

    job: Job
    subject: Any
    note: str
    about: Mapping[str, Any]


def do_job(job: Job, subject: Any) -> JobOutcome:
    """Do a job on its subject. An error is returned in the outcome."""
    with _ALONE:
        store = StageStore(job.store)
        measured, error, trace = None, "", ""
        try:
            measured = job.measure(subject, store)
        except TactileLocError as raised:
            error = str(raised)
        except Exception as raised:  # noqa: BLE001 - a component may raise anything
            error, trace = f"{type(raised).__name__}: {raised}", traceback.format_exc()
        built = tuple(map(str, store.built))
        return JobOutcome(job.key, measured, built, fold_line(" ".join(error.split())), trace)


class FinishedJobs:
    """The outcomes of finished jobs in the files OUT/rows/KEY.json, and tracebacks, in OUT/errors/KEY.txt."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def read(self, key: str) -> JobOutcome | None:
        """Return the outcome of this key; None if its file is missing or damaged."""
        try:
            found = read_json(self._locate_row(key))
            return JobOutcome(found["key"], found["measured"], tuple(found["built"]), found["error"])
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def find_successful(self, keys: Iterable[str]) -> dict[str, JobOutcome]:
        """Return the outcomes, by key, of the jobs that were done without an error."""
        found = {key: self.read(key) for key in keys}
        return {key: outcome for key, outcome in found.items() if outcome is not None and not outcome.error}

    def write(self, outcome: JobOutcome, about: Mapping[str, Any]) -> None:
        """Write an outcome, with JSON values `about` its job, atomically. Raises OutputError."""
        trace = self.out / ERRORS / f"{outcome.key}.txt"
        if outcome.trace:
            write_text(trace, outcome.trace)
        elif not outcome.error:
            trace.unlink(missing_ok=True)
        values = {name: value for name, value in asdict(outcome).items() if name != "trace"}
        write_json(self._locate_row(outcome.key), {**values, **about})

    def tidy(self) -> None:
        """Remove unfinished files of a process that was killed."""
        for name in (ROWS, ERRORS):
            remove_abandoned(self.out / name)

    def _locate_row(self, key: str) -> Path:
        return self.out / ROWS / f"{key}.json"


def resume_jobs(
    title: str, queue: Sequence[QueuedJob], out: Path, workers: Workers, progress: Progress | None = None
) -> tuple[dict[str, JobOutcome], list[str]]:
    """Do the jobs of a queue that have no row in `out`, and write each row there when the job ends.

    Return all outcomes by key, and the keys of the jobs done now. The row of a failed job states the error, and the
    next call tries the job again. Raises TactileLocError if a row cannot be written, or if the workers do not start.
    """
    kept, progress = FinishedJobs(out), progress or Progress()
    kept.tidy()
    outcomes = kept.find_successful(one.job.key for one in queue)
    missing = {one.job.key: one for one in queue if one.job.key not in outcomes}
    if not missing:
        return outcomes, []
    failed, before = 0, len(outcomes)
    running = workers.run_jobs([one.job for one in missing.values()], {k: one.subject for k, one in missing.items()})
    with progress.task(title, before + len(missing)) as advance, closing(running):
        advance(before)
        for number, outcome in enumerate(running, start=1):
            one = missing[outcome.key]
            kept.write(outcome, one.about)
            outcomes[outcome.key] = outcome
            failed += bool(outcome.error)
            note = f"{one.note} ({failed} failed)" if failed else one.note
            log.info("%s: %d jobs are finished; the last was %s.", title, number, note)
            progress.note(note)
            advance(1)
    return outcomes, list(missing)
