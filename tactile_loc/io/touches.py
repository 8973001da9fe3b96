"""Reads and writes touch files: contact shapes as npz, npy or 16-bit PNG. docs/files.md describes the formats.

Pickles are never loaded, and units are never guessed.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactile_loc.core.runtime.errors import OutputError, TouchError, name_source, note_source
from tactile_loc.core.runtime.limits import require_pixels
from tactile_loc.core.sensing.depth_maps import (
    KINDS,
    MASK,
    METRES_PER_UNIT,
    DepthKind,
    DepthUnit,
    TouchKind,
    require_kind,
)
from tactile_loc.core.sensing.gel import Gel, GelKind
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import (
    ContactShape,
    Meaning,
    Touch,
    blank_unobserved,
    contact_shape_from_array,
    require_fit,
)
from tactile_loc.io.images import (
    FORMATS,
    IMAGE_SUFFIXES,
    PHOTO,
    explain_picture,
    guard_reading,
    load_image,
    read_brightness,
    read_colour_image,
)
from tactile_loc.io.toml import MATRIX, Matrix, name_errors, to_array
from tactile_loc.store.arrays import load_npy, load_npz, measure_npy, measure_npz
from tactile_loc.store.files import list_files, replace_file

if TYPE_CHECKING:
    from tactile_loc.slots.sensor import SensorModel

logger = logging.getLogger(__name__)

TOUCH_SUFFIXES = (".npz", ".npy", *IMAGE_SUFFIXES)  # of images and contact shapes
LARGEST_INDENTATION_M = 0.05
LARGEST_OTHER_BYTES = 4096  # of an array beside the map
OVERVIEW, TRUE_POSES = "touches.png", "poses.json"  # a picture of simulated touches, and their poses, beside them
GEL_NAMES = {"rigid": "a rigid gel", "layer": "an elastic gel"}
KIND_OPTION = "`touch_kind` {}"
NO_CONTACT_U16 = 65535
NUMBER = "one number"


class FileContents(BaseModel):
    """The contents of a touch file. A value that the file does not give is None.

    `depth` (H, W), `press_depth` and `indentation` are in `unit`. `kind` is the meaning of `depth`, as in
    `Touch.from_depth`, or "mask". `gel` is the kind of gel that it shows. The poses (4, 4) are in metres. `press_std`,
    in `unit`, is the standard deviation of a mask's press. A field's description completes "key must be ...".
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    depth: Any
    unit: DepthUnit | None = Field(default=None, description="'m', 'mm' or 'um'")
    kind: TouchKind | None = Field(default=None, description="'distance', 'indentation', 'height' or 'mask'")
    gel: GelKind | None = Field(default=None, description="'rigid' or 'layer'")
    press_depth: float | None = Field(default=None, description=NUMBER)
    press_std: float | None = Field(default=None, description=NUMBER)
    indentation: float | None = Field(default=None, description=NUMBER)
    T_sensor_object: Matrix | None = Field(default=None, description=MATRIX)
    T_base_sensor: Matrix | None = Field(default=None, description=MATRIX)


def read_contents(path: Path, geometry: SensorGeometry | None = None) -> FileContents:
    """Read an .npz, .npy or 16-bit grey .png file. Raises TouchError for any other file, and for a damaged file.

    The contact shape must have the image size of the sensor `geometry`, if given. It is compared before it is read.
    """
    readers = {".npz": _read_npz, ".npy": _read_npy, ".png": _read_png}
    suffix = path.suffix.lower()
    with guard_reading(path):
        if suffix not in readers:
            read_colour_image(path)  # names the kind of another picture
            kind = PHOTO if suffix in IMAGE_SUFFIXES else "not a touch file"
            raise TouchError(f"{path} is {kind}; give {FORMATS}, or with a calibrated sensor a photo, PNG or JPEG")
        return readers[suffix](path, geometry)


def _read_npz(path: Path, geometry: SensorGeometry | None) -> FileContents:
    held = measure_npz(path)
    depth = _find_depth(held, path)
    _check_map(held[depth], path, geometry)
    others = [name for name in FileContents.model_fields if name in held and name != "depth"]
    for name in others:
        if held[name].nbytes > LARGEST_OTHER_BYTES:
            raise TouchError(f"{name} in {path} has shape {held[name].shape}; save a number, a text or a pose (4, 4)")
    arrays = load_npz(path, (depth, *others))
    stated = {name: _unpack(arrays[name]) for name in others}
    with name_errors(path, FileContents, stated, "a touch", TouchError):
        return FileContents(depth=arrays[depth], **stated)


