"""Reads folders of presses, and converts public sets of presses to such folders.

A folder of presses holds images, a table of labels and a sensor file: see docs/sensors.md.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.core.runtime.errors import CalibrationError, TactileLocError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.csv_tables import read_table, require_columns
from tactile_loc.io.images import IMAGE_SUFFIXES, load_npz, read_photo, write_image
from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.io.toml import format_toml
from tactile_loc.sensors.calibration.circles import Circle
from tactile_loc.sensors.calibration.gel_fit import BallImage, GelFit, fit_gel
from tactile_loc.sensors.calibration.labels import (
    STEEPEST,
    Image,
    LabelledPresses,
    PressLabel,
    label_ball,
    label_elastic_ball,
    label_mesh,
)
from tactile_loc.sensors.calibration.pressed_balls import press_balls
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.reading import reduce_image
from tactile_loc.slots.registry import registry
from tactile_loc.store.files import list_files, order_as_counted, read_text, write_atomically

TABLE, SENSOR = "presses.csv", "sensor.toml"
KINDS = {
    "background": (),
    "ball": ("center_x_px", "center_y_px", "radius_px", "ball_radius_mm"),
    "mesh": ("mesh", "units", "x_mm", "y_mm", "roll_deg", "pitch_deg", "yaw_deg", "press_mm"),
}
MOST_READ_PX = 200  # longer image side; twice this size takes four times as long and does not improve the poses
SAME_SHAPE = 0.01  # largest relative difference of the aspect ratio of a smaller image
FOR_MEDIAN = 9  # fewest presses, at different places, whose median shows the untouched gel
DEEPEST_MM = 1.5  # assumed maximal depth of the sensor of a public set
Rows = Iterable[tuple[str, tuple[float, float, float] | None]]  # an image's name and circle (x, y, radius), px
HALF = 0.5  # pixel centres are at whole numbers in public sets, and at half integers in tactile-loc


@dataclass(frozen=True, eq=False)
class Row:
    """A row of a folder's table.

    `where` names the table and the line, for messages. `kind` is a key of KINDS. `values` maps columns to their texts.
    """

    where: str
    folder: Path
    image: Path
    kind: str
    values: Mapping[str, str]

    @property
    def mesh(self) -> Path:
        """The path of the pressed mesh. Raises CalibrationError when the row names no mesh."""
        if not self.values.get("mesh"):
            raise CalibrationError("mesh is missing; a mesh press needs the path of its mesh, relative to the table")
        return self.folder / self.values["mesh"]

    def read_number(self, column: str) -> float:
        """Return the number in a column. Raises CalibrationError when it is missing or not finite."""
        text = self.values.get(column, "")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            fault = f"{text!r}" if text else "missing"
            raise CalibrationError(f"{self.where}: {column} is {fault}; a {self.kind} press needs a number")
        return value


@dataclass(frozen=True, eq=False)
class PressFolder(LabelledPresses):
    """The presses of a table, with their images in memory.

    `images` have the size of `geometry`. `camera` is the geometry of the images as they were taken. The circles in the
    table are in pixels of `camera`. Marker dots are filled in, in the images and in the background; `gel` has the
    background with its dots. `fit` is the gel's elasticity, if it is known; the balls' labels follow from it.
    """

    rows: tuple[Row, ...]
    images: tuple[Image, ...]
    background: Image
    geometry: SensorGeometry
    camera: SensorGeometry
    gel: UntouchedGel | None = None
    fit: GelFit | None = None
    _scenes: dict[tuple[Path, str], Scene] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        return len(self.rows)

    def read_press(self, number: int) -> tuple[Image, PressLabel]:
        """Return the image (H, W, 3) and the label of a press. Raises CalibrationError as `label` does."""
        return self.images[number], self.label(number)

    def name(self, number: int) -> str:
        """Return the name of a press's image."""
        return self.rows[number].image.name

    def label(self, number: int) -> PressLabel:
        """Return the label of a press. Raises CalibrationError, which names the row, when the label is impossible."""
        row = self.rows[number]
        try:
            if row.kind == "ball":
                return self._label_ball(*self._scale_circle(row))
            return self._label_mesh(row)
        except TactileLocError as error:
            if str(error).startswith(row.where):
                raise
            raise CalibrationError(f"{row.where}: {error}") from error

    def measure_gel(self, thickness_m: float | None = None, progress: Progress | None = None) -> PressFolder:
        """Return the presses with the gel's elasticity, if it can be fitted to the presses of balls.

        With `thickness_m`, metres, the gel's thickness is known. Curved gels are not fitted.
        """
        circles = [
            (image, self._scale_circle(row))
            for image, row in zip(self.images, self.rows, strict=True)
            if row.kind == "ball"
        ]
        pitch_m = self.geometry.pixel_pitch_m
        balls = [BallImage(image, Circle(*at, radius), ball_m, pitch_m) for image, (at, radius, ball_m) in circles]
        fit = None if self.geometry.is_curved else fit_gel(balls, self.background, thickness_m, progress)
        if fit is None or not fit.is_elastic:
            return replace(self, fit=fit)
        return replace(self, fit=fit, geometry=replace(self.geometry, gel=fit.gel))

    @property
    def untouched(self) -> Image:
        """The image (H, W, 3) of the untouched gel, with its marker dots."""
        return self.background if self.gel is None else self.gel.image

    def record(self) -> dict[str, Any]:
        """Return the size of the camera's images, the marker dots and the gel's elasticity, as JSON values.

        The elasticity is left out if the presses do not determine it.
        """
        dots = {} if self.gel is None else {"dots": self.gel.record(self.geometry.pixel_pitch_m)}
        gel = {} if self.fit is None else {"gel": self.fit.record()}
        return {"camera_px": list(self.camera.shape), **dots, **gel}

    def _label_ball(self, centre_px: tuple[float, float], radius_px: float, ball_m: float) -> PressLabel:
        label = label_ball(self.geometry, centre_px, radius_px, ball_m)
        if self.fit is None or not self.fit.is_elastic:
            return label
        contact_m = self.fit.contact * radius_px * self.geometry.pixel_pitch_m
        return label_elastic_ball(self.geometry, centre_px, contact_m, press_balls(self.fit.gel, ball_m))

    def place_circle(self, number: int) -> tuple[tuple[float, float], float, float]:
        """Return the centre (x, y) and radius of a ball's circle on the surface, and the ball's radius; all in m."""
        (x, y), radius_px, ball_m = self._scale_circle(self.rows[number])
        sx, sy = self.geometry.scale_at_surface
        centre_m = (x - self.geometry.cx) / sx, (y - self.geometry.cy) / sy
        return centre_m, radius_px * self.geometry.pixel_pitch_m, ball_m

    def _scale_circle(self, row: Row) -> tuple[tuple[float, float], float, float]:
        x, y, radius, ball_mm = (row.read_number(column) for column in KINDS["ball"])
        (rows, columns), (height, width) = self.geometry.shape, self.camera.shape
        radius_px = radius * self.camera.pixel_pitch_m / self.geometry.pixel_pitch_m
        return (x * columns / width, y * rows / height), radius_px, 1e-3 * ball_mm

    def _label_mesh(self, row: Row) -> PressLabel:
        from scipy.spatial.transform import Rotation

        scene = self._load_scene(row.mesh, row.values.get("units") or "auto")
        angles = [row.read_number(f"{name}_deg") for name in ("yaw", "pitch", "roll")]
        T = make_transform(
            Rotation.from_euler("ZYX", angles, degrees=True).as_matrix(),
            [1e-3 * row.read_number("x_mm"), 1e-3 * row.read_number("y_mm"), 0.0],
        )
        return label_mesh(scene, T, 1e-3 * row.read_number("press_mm"))

    def _load_scene(self, path: Path, units: Any) -> Scene:
        key = (path, units)
        if key not in self._scenes:
            renderer = registry().create("renderer", "heightmap", {})
            self._scenes[key] = Scene(load_object(path, units, "none"), self.geometry, renderer)
        return self._scenes[key]


