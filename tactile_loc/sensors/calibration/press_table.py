"""The table `presses.csv` of a folder of presses, and the sensor file beside it: see docs/sensor-labels.md."""

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.io.csv_tables import read_table, require_columns
from tactile_loc.store.files import write_atomically

TABLE, SENSOR = "presses.csv", "sensor.toml"
UNTOUCHED = "untouched-gel.png"  # the composed or corrected image of the untouched gel; it is rectified
KINDS = ("background", "ball")
BALL = ("center_x_px", "center_y_px", "radius_px", "ball_radius_mm")  # columns of a ball
Circles = Iterable[tuple[str, tuple[float, float, float] | None]]  # an image's name and circle (x, y, radius), px


@dataclass(frozen=True, eq=False)
class PressRow:
    """A row in a `line` of a `table`. `values` maps columns to their texts."""

    table: Path
    line: int
    values: Mapping[str, str]

    @property
    def where(self) -> str:
        """The table and the line, for messages."""
        return f"{self.table}, line {self.line}"

    @property
    def kind(self) -> str:
        """One of KINDS."""
        return self.values["kind"]

    @property
    def image(self) -> Path:
        """The path of the image."""
        return self.table.parent / self.values["image"]

    def read_number(self, column: str) -> float:
        """Return the number in a column. Raises CalibrationError when it is missing or not finite."""
        text = self.values.get(column, "")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            fault = f"{text!r}" if text else "missing"
            raise CalibrationError(f"{self.where}: {column} is {fault}; the press of a ball needs a number")
        return value


def read_rows(table: Path) -> list[PressRow]:
    """Read a table of presses.

    Raises CalibrationError when there is no table, when it cannot be read, or when a row has no image or a wrong kind.
    """
    if not table.exists():
        raise CalibrationError(f"there is no table {table}; give a folder with images of presses and this table")
    found = read_table(table, "press", CalibrationError)
    advice = "; it needs image, kind, and the columns of a ball (docs/sensor-labels.md)"
    require_columns(table, found.columns, ("image", "kind"), CalibrationError, advice)
    rows = [PressRow(table, line, values) for line, values in zip(found.lines, found.rows, strict=True)]
    for row in rows:
        image, kind = row.values["image"], row.kind
        if not image:
            raise CalibrationError(f"{row.where}: image is missing; give the path of a picture, relative to the table")
        if kind not in KINDS:
            fault = f"there is no kind {kind!r}" if kind else f"{image} has no kind"
            raise CalibrationError(f"{row.where}: {fault}; give one of {', '.join(KINDS)}")
    return rows


def list_named_files(table: Path) -> set[str]:
    """Return the paths of the images in a table, as it names them. Raises CalibrationError if it cannot be read."""
    return {row.values["image"] for row in read_rows(table)}


def write_table(table: Path, circles: Circles, ball_radius_mm: float) -> Path:
    """Write a table of images and return its path.

    Each row has an image's name and the ball's circle (x, y, radius), pixels, or None for the untouched gel. Raises
    OutputError when the file cannot be written.
    """
    lines: list[tuple[object, ...]] = [("image", "kind", *BALL)]
    for image, circle in circles:
        if circle is None:
            lines.append((image, "background"))
        else:
            lines.append((image, "ball", *circle, ball_radius_mm))

    def write(path: Path) -> None:
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)

    return write_atomically(table, write)
