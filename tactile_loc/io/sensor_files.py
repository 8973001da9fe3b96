"""Reads and writes sensors as TOML files, and recognises calibration folders.

docs/files.md lists the keys of a sensor file. examples/my_sensor.toml is an example.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.bases.depth_sensor import GelOptions
from tactile_loc.core.runtime.errors import ConfigError, SensorError, name_source
from tactile_loc.core.sensing.gel import RIGID, GelKind
from tactile_loc.core.sensing.photo_map import FACTORS, Lens, PhotoMap, even_scales
from tactile_loc.core.sensing.sensor_geometry import Depth, SensorGeometry
from tactile_loc.io.images import UNREADABLE, load_image, write_image
from tactile_loc.io.toml import POSITIVE_MM, Finite, Positive, format_toml, name_errors, read_toml
from tactile_loc.store.arrays import load_npy
from tactile_loc.store.files import read_text, recover_folder

CALIBRATION = "calibration.json"  # a file that every calibration folder holds

SMALLEST_M, LARGEST_M = 1e-3, 1.0  # limits of a plausible side of the gel that an image shows

LENS_KEYS = "camera_matrix|K", "distortion_coefficients|dist_coeffs|distortion|D"  # regular expressions
SAME_SCALE = 0.01  # largest relative difference between the scales of x and y that are taken for equal

PositiveInt = Annotated[int, Field(gt=0)]


_Two = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class PhotoKeys(BaseModel):
    """The keys of a map from the camera's photos to the sensor's image: see `PhotoMap`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    size_px: Annotated[list[PositiveInt], Field(min_length=2, max_length=2)]
    corners_px: Annotated[list[_Two], Field(min_length=4, max_length=4)]
    camera: Annotated[list[Finite], Field(min_length=4, max_length=4)] | None = None
    distortion: Annotated[list[Finite], Field(max_length=FACTORS)] = []

    def make_map(self, image_px: tuple[int, int]) -> PhotoMap:
        """Return the map to images of `image_px` (width, height). Raises SensorError for impossible numbers."""
        return PhotoMap.of_record(self.model_dump(), image_px)