def read_presses(
    folder: Path, camera: SensorGeometry, median_background: bool = False, size_px: tuple[int, int] | None = None
) -> PressFolder:
    """Read a folder of presses with the table `presses.csv`, taken by a sensor with the geometry `camera`.

    With `size_px` (width, height), images and sensor are reduced to that size. The background is the mean of the
    table's background images. With `median_background`, the background is the pixelwise median of all presses, of which
    at least FOR_MEDIAN are needed. Marker dots are filled in. Raises CalibrationError, which names the faulty row, when
    the folder cannot be used.
    """
    table = folder / TABLE
    geometry = camera if size_px is None else _shrink_sensor(camera, size_px)
    rows = _read_table(table)
    images = {row: reduce_image(_read_image(row, camera), geometry.shape) for row in rows}
    unpressed = [image for row, image in images.items() if row.kind == "background"]
    pressed = tuple(row for row in rows if row.kind != "background")
    if not pressed:
        raise CalibrationError(f"{table} lists no press; add rows of kind ball or mesh")
    if not unpressed and not median_background:
        raise CalibrationError(
            f"{table} lists no image of the untouched gel; add a row of kind background, or use `background` median "
            "with many presses at different places"
        )
    if median_background and len(pressed) < FOR_MEDIAN:
        raise CalibrationError(
            f"{table} lists {len(pressed)} presses, but `background` median needs at least {FOR_MEDIAN} at different "
            "places; add presses, or a row of kind background"
        )
    stack = np.stack([images[row] for row in pressed] if median_background else unpressed)
    background = np.median(stack, axis=0) if median_background else stack.mean(axis=0)
    gel = UntouchedGel.of(np.rint(background).astype(np.uint8))
    clear = tuple(gel.clear_image(images[row]) for row in pressed)
    presses = PressFolder(pressed, clear, gel.clear, geometry, camera, gel)
    for number in range(len(presses)):
        presses.label(number)  # reports faulty rows before the training
    return presses


