"""Local worker processes. One that dies costs the combination it was at a try, and nothing else."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path
from typing import IO, Any

from tactile_loc.core.errors import OutputError
from tactile_loc.core.objects import ObjectModel
from tactile_loc.sweeps.work import Job, Outcome

log = logging.getLogger(__name__)

TRIES = 3  # of a combination whose worker dies
END_S = 15.0  # until a worker that does not end is killed
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class LocalWorkers:
    """So many processes of this machine, each with so many threads; what they write to the terminal goes to `log`."""

    workers: int
    threads: int
    log: Path

    def outcomes(self, jobs: Sequence[Job], objects: Mapping[str, ObjectModel]) -> Generator[Outcome, None, None]:
        """Yield the outcome of every job as it ends; `objects` holds each job's object by the job's key.

        However the iteration ends, so do the workers. Raises OutputError when the log cannot be written.
        """
        left = deque((job, 1) for job in jobs)
        with ExitStack() as stack:
            crew = stack.enter_context(_Crew(self, stack.enter_context(_open(self.log))))
            while left or crew.busy:
                while left and len(crew.busy) < self.workers:
                    job, attempt = left.popleft()
                    crew.give(job, objects[job.key], attempt)
                for job, attempt, outcome in crew.ended():
                    if outcome is None and attempt < TRIES:
                        left.append((job, attempt + 1))
                    else:
                        yield outcome or Outcome(job.key, None, error=crew.why(self.log))


class _Crew:
    """The processes: some at work (`busy`), others waiting for it."""

    def __init__(self, workers: LocalWorkers, output: IO[bytes]) -> None:
        self.busy: dict[Any, tuple[_Worker, Job, int]] = {}
        self._idle: list[_Worker] = []
        self._output = output
        self._environment = {**os.environ, **dict.fromkeys(THREADS, str(workers.threads))}
        self._death = ""

    def __enter__(self) -> _Crew:
        return self

    def __exit__(self, *_: object) -> None:
        crew = [worker for worker, _, _ in self.busy.values()] + self._idle
        for worker in crew:
            worker.connection.close()
        for worker in crew:
            worker.end()

    def give(self, job: Job, obj: ObjectModel, attempt: int) -> None:
        """Set a waiting or a new worker to a job."""
        worker = self._idle.pop() if self._idle else _Worker(self._environment, self._output)
        self.busy[worker.connection] = (worker, job, attempt)
        with suppress(OSError):  # one that has died meanwhile is noticed by `ended`
            worker.connection.send((job, obj))

    def ended(self) -> Iterator[tuple[Job, int, Outcome | None]]:
        """Wait, and yield jobs that ended with their outcome; None where the worker died."""
        for connection in wait(list(self.busy)):
            worker, job, attempt = self.busy.pop(connection)
            try:
                outcome = worker.connection.recv()
                self._idle.append(worker)
            except (EOFError, OSError):
                self._death = worker.death()
                outcome = None
                log.info("A worker %s at %s, for the %d. time.", self._death, job.key, attempt)
            yield job, attempt, outcome

    def why(self, path: Path) -> str:
        """Say how the last worker died."""
        return f"its worker {self._death}, {TRIES} times; perhaps there is too little memory, see {path}"


class _Worker:
    """One process, and the connection to it. A session of its own keeps the terminal's Ctrl-C from it."""

    def __init__(self, environment: Mapping[str, str], output: IO[bytes]) -> None:
        self.connection, theirs = Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tactile_loc.sweeps.worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()], env=environment, start_new_session=True,
                stdin=subprocess.DEVNULL, stdout=output, stderr=output,
            )  # fmt: skip

    def death(self) -> str:
        """Wait for the end of a process that has closed its connection, and say how it came."""
        self.connection.close()
        code = self.end()
        return f"was killed ({signal.Signals(-code).name})" if code < 0 else f"ended with exit code {code}"

    def end(self) -> int:
        """Wait for the process, whose connection is closed, and return its exit code; kill it if it does not end."""
        try:
            return self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()


def _open(path: Path) -> IO[bytes]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("ab")
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error}); choose another --out") from error


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
