"""A benchmark run: it prepares the sensors, does the missing jobs, and keeps the rows of every finished job."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tactile_loc.benchmark.examples import describe_libraries, make_sensor
from tactile_loc.benchmark.job import LocatingJob, Row
from tactile_loc.benchmark.suite import Entry, Suite, create
from tactile_loc.core.errors import MissingLibraryError, TactileLocError
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.progress import Progress
from tactile_loc.core.slots.benchmarking import RecordedSource, TouchSource
from tactile_loc.io.config import ObjectConfig
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.store.files import (
    lock_folder,
    read_json,
    remove_abandoned,
    require_writable,
    write_atomically,
    write_json,
)
from tactile_loc.store.keys import write_canonical_json
from tactile_loc.store.store import StageStore
from tactile_loc.sweeps.sweep import Workers
from tactile_loc.sweeps.workers import BuildJournal, Outcome

ROW_VERSION = 1  # increase it if the same method gets other rows
SENSOR_VERSION = 1  # increase it if the same source gets another sensor
KEY_DIGITS = 16
ROWS, ERRORS, SENSORS = "rows", "errors", "benchmark-sensors"

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PreparedSource:
    """A source with its prepared sensor and its objects, or the `problem` why it cannot be used."""

    entry: Entry
    table: Mapping[str, Any] = field(default_factory=dict)
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    problem: str = ""
    libraries: Mapping[str, str] = field(default_factory=dict)
    licence: str = ""
    recorded: bool = False


@dataclass(frozen=True, eq=False)
class Cell:
    """One job, and its outcome when it is done."""

    source: PreparedSource
    object: str
    method: Entry
    job: LocatingJob
    outcome: Outcome | None = None

    @property
    def name(self) -> str:
        """The method, the object and the source, for messages."""
        return f"{self.method.label} on {self.object} ({self.source.entry.label})"

    @property
    def error(self) -> str:
        """The error with which the job ended, in one sentence; "" without an error."""
        return self.outcome.error if self.outcome else ""

    @property
    def rows(self) -> list[Row]:
        """The rows of a finished job, with the names of the source, the object and the method."""
        measured = (self.outcome and self.outcome.measured) or {}
        names = {"source": self.source.entry.label, "object": self.object, "method": self.method.label}
        rest = {"diameter_m": measured.get("diameter_m"), "prepared_s": measured.get("prepared_s")}
        return [{**names, **row, **rest} for row in measured.get("rows", [])]


@dataclass(frozen=True, eq=False)
class Benchmark:
    """A suite, its prepared sources, and all cells with their outcomes. `done` jobs were done by this call."""

    suite: Suite
    sources: Sequence[PreparedSource]
    cells: Sequence[Cell]
    done: int

    @property
    def rows(self) -> list[Row]:
        """All rows, in the order of sources, objects and methods."""
        return [row for cell in self.cells for row in cell.rows]

    @property
    def failed(self) -> list[Cell]:
        """The cells whose job ended with an error."""
        return [cell for cell in self.cells if cell.error]


def run_benchmark(
    suite: Suite, out: Path, store: Path, workers: Workers, progress: Progress | None = None
) -> Benchmark:
    """Do every job of a suite that has no rows in `out`, and write each job's rows there when it is done.

    A job that fails states its error, and the next call tries it again. A source that cannot be used, for instance
    because its library is missing, has no cells and states its `problem`. All workers share the stage store in the
    folder `store`. Raises TactileLocError for a wrong suite or `out`, before anything runs.
    """
    require_writable(out)
    progress = progress or Progress()
    kept = FinishedJobs(out)
    kept.tidy()
    objects = load_objects(suite.objects, store)
    sources = []
    with progress.task("preparing the sensors", len(suite.source)) as advance:
        for entry in suite.source:
            progress.note(entry.label)
            sources.append(prepare_source(entry, objects, store))
            advance(1)
    cells = list(_list_cells(suite, sources, store))
    outcomes = {cell.job.key: outcome for cell in cells if (outcome := kept.read(cell.job.key)) is not None}
    missing = [cell for cell in _order_for_running(cells, suite) if cell.job.key not in outcomes]
    if missing:
        outcomes |= _run(missing, store, workers, kept, progress, len(outcomes))
    done = [Cell(c.source, c.object, c.method, c.job, outcomes[c.job.key]) for c in cells]
    return Benchmark(suite, sources, done, len(missing))


def load_objects(configs: Sequence[ObjectConfig], store: Path) -> dict[str, ObjectModel]:
    """Return the objects by name. Raises TactileLocError if an object cannot be read."""
    found = {}
    for config in configs:
        obj = load_stored_object(config.path, config.units, config.symmetry, StageStore(store))
        found[obj.name] = obj
    return found


def prepare_source(entry: Entry, objects: Mapping[str, ObjectModel], store: Path) -> PreparedSource:
    """Return a source with its sensor, calibrated now or by an earlier call, or with the problem that prevents this."""
    try:
        source: TouchSource = create("touch-source", entry)
        recorded = isinstance(source, RecordedSource)
        own = source.find_objects() if isinstance(source, RecordedSource) else objects
        table = _prepare_sensor(source, store)
        make_sensor(table)
    except (TactileLocError, ImportError) as error:
        if isinstance(error, ImportError):
            error = MissingLibraryError(f"the source {entry.label!r} needs {error.name}, which is not installed")
        log.warning("the source %r is left out: %s", entry.label, error)
        return PreparedSource(entry, problem=str(error))
    return PreparedSource(entry, table, own, "", describe_libraries(source), source.licence, recorded)


def _prepare_sensor(source: TouchSource, store: Path) -> dict[str, Any]:
    """Return the sensor's table, from the store or prepared now. Its files are complete when its table is written."""
    described = {"version": SENSOR_VERSION, "source": source.describe(), "libraries": describe_libraries(source)}
    folder = store / SENSORS / _hash(described)
    with lock_folder(folder):
        try:
            return dict(read_json(folder / "sensor.json"))
        except (OSError, ValueError, TypeError):
            table = dict(source.prepare_sensor(folder))
            write_json(folder / "sensor.json", table)
            return table


