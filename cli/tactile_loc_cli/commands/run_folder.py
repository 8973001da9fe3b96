"""`tactile-loc run --touch FOLDER`: many touches of one object, one line each."""

from __future__ import annotations

import csv
import io
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_loc.core.geometry import axis_angle
from tactile_loc_cli.console import progress, say

if TYPE_CHECKING:
    from tactile_loc.core.sensing import Touch
    from tactile_loc.locate.localizer import Localizer
    from tactile_loc.locate.result import Localization

COLUMNS = ("touch", "probability", "fit", "x_mm", "y_mm", "z_mm", "turn_deg", "axis_x", "axis_y", "axis_z", "says")
TOGETHER = 32  # touches read and located at once

logger = logging.getLogger(__name__)


def run_folder(
    localizer: Localizer, folder: Path, press_depth_m: float | None, out: Path, pictures: bool
) -> dict[str, Any]:
    """Locate every touch of a folder or pattern, in the order of names; what cannot be is a line with its reason.

    Writes results.csv and, a folder a touch, result.json and, if asked for, result.png; returns what each came to, and
    the paths. Raises TouchError when the folder holds no touch or none can be located.
    """
    from tactile_loc.core.errors import TouchError
    from tactile_loc.store.files import write_atomically

    files = _touch_files(folder)
    rows: list[dict[str, Any]] = []
    results: list[dict[str, Any]] = []
    with progress().task(f"locating the touches of {folder}", len(files)) as advance:
        for first in range(0, len(files), TOGETHER):
            some = files[first : first + TOGETHER]
            for row, localization in _located(localizer, some, press_depth_m):
                rows.append(row)
                if localization is not None:
                    _write(localizer, localization, out / Path(row["touch"]).stem, pictures)
                results.append(_result(row, localization, out))
            advance(len(some))
    write_atomically(out / "results.csv", lambda path: path.write_text(_csv(rows), encoding="utf-8"))
    failed = [row for row in rows if row["says"]]
    _say(rows)
    say(f"located: {len(rows) - len(failed)} of {len(rows)}; written: {out / 'results.csv'}, and a folder a touch")
    for row in failed:
        logger.warning("%s", row["says"])
    if len(failed) == len(rows):
        raise TouchError(f"no touch of {folder} can be located; the first: {failed[0]['says']}")
    return {"located": len(rows) - len(failed), "touches": results, "written": [str(out / "results.csv")]}


def is_many(path: Path) -> bool:
    """Tell whether a path means many touches: a folder, or a pattern such as folder/*.png."""
    return path.is_dir() or ("*" in path.name and not path.exists())


def _touch_files(folder: Path) -> list[Path]:
    from tactile_loc.core.errors import TouchError
    from tactile_loc.io.images import IMAGE_SUFFIXES

    known = {".npz", ".npy", *IMAGE_SUFFIXES}
    if folder.is_dir():
        # of what `simulate` wrote, the contact shapes: the images show the same touches, and a sheet of all of them
        simulated = (folder / "poses.json").is_file()
        candidates = folder.glob("*.npz") if simulated else folder.iterdir()
    else:
        candidates = folder.parent.glob(folder.name)
    files = sorted(path for path in candidates if path.suffix.lower() in known and path.is_file())
    if not files:
        raise TouchError(f"{folder} holds no touch; give files {', '.join(sorted(known))}")
    return files


def _located(
    localizer: Localizer, files: list[Path], press_depth_m: float | None
) -> Iterator[tuple[dict[str, Any], Localization | None]]:
    from tactile_loc.core.errors import TactileLocError

    touches: dict[Path, Touch] = {}
    reasons: dict[Path, str] = {}
    for path in files:
        try:
            touches[path] = localizer.read_touch(path, localizer.config.touch.unit, press_depth_m)
        except TactileLocError as error:
            reasons[path] = " ".join(str(error).split())
    found = dict(zip(touches, localizer.localize_many(list(touches.values())), strict=True))
    for path in files:
        if path in found:
            yield _row(path, found[path]), found[path]
        else:
            yield {"touch": path.name, "says": reasons[path]}, None


def _row(path: Path, localization: Localization) -> dict[str, Any]:
    best = localization.best
    T = best.T_sensor_object
    angle_deg, axis = axis_angle(T[:3, :3])
    places = zip(("x_mm", "y_mm", "z_mm"), 1e3 * T[:3, 3], strict=True)
    axes = zip(("axis_x", "axis_y", "axis_z"), axis, strict=True)
    return {
        "touch": path.name, "probability": f"{best.probability:.4f}", "imprint_iou": f"{best.imprint_iou:.3f}",
        **{name: f"{value:.3f}" for name, value in places}, "turn_deg": f"{angle_deg:.2f}",
        **{name: f"{value:.4f}" for name, value in axes}, "says": "",
    }  # fmt: skip


def _result(row: dict[str, Any], localization: Localization | None, out: Path) -> dict[str, Any]:
    """What became of one touch, as JSON values in SI units."""
    if localization is None:
        return {"touch": row["touch"], "error": row["says"]}
    best = localization.best
    return {
        "touch": row["touch"], "result": str(out / Path(row["touch"]).stem / "result.json"),
        "probability": best.probability, "imprint_iou": best.imprint_iou,
        "T_sensor_object": best.T_sensor_object.tolist(),
    }  # fmt: skip


def _write(localizer: Localizer, localization: Localization, folder: Path, pictures: bool) -> None:
    from tactile_loc.drawing.pictures import draw_result, save_figure
    from tactile_loc.locate.result_json import result_record, write_result
    from tactile_loc_cli.tables import title

    record = result_record(localizer, localization)
    write_result(folder / "result.json", record)
    if pictures:
        save_figure(folder / "result.png", draw_result(localization, localizer.scene, title(record)))


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _say(rows: list[dict[str, Any]]) -> None:
    """One line a touch: its pose, or what is wrong with it."""
    width = max(len(row["touch"]) for row in rows)
    say(f"{'touch':<{width}}  prob. %  fit %     x mm     y mm     z mm  turn deg  about axis")
    for row in rows:
        if row["says"]:
            say(f"{row['touch']:<{width}}  {row['says']}")
            continue
        share = f"{100 * float(row['probability']):7.1f}  {100 * float(row['fit']):5.0f}"
        place = "".join(f"{float(row[name]):9.2f}" for name in ("x_mm", "y_mm", "z_mm"))
        axis = ", ".join(f"{float(row[name]):.3f}" for name in ("axis_x", "axis_y", "axis_z"))
        say(f"{row['touch']:<{width}}  {share}{place}{float(row['turn_deg']):10.1f}  ({axis})")
