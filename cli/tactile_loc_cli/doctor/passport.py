"""The checks of a calibrated sensor: their table and their page."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tactile_loc.evaluation.sensor_damage import measure_damage
from tactile_loc.io.images import IMAGE_SUFFIXES, read_photo
from tactile_loc.reports.report import write_page
from tactile_loc.reports.tasks import make_passport_page
from tactile_loc.sensors.calibration.folder import read_calibration
from tactile_loc.sensors.calibration.layouts import SHEET
from tactile_loc.sensors.reading.passport import Examination, SensorFinding, examine_photos
from tactile_loc.store.files import list_files, require_writable
from tactile_loc.store.store import StageStore
from tactile_loc_cli import failures
from tactile_loc_cli.console import say, say_table

PAGE = "passport.html"


def check_sensor(
    folder: Path, photos: Sequence[Path], zero: Path | None, out: Path, store: Path | None
) -> dict[str, Any]:
    """Check a calibrated sensor on photos of presses, and write its page. Raises Finding if it has a fault."""
    require_writable(out)
    sensor = read_calibration(folder, zero)
    seen = sensor.examine([read_photo(path) for path in _list_photos(photos)])
    findings = examine_photos(seen)
    damage = measure_damage(sensor, seen, findings, StageStore(store))
    say_table([_list_cells(one, seen) for one in findings], left=2)
    page = write_page(make_passport_page(folder.name, seen, findings, damage), out / PAGE)
    errors = {one.finding.check.name: one.error_m for one in damage if one.finding is not None}
    faults = {one.check.name: one.says for one in findings if one.is_fault}
    say()
    for name, says in faults.items():
        error = f"; it would cause a pose error of {1e3 * errors[name]:.2f} mm" if name in errors else ""
        say(f"{says}{error}")
    say(f"written: {page}")
    values = {one.check.name: one.value for one in findings if one.value == one.value}
    result = {"sensor": str(folder), "photos": len(seen.photos), "values": values, "faults": faults, "page": str(page)}
    result["pose_errors_m"] = {name: error for name, error in errors.items() if error < float("inf")}
    if faults:
        raise failures.Finding(failures.UNEXPECTED, result)
    say("no fault found")
    return result


def _list_photos(paths: Sequence[Path]) -> list[Path]:
    """Return the given photos and those in given folders, in order."""
    found = [list_files(path, IMAGE_SUFFIXES) if os.path.isdir(path) else [path] for path in paths]
    return [path for part in found for path in part if path.name != SHEET]


def _list_cells(one: SensorFinding, seen: Examination) -> list[str]:
    scale, unit = (1e3, "mm") if one.check.unit == "m" else (1.0, one.check.unit)
    if one.value != one.value:
        return ["-", one.check.name, "not judged"]
    value, limit = (f"{scale * number:.3g}" for number in (one.value, one.check.find_limit(seen)))
    return ["FAULT" if one.is_fault else "ok", one.check.name, f"{value} {unit}".strip() + f", limit {limit}"]