def _unpack(array: NDArray[Any]) -> Any:
    """Return the only element of an array, or its rows. Bytes become text."""
    value = array.item() if array.size == 1 else array.tolist()
    value = value.decode(errors="backslashreplace") if isinstance(value, bytes) else value
    return value.strip() if isinstance(value, str) else value


def _read_npy(path: Path, geometry: SensorGeometry | None) -> FileContents:
    _check_map(measure_npy(path), path, geometry)
    return FileContents(depth=load_npy(path))


def _check_map(held: NDArray[Any], path: Path, geometry: SensorGeometry | None) -> None:
    """Raise TouchError or ValueError unless an array (H, W), of which only the shape is read, fits the sensor."""
    if held.ndim == 2 and geometry is not None:
        require_fit(held.shape, geometry, str(path))
    elif held.ndim >= 2:
        require_pixels(*held.shape[:2])
    if held.ndim != 2 or held.dtype.kind not in "fiub":
        raise TouchError(f"{path} holds {held.dtype} of shape {held.shape}; a contact shape must be numbers (H, W)")


def _find_depth(held: Mapping[str, NDArray[Any]], path: Path) -> str:
    """Return the name `depth`, or else that of the only array with two or more dimensions that is not a pose."""
    if "depth" in held:
        return "depth"
    maps = [name for name, a in held.items() if a.ndim >= 2 and a.size > 1 and not name.startswith("T_")]
    if len(maps) != 1:
        listed = ", ".join(f"{name} {a.shape}" for name, a in held.items()) or "nothing"
        raise TouchError(f"{path} holds {listed}; save one array (H, W), or name the contact shape 'depth'")
    return maps[0]


def _read_png(path: Path, geometry: SensorGeometry | None) -> FileContents:
    mode, values = load_image(path)
    if not mode.startswith("I"):  # Pillow before 11 opens 16-bit grey as "I"
        raise TouchError(explain_picture(path, mode))
    if geometry is not None:
        require_fit(values.shape, geometry, str(path))
    return FileContents(depth=values.astype(np.uint16))


def is_overview(path: Path) -> bool:
    """Return whether a file is the picture that shows all touches of a folder of simulated touches."""
    return path.name == OVERVIEW and path.with_name(TRUE_POSES).is_file()


