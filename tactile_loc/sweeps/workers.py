"""Workers that do jobs: local processes or a Dask cluster. Dask reassigns the jobs of a dead worker."""

from __future__ import annotations

import itertools
import logging
import os
import re
import signal
import threading
import traceback
import uuid
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from tactile_loc.core.runtime.errors import MissingLibraryError, OutputError, TactileLocError, fold_line
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.sweeps import detached

JOURNALS = "sweep-builds"  # a folder of the store
RETRIES = 2  # repetitions after failures outside the evaluation, such as a broken connection
CONNECT_S = 10
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
LOCAL_FAILURES = 1  # deaths of workers after which a combination is tried again, in each of two rounds
REPLACEMENT_S = 5  # time between two checks of local workers; a worker lost in both is replaced
LOGS = ("distributed", "distributed.client", "tornado.application", "asyncio")  # loggers that Dask uses

_ADDRESS = re.compile(r"(tcp|tls|ucx|wss?)://.+")
# A Dask worker may have several threads, but OpenGL contexts and numba's workqueue allow only one at a time.
_ALONE = threading.Lock()


class ClusterError(TactileLocError):
    """A Dask cluster cannot be reached or started, or has stopped."""


class Named(Protocol):
    """What a job works on, such as an `ObjectModel`. Equal names mean equal values."""

    @property
    def name(self) -> str:
        """The name."""
        ...


Subject = TypeVar("Subject", bound=Named)
Measured = TypeVar("Measured", bound=Named, contravariant=True)


class Job(Protocol[Measured]):
    """Work for one process: it measures one object. A job is pickled, so it holds only plain values.

    `key` identifies the job, and `store` is the folder of the stage store that all workers share.
    """

    @property
    def key(self) -> str:
        """A hash of all inputs of the job."""
        ...

    @property
    def store(self) -> Path:
        """The folder of the stage store."""
        ...

    def measure(self, obj: Measured, store: StageStore, /) -> dict[str, Any]:
        """Return the measured values, as JSON values. Raises TactileLocError if the job is impossible."""
        ...


@dataclass(frozen=True)
class Outcome:
    """The outcome of a job: the values `measured`, or an `error` in one sentence.

    `trace` is the traceback of an unexpected error. `built` has the names, "stage digest", of the stages that were
    built for the job, also by processes that were killed.
    """

    key: str
    measured: dict[str, Any] | None
    built: tuple[str, ...] = ()
    error: str = ""
    trace: str = ""


class BuildJournal(list[StageKey]):
    """The keys of the stages built for a job, also kept in a file of the store until `forget`.

    If the file cannot be written, the list lacks stages built by processes that were killed.
    """

    def __init__(self, store: Path, key: str) -> None:
        super().__init__()
        self._path = _locate_journal(store, key)
        self._earlier: list[str] = []
        with suppress(OSError, UnicodeDecodeError):
            self._earlier = self._path.read_text(encoding="utf-8").splitlines()

    def append(self, key: StageKey) -> None:
        """Record that a stage was built."""
        super().append(key)
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(f"{key}\n")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all stages, "stage digest"; names from killed processes come first."""
        return tuple(dict.fromkeys([*self._earlier, *map(str, self)]))

    @staticmethod
    def forget(store: Path, key: str) -> None:
        """Remove a job's file, after its outcome has been written."""
        with suppress(OSError):
            _locate_journal(store, key).unlink(missing_ok=True)


def _locate_journal(store: Path, key: str) -> Path:
    return store / JOURNALS / f"{key}.txt"


def evaluate_job(job: Job[Subject], obj: Subject) -> Outcome:
    """Do a job on its object. An error is returned in the outcome."""
    with _ALONE:
        store = StageStore(job.store)
        store.built = built = BuildJournal(job.store, job.key)
        measured, error, trace = None, "", ""
        try:
            measured = job.measure(obj, store)
        except TactileLocError as raised:
            error = str(raised)
        except Exception as raised:  # noqa: BLE001 - a component may raise anything
            error, trace = f"{type(raised).__name__}: {raised}", traceback.format_exc()
        return Outcome(job.key, measured, built.names, fold_line(" ".join(error.split())), trace)