class _SensorFile(BaseModel):
    """The keys of every sensor. A field's description completes "key must be ..."."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    camera: Literal["pinhole", "orthographic"] = Field(description="'pinhole' or 'orthographic'")
    image_size_px: list[PositiveInt] = Field(
        min_length=2, max_length=2, description="[width, height], positive whole numbers (pixels)"
    )
    max_depth_mm: Positive = Field(description=POSITIVE_MM)
    cx: Finite | None = Field(None, description="a number (pixels), by default the image's centre")
    cy: Finite | None = Field(None, description="a number (pixels), by default the image's centre")
    sensing_rectangle_mm: list[Finite] | None = Field(
        None, min_length=4, max_length=4, description="[x_min, x_max, y_min, y_max], four numbers (mm)"
    )
    mask: str | None = Field(None, description="the path of a PNG, relative to the sensor file, in quotes")
    surface: str | None = Field(None, description="the path of a .npy file, relative to the sensor file, in quotes")
    gel: GelKind = Field("rigid", description="'rigid' or 'layer'")
    gel_thickness_mm: Positive | None = Field(None, description="a positive number (mm), by default 4")
    poisson: Annotated[float, Field(ge=0, lt=0.5)] | None = Field(
        None, description="a number from 0 to 0.5, by default 0.48"
    )
    gel_coating_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        None, description="a number of at least 0 (mm), by default 0"
    )
    photo: PhotoKeys | None = Field(
        None,
        description="a table with size_px [width, height] and corners_px [[x, y], ...] of the camera's photos, four "
        "corners from the upper left clockwise, and for a lens camera [fx, fy, cx, cy] and distortion [k1, ...]",
    )


class _Pinhole(_SensorFile):
    fx: Positive = Field(description="a positive number (pixels)")
    fy: Positive = Field(description="a positive number (pixels)")
    standoff_mm: Positive = Field(description=POSITIVE_MM)

    @property
    def focal(self) -> tuple[float, float]:
        return self.fx, self.fy


class _Orthographic(_SensorFile):
    mm_per_px: Positive | Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        description="a positive number, or [x, y] (mm)"
    )
    standoff_mm: Positive = Field(10.0, description="a positive number (mm), by default 10")

    @property
    def focal(self) -> tuple[float, float]:
        x, y = self.mm_per_px if isinstance(self.mm_per_px, list) else (self.mm_per_px, self.mm_per_px)
        return 1e3 / x, 1e3 / y


def read_sensor_file(path: Path) -> SensorGeometry:
    """Read a sensor file (TOML, mm and pixels) into a geometry in metres and pixels.

    Raises SensorError when the file, its mask or its surface cannot be read, a key is missing, unknown or ill-typed,
    or the numbers contradict each other.
    """
    return _read_keys(path)[1]


def read_camera(path: Path) -> tuple[SensorGeometry, PhotoMap | None]:
    """Read a sensor file like `read_sensor_file`, and the map from the camera's photos to the sensor's images, if any.

    If an orthographic sensor states different scales of x and y, the returned sensor has square pixels, and the map
    resizes the photos. Without a map, the photos are the images.
    """
    keys, geometry = _read_keys(path)
    if keys.photo is not None:
        with name_source(path):
            photo_map = keys.photo.make_map((geometry.width_px, geometry.height_px))
        return photo_map.hide_unseen(geometry), photo_map
    sx, sy = geometry.scale_at_surface
    uneven = not geometry.is_pinhole and abs(sx / sy - 1) > SAME_SCALE
    return even_scales(geometry) if uneven else (geometry, None)


def _read_keys(path: Path) -> tuple[_Pinhole | _Orthographic, SensorGeometry]:
    try:
        values = read_toml(path)
    except ConfigError as error:
        raise SensorError(str(error)) from error
    model = _Orthographic if values.get("camera") == "orthographic" else _Pinhole
    kind = f"an {values['camera']}" if model is _Orthographic else "a pinhole"
    with name_errors(path, model, values, f"{kind} sensor", SensorError, decisive="camera"):
        keys = model(**values)
        return keys, _check_view(_build_geometry(keys, path.parent))


def _build_geometry(keys: _Pinhole | _Orthographic, folder: Path) -> SensorGeometry:
    width, height = keys.image_size_px
    fx, fy = keys.focal
    rectangle = keys.sensing_rectangle_mm
    x0, x1, y0, y1 = (v * 1e-3 for v in rectangle or (0.0,) * 4)
    return SensorGeometry(
        keys.camera,
        width,
        height,
        fx,
        fy,
        cx=width / 2 if keys.cx is None else keys.cx,
        cy=height / 2 if keys.cy is None else keys.cy,
        standoff_m=keys.standoff_mm * 1e-3,
        max_depth_m=keys.max_depth_mm * 1e-3,
        rectangle_m=None if rectangle is None else (x0, x1, y0, y1),
        observed=None if keys.mask is None else _read_mask(folder / keys.mask),
        relief_m=None if keys.surface is None else _read_surface(folder / keys.surface),
        gel=GelOptions(**keys.model_dump(include=set(GelOptions.model_fields))).make_gel(RIGID),
    )


def _check_view(geometry: SensorGeometry) -> SensorGeometry:
    """Return the geometry. Raises SensorError if the image shows an implausibly large or small part of the gel."""
    x0, x1, y0, y1 = geometry.view
    if not all(SMALLEST_M <= side_m <= LARGEST_M for side_m in (x1 - x0, y1 - y0)):
        keys = "fx, fy or standoff_mm" if geometry.is_pinhole else "mm_per_px"
        raise SensorError(
            f"the image shows {1e3 * (x1 - x0):.5g} x {1e3 * (y1 - y0):.5g} mm of the gel; {keys} is probably in "
            "another unit"
        )
    return geometry


def _read_mask(path: Path) -> NDArray[np.bool_]:
    """Read the mask (H, W) of observed pixels from a PNG. Pixels that are at least half white are observed."""
    with _guard(f"the mask {path} cannot be read as an image", "give a PNG, white at observed pixels"):
        return load_image(path, "L")[1] >= 128


def _read_surface(path: Path) -> Depth:
    """Read the undeformed gel's relief (H, W), metres, from a .npy file."""
    needed = "an array (rows, columns) of floats in metres"
    with _guard(f"the surface {path} cannot be read as .npy", f"give {needed}"):
        surface = load_npy(path)
    if surface.ndim != 2 or surface.dtype.kind != "f":
        raise SensorError(f"the surface {path} has shape {surface.shape} and type {surface.dtype}; it must be {needed}")
    return surface.astype(np.float32)


