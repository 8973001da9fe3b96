"""`tactile-loc report`: one HTML file that shows a result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tactile_loc_cli.console import say

Result = Annotated[
    Path,
    typer.Argument(metavar="RESULT", help="The folder that run, evaluate or sweep wrote, or a result's .json file."),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="FILE.html", help="Where the page goes; by default report.html in the folder."),
]


def report(result: Result, out: Out = None) -> dict[str, Any]:
    """Make one HTML file of a result: of a run, an evaluation, several contacts, or a sweep.

    The file holds everything, works offline and can be sent to somebody else.
    """
    from tactile_loc.reports import find_source, write_report

    source = find_source(result)
    written = write_report(source, out)
    say(f"written: {written}")
    return {"kind": source.kind, "result": str(source.path), "report": str(written)}