Outcomes = Generator[Outcome, None, None]


@dataclass(frozen=True)
class LocalWorkers:
    """Local processes: the number of `workers`, the `threads` of each, and the file `log` for their output."""

    workers: int
    threads: int
    log: Path

    def run_jobs(self, jobs: Sequence[Job[Subject]], objects: Mapping[str, Subject]) -> Outcomes:
        """Yield the outcome of every job when it ends; `objects` maps each job's key to its object.

        The workers end with the iteration. Raises MissingLibraryError, ClusterError, or OutputError if the log cannot
        be written.
        """
        why = f"its worker died each time, perhaps for lack of memory; see {self.log}"
        with _start_cluster(self) as address, _connect(address) as client:
            yield from _run_twice(client, jobs, objects, why, at_once=self.workers)


@dataclass(frozen=True)
class DaskWorkers:
    """The workers of the Dask scheduler at an `address` such as tcp://host:8786."""

    address: str

    def run_jobs(self, jobs: Sequence[Job[Subject]], objects: Mapping[str, Subject]) -> Outcomes:
        """Yield the outcome of every job when it ends; `objects` maps each job's key to its object.

        Raises MissingLibraryError or ClusterError.
        """
        _require_dask()
        if not _ADDRESS.fullmatch(self.address):
            raise ClusterError(
                f"`scheduler` cannot be {self.address!r}; give the address of a Dask scheduler, such as tcp://host:8786"
            )
        why = "its Dask workers died each time, perhaps for lack of memory; see their logs"
        with _redirect_logs(logging.NullHandler()), _connect(self.address) as client:
            if not client.scheduler_info()["workers"]:
                log.warning("the Dask cluster at %s has no workers yet; waiting for them", self.address)
            yield from _run_twice(client, jobs, objects, why)


log = logging.getLogger(__name__)


def count_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run_twice(
    client: Any, jobs: Sequence[Job[Subject]], objects: Mapping[str, Subject], why: str, at_once: int | None = None
) -> Outcomes:
    """Yield the outcome of every job.

    Dask gives up a job if its workers died, but another job may have killed the workers. So each such job is tried once
    more, alone.
    """
    given_up: list[Job[Subject]] = []
    for some in itertools.chain([jobs], ([job] for job in given_up)):
        with closing(_run(client, some, objects, at_once)) as running:
            for job, outcome in running:
                if outcome is not None or some is not jobs:
                    yield outcome or Outcome(job.key, None, error=why)
                else:
                    given_up.append(job)


def _run(
    client: Any, jobs: Sequence[Job[Subject]], objects: Mapping[str, Subject], at_once: int | None
) -> Generator[tuple[Job[Subject], Outcome | None], None, None]:
    """Yield each job with its outcome, or with None if too many workers died. Cancels all jobs at the end.

    At most `at_once` jobs are submitted at a time, so that few jobs are on a worker that dies.
    """
    from distributed import as_completed

    token = uuid.uuid4().hex[:8]
    held: dict[str, Any] = {}  # each object is sent once, as the result of a task that Dask can repeat
    futures: dict[Any, Job[Subject]] = {}
    waiting, running = deque(jobs), as_completed(loop=client.loop)
    try:
        while waiting or futures:
            while waiting and (at_once is None or len(futures) < at_once):
                job = waiting.popleft()
                obj = objects[job.key]
                if obj.name not in held:
                    held[obj.name] = client.submit(_return_object, obj, key=f"object-{obj.name}-{token}")
                name = f"job-{job.key}-{token}"
                future = client.submit(evaluate_job, job, held[obj.name], key=name, retries=RETRIES)
                futures[future] = job
                running.add(future)
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