def choose_size_px(camera: SensorGeometry) -> tuple[int, int]:
    """Return the size (width, height), pixels, to which a camera's images are reduced before they are read.

    Each reduced pixel replaces a square of whole pixels. If the gel is about 20 mm wide, a reduced pixel shows about a
    tenth of a millimetre.
    """
    merged = math.ceil(max(camera.shape) / MOST_READ_PX)
    return round(camera.width_px / merged), round(camera.height_px / merged)


def _shrink_sensor(camera: SensorGeometry, size_px: tuple[int, int]) -> SensorGeometry:
    """Return the sensor at a smaller image size (width, height), pixels.

    Raises CalibrationError when the size is larger than the camera's or has another aspect ratio.
    """
    width, height = size_px
    shares = width / camera.width_px, height / camera.height_px
    if not (min(shares) > 0 and max(shares) <= 1 and abs(shares[0] / shares[1] - 1) <= SAME_SHAPE):
        raise CalibrationError(
            f"images of {camera.width_px} x {camera.height_px} px cannot be reduced to {width} x {height} px; give a "
            "smaller size with the same aspect ratio"
        )
    return camera.resize(width, height)


def _read_table(table: Path) -> list[Row]:
    if not table.exists():
        raise CalibrationError(f"there is no table {table}; give a folder with images of presses and this table")
    found = read_table(table, "press", CalibrationError)
    advice = "; it needs image, kind, and the columns of the kind (docs/sensor-labels.md)"
    require_columns(table, found.columns, ("image", "kind"), CalibrationError, advice)
    return [
        _parse_row(row, f"{table}, line {number}", table.parent)
        for number, row in zip(found.lines, found.rows, strict=True)
    ]


def summarize_table(folder: Path) -> tuple[set[str], set[float]]:
    """Return the paths of the images in a folder's table, and the radii of its balls, mm.

    Raises CalibrationError when the table cannot be read.
    """
    rows = _read_table(folder / TABLE)
    radii_mm = {row.read_number(KINDS["ball"][-1]) for row in rows if row.kind == "ball"}
    return {row.values["image"] for row in rows}, radii_mm


def list_named_files(table: Path) -> set[str]:
    """Return the paths of the images and meshes in a table, as it names them. Raises CalibrationError if unreadable."""
    rows = _read_table(table)
    return {row.values["image"] for row in rows} | {row.values.get("mesh") or "" for row in rows} - {""}


def _parse_row(values: Mapping[str, str], where: str, folder: Path) -> Row:
    image, kind = values["image"], values["kind"]
    if not image:
        raise CalibrationError(f"{where}: image is missing; give the path of a picture, relative to the table")
    if kind not in KINDS:
        fault = f"there is no kind {kind!r}" if kind else f"{image} has no kind"
        raise CalibrationError(f"{where}: {fault}; give one of {', '.join(KINDS)}")
    return Row(where, folder, folder / image, kind, values)


def _read_image(row: Row, geometry: SensorGeometry) -> Image:
    try:
        image = read_photo(row.image)
    except TactileLocError as error:
        raise CalibrationError(f"{row.where}: {error}") from error
    if image.shape[:2] != geometry.shape:
        got, want = (f"{shape[1]} x {shape[0]}" for shape in (image.shape, geometry.shape))
        raise CalibrationError(
            f"{row.where}: {row.image.name} is {got} px but the sensor's image is {want} px (width x height); "
            "all images must have that size"
        )
    return image


