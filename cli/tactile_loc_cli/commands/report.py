"""`tactile-loc report`: show a result as one HTML file."""

from pathlib import Path
from typing import Annotated, Any

import typer

from tactile_loc_cli.console import say
from tactile_loc_cli.options import declare

Result = Annotated[
    Path, typer.Argument(metavar="RESULT", help="Folder written by a command, or the .json file of a result.")
]
Out = Annotated[Path | None, declare("--out FILE.html", "Page to write. Default: report.html in the folder.")]


def report(result: Result, out: Out = None) -> dict[str, Any]:
    """Show a result as one HTML file.

    The result may be a run, an evaluation or a sweep. The file is self-contained and works offline.
    """
    from tactile_loc.reports import find_result, write_report
    from tactile_loc.reports.report import KINDS

    document = find_result(result)
    written = write_report(document, out)
    say(f"written: {written}")
    return {"kind": KINDS[document.stem], "result": str(document), "report": str(written)}