def _read_outcome(future: Any, job: Job[Any], address: str) -> Outcome | None:
    from distributed import KilledWorker

    if future.status == "cancelled":
        raise ClusterError(
            f"the Dask scheduler at {address} has stopped; finished rows are kept, so run the same command again"
        )
    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        return None
    outcome: Outcome = Outcome(job.key, None, error=f"{type(error).__name__}: {error}") if error else future.result()
    return outcome


def _return_object(obj: Subject) -> Subject:
    return obj


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
def _start_cluster(local: LocalWorkers) -> Iterator[str]:
    """Yield the address of a scheduler in this process, whose workers are separate processes that end with the block.

    Dask's own limits of memory and of time without contact are off: only the operating system kills a worker.
    """
    _require_dask()
    import dask
    from distributed import LocalCluster

    settings = {
        "distributed.scheduler.allowed-failures": LOCAL_FAILURES,
        "distributed.scheduler.worker-ttl": None,
    }
    with (
        _open_log(local.log) as handler,
        _redirect_logs(handler),
        _set_environment(local.threads),
        dask.config.set(settings),
    ):
        try:
            cluster = LocalCluster(
                n_workers=local.workers, threads_per_worker=1, processes=True, memory_limit=0,
                preload=[detached.__name__], env={detached.LOG: str(local.log.absolute())},
                dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False}, silence_logs=False,
            )  # fmt: skip
        except (OSError, RuntimeError) as error:
            raise ClusterError(f"local workers do not start ({error}); see {local.log}") from error
        try:
            with replace_lost_workers(cluster, local.workers):
                yield cluster.scheduler_address
        finally:
            _end(cluster)


@contextmanager
def replace_lost_workers(cluster: Any, count: int) -> Iterator[None]:
    """Keep a local cluster at `count` workers.

    The nanny of a worker that dies starts it again, except if the worker dies while the nanny waits for its start. So a
    combination that kills its workers at once could leave a cluster without workers, and the sweep would wait forever.
    Here, a nanny that had no process in two checks is replaced. Dask's own replacement is off: it would also replace
    workers that start slowly, and Dask counts that as a failure of their jobs.
    """
    import dask
    from tornado.ioloop import PeriodicCallback

    idle: set[Any] = set()  # nannies without a process at the last check

    def replace() -> None:
        nonlocal idle
        now_idle = {nanny for nanny in cluster.workers.values() if nanny.pid is None}
        for name, nanny in list(cluster.workers.items()):
            if nanny in now_idle & idle:
                del cluster.workers[name]
                cluster.loop.add_callback(nanny.close)
        idle = now_idle
        cluster.scale(count)

    check = PeriodicCallback(replace, 1e3 * REPLACEMENT_S)
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"}):
        cluster.loop.add_callback(check.start)
        try:
            yield
        finally:
            cluster.loop.add_callback(check.stop)


def _end(cluster: Any) -> None:
    """Kill the workers, then close the cluster.

    On a busy machine, workers that end by themselves take longer than Dask waits. At this point, the workers hold no
    results, and the store is always consistent.
    """
    for nanny in cluster.workers.values():
        nanny.close_gracefully("the sweep has ended")  # so that Dask does not restart the worker
        if (pid := nanny.pid) is not None:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    with suppress(TimeoutError):
        cluster.close()


@contextmanager
def _set_environment(threads: int) -> Iterator[None]:
    """Set the environment variables with which workers start and restart, such as their number of threads."""
    before = dict(os.environ)
    os.environ.update(dict.fromkeys(THREADS, str(threads)), DASK_LOGGING__DISTRIBUTED="warning")
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def _open_log(path: Path) -> Iterator[logging.Handler]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error}); choose another `out`") from error
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    with closing(handler):
        yield handler


@contextmanager
def _redirect_logs(handler: logging.Handler) -> Iterator[None]:
    """Send Dask's log to a handler, because the errors of the sweep tell the user all that matters."""
    loggers = [logging.getLogger(name) for name in LOGS]
    before = [(logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [handler], False
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
            "workers need dask.distributed, which is not installed: pip install 'tactile-loc[sweep]'"
        ) from error
