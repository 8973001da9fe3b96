"""Checks for sensors: the geometry must be constant, and each observation is converted or refused."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.depth_maps import KINDS, METRES_PER_UNIT
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.slots.sensor import DepthFiles, SensorModel
from tactile_loc.testing.contract import (
    ContractError,
    Untouched,
    check,
    name_cause,
    require,
    require_close,
    require_equal,
)
from tactile_loc.testing.properties import hold, whole


@check("sensor")
def check_geometry(sensor: SensorModel) -> None:
    """`geometry` is a SensorGeometry of plausible size, and always the same."""
    geometry = sensor.geometry
    require(isinstance(geometry, SensorGeometry), f"geometry must be a SensorGeometry, not {type(geometry).__name__}")
    same = geometry.describe() == sensor.geometry.describe()
    require(same, "geometry must be the same each time: grids and banks are built for it")
    json.dumps(geometry.describe())
    x0, x1, y0, y1 = geometry.rectangle
    size_mm = 1e3 * max(x1 - x0, y1 - y0)
    plausible = 1 <= size_mm <= 1000
    require(plausible, f"lengths are metres: a sensing surface of {size_mm:.4g} mm is implausible")
    deepest_mm = 1e3 * geometry.max_depth_m
    require(deepest_mm <= 50, f"lengths are metres: a maximal depth of {deepest_mm:.4g} mm is implausible")


@check("sensor")
def check_depth_files(sensor: SensorModel) -> None:
    """`depth_files` declares known units and kinds, or nothing."""
    declared = sensor.depth_files
    require(isinstance(declared, DepthFiles), f"depth_files must be a DepthFiles, not {type(declared).__name__}")
    for what, known in (("unit", tuple(METRES_PER_UNIT)), ("kind", KINDS)):
        value = getattr(declared, what)
        require(value is None or value in known, f"depth_files.{what} must be one of {', '.join(known)}, not {value!r}")


@check("sensor")
def check_contact_shape(sensor: SensorModel) -> None:
    """`contact_shape` returns float32 depths, metres, in the geometry's image size, from 0 to a valid press depth."""
    _, shape = observe(sensor)
    depth, geometry = shape.depth_m, sensor.geometry
    require(depth.shape == geometry.shape, f"a contact shape has the image's size {geometry.shape}, not {depth.shape}")
    require(depth.dtype == np.float32, f"contact depths are float32, not {depth.dtype}")
    in_range = 0 < shape.press_depth_m <= geometry.max_depth_m * (1 + 1e-6)
    deepest_m = geometry.max_depth_m
    sentence = (
        f"the press depth must be within the sensor's maximal depth of {deepest_m:g} m, not {shape.press_depth_m:g} m"
    )
    in_mm = 20 * deepest_m < shape.press_depth_m <= 1e3 * deepest_m * (1 + 1e-6)
    require(in_range, sentence, name_cause({"it is in millimetres": in_mm}))
    within = bool((depth >= 0).all() and (depth <= np.float32(shape.press_depth_m)).all())
    require(within, "contact depths must be from 0 to the press depth, which marks no contact, and not NaN")


@check("sensor")
def check_depths_are_kept(sensor: SensorModel) -> None:
    """If the sensor takes depths, depths below the press depth are kept, to 0.1 um; the other pixels have no contact.

    An asymmetric imprint at any position and press keeps its pixels, so it is not mirrored. This is tested with depths
    in metres, because the true contact shape of an image is unknown here.
    """

    def claim(column_percent: int, row_percent: int, press_percent: int) -> None:
        _require_kept(sensor, make_stamp(sensor.geometry, column_percent, row_percent, press_percent))

    _require_kept(sensor, make_dome(sensor.geometry))
    hold(claim, column_percent=whole(0, 60), row_percent=whole(0, 60), press_percent=whole(30, 100))


@check("sensor")
def check_observation_untouched(sensor: SensorModel) -> None:
    """The observation is not written to."""
    image = observe(sensor)[0]
    before = Untouched(image=image)
    sensor.contact_shape(image)
    before.require()


@check("sensor")
def check_refuses_nonsense(sensor: SensorModel) -> None:
    """An observation of the wrong size, shape or type raises TouchError, whose message the user reads."""
    image = observe(sensor)[0]
    wrong = {
        "an image of another size": np.concatenate([image, image[:3]]),
        "a single row": image[0].ravel(),
        "an empty array": image[:0],
        "text": np.full(image.shape, "contact"),
    }
    for what, observation in wrong.items():
        try:
            sensor.contact_shape(observation)
        except TouchError:
            continue
        except Exception as error:
            raise ContractError(f"{what} must raise TouchError, not {type(error).__name__}: {error}") from error
        raise ContractError(f"{what} must raise TouchError, which the user reads; it was accepted")


