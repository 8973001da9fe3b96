"""Converts public sets of presses of a ball to folders of presses."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.io.csv_tables import read_table
from tactile_loc.io.images import IMAGE_SUFFIXES, read_photo, write_image
from tactile_loc.sensors.calibration.press_table import TABLE, Circles, write_scale, write_table
from tactile_loc.store.arrays import load_npz
from tactile_loc.store.files import list_files, order_as_counted, read_text

HALF = 0.5  # pixel centres are at whole numbers in public sets, and at half integers in tactile-loc


def convert_presses(source: Path, out: Path, format: str, ball_radius_mm: float, mm_per_px: float) -> Path:
    """Convert a set of presses in one of FORMATS to a folder of presses `out`, and return the path of the table.

    The folder gets a sensor file of square pixels, `mm_per_px` mm wide. Circles larger than the ball are reduced: see
    `write_table`. Raises CalibrationError when the set does not match
    its format.
    """
    if format not in FORMATS:
        raise CalibrationError(f"there is no format {format!r}; choose one of {', '.join(FORMATS)}")
    out.mkdir(parents=True, exist_ok=True)
    try:
        found = FORMATS[format](source, out)
        rows = [(image, None if c is None else (c[0] + HALF, c[1] + HALF, c[2])) for image, c in found]
    except (OSError, KeyError, ValueError, IndexError, TypeError, CalibrationError) as error:
        named = getattr(error, "filename", None)
        reason = getattr(error, "strerror", None) or error
        reason = f"{named}: {reason}" if named else reason
        raise CalibrationError(
            f"{source} cannot be read as a set in the format {format} ({reason}); check FOLDER and `format`"
        ) from error
    if all(circle is None for _, circle in rows):
        raise CalibrationError(f"{source} holds no press in the format {format}; check `format`")
    write_scale(out, read_photo(list_files(out, IMAGE_SUFFIXES)[0]).shape[:2], mm_per_px)
    return write_table(out / TABLE, rows, ball_radius_mm, mm_per_px)


def _read_gs_sdk(source: Path, out: Path) -> Circles:
    """Read a gs_sdk set: background.png, and for each press a folder with gelsight.png and label.npz.

    label.npz holds the circle's center and radius.
    """
    yield _copy_image(source / "background.png", out, "background.png"), None
    for label in sorted(source.glob("[!.]*/label.npz"), key=lambda path: order_as_counted(path.parent)):
        values = load_npz(label)
        x, y = map(float, values["center"].ravel())
        circle = (x, y, float(values["radius"].item()))
        yield _copy_image(label.with_name("gelsight.png"), out, f"{label.parent.name}.png"), circle


def _read_taxim(source: Path, out: Path) -> Circles:
    """Read a Taxim set: a data pack (npz) with imgs, f0, touch_center and touch_radius."""
    pack = load_npz(source)
    pack |= {name: pack[name].astype(np.uint8) for name in ("imgs", "f0")}
    yield write_image(out / "background.png", pack["f0"]).name, None
    for number, (image, centre, radius) in enumerate(
        zip(pack["imgs"], pack["touch_center"], pack["touch_radius"], strict=True)
    ):
        yield write_image(out / f"{number:04d}.png", image).name, (float(centre[0]), float(centre[1]), float(radius))


def _read_fots(source: Path, out: Path) -> Circles:
    """Read a FOTS set: gelsight/*.png and csv/annotate.csv (img_names, center_x, center_y, radius).

    The set has no image of the untouched gel.
    """
    for row in read_table(source / "csv" / "annotate.csv", "press", CalibrationError).rows:
        name = Path(row["img_names"]).name
        circle = (float(row["center_x"]), float(row["center_y"]), float(row["radius"]))
        yield _copy_image(source / "gelsight" / name, out, name), circle


def _read_circles(source: Path, out: Path) -> Circles:
    """Read a set with background_real.png or background.png, and a text file of lines `image (x, y) radius`."""
    for name in ("background.png", "background_real.png"):
        if (source / name).is_file():
            yield _copy_image(source / name, out, name), None
    tables = sorted(source.glob("labels*.txt"))
    if len(tables) != 1:
        raise ValueError(f"there are {len(tables)} files labels*.txt; there must be one")
    for line in filter(str.strip, read_text(tables[0]).splitlines()):
        found = re.fullmatch(r"\s*(\S+)\s*\(([^,]+),([^)]+)\)\s*(\S+)\s*", line)
        if found is None:
            raise ValueError(f"{tables[0].name} has the line {line!r}; write: image (x, y) radius")
        name, x, y, radius = found.groups()
        yield _copy_image(source / name, out, name), (float(x), float(y), float(radius))


FORMATS: dict[str, Callable[[Path, Path], Circles]] = {
    "gs_sdk": _read_gs_sdk,
    "taxim": _read_taxim,
    "fots": _read_fots,
    "circles": _read_circles,
}


def _copy_image(image: Path, out: Path, name: str) -> str:
    (out / name).write_bytes(image.read_bytes())
    return name