def _list_cells(suite: Suite, sources: Sequence[PreparedSource], store: Path) -> Iterator[Cell]:
    for source in sources:
        for name, obj in source.objects.items():
            for method in suite.method:
                key = _make_key(suite, source, obj, method)
                yield Cell(source, name, method, LocatingJob(key, store, suite, source.entry, method, source.table))


def _make_key(suite: Suite, source: PreparedSource, obj: ObjectModel, method: Entry) -> str:
    """Return a hash of all inputs of a cell's rows; the other sources and methods of the suite do not matter."""
    sensor = make_sensor(source.table)
    component = create("method", method)
    return _hash({
        "version": ROW_VERSION, "tactile-loc": version("tactile-loc"),
        "suite": suite.model_dump(mode="json", include={"touches", "examples", "seed", "press"}),
        "source": create("touch-source", source.entry).describe(), "libraries": dict(source.libraries),
        "sensor": {**sensor.describe(), "geometry": sensor.geometry.describe()},
        "object": {"name": obj.name, **obj.describe()}, "method": component.describe(),
    })  # fmt: skip


def _hash(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(write_canonical_json(values).encode()).hexdigest()[:KEY_DIGITS]


def _order_for_running(cells: Sequence[Cell], suite: Suite) -> list[Cell]:
    """Return the cells in an order in which neighbours seldom need the same touches or models."""
    order = {method.label: number for number, method in enumerate(suite.method)}
    return sorted(cells, key=lambda cell: order[cell.method.label])


def _run(
    missing: Sequence[Cell], store: Path, workers: Workers, kept: FinishedJobs, progress: Progress, before: int
) -> dict[str, Outcome]:
    by_key = {cell.job.key: cell for cell in missing}
    outcomes: dict[str, Outcome] = {}
    jobs = [cell.job for cell in missing]
    objects = {cell.job.key: cell.source.objects[cell.object] for cell in missing}
    with progress.task("benchmark", before + len(jobs)) as advance, closing(workers.run_jobs(jobs, objects)) as running:
        advance(before)
        for outcome in running:
            kept.write(by_key[outcome.key], outcome)
            BuildJournal.forget(store, outcome.key)
            outcomes[outcome.key] = outcome
            last = by_key[outcome.key]
            progress.note(f"{last.source.entry.label}, {last.object}, {last.method.label}")
            advance(1)
    return outcomes


class FinishedJobs:
    """The rows of finished jobs, in the files OUT/rows/KEY.json, and tracebacks, in OUT/errors/KEY.txt."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def read(self, key: str) -> Outcome | None:
        """Return the outcome of this key; None if its file is missing or damaged, or if the job failed."""
        try:
            found = read_json(self._locate(key))
            outcome = Outcome(key, found["measured"], tuple(found["built"]), found["error"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return None if outcome.error else outcome

    def write(self, cell: Cell, outcome: Outcome) -> None:
        """Write an outcome, atomically. Raises OutputError."""
        trace = self.out / ERRORS / f"{outcome.key}.txt"
        if outcome.trace:
            write_atomically(trace, lambda path: path.write_text(outcome.trace, encoding="utf-8"))
        else:
            trace.unlink(missing_ok=True)
        names = {"source": cell.source.entry.label, "object": cell.object, "method": cell.method.label}
        values = {"measured": outcome.measured, "built": list(outcome.built), "error": outcome.error}
        write_json(self._locate(outcome.key), json.loads(json.dumps({**names, **values})))

    def tidy(self) -> None:
        """Remove unfinished files of a benchmark that was killed."""
        for name in (ROWS, ERRORS):
            remove_abandoned(self.out / name)

    def _locate(self, key: str) -> Path:
        return self.out / ROWS / f"{key}.json"
