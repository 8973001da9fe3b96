"""The options and the choice of the workers of commands that run many jobs: local processes or a Dask cluster."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc_cli.options import declare

if TYPE_CHECKING:
    from tactile_loc.evaluation.workers import DaskWorkers, LocalWorkers


@dataclass(frozen=True)
class WorkerOptions:
    """The options that choose the workers of a command."""

    workers: Annotated[int | None, declare("--workers N", "Local processes. Default: one for each core.", min=1)] = None
    threads: Annotated[
        int | None, declare("--threads N", "Threads of each local process (OpenMP, numba). Default: 1.", min=1)
    ] = None
    scheduler: Annotated[
        str | None, declare("--scheduler tcp://HOST:PORT", "Run on the workers of this Dask scheduler.")
    ] = None

    def choose(self, out: Path) -> LocalWorkers | DaskWorkers:
        """Return the workers of a scheduler, or local ones whose log is in the folder `out`.

        Raises ConfigError if local processes or threads are given with a scheduler.
        """
        from tactile_loc.evaluation.workers import DaskWorkers, LocalWorkers, count_cores

        if self.scheduler is None:
            return LocalWorkers(self.workers or count_cores(), self.threads or 1, out / "workers.log")
        for flag, value in (("--workers", self.workers), ("--threads", self.threads)):
            if value is not None:
                raise ConfigError(f"{flag} is for local processes; leave it out with --scheduler")
        return DaskWorkers(self.scheduler)
