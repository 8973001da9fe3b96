"""Workers that do jobs: processes of this machine, or a Dask cluster. Both do the job of a dead worker again."""

from __future__ import annotations

import faulthandler
import itertools
import logging
import multiprocessing
import os
import re
import signal
import threading
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tactile_loc.core.runtime.errors import MissingLibraryError, OutputError, TactileLocError
from tactile_loc.evaluation.jobs import Job, JobOutcome, JobOutcomes, do_job

RETRIES = 2  # repetitions by Dask after failures outside the job, such as a broken connection
CONNECT_S = 10
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
MOST_DEATHS = 2  # of local workers, after which a job is given up, in each of two rounds
GRACE_S = 1.0  # a dead process needs time until its exit code is known
LOGS = ("distributed", "distributed.client", "tornado.application", "asyncio")  # loggers that Dask uses

_ADDRESS = re.compile(r"(tcp|tls|ucx|wss?)://.+")

log = logging.getLogger(__name__)


class ClusterError(TactileLocError):
    """A Dask cluster cannot be reached, or has stopped."""


Attempts = Generator[tuple[Job, JobOutcome | None], None, None]
"""Jobs, each with its outcome, or with None if its workers died."""


def _try_twice(run: Callable[[Sequence[Job]], Attempts], jobs: Sequence[Job], why: str) -> JobOutcomes:
    """Yield the outcome of every job; `why` is the error of a job whose workers always die.

    Another job may have killed the workers, for instance if it took all memory. So each job whose workers died is tried
    once more, alone.
    """
    given_up: list[Job] = []
    for some in itertools.chain([jobs], ([job] for job in given_up)):
        with closing(run(some)) as running:
            for job, outcome in running:
                if outcome is not None or some is not jobs:
                    yield outcome or JobOutcome(job.key, None, error=why)
                else:
                    given_up.append(job)


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class LocalWorkers:
    """Local processes: the number of `workers`, the `threads` of each, and the file `log` for their output."""

    workers: int
    threads: int
    log: Path

    def run_jobs(self, jobs: Sequence[Job], subjects: Mapping[str, Any]) -> JobOutcomes:
        """Yield the outcome of every job when it ends; `subjects` maps each job's key to its subject.

        The workers end with the iteration. Raises OutputError if the log cannot be written.
        """
        self._write_log("")
        why = f"its worker died each time, perhaps for lack of memory; see {self.log}"
        return _try_twice(lambda some: self._run(some, subjects), jobs, why)

    def _run(self, jobs: Sequence[Job], subjects: Mapping[str, Any]) -> Attempts:
        """Yield each job with its outcome, or with None if MOST_DEATHS of its workers died."""
        waiting, deaths = deque(jobs), dict.fromkeys((job.key for job in jobs), 0)
        pool: dict[Connection, _LocalWorker] = {}
        try:
            while waiting or pool:
                while waiting and len(pool) < self.workers:
                    worker = _LocalWorker.start(self)
                    pool[worker.connection] = worker
                    worker.send(waiting.popleft(), subjects)
                for connection in wait(list(pool)):
                    worker = pool[connection]  # type: ignore[index]
                    outcome, job = worker.receive(), worker.job
                    if outcome is None:
                        deaths[job.key] += 1
                        worker.process.join(GRACE_S)
                        code = worker.end()
                        how = f"signal {-code}" if code < 0 else f"exit code {code}"
                        self._write_log(f"the worker of the job {job.key} died ({how})\n")
                        del pool[worker.connection]
                        if deaths[job.key] < MOST_DEATHS:
                            waiting.appendleft(job)
                            continue
                    elif waiting:
                        worker.send(waiting.popleft(), subjects)
                    else:
                        worker.end()
                        del pool[worker.connection]
                    yield job, outcome
        finally:
            for worker in pool.values():
                worker.end()

    def _write_log(self, text: str) -> None:
        try:
            self.log.parent.mkdir(parents=True, exist_ok=True)
            with self.log.open("a", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise OutputError(
                f"{self.log} cannot be written ({error.strerror or error}); choose another `out`"
            ) from error


class _LocalWorker:
    """A local process that does one job after another, and the job that it does now."""

    def __init__(self, process: Any, connection: Connection) -> None:
        self.process, self.connection = process, connection
        self.job: Any = None
        self._sent: set[str] = set()

    @classmethod
    def start(cls, workers: LocalWorkers) -> _LocalWorker:
        """Start a process, with the threads and the log of `workers`."""
        context = multiprocessing.get_context("spawn")
        ours, its = context.Pipe()
        process = context.Process(target=_do_jobs, args=(its, str(workers.log.absolute())), daemon=True)
        with _set_threads(workers.threads):
            process.start()
        its.close()
        return cls(process, ours)

    def send(self, job: Job, subjects: Mapping[str, Any]) -> None:
        """Send a job; its subject is sent once only. If the process has died, `receive` returns None."""
        subject = subjects[job.key]
        self.job = job
        with suppress(OSError):
            self.connection.send((job, subject.name, None if subject.name in self._sent else subject))
        self._sent.add(subject.name)

    def receive(self) -> JobOutcome | None:
        """Return the outcome of the job; None if the process has died."""
        try:
            outcome: JobOutcome = self.connection.recv()
        except (EOFError, OSError):
            return None
        return outcome

    def end(self) -> int:
        """Kill the process, whose store is always consistent, and return its exit code."""
        self.process.kill()
        self.process.join()
        self.connection.close()
        return int(self.process.exitcode or 0)


def _do_jobs(connection: Connection, log_file: str) -> None:
    """Do the jobs that come through a connection. The output goes to a file; Ctrl-C is for the parent alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    file = os.open(log_file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(file, stream)
    os.close(file)
    faulthandler.enable()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    known: dict[str, Any] = {}
    while True:
        job, name, subject = connection.recv()
        known.setdefault(name, subject)
        connection.send(do_job(job, known[name]))


def _end_with_parent() -> None:
    """Wait until the parent process has ended, then end this process at once."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


@contextmanager
def _set_threads(threads: int) -> Iterator[None]:
    """Set the environment variables that limit the threads of processes started in the block."""
    before = dict(os.environ)
    os.environ.update(dict.fromkeys(THREADS, str(threads)))
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@dataclass(frozen=True)
class DaskWorkers:
    """The workers of the Dask scheduler at an `address` such as tcp://host:8786."""

    address: str

    def run_jobs(self, jobs: Sequence[Job], subjects: Mapping[str, Any]) -> JobOutcomes:
        """Yield the outcome of every job when it ends; `subjects` maps each job's key to its subject.

        Raises MissingLibraryError or ClusterError.
        """
        _require_dask()
        if not _ADDRESS.fullmatch(self.address):
            raise ClusterError(
                f"`scheduler` cannot be {self.address!r}; give the address of a Dask scheduler, such as tcp://host:8786"
            )
        why = "its Dask workers died each time, perhaps for lack of memory; see their logs"
        with _silence_dask(), _connect(self.address) as client:
            if not client.scheduler_info()["workers"]:
                log.warning("the Dask cluster at %s has no workers yet; waiting for them", self.address)
            yield from _try_twice(lambda some: run_on_dask(client, some, subjects), jobs, why)


def run_on_dask(client: Any, jobs: Sequence[Job], subjects: Mapping[str, Any]) -> Attempts:
    """Yield each job with its outcome, or with None if too many workers died. Cancels all jobs at the end."""
    from distributed import as_completed

    token = uuid.uuid4().hex[:8]
    held: dict[str, Any] = {}  # each subject is sent once, as the result of a task that Dask can repeat
    futures: dict[Any, Job] = {}
    running = as_completed(loop=client.loop)
    try:
        for job in jobs:
            subject = subjects[job.key]
            if subject.name not in held:
                held[subject.name] = client.submit(_return_subject, subject, key=f"subject-{subject.name}-{token}")
            name = f"job-{job.key}-{token}"
            future = client.submit(do_job, job, held[subject.name], key=name, retries=RETRIES)
            futures[future] = job
            running.add(future)
        while futures:
            future = next(running)
            if future.status == "lost":  # the worker died after the job had ended, and Dask repeats the job
                running.add(future)
                continue
            job = futures.pop(future)
            outcome = _read_outcome(future, job, client.scheduler.address)
            future.release()  # otherwise Dask repeats the job if the worker with its result dies
            yield job, outcome
    finally:
        client.cancel(list(futures))


def _read_outcome(future: Any, job: Job, address: str) -> JobOutcome | None:
    from distributed import KilledWorker

    if future.status == "cancelled":
        raise ClusterError(
            f"the Dask scheduler at {address} has stopped; finished rows are kept, so run the same command again"
        )
    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        return None
    if error:
        return JobOutcome(job.key, None, error=f"{type(error).__name__}: {error}")
    outcome: JobOutcome = future.result()
    return outcome


def _return_subject(subject: Any) -> Any:
    return subject


@contextmanager
def _connect(address: str) -> Iterator[Any]:
    """Yield a client of the scheduler, and close the client at the end."""
    from distributed import Client

    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ClusterError(
            f"there is no Dask scheduler at {address} ({type(error).__name__}); start it, or correct `scheduler`"
        ) from error
    try:
        yield client
    finally:
        client.close()


@contextmanager
def _silence_dask() -> Iterator[None]:
    """Drop Dask's log, because the errors of the jobs tell the user all that matters."""
    loggers = [logging.getLogger(name) for name in LOGS]
    before = [(logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [logging.NullHandler()], False
    try:
        yield
    finally:
        for logger, (handlers, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate


def _require_dask() -> None:
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise MissingLibraryError(
            "a Dask cluster needs dask.distributed, which is not installed: pip install 'tactile-loc[sweep]'"
        ) from error