@contextmanager
def _guard(problem: str, advice: str) -> Iterator[None]:
    """Convert the errors of reading a file that a sensor file names to a SensorError."""
    try:
        yield
    except UNREADABLE as error:
        raise SensorError(f"{problem} ({error}); {advice}, by its path relative to the sensor file") from error


def read_lens(path: Path) -> Lens:
    """Read a camera matrix and distortion factors from a file of OpenCV, ROS or one's own: YAML, JSON or TOML.

    The lists of numbers after the keys of LENS_KEYS are read, whatever is around them. Raises SensorError when the file
    cannot be read, or when it holds no camera matrix.
    """
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise SensorError(
            f"{path} cannot be read as a camera matrix ({error}); give a YAML, JSON or TOML file"
        ) from error
    matrix, distortion = (_find_numbers(text, keys) for keys in LENS_KEYS)
    if matrix is None or len(matrix) != 9 or min(matrix[0], matrix[4]) <= 0:
        raise SensorError(
            f"{path} holds no camera matrix; write `camera_matrix` as [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], in pixels"
        )
    factors = tuple(distortion or ())
    if any(factors[FACTORS:]) or re.search("equidistant|fisheye|rational", text):
        raise SensorError(f"{path} has another model of distortion; give k1, k2, p1, p2 and k3 (plumb_bob)")
    return Lens(matrix[0], matrix[4], matrix[2], matrix[5], factors[:FACTORS])


def _find_numbers(text: str, keys: str) -> list[float] | None:
    """Return the numbers of the first list, which may hold lists, after a key; None if there is no such list."""
    found = re.search(rf"\b({keys})\b[^\[]*(\[[^a-df-zA-DF-Z]*\])", text)
    if found is None:
        return None
    return [float(number) for number in re.findall(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", found[2])]


def is_calibrated_sensor(folder: Path) -> bool:
    """Return whether `folder` is a calibration folder."""
    recover_folder(folder)
    return os.path.isfile(folder / CALIBRATION)


def _join_scales(x: float, y: float) -> float | list[float]:
    return x if x == y else [x, y]


def write_sensor_file(path: Path, geometry: SensorGeometry, photo_map: PhotoMap | None = None) -> Path:
    """Write a sensor file, and its mask and surface beside it, and return the path. Raises OSError if that fails.

    `photo_map` maps the camera's photos to images of the sensor.
    """
    mm = 1e3
    pinhole = {"fx": geometry.fx, "fy": geometry.fy}
    values: dict[str, Any] = {
        "camera": geometry.camera,
        "image_size_px": [geometry.width_px, geometry.height_px],
        **(pinhole if geometry.is_pinhole else {"mm_per_px": _join_scales(mm / geometry.fx, mm / geometry.fy)}),
        "cx": geometry.cx,
        "cy": geometry.cy,
        "standoff_mm": mm * geometry.standoff_m,
        "max_depth_mm": mm * geometry.max_depth_m,
    }
    if geometry.rectangle_m is not None:
        values |= {"sensing_rectangle_mm": [mm * v for v in geometry.rectangle_m]}
    if geometry.observed is not None:
        values |= {"mask": f"{path.stem}_mask.png"}
        write_image(path.with_name(values["mask"]), geometry.observed.astype(np.uint8) * 255)
    gel = geometry.gel
    if gel.thickness_m is not None:
        values |= {"gel": gel.kind, "gel_thickness_mm": mm * gel.thickness_m, "poisson": gel.poisson}
        values |= {"gel_coating_mm": mm * gel.coating_m}
    if geometry.relief_m is not None:
        values |= {"surface": f"{path.stem}_surface.npy"}
        np.save(path.with_name(values["surface"]), geometry.relief_m)
    if photo_map is not None:
        values |= {"photo": photo_map.record()}
    path.write_text(format_toml(values), encoding="utf-8")
    return path
