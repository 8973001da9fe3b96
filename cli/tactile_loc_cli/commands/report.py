"""`tactile-loc report`: show a result as one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tactile_loc_cli.console import say

Result = Annotated[
    Path,
    typer.Argument(metavar="RESULT", help="Folder written by a command, or the .json file of a result."),
]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="FILE.html", help="Page to write. Default: report.html in the folder.")
]


def report(result: Result, out: Out = None) -> dict[str, Any]:
    """Show a result as one HTML file.

    The result may be a run, an evaluation, a sweep or a benchmark. The file is self-contained and works offline.
    """
    from tactile_loc.benchmark.files import find_benchmark

    if (document := find_benchmark(result)) is not None:
        kind, path, written = "benchmark", document, _write_benchmark_page(document, out)
    else:
        from tactile_loc.reports import find_source, write_report

        source = find_source(result)
        kind, path, written = source.kind, source.path, write_report(source, out)
    say(f"written: {written}")
    return {"kind": kind, "result": str(path), "report": str(written)}


def _write_benchmark_page(document: Path, out: Path | None) -> Path:
    from tactile_loc.benchmark.files import read_benchmark
    from tactile_loc.benchmark.page import make_benchmark_page
    from tactile_loc.reports.report import choose_path, write_page

    path = choose_path(document.parent, out)
    return write_page(make_benchmark_page(*read_benchmark(document)), path)