def list_touches(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the visible images and contact shapes in a folder, as `list_files` does, without the overview."""
    return [path for path in list_files(folder, TOUCH_SUFFIXES, pattern) if not is_overview(path)]


def read_touch(
    path: str | Path,
    sensor: SensorModel,
    unit: str | None = None,
    press_depth_m: float | None = None,
    kind: str | None = None,
) -> Touch:
    """Read a touch of `sensor` from a file with a contact shape (.npz, .npy or 16-bit .png) or a colour image.

    A calibrated sensor converts the image to a contact shape. The touch has the poses that the file gives. A file that
    states another kind of gel than the sensor's is logged as a warning.

    `unit` ("m", "mm" or "um") is needed if a contact shape's file states no unit and the sensor declares none. `kind`
    is the meaning of its depths if the file does not state it: see `Touch.from_depth`. The default is what the sensor
    declares, or "distance". A `unit` or a `kind` that contradicts the sensor's declaration is used, with a warning. If
    the file states no press depth,
    `press_depth_m`, metres, is the press depth. By default, it is taken from the shape (see
    `contact_shape_from_array`). If the file states a press depth, the shape is cut at `press_depth_m`, which must be
    smaller. With the `kind` "mask", the file is a contact mask: see `Touch.from_mask`.

    Raises TouchError when the file is not a touch, does not fit the sensor, shows no contact, is in contact everywhere,
    or when its depths have the opposite meaning.
    """
    path = Path(path)
    geometry = sensor.geometry
    if kind == MASK:
        is_picture = path.suffix.lower() == ".png"
        contents = FileContents(depth=read_brightness(path)) if is_picture else read_contents(path, geometry)
        return _build_mask(path, contents, sensor, unit, press_depth_m)
    image = read_colour_image(path)
    if image is not None:
        with name_source(path):
            shape = sensor.contact_shape(image)
        return Touch(_cut(shape, str(path), press_depth_m), geometry, path.name, image=sensor.rectify(image))
    contents = read_contents(path, geometry)
    if contents.kind == MASK and kind is None:
        return _build_mask(path, contents, sensor, unit, press_depth_m)
    _compare_gels(contents.gel, geometry.gel, path)
    unit = _find_declared("unit", contents.unit, unit, sensor.depth_files.unit, path)
    kind = _find_declared("kind", contents.kind, kind, sensor.depth_files.kind, path)
    shape = _build_shape(contents, str(path), geometry, unit, press_depth_m, kind)
    return Touch(shape, geometry, path.name, to_array(contents.T_base_sensor), to_array(contents.T_sensor_object))


def _build_mask(
    path: Path, contents: FileContents, sensor: SensorModel, unit: str | None, press_depth_m: float | None
) -> Touch:
    """Return the touch of a contact mask; a press depth in the file takes the place of `press_depth_m`, metres."""
    _choose("kind", contents.kind, MASK, str(path))
    scale = 1.0 if contents.press_depth is None else _find_scale(contents, str(path), unit)
    press_m = press_depth_m if contents.press_depth is None else contents.press_depth * scale
    return Touch.from_mask(
        contents.depth,
        sensor=sensor,
        press_depth_m=press_m,
        press_std_m=None if contents.press_std is None else contents.press_std * scale,
        name=path.name,
        T_base_sensor=to_array(contents.T_base_sensor),
        T_sensor_object=to_array(contents.T_sensor_object),
    )


def touch_from_image(
    image: NDArray[Any],
    sensor: SensorModel,
    press_depth_m: float | None = None,
    name: str = "the image",
    unit: str | None = None,
    kind: str | None = None,
) -> Touch:
    """Return the touch that a sensor reads from an image (H, W, 3) uint8, or from depths (H, W).

    For depths, `press_depth_m`, metres, is the press depth. `unit`, by default "m", and `kind` are as for `read_touch`.
    The contact shape of an image is cut at `press_depth_m`, which must be smaller than the image's press depth. Raises
    NoContactError when nothing touches the gel, and TouchError when the sensor cannot read the image.
    """
    if kind == MASK:
        return Touch.from_mask(image, sensor=sensor, press_depth_m=press_depth_m, name=name)
    if image.ndim == 2 and image.dtype.kind == "f" and (press_depth_m, unit, kind) != (None, None, None):
        shape = _build_shape(FileContents(depth=image), name, sensor.geometry, unit or "m", press_depth_m, kind)
        return Touch(shape, sensor.geometry, name)
    with note_source(name):
        shape = _cut(sensor.contact_shape(image), name, press_depth_m)
    return Touch(shape, sensor.geometry, name, image=sensor.rectify(image) if image.ndim == 3 else None)


def write_touch(path: str | Path, touch: Touch) -> Path:
    """Write a touch as .npz (metres), atomically, and return the path. Raises OutputError if that fails."""
    path = Path(path)
    if path.suffix.lower() != ".npz":
        raise OutputError(f"a touch cannot be written to {path}; choose a file name that ends in .npz")
    poses = {"T_sensor_object": touch.T_sensor_object, "T_base_sensor": touch.T_base_sensor}
    shape = touch.contact_shape
    seen = {
        "depth": shape.depth_m.astype(np.float32),
        "kind": np.array("distance"),
        "indentation": np.array(touch.indentation_m, np.float64),
    }
    mask = {"mask": shape.contact, "kind": np.array(MASK), "press_std": np.array(shape.indentation_std_m, np.float64)}
    arrays = {
        **(seen if touch.has_depths else mask),
        "unit": np.array("m"),
        "gel": np.array(touch.geometry.gel.kind),
        "press_depth": np.array(touch.press_depth_m, np.float64),
        **{name: np.asarray(T, np.float64) for name, T in poses.items() if T is not None},
    }
    try:
        with replace_file(path) as temporary, temporary.open("xb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror}); choose another folder") from error
    return path


def _build_shape(
    contents: FileContents,
    name: str,
    geometry: SensorGeometry,
    unit: str | None,
    press_depth_m: float | None,
    kind: str | None,
) -> ContactShape:
    raw = contents.depth
    if raw.dtype.kind == "b":
        raise TouchError(f"{name} holds {raw.dtype} of shape {raw.shape}; a contact shape must be numbers (H, W)")
    scale, known = _find_scale(contents, name, unit), _find_kind(contents, name, kind)
    depth = raw.astype(np.float64) * scale
    if raw.dtype.kind == "u" and raw.dtype.itemsize == 2:
        depth[raw == NO_CONTACT_U16] = np.nan
    if known != "distance":
        depth = blank_unobserved(depth, geometry)
    press_m = press_depth_m if contents.press_depth is None else contents.press_depth * scale
    meaning = Meaning(known, contents.unit is not None, KIND_OPTION if contents.kind is None else None)
    shape = contact_shape_from_array(depth, geometry.max_depth_m, press_m, name, meaning, geometry.gel)
    if contents.press_depth is None:
        return shape
    if contents.indentation is not None:
        shape = dataclasses.replace(shape, indentation_m=_check_depth_m(contents.indentation * scale, shape, name))
    return _cut(shape, name, press_depth_m)


def _compare_gels(stated: GelKind | None, gel: Gel, path: Path) -> None:
    """Warn if a file states another kind of gel than the sensor's."""
    if stated not in (None, gel.kind):
        logger.warning(
            "%s shows %s, but the sensor has %s, so the pose will probably be wrong; set the sensor's gel to %r",
            path,
            GEL_NAMES[stated],
            GEL_NAMES[gel.kind],
            stated,
        )


def _check_depth_m(indentation_m: float, shape: ContactShape, name: str) -> float:
    """Return the indentation, metres, which is at least the press depth."""
    if not shape.press_depth_m * (1 - 1e-6) <= indentation_m < LARGEST_INDENTATION_M:
        raise TouchError(
            f"the indentation in {name} is {indentation_m * 1e3:.3g} mm; it must be at least its press depth of "
            f"{shape.press_depth_m * 1e3:.3g} mm, and below {LARGEST_INDENTATION_M * 1e3:.0f} mm"
        )
    return max(indentation_m, shape.press_depth_m)


def _cut(shape: ContactShape, name: str, press_depth_m: float | None) -> ContactShape:
    """Cut a shape at a smaller press depth, metres. Raises TouchError for a larger depth, which the shape lacks."""
    if press_depth_m is None:
        return shape
    if not 0 < press_depth_m <= shape.press_depth_m * (1 + 1e-6):
        raise TouchError(
            f"{name} has a press depth of {shape.press_depth_m * 1e3:.3g} mm and the given press depth "
            f"is {press_depth_m * 1e3:.3g} mm; give less than in the file, and more than 0"
        )
    return shape.press_to(press_depth_m)


def _find_kind(contents: FileContents, name: str, kind: str | None) -> DepthKind:
    """Return the meaning of a file's depths."""
    if kind is not None:
        require_kind(kind, name, (*KINDS, MASK))
    if MASK in (kind, contents.kind):
        raise TouchError(f"{name} is a contact mask, which has no depths; read it as a touch")
    return cast(DepthKind, _choose("kind", contents.kind, kind, name) or "distance")


def _find_scale(contents: FileContents, name: str, unit: str | None) -> float:
    """Return the metres per unit of a file's depths."""
    units = ", ".join(METRES_PER_UNIT)
    if unit is not None and unit not in METRES_PER_UNIT:
        raise TouchError(f"the unit {unit!r} of {name} is unknown; the units are {units}")
    known = _choose("unit", contents.unit, unit, name)
    if known is None:
        raise TouchError(f"{name} has no unit; give the unit of its depths by `touch_unit`: {units}")
    return METRES_PER_UNIT[cast(DepthUnit, known)]


def _find_declared(what: str, stated: str | None, given: str | None, declared: str | None, path: Path) -> str | None:
    """Return what the caller gives or, if neither the caller nor the file states anything, what the sensor declares.

    Warn if the caller contradicts the sensor.
    """
    if stated is not None or declared is None:
        return given
    if given not in (None, declared):
        logger.warning(
            "%s is read with the %s %s, as given, but the sensor declares %s for its files; leave `touch_%s` out if "
            "the sensor's software wrote the file",
            *(path, what, given, declared, what),
        )
    return given or declared


def _choose(what: str, stated: str | None, given: str | None, name: str) -> str | None:
    """Return what a file states, or else what the caller gives. Raises TouchError if they differ."""
    if stated is not None and given not in (None, stated):
        raise TouchError(f"the {what} in {name} is {stated}, but `touch_{what}` is {given}; leave it out")
    return stated or given
