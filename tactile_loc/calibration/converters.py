"""Public calibration sets as folders of presses: each differs in how it writes down the same circle."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from tactile_loc.calibration.labels import STEEPEST
from tactile_loc.calibration.presses import TABLE
from tactile_loc.core.errors import CalibrationError
from tactile_loc.io.images import read_colour_image

COLUMNS = ("image", "kind", "center_x_px", "center_y_px", "radius_px", "ball_radius_mm")
DEEPEST_MM = 1.5
HALF = 0.5  # these sets count pixels from the centre of the first; tactile-loc from its corner


def convert(source: Path, out: Path, format: str, ball_radius_mm: float, mm_per_px: float) -> Path:
    """Write a folder of presses `out` from a set in one of FORMATS, and return its table's path.

    Circles larger than the ball, which one scale for a whole image makes of some, are taken for the largest that it can
    make. Raises CalibrationError when the set is not as its format says.
    """
    if format not in FORMATS:
        raise CalibrationError(f"there is no format {format!r}; give one of {', '.join(FORMATS)}")
    out.mkdir(parents=True, exist_ok=True)
    largest = np.floor(1e3 * STEEPEST * ball_radius_mm / mm_per_px) / 1e3
    try:
        rows = list(FORMATS[format](source, out))
    except (OSError, KeyError, ValueError, IndexError, TypeError, EOFError, BadZipFile) as error:
        raise CalibrationError(f"{source} cannot be read as a set in the format {format} ({error})") from error
    if all(circle is None for _, circle in rows):
        raise CalibrationError(f"{source} holds no press in the format {format}")
    with (out / TABLE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for image, circle in rows:
            if circle is None:
                writer.writerow([image, "background"])
                continue
            x, y, radius = circle
            writer.writerow([image, "ball", x + HALF, y + HALF, min(radius, largest), ball_radius_mm])
    return out / TABLE


def write_sensor(folder: Path, mm_per_px: float) -> Path:
    """Describe the sensor of a set that was converted to `folder`, `sensor.toml`, and return the file's path.

    Its pixels are square, `mm_per_px` mm wide; the deepest press, which no format tells, is taken for DEEPEST_MM.
    Raises CalibrationError or TouchError when an image cannot be read.
    """
    first = min(path for path in folder.iterdir() if path.name != TABLE)
    image = read_colour_image(first)
    if image is None:
        raise CalibrationError(f"{first.name} of the set is no colour image; give PNG or JPEG with three channels")
    height, width = image.shape[:2]
    lines = [
        'camera = "orthographic"',
        f"image_size_px = [{width}, {height}]",
        f"mm_per_px = {float(mm_per_px)}",
        f"max_depth_mm = {DEEPEST_MM}",
    ]
    path = folder / "sensor.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


Circle = tuple[float, float, float]
Rows = Iterable[tuple[str, Circle | None]]


def _gs_sdk(source: Path, out: Path) -> Rows:
    """gs_sdk: background.png, and a folder a press with gelsight.png and label.npz (center, radius)."""
    yield _link(source / "background.png", out, "background.png"), None
    for label in sorted(source.glob("*/label.npz"), key=lambda path: (len(path.parent.name), path.parent.name)):
        with np.load(label, allow_pickle=False) as values:
            x, y = map(float, values["center"])
            circle = (x, y, float(values["radius"]))
        yield _link(label.with_name("gelsight.png"), out, f"{label.parent.name}.png"), circle


def _taxim(source: Path, out: Path) -> Rows:
    """Taxim: a data pack (npz) with imgs, f0, touch_center and touch_radius."""
    with np.load(source, allow_pickle=False) as values:
        pack = {name: values[name] for name in ("imgs", "f0", "touch_center", "touch_radius")}
    yield _save(pack["f0"], out / "background.png"), None
    for number, (image, centre, radius) in enumerate(
        zip(pack["imgs"], pack["touch_center"], pack["touch_radius"], strict=True)
    ):
        yield _save(image, out / f"{number:04d}.png"), (float(centre[0]), float(centre[1]), float(radius))


def _fots(source: Path, out: Path) -> Rows:
    """FOTS: gelsight/*.png and csv/annotate.csv (img_names, center_x, center_y, radius); no untouched gel."""
    with (source / "csv" / "annotate.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            name = Path(row["img_names"]).name
            circle = (float(row["center_x"]), float(row["center_y"]), float(row["radius"]))
            yield _link(source / "gelsight" / name, out, name), circle


def _circles(source: Path, out: Path) -> Rows:
    """A text file of lines `image (x, y) radius`, and background_real.png or background.png."""
    for name in ("background.png", "background_real.png"):
        if (source / name).is_file():
            yield _link(source / name, out, name), None
    tables = sorted(source.glob("labels*.txt"))
    if len(tables) != 1:
        raise ValueError(f"it has {len(tables)} files labels*.txt; it must have one")
    for line in filter(str.strip, tables[0].read_text(encoding="utf-8").splitlines()):
        found = re.fullmatch(r"\s*(\S+)\s*\(([^,]+),([^)]+)\)\s*(\S+)\s*", line)
        if found is None:
            raise ValueError(f"{tables[0].name} has the line {line!r}; each must be: image (x, y) radius")
        name, x, y, radius = found.groups()
        yield _link(source / name, out, name), (float(x), float(y), float(radius))


FORMATS: dict[str, Callable[[Path, Path], Rows]] = {
    "gs_sdk": _gs_sdk,
    "taxim": _taxim,
    "fots": _fots,
    "circles": _circles,
}


def _link(image: Path, out: Path, name: str) -> str:
    """Put an image into the folder under a name."""
    (out / name).write_bytes(image.read_bytes())
    return name


def _save(image: Any, path: Path) -> str:
    from PIL import Image

    Image.fromarray(np.asarray(image, np.uint8)).save(path)
    return path.name