@check("sensor", "deterministic")
def check_deterministic(sensor: SensorModel) -> None:
    """The same observation gives the same contact shape."""
    image, first = observe(sensor)
    again = sensor.contact_shape(image)
    for a, b in ((first.depth_m, again.depth_m), (first.press_depth_m, again.press_depth_m)):
        require_equal(a, b, "the same observation must give the same contact shape")


@check("sensor", "property")
def property_image_size(sensor: SensorModel) -> None:
    """An observation with repeated pixels is refused by TouchError, or read like the original, to 1 um.

    A sensor may accept images of its camera's own size, but must not crop images of another size.
    """
    image, shape = observe(sensor)

    def claim(across: int, down: int) -> None:
        try:
            large = sensor.contact_shape(image.repeat(down, axis=0).repeat(across, axis=1))
        except TouchError:
            return
        except Exception as error:
            kind = type(error).__name__
            raise ContractError(f"an image of another size must raise TouchError, not {kind}: {error}") from error
        require_close(large.depth_m, shape.depth_m, 1e-6, "an image of another size must be refused or read as a whole")

    hold(claim, across=whole(2, 4), down=whole(2, 4))


def make_dome(geometry: SensorGeometry) -> Floats:
    """Return depths (H, W), metres, of a round imprint. The image's corners are NaN: no contact."""
    v, u = (np.linspace(-1.2, 1.2, n) for n in geometry.shape)
    depth = 0.8 * geometry.max_depth_m * (u[None, :] ** 2 + v[:, None] ** 2)
    return np.where(depth < 0.75 * geometry.max_depth_m, depth, np.nan)


def make_stamp(geometry: SensorGeometry, column: int, row: int, press: int) -> Floats:
    """Return depths (H, W), metres, of a wedge at `column` and `row`, in percent of width and height; NaN elsewhere.

    The wedge is asymmetric: it is deepest at its left, and wider than high. `press` is its depth, in percent of the
    maximal depth.
    """
    v, u = (100 * (np.arange(n) + 0.5) / n for n in geometry.shape)
    u, v = u[None, :] - column, v[:, None] - row
    rise = 0.9e-2 * press * geometry.max_depth_m * u / 40
    return np.where((u >= 0) & (u < 40) & (v >= 0) & (v < 25), rise, np.nan)


def observe(sensor: SensorModel) -> tuple[NDArray[Any], ContactShape]:
    """Return an observation that the sensor accepts, which is depths or an RGB image, and its contact shape."""
    depth = make_dome(sensor.geometry)
    try:
        return depth, _read(sensor, depth)
    except TouchError:
        grey = np.nan_to_num(depth / sensor.geometry.max_depth_m, nan=1.0)
        image = np.repeat((200 * grey).astype(np.uint8)[..., None], 3, axis=-1)
        return image, _read(sensor, image)


def _read(sensor: SensorModel, observation: NDArray[Any]) -> ContactShape:
    """Return the contact shape of a copy. Raises ContractError unless it is a ContactShape."""
    shape = sensor.contact_shape(observation.copy())
    require(isinstance(shape, ContactShape), f"contact_shape must return a ContactShape, not {type(shape).__name__}")
    return shape


def _require_kept(sensor: SensorModel, depth_m: Floats) -> None:
    """Raise ContractError unless the sensor keeps depths (H, W), metres, or refuses depths."""
    try:
        shape = _read(sensor, depth_m)
    except TouchError:  # the true contact shape of an image is unknown here
        return
    form, found = sensor.geometry.shape, np.asarray(shape.depth_m)
    require(found.shape == form, f"a contact shape has the image's size {form}, not {found.shape}")
    kept = depth_m < shape.press_depth_m
    whole = np.fmin(depth_m, shape.press_depth_m)
    undone = {
        "depths are in millimetres": found / 1e3,
        "depths are multiplied by 1e-3 once too often": found * 1e3,
        "depths are counted from the gel at rest; 0 is the deepest point": shape.press_depth_m - found,
        "columns are in the opposite order": found[:, ::-1],
        "rows are in the opposite order": found[::-1],
        "the image is turned by half a turn": found[::-1, ::-1],
        "the image is transposed": found.T,
        "the image is turned by a quarter turn": np.rot90(found),
        "the image is turned back by a quarter turn": np.rot90(found, -1),
    }

    def explains(depth: NDArray[np.floating]) -> bool:
        return depth.shape == whole.shape and bool((np.abs(depth - whole)[kept] <= 1e-6).all())

    require_close(
        found[kept], depth_m[kept], 1e-7, "depths in metres must be kept", lambda: name_cause(undone, explains)
    )
    require(not shape.contact[~kept].any(), "a pixel at the press depth or deeper, or NaN, must not be in contact")
    require(shape.contact.any(), "a pixel above the press depth must be in contact")
