"""`tactile-loc benchmark`: compare methods on touches from many sources."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tactile_loc.commands import (
    UNEXPECTED,
    Finding,
    Store,
    Takes,
    WorkerOptions,
    declare,
    format_count,
    make_progress,
    say,
    say_table,
    say_written,
)

if TYPE_CHECKING:
    from tactile_loc_benchmark.runner import Benchmark
    from tactile_loc_benchmark.suite import Suite

DEFAULT_OUT, PAGE = Path("benchmark"), "report.html"

SuiteName = Annotated[str, declare("--suite NAME|FILE.toml", "The suite: quick, standard, full, or a file.")]
Sources = Annotated[
    list[str] | None, declare("--source LABEL,...", "Only these sources of touches; --list shows the labels.")
]
Methods = Annotated[
    list[str] | None, declare("--method LABEL,...", "Only these methods; also the name of a method of a plugin.")
]
Data = Annotated[Path | None, declare("--data FOLDER", "Folder of recorded touches and further meshes.")]
Examples = Annotated[int | None, declare("--examples N", "Examples of each object. Default: the suite's.", min=1)]
Workers = Annotated[WorkerOptions, Takes("workers", "scheduler")]
List = Annotated[bool, declare("--list", "Only list the sources and methods of the suite, with their labels.")]
Report = Annotated[
    bool, declare("--report", "Only write report.html again, from the other files in the folder of --out.")
]
Out = Annotated[Path, declare("--out FOLDER", "Folder of the rows and tables.")]


def benchmark(
    suite: SuiteName = "quick",
    source: Sources = None,
    method: Methods = None,
    data: Data = None,
    examples: Examples = None,
    *,
    workers: Workers,
    list_labels: List = False,
    report: Report = False,
    out: Out = DEFAULT_OUT,
    store: Store = None,
) -> dict[str, Any]:
    """Compare methods on touches from several sources.

    A suite has objects, sources of touches, and methods. Each source draws the same presses. Every method locates the
    objects from one touch and from several (docs/benchmark.md). A source whose library is missing is left out, with the
    reason. After an interruption, the same command resumes.
    """

    from tactile_loc import StageStore, write_page

    from tactile_loc_benchmark.files import read_benchmark, tabulate, write_benchmark
    from tactile_loc_benchmark.page import make_benchmark_page, show_sources
    from tactile_loc_benchmark.runner import run_benchmark
    from tactile_loc_benchmark.suite import Suite

    if report:
        written = write_page(make_benchmark_page(*read_benchmark(out)), out / PAGE)
        say(f"written: {written}")
        return {"out": str(out), "written": [str(written)]}
    chosen = Suite.from_toml(suite, data)
    chosen = chosen.select(source and _split(source), method and _split(method))
    if examples is not None:
        chosen = chosen.model_copy(update={"examples": examples})
    if list_labels:
        return _list_labels(chosen)
    stages = StageStore(store)
    found = run_benchmark(chosen, out, stages.root, workers.choose(out), make_progress())
    results, pictures = found.results, list(show_sources(found, stages))
    files = write_benchmark(out, results, pictures)
    if results.rows:
        say_table(tabulate(results.groups), left=(0, 2))
        files.append(write_page(make_benchmark_page(results, pictures), out / PAGE))
    outcome = _say_outcome(found, out, files)
    if found.failed:
        raise Finding(UNEXPECTED, outcome)
    return outcome


def _split(words: list[str]) -> list[str]:
    return [label.strip() for word in words for label in word.split(",")]


def _list_labels(suite: Suite) -> dict[str, Any]:
    entries = {"source": suite.source, "method": suite.method}
    rows = [[kind, one.label, one.name] for kind, some in entries.items() for one in some]
    say_table([["kind", "label", "name"], *rows], left=3)
    listed = {f"{kind}s": [{"label": one.label, "name": one.name} for one in some] for kind, some in entries.items()}
    return {"suite": suite.name, **listed}


def _say_outcome(found: Benchmark, out: Path, files: list[Path]) -> dict[str, Any]:
    for label, problem in found.results.left_out.items():
        say(f"left out: {label}: {problem}")
    for cell in found.failed:
        say(f"failed: {cell.name}: {cell.error}")
    say(f"{format_count(len(found.cells), 'job')}, {found.done} done now")
    return {
        "suite": found.suite.name,
        "out": str(out),
        "jobs": len(found.cells),
        "done": found.done,
        "failed": len(found.failed),
        "left_out": found.results.left_out,
        "written": say_written(files),
    }
