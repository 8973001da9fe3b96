"""Small sources and methods, a suite of them, and workers in this process."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from bench_fakes import offer_fakes
from bench_parts import BOX_CORNERS_M, BOX_FACES
from tactile_loc.evaluation.jobs import Job, JobOutcomes, do_job
from tactile_loc.plugin import ObjectModel

from tactile_loc_benchmark.runner import Benchmark, run_benchmark
from tactile_loc_benchmark.suite import Suite


class InProcess:
    """Workers that do the jobs in this process."""

    def run_jobs(self, jobs: Sequence[Job], objects: Mapping[str, ObjectModel]) -> JobOutcomes:
        for job in jobs:
            yield do_job(job, objects[job.key])


@pytest.fixture(autouse=True, scope="module")
def fakes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Offer the components of bench_fakes."""
    with offer_fakes(tmp_path_factory.mktemp("fakes") / "site"):
        yield


@pytest.fixture(scope="session")
def box_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The mesh file of a box, in mm."""
    path = tmp_path_factory.mktemp("mesh") / "brick.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in 1e3 * BOX_CORNERS_M]
    lines += ["f {} {} {}".format(*(k + 1 for k in face)) for face in BOX_FACES]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="session")
def bench_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One stage store for the tests of the benchmark."""
    return tmp_path_factory.mktemp("bench-store")


@pytest.fixture(scope="module")
def make_suite(box_file: Path) -> Callable[..., Suite]:
    """Make a small suite; keywords replace its values."""

    def make(**changes: Any) -> Suite:
        values: dict[str, Any] = {
            "name": "small",
            "summary": "A box",
            "objects": [{"path": str(box_file), "units": "mm", "symmetry": "none"}],
            "touches": [1, 2],
            "examples": 3,
            "seed": 7,
            "source": ["sketch"],
            "method": ["oracle", "guess"],
        }
        return Suite.from_values({**values, **changes}, "small.toml")

    return make


@pytest.fixture(scope="module")
def run_small(
    make_suite: Callable[..., Suite], bench_store: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Benchmark]:
    """Run a small suite in this process; keywords replace its values, or name the folder `out`."""

    def run(out: Path | None = None, store: Path = bench_store, **changes: Any) -> Benchmark:
        return run_benchmark(make_suite(**changes), out or tmp_path_factory.mktemp("out"), store, InProcess())

    return run


@pytest.fixture(scope="module")
def finished(run_small: Callable[..., Benchmark]) -> Benchmark:
    """The small suite with another source, a missing library, and recorded touches; tests must not change it."""
    sources = ["sketch", {"name": "sketch", "label": "shy", "refused": 0.5}, "library-source", "archive"]
    return run_small(source=sources, method=["oracle", "guess", "library-method"])
