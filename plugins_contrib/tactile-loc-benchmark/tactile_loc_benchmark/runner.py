"""A benchmark run: it prepares the sensors, does the missing jobs, and keeps the rows of every finished job."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.evaluation.jobs import JobOutcome, QueuedJob, Workers, resume_jobs
from tactile_loc.evaluation.text_tables import require_parquet
from tactile_loc.io.streams.records import read_versions
from tactile_loc.store.files import require_writable
from tactile_loc.store.keys import hash_shortly

from tactile_loc_benchmark.examples import make_sensor
from tactile_loc_benchmark.job import LocatingJob, Row, describe_code
from tactile_loc_benchmark.prepare import (
    PreparedMethod,
    PreparedSource,
    load_objects,
    prepare_method,
    prepare_source,
)
from tactile_loc_benchmark.results import Results
from tactile_loc_benchmark.suite import Suite

ROW_VERSION = 2  # increase it if the same method gets other rows


@dataclass(frozen=True, eq=False)
class Cell:
    """One job, and its outcome when it is done."""

    source: PreparedSource
    object: str
    method: PreparedMethod
    job: LocatingJob
    outcome: JobOutcome | None = None

    @property
    def names(self) -> dict[str, str]:
        """The labels of the source and the method, and the name of the object."""
        return {"source": self.source.entry.label, "object": self.object, "method": self.method.entry.label}

    @property
    def name(self) -> str:
        """The method, the object and the source, for messages."""
        return "{method} on {object} ({source})".format_map(self.names)

    @property
    def error(self) -> str:
        """The error with which the job ended, in one sentence; "" without an error."""
        return self.outcome.error if self.outcome else ""

    @property
    def rows(self) -> list[Row]:
        """The rows of a finished job, with the names of the source, the object and the method."""
        measured = (self.outcome and self.outcome.measured) or {}
        common = {name: measured.get(name) for name in ("diameter_m", "prepared_s")}
        return [{**self.names, **row, **common} for row in measured.get("rows", [])]


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
            [one.describe_use(self.suite) for one in self.sources],
            [one.describe_use() for one in self.methods],
            [row for cell in self.cells for row in cell.rows],
            [{**cell.names, "error": cell.error} for cell in self.failed],
            read_versions(),
            datetime.now(UTC).isoformat(timespec="seconds"),
        )

    @property
    def failed(self) -> list[Cell]:
        """The cells whose job ended with an error."""
        return [cell for cell in self.cells if cell.error]

    @property
    def left_out(self) -> dict[str, str]:
        """The sources and methods that cannot be used, by label, with their problems."""
        return find_problems(self.sources, self.methods)


def find_problems(sources: Sequence[PreparedSource], methods: Sequence[PreparedMethod]) -> dict[str, str]:
    """Return the problems of the sources and methods that cannot be used, by label."""
    of_sources = {one.entry.label: one.problem for one in sources if one.problem}
    return of_sources | {one.entry.label: one.problem for one in methods if one.problem}


def run_benchmark(
    suite: Suite, out: Path, store: Path, workers: Workers, progress: Progress | None = None
) -> Benchmark:
    """Do every job of a suite that has no rows in `out`, and write each job's rows there when it is done.

    A job that fails states its error, and the next call tries it again. A source or method that cannot be used, for
    instance because its library is missing, has no cells and states its `problem`. All workers share the stage store in
    the folder `store`. Raises TactileLocError for a wrong suite or `out`, or if nothing can be used, before any job.
    """
    require_parquet("a benchmark")
    require_writable(out)
    progress = progress or Progress()
    sources, methods = _prepare(suite, store, progress)
    cells = list(_list_cells(suite, sources, methods, store))
    if not cells:
        problems = "; ".join(f"{label}: {why}" for label, why in find_problems(sources, methods).items())
        raise ConfigError(f"the suite {suite.name!r} has no source and method that can be used: {problems}")
    queue = [
        QueuedJob(cell.job, cell.source.objects[cell.object], cell.name, cell.names)
        for cell in _order_for_running(cells)
    ]
    outcomes, done = resume_jobs("benchmark", queue, out, workers, progress)
    ended = [dataclasses.replace(cell, outcome=outcomes[cell.job.key]) for cell in cells]
    return Benchmark(suite, sources, methods, ended, done)


def _prepare(suite: Suite, store: Path, progress: Progress) -> tuple[list[PreparedSource], list[PreparedMethod]]:
    objects = load_objects(suite.objects, store)
    methods = [prepare_method(entry) for entry in suite.method]
    sources = []
    with progress.task("preparing the sensors", len(suite.source)) as advance:
        for entry in suite.source:
            progress.note(entry.label)
            sources.append(prepare_source(entry, objects, store, suite.data))
            advance(1)
    return sources, methods


def _list_cells(
    suite: Suite, sources: Sequence[PreparedSource], methods: Sequence[PreparedMethod], store: Path
) -> Iterator[Cell]:
    for source in sources:
        for name, obj in source.objects.items():
            for method in methods:
                if not method.problem:
                    code = describe_code(source.entry, method.entry)
                    key = _make_key(suite, source, obj, method, code)
                    job = LocatingJob(key, store, suite, source.entry, method.entry, source.table, code)
                    yield Cell(source, name, method, job)


def _make_key(
    suite: Suite, source: PreparedSource, obj: ObjectModel, method: PreparedMethod, code: Mapping[str, str]
) -> str:
    """Return a hash of all inputs of a cell's rows; the other sources and methods of the suite do not matter."""
    sensor = make_sensor(source.table)
    return hash_shortly({
        "version": ROW_VERSION, "tactile-loc": version("tactile-loc"), "suite": suite.describe_protocol(),
        "source": source.described, "method": method.described,
        "libraries": {**source.libraries, **method.libraries}, "code": code,
        "sensor": {**sensor.describe(), "geometry": sensor.geometry.describe()},
        "object": {"name": obj.name, **obj.describe()},
    })  # fmt: skip


def _order_for_running(cells: Sequence[Cell]) -> list[Cell]:
    """Return the cells in an order in which neighbours seldom need the same touches or models."""
    order = {label: number for number, label in enumerate(dict.fromkeys(cell.names["method"] for cell in cells))}
    return sorted(cells, key=lambda cell: order[cell.names["method"]])
