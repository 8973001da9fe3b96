"""A benchmark run: it prepares the sensors, does the missing jobs, and keeps the rows of every finished job."""

import dataclasses
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tactile_loc import QueuedJob, resume_jobs
from tactile_loc.plugin import ConfigError, ObjectModel, Progress

from tactile_loc_benchmark.examples import describe_libraries, make_sensor
from tactile_loc_benchmark.job import LocatingJob, Row, describe_code
from tactile_loc_benchmark.prepare import PreparedMethod, PreparedSource, load_objects, prepare_method, prepare_source
from tactile_loc_benchmark.results import Results, find_problems
from tactile_loc_benchmark.suite import Suite, hash_shortly

LIBRARIES = ("tactile-loc", "tactile-loc-benchmark", "numpy", "numba", "scipy", "trimesh", "open3d-cpu", "open3d")
ROW_VERSION = 3  # increase it if the same method gets other rows


@dataclass(frozen=True, eq=False)
class Cell:
    """One job, and when it is done, what it measured or the `error` with which it ended, in one sentence."""

    source: PreparedSource
    object: str
    method: PreparedMethod
    job: LocatingJob
    measured: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""

    @property
    def names(self) -> dict[str, str]:
        """The labels of the source and the method, and the name of the object."""
        return {"source": self.source.entry.label, "object": self.object, "method": self.method.entry.label}

    @property
    def name(self) -> str:
        """The method, the object and the source, for messages."""
        return "{method} on {object} ({source})".format_map(self.names)

    @property
    def rows(self) -> list[Row]:
        """The rows of a finished job, with the names of the source, the object and the method."""
        common = {name: self.measured.get(name) for name in ("diameter_m", "prepared_s")}
        return [{**self.names, **row, **common} for row in self.measured.get("rows", [])]


@dataclass(frozen=True, eq=False)
class Benchmark:
    """A suite, its prepared sources and methods, and all cells with their outcomes. This call did `done` jobs."""

    suite: Suite
    sources: Sequence[PreparedSource]
    methods: Sequence[PreparedMethod]
    cells: Sequence[Cell]
    done: int

    @cached_property
    def results(self) -> Results:
        """The rows and failures, with what the files state about the sources and methods."""
        return Results(
            self.suite,
            [one.used for one in self.sources],
            [one.used for one in self.methods],
            [row for cell in self.cells for row in cell.rows],
            [{**cell.names, "error": cell.error} for cell in self.failed],
            {"python": platform.python_version(), **describe_libraries(LIBRARIES)},
            datetime.now(UTC).isoformat(timespec="seconds"),
        )

    @property
    def failed(self) -> list[Cell]:
        """The cells whose job ended with an error."""
        return [cell for cell in self.cells if cell.error]


def run_benchmark(suite: Suite, out: Path, store: Path, workers: Any, progress: Progress | None = None) -> Benchmark:
    """Do every job of a suite that has no rows in `out`, and write each job's rows there when it is done.

    `workers` are `LocalWorkers`, or others that `resume_jobs` takes. They share the stage store in the folder `store`.
    A job that fails states its error, and the next call tries it again. A source or method that cannot be used, for
    instance because its library is missing, has no cells and states its problem. Raises TactileLocError for a wrong
    suite or `out`, or if nothing can be used, before any job.
    """
    with suppress(FileExistsError):
        out.mkdir(parents=True)
    if not out.is_dir() or not os.access(out, os.W_OK):
        raise ConfigError(f"{out} is not a folder that can be written to; choose another `out`")
    progress = progress or Progress()
    sources, methods = _prepare(suite, store, progress)
    cells = list(_list_cells(suite, sources, methods, store))
    if not cells:
        left_out = find_problems([*(source.used for source in sources), *(method.used for method in methods)])
        problems = "; ".join(f"{label}: {why}" for label, why in left_out.items())
        raise ConfigError(f"the suite {suite.name!r} has no source and method that can be used: {problems}")
    order = [method.entry.label for method in methods]  # so neighbours seldom need the same touches or models
    queue = [
        QueuedJob(cell.job, cell.source.objects[cell.object], cell.name, cell.names)
        for cell in sorted(cells, key=lambda cell: order.index(cell.method.entry.label))
    ]
    outcomes, done = resume_jobs("benchmark", queue, out, workers, progress)
    ended = []
    for cell in cells:
        outcome = outcomes[cell.job.key]
        ended.append(dataclasses.replace(cell, measured=outcome.measured or {}, error=outcome.error))
    return Benchmark(suite, sources, methods, ended, len(done))


def _prepare(suite: Suite, store: Path, progress: Progress) -> tuple[list[PreparedSource], list[PreparedMethod]]:
    objects = load_objects(suite.objects)
    methods = [prepare_method(entry) for entry in suite.method]
    sources = []
    with progress.task("preparing the sensors", len(suite.source)) as advance:
        for entry in suite.source:
            progress.note(entry.label)
            sources.append(prepare_source(entry, objects, suite, store))
            advance(1)
    return sources, methods


def _list_cells(
    suite: Suite, sources: Sequence[PreparedSource], methods: Sequence[PreparedMethod], store: Path
) -> Iterator[Cell]:
    for source in sources:
        for name, obj in source.objects.items():
            for method in methods:
                if not method.used.problem:
                    code = describe_code(source.entry, method.entry)
                    key = _make_key(suite, source, obj, method, code)
                    job = LocatingJob(key, store, suite, source.entry, method.entry, source.table, code)
                    yield Cell(source, name, method, job)


def _make_key(
    suite: Suite, source: PreparedSource, obj: ObjectModel, method: PreparedMethod, code: Mapping[str, str]
) -> str:
    """Return a hash of all inputs of a cell's rows; the other sources and methods of the suite do not matter."""
    sensor = make_sensor(source.table)
    return hash_shortly(
        {
            "version": ROW_VERSION,
            "tactile-loc": version("tactile-loc"),
            "suite": suite.describe_protocol(),
            "source": source.described,
            "method": method.described,
            "libraries": {**source.used.libraries, **method.used.libraries},
            "code": code,
            "sensor": {**sensor.describe(), "geometry": sensor.geometry.describe()},
            "object": {"name": obj.name, **obj.describe()},
        }
    )
