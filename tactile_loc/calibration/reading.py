"""Reading an image: is it one of this sensor's, is there contact, how deep, and which contact shape is it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.labels import Image
from tactile_loc.core.errors import NoContactError, TouchError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.io.images import read_colour_image

SKIRT, MOST_SKIRT = 0.3, 0.75  # of the press: below the first nothing touches, and above the second all that is left
STEEP = 0.25  # of the steepest slope: what is flatter hangs nowhere
HANGING_M = 1 / 600  # slope over curvature: a ball's is half the distance from its tip
SMOOTHING_M = 1e-4  # of slope and curvature: standard deviation
TIP_M = 3e-4  # the press depth is that of the deepest area of this size, squared
LEAST_M = 5e-5  # no sensor tells a lighter press from none
ABOVE_NOISE = 4.0  # noise floors that a press stands out by
ABOVE_FALSE = 1.5  # times what the untouched gel seems to be pressed, by error
MOST_FALSE_M = 1e-4  # more of that is no reason to refuse a press: what the gel looks like is then known badly
BLACK, WHITE = 8, 253  # counts of 255
STRANGE = 22  # counts by which half the image may differ from the untouched gel's; presses do by 2 to 19


def reduce_image(image: Image, shape: tuple[int, int]) -> Image:
    """Return an image (H, W, 3) at a smaller size (rows, columns): each pixel is the mean of what it covers."""
    from PIL import Image as Picture

    if image.shape[:2] == shape:
        return image
    return np.asarray(Picture.fromarray(image).resize(shape[::-1], Picture.Resampling.BOX))


def require_image(image: NDArray[Any], background: Image, camera_px: tuple[int, int] | None = None) -> Image:
    """Return an image that can be this sensor's, as large as `background` (H, W, 3), that of the untouched gel.

    One of the camera's own size `camera_px` (rows, columns) is reduced to it. Raises TouchError for another size or
    type, or what no gel looks like: all black, mostly saturated, or altogether unlike the background.
    """
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise TouchError(
            f"the image is {image.dtype} of shape {image.shape}; it must be colour, (H, W, 3) of 8 bits; convert it"
        )
    if image.shape[:2] == camera_px:
        image = reduce_image(image, background.shape[:2])
    if image.shape != background.shape:
        sizes = (image.shape, background.shape, camera_px or background.shape)
        got, want, own = (f"{shape[1]} x {shape[0]}" for shape in sizes)
        also = "" if own == want else f", reduced from the camera's {own}"
        raise TouchError(
            f"the image is {got} px (width x height) but the sensor was calibrated at {want}{also}; was it taken by "
            "another camera, or cut or resized?"
        )
    if (image <= BLACK).all(axis=2).mean() > 0.95:
        raise TouchError("the image is black; is the sensor's light on, and its camera uncovered?")
    if (image >= WHITE).any(axis=2).mean() > 0.5 > (background >= WHITE).any(axis=2).mean():
        raise TouchError("more than half of the image is saturated; lower the camera's exposure or its gain")
    some = np.s_[::2, ::2]  # the median of a quarter is that of all
    if np.median(np.abs(image[some].astype(np.int16) - background[some])) > STRANGE:
        raise TouchError(
            "the image does not look like the sensor's untouched gel anywhere; was it taken by another sensor, or has "
            "the light changed? calibrate this one"
        )
    return image


def read_zero(path: Path) -> Image:
    """Return a newer image (H, W, 3) of the untouched gel. Raises TouchError when the file holds no colour image."""
    image = read_colour_image(path)
    if image is None:
        raise TouchError(f"{path} is no colour image; as the untouched gel (--zero) give a photo of it, PNG or JPEG")
    return image


def measure_press_m(indentation_m: NDArray[np.float32], geometry: SensorGeometry) -> float:
    """Return how deep the gel is pressed in, metres: at the border of the deepest TIP_M x TIP_M of (H, W)."""
    pixels = max(1, round((TIP_M / geometry.pixel_pitch_m) ** 2))
    observed = np.sort(indentation_m[geometry.observed_mask])
    return float(observed[-min(pixels, len(observed))])


def find_contact_shape(
    indentation_m: NDArray[np.float32], geometry: SensorGeometry, noise_m: float, sees_skirt: bool = True,
    false_press_m: float = 0.0,
) -> ContactShape:  # fmt: skip
    """Return the contact shape of an indentation (H, W), metres, whose noise is `noise_m`.

    Untouched, the gel seems to be pressed by `false_press_m` metres.
    The object is where the gel is, except at the skirt, where the gel hangs from the contact's edge to its untouched
    surface: `find_contact` tells them apart. The shape is cut at a lighter press, which leaves as much contact: a steep
    edge is then where it is, and a ball's imprint as wide as at that press; how deep the object really was is its
    indentation. An indentation that is of the contact alone
    (`sees_skirt` False) is cut where it stands out of the noise. Raises TouchError when the gel is not pressed in.
    """
    press = measure_press_m(indentation_m, geometry)
    least = max(LEAST_M, ABOVE_NOISE * noise_m, min(ABOVE_FALSE * false_press_m, MOST_FALSE_M))
    if press < least:
        raise NoContactError(
            f"no contact: nowhere is the gel pressed in by {1e3 * least:.2g} mm, the least that stands out here "
            f"(deepest: {max(0.0, 1e3 * press):.2g} mm)"
        )
    press = min(press, geometry.max_depth_m)
    if not sees_skirt:
        contact = geometry.observed_mask & (indentation_m > least)
        depth = np.maximum(np.float32(press) - indentation_m, 0)
        return ContactShape(np.where(contact, depth, press).astype(np.float32), press)
    contact = find_contact(indentation_m, press, geometry)
    observed = np.sort(indentation_m[geometry.observed_mask])
    pixels = min(int(np.count_nonzero(contact)), len(observed) - 1)
    level = float(observed[-pixels - 1])  # as many are deeper
    if not SKIRT * press <= level <= MOST_SKIRT * press:
        level = min(max(level, SKIRT * press), MOST_SKIRT * press)
        contact = geometry.observed_mask & (indentation_m > level)
    cut = np.float32(press - level)
    depth = np.clip(np.float32(press) - indentation_m, 0, np.nextafter(cut, np.float32(0)))
    return ContactShape(np.where(contact, depth, cut).astype(np.float32), float(cut), press)


def find_contact(indentation_m: NDArray[np.float32], press_m: float, geometry: SensorGeometry) -> NDArray[np.bool_]:
    """Mark (H, W) where the gel lies on the object, and does not hang down from it, of an indentation (H, W), metres.

    At a contact's rim the gel bends over it; where it hangs it is steep, and straight or bent the other way. The border
    is where the slope is no more than HANGING_M times the bend: at a wall, that is its edge.
    """
    from scipy.ndimage import binary_opening, gaussian_filter, gaussian_laplace, label

    pitch_m, surface = geometry.pixel_pitch_m, indentation_m.astype(np.float64)
    sigma = max(SMOOTHING_M / pitch_m, 0.5)
    slope = gaussian_filter(np.hypot(*np.gradient(surface, pitch_m)), sigma)
    bend = -gaussian_laplace(surface, sigma) / pitch_m**2
    hangs = (slope > STEEP * slope.max()) & (slope > HANGING_M * bend)
    parts, _ = label(binary_opening((surface > SKIRT * press_m) & ~hangs & geometry.observed_mask))
    deep = np.unique(parts[surface > 0.5 * press_m])
    return np.isin(parts, deep[deep > 0])