def convert_presses(source: Path, out: Path, format: str, ball_radius_mm: float, mm_per_px: float) -> Path:
    """Convert a set of presses in one of FORMATS to a folder of presses `out`, and return the path of the table.

    Circles larger than the ball are reduced: see `write_table`. Raises CalibrationError when the set does not match
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
    return write_table(out / TABLE, rows, ball_radius_mm, mm_per_px)


def write_table(table: Path, rows: Rows, ball_radius_mm: float, mm_per_px: float) -> Path:
    """Write a table of images and return its path.

    Each row has an image's name and the ball's circle (x, y, radius), pixels, or None for the untouched gel. The image
    scale is approximate, so a circle may be larger than the ball. Such a circle is reduced to the largest possible
    circle. Raises OutputError when the file cannot be written.
    """
    largest = np.floor(1e3 * STEEPEST * ball_radius_mm / mm_per_px) / 1e3
    lines: list[tuple[object, ...]] = [("image", "kind", *KINDS["ball"])]
    for image, circle in rows:
        if circle is None:
            lines.append((image, "background"))
        else:
            lines.append((image, "ball", circle[0], circle[1], min(circle[2], largest), ball_radius_mm))

    def write(path: Path) -> None:
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)

    return write_atomically(table, write)


def write_sensor(folder: Path, mm_per_px: float) -> Path:
    """Write `sensor.toml` for a set that was converted to `folder`, and return the path of `sensor.toml`.

    Pixels are square and `mm_per_px` mm wide. Raises TouchError when an image cannot be read.
    """
    first = list_files(folder, IMAGE_SUFFIXES)[0]
    return write_scale(folder, read_photo(first).shape[:2], mm_per_px)


def write_scale(folder: Path, shape: tuple[int, int], mm_per_px: float) -> Path:
    """Write `sensor.toml` for images of a shape (rows, columns) and a scale, with the maximal depth DEEPEST_MM.

    Return the path of `sensor.toml`.
    """
    scale = {"mm_per_px": float(mm_per_px), "max_depth_mm": DEEPEST_MM}
    path = folder / SENSOR
    path.write_text(format_toml({"camera": "orthographic", "image_size_px": shape[::-1], **scale}), encoding="utf-8")
    return path


def _read_gs_sdk(source: Path, out: Path) -> Rows:
    """Read a gs_sdk set: background.png, and for each press a folder with gelsight.png and label.npz.

    label.npz holds the circle's center and radius.
    """
    yield _copy_image(source / "background.png", out, "background.png"), None
    for label in sorted(source.glob("[!.]*/label.npz"), key=lambda path: order_as_counted(path.parent)):
        values = load_npz(label)
        x, y = map(float, values["center"].ravel())
        circle = (x, y, float(values["radius"].item()))
        yield _copy_image(label.with_name("gelsight.png"), out, f"{label.parent.name}.png"), circle


def _read_taxim(source: Path, out: Path) -> Rows:
    """Read a Taxim set: a data pack (npz) with imgs, f0, touch_center and touch_radius."""
    pack = load_npz(source)
    pack |= {name: pack[name].astype(np.uint8) for name in ("imgs", "f0")}
    yield write_image(out / "background.png", pack["f0"]).name, None
    for number, (image, centre, radius) in enumerate(
        zip(pack["imgs"], pack["touch_center"], pack["touch_radius"], strict=True)
    ):
        yield write_image(out / f"{number:04d}.png", image).name, (float(centre[0]), float(centre[1]), float(radius))


def _read_fots(source: Path, out: Path) -> Rows:
    """Read a FOTS set: gelsight/*.png and csv/annotate.csv (img_names, center_x, center_y, radius).

    The set has no image of the untouched gel.
    """
    for row in read_table(source / "csv" / "annotate.csv", "press", CalibrationError).rows:
        name = Path(row["img_names"]).name
        circle = (float(row["center_x"]), float(row["center_y"]), float(row["radius"]))
        yield _copy_image(source / "gelsight" / name, out, name), circle


def _read_circles(source: Path, out: Path) -> Rows:
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


FORMATS: dict[str, Callable[[Path, Path], Rows]] = {
    "gs_sdk": _read_gs_sdk,
    "taxim": _read_taxim,
    "fots": _read_fots,
    "circles": _read_circles,
}


def _copy_image(image: Path, out: Path, name: str) -> str:
    (out / name).write_bytes(image.read_bytes())
    return name
