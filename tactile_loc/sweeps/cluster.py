"""Workers of a Dask cluster. One that dies costs nothing: Dask gives what it had to others."""

from __future__ import annotations

import logging
import re
import uuid
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

from tactile_loc.core.errors import MissingLibraryError, TactileLocError
from tactile_loc.core.objects import ObjectModel
from tactile_loc.sweeps.work import Job, Outcome, work

log = logging.getLogger(__name__)

RETRIES = 2  # of a task that fails for another reason than its combination, such as a broken connection
CONNECT_S = 10
_LOGS = ("client", "comm", "core")
_ADDRESS = re.compile(r"(tcp|tls|ucx|wss?)://.+")


class ClusterError(TactileLocError):
    """A Dask cluster cannot be reached, or is gone."""


@dataclass(frozen=True)
class DaskWorkers:
    """The workers of the Dask scheduler at an address such as tcp://host:8786."""

    address: str

    def outcomes(self, jobs: Sequence[Job], objects: Mapping[str, ObjectModel]) -> Generator[Outcome, None, None]:
        """Yield the outcome of every job as it ends; `objects` holds each job's object by the job's key.

        A job that Dask gives up, because workers died while they had it, may have been only near the one that kills
        them: it is tried once more after the others, alone. Raises MissingLibraryError or ClusterError.
        """
        with _connected(self.address) as client:
            if not client.scheduler_info()["workers"]:
                log.warning("the Dask cluster at %s has no workers yet; waiting for some", self.address)
            given_up = []
            with closing(_run(client, self.address, jobs, objects)) as running:
                for job, outcome in running:
                    if outcome is None:
                        given_up.append(job)
                    else:
                        yield outcome
            for one in given_up:
                with closing(_run(client, self.address, [one], objects)) as running:
                    for job, outcome in running:
                        yield outcome or Outcome(job.key, None, error=_KILLED)


_KILLED = "its Dask workers died, several times; perhaps they have too little memory, see their logs"


def _run(
    client: Any, address: str, jobs: Sequence[Job], objects: Mapping[str, ObjectModel]
) -> Generator[tuple[Job, Outcome | None], None, None]:
    """Submit jobs and yield each with its outcome; None where too many workers died. Cancels them all at the end."""
    from distributed import as_completed

    token = uuid.uuid4().hex[:8]
    held: dict[str, Any] = {}  # an object is sent once: as the result of a task, which Dask can make again
    futures = {}
    for job in jobs:
        obj = objects[job.key]
        if obj.name not in held:
            held[obj.name] = client.submit(_itself, obj, key=f"object-{obj.name}-{token}")
        name = f"combination-{job.key}-{token}"
        futures[client.submit(work, job, held[obj.name], key=name, retries=RETRIES)] = job
    try:
        for future in as_completed(list(futures), loop=client.loop):
            job = futures.pop(future)
            outcome = _outcome(future, job, address)
            future.release()  # else it would be done again if the worker that holds its result died
            yield job, outcome
    finally:
        client.cancel(list(futures))


def _outcome(future: Any, job: Job, address: str) -> Outcome | None:
    from distributed import KilledWorker

    if future.status in ("cancelled", "lost"):
        raise ClusterError(
            f"the Dask scheduler at {address} is gone; what was finished is kept, run the same command again"
        )
    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        return None
    outcome: Outcome = Outcome(job.key, None, error=f"{type(error).__name__}: {error}") if error else future.result()
    return outcome


def _itself(obj: ObjectModel) -> ObjectModel:
    return obj


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """A client, closed at the end. What Dask's own log says of lost connections is said by an error."""
    client = _connect(address)
    dask_log = logging.getLogger("distributed")
    before = {name: dask_log.getChild(name).level for name in _LOGS}
    try:
        for name in before:
            dask_log.getChild(name).setLevel(logging.CRITICAL)
        yield client
    finally:
        client.close()
        for name, level in before.items():
            dask_log.getChild(name).setLevel(level)


def _connect(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingLibraryError(
            "--scheduler needs dask.distributed, which is not installed: pip install 'tactile-loc[sweep]'"
        ) from error
    if not _ADDRESS.fullmatch(address):
        raise ClusterError(f"{address!r} is no address of a Dask scheduler; write it as tcp://host:8786")
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ClusterError(
            f"there is no Dask scheduler at {address} ({type(error).__name__}); check it runs"
        ) from error
