"""`tactile-loc next-touch`: choose the next touch with the largest information gain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tactile_loc.core.errors import ResultError
from tactile_loc.store.files import require_writable
from tactile_loc_cli import options
from tactile_loc_cli.console import say_written

DEFAULT_OUT = Path("tactile-loc-next-touch")

Result = Annotated[Path, typer.Argument(metavar="RESULT", help="Folder written by run, or its result.json.")]
Candidates = Annotated[
    Path,
    options.declare(
        "--candidates", "FILE.toml",
        "Approaches: [[approach]] tables, each with a start pose: xyz_mm with rpy_deg, or T_sensor_next in metres "
        "(docs/next-touch.md).",
    ),
]  # fmt: skip
Top = Annotated[int, options.declare("--top", "N", "Number of approaches to show; the file has all of them.")]
Out = Annotated[Path, options.declare("--out", "FOLDER", "Folder of next_touch.json and next_touch.png.")]


def next_touch(
    result: Result, candidates: Candidates, top: Top = 10, out: Out = DEFAULT_OUT, report: options.Report = False
) -> dict[str, Any]:
    """Choose where to touch next.

    The next touch should distinguish the poses that a result lists. For each pose and approach, the command simulates
    the sensor's travel until contact and the contact shape. Approaches are ranked by their expected information per
    cost. The output also names the poses that no approach distinguishes.
    """
    from tactile_loc.drawing.pictures import save_figure
    from tactile_loc.drawing.tasks import draw_next_touch
    from tactile_loc.io.approach_files import read_approaches
    from tactile_loc.io.streams.records import write_record
    from tactile_loc.tasks.next_touch import choose_next_touch as choose
    from tactile_loc.tasks.next_touch_files import make_next_touch_record, read_modes
    from tactile_loc_cli.results import say_next_touch

    modes, T_base_sensor = read_modes(_find_result(result))
    approaches = read_approaches(candidates, T_base_sensor)
    require_writable(out)
    found = choose(modes, approaches)
    record = make_next_touch_record(found)
    say_next_touch(record, top)
    title = f"{record.object}: {len(record.modes)} possible poses, {len(record.ranked)} approaches"
    written = [
        write_record(out / "next_touch.json", record),
        save_figure(out / "next_touch.png", draw_next_touch(found, title)),
    ]
    if report:
        from tactile_loc.reports.report import DEFAULT_NAME, write_page
        from tactile_loc.reports.tasks import make_next_touch_page

        written.append(write_page(make_next_touch_page(record, written[-1]), out / DEFAULT_NAME))
    return {**record.model_dump(mode="json"), "written": say_written(written)}


def _find_result(path: Path) -> Path:
    """Return the result.json of a folder, or the path itself if it is not a folder. Raises ResultError without one."""
    from tactile_loc.reports import find_source

    if not path.is_dir():
        return path
    source = find_source(path)
    if source.kind != "run":
        raise ResultError(f"{path} is the folder of another command; give the folder that run wrote")
    return source.path
