"""Reads images: checks that an image is this sensor's, measures the press depth, and finds the contact shape.

The health of an image consists of two figures, which increase when the gel wears or a lamp moves. The first figure is
the change of the untouched gel's colour. The second is the share of the estimated slopes that fits no surface. The
slopes of a surface sum to zero around any closed loop. Slopes that are estimated under changed light do not.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture
from scipy.ndimage import binary_opening, gaussian_filter, gaussian_laplace, label

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.runtime.errors import NoContactError, TouchError, mention_source
from tactile_loc.core.sensing.gel import RIGID, Gel
from tactile_loc.core.sensing.gel_surface import recover_contact
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.photometric import PhotometricEstimator
from tactile_loc.sensors.reading.surface import differentiate, integrate

logger = logging.getLogger(__name__)

SKIRT, MOST_SKIRT = 0.3, 0.75  # least and greatest indentation of the contact's border, share of the press depth
STEEP = 0.25  # least slope of the skirt, share of the steepest slope
HANGING_M = 1 / 600  # least ratio of slope to curvature in the skirt; on a ball it is half the distance from the tip
SMOOTHING_M = 1e-4  # standard deviation of the smoothing of slope and curvature
TIP_M = 3e-4  # the press depth is the least indentation in the deepest area of TIP_M x TIP_M
WIDER, TOWARDS_TIP = 4.0, 0.7  # for extrapolating to a sharp tip: see `extrapolate_press_m`
LEAST_M = 5e-5  # no sensor distinguishes a lighter press from no contact
ABOVE_NOISE = 4.0  # least press depth, in standard deviations of the noise
ABOVE_FALSE = 1.5  # least press depth, as a multiple of the false press of the untouched gel
MOST_FALSE_M = 1e-4  # largest threshold that follows from a false press; a larger one means an unreliable image
TOUCHING = 0.2  # least integrated indentation where the gel may touch the object, share of the press depth
BLACK, WHITE = 8, 253  # largest count of a black pixel, and least count of a saturated pixel, of 255
STRANGE = 22  # largest median difference from the untouched gel, counts; presses have 2 to 19


def reduce_image(image: Image, shape: tuple[int, int]) -> Image:
    """Return an image (H, W, 3) at a smaller size (rows, columns), by averaging over the area of each new pixel."""
    if image.shape[:2] == shape:
        return image
    return np.asarray(Picture.fromarray(image).resize(shape[::-1], Picture.Resampling.BOX))


def require_image(
    image: NDArray[Any],
    background: Image,
    camera_px: tuple[int, int] | None = None,
    advice: str = "calibrate this sensor",
) -> Image:
    """Check an image against the `background` (H, W, 3), and return the image at the background's size.

    The background is an image of the untouched gel. An image of the camera's size `camera_px` (rows, columns) is
    reduced. `advice` says what to do about an image of another sensor. Raises TouchError for another size or type, and
    for an image that is black, mostly saturated, or different from the background everywhere.
    """
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise TouchError(
            f"the image is {image.dtype} of shape {image.shape}; convert it to colour with 8 bits, (H, W, 3)"
        )
    if image.shape[:2] == camera_px:
        image = reduce_image(image, background.shape[:2])
    if image.shape != background.shape:
        sizes = (image.shape, background.shape, camera_px or background.shape)
        got, want, own = (f"{shape[1]} x {shape[0]}" for shape in sizes)
        also = "" if own == want else f", reduced from the camera's {own}"
        raise TouchError(
            f"the image is {got} px (width x height) but the sensor was calibrated at {want}{also}; give images of the "
            "same camera, neither cropped nor resized"
        )
    if (image <= BLACK).all(axis=2).mean() > 0.95:
        raise TouchError("the image is black; check the sensor's light and its camera")
    if (image >= WHITE).any(axis=2).mean() > 0.5 > (background >= WHITE).any(axis=2).mean():
        raise TouchError("more than half of the image is saturated; lower the camera's exposure or gain")
    some = np.s_[::2, ::2]  # a quarter of the pixels has nearly the same median
    if np.median(np.abs(image[some].astype(np.int16) - background[some])) > STRANGE:
        raise TouchError(
            "the image differs from the untouched gel everywhere, so it shows another sensor or another light; "
            f"{advice}"
        )
    return image


def measure_press_m(indentation_m: Float32, geometry: SensorGeometry, areas: float = 1.0) -> float:
    """Return the press depth, metres, of an indentation (H, W), metres.

    It is the least indentation of the deepest pixels that together cover `areas` areas of TIP_M x TIP_M.
    """
    pixels = max(1, round(areas * (TIP_M / geometry.pixel_pitch_m) ** 2))
    observed = np.sort(indentation_m[geometry.observed_mask])
    return float(observed[-min(pixels, len(observed))])


def extrapolate_press_m(indentation_m: Float32, geometry: SensorGeometry) -> tuple[float, float]:
    """Return the press depth of a gel surface (H, W), metres, and the standard deviation of its error, metres.

    A sharp tip is narrower than the area that `measure_press_m` considers. The indentation is therefore extrapolated
    from this area and from one that is WIDER times as large. Between a cone, whose indentation falls with the square
    root of the area, and a ridge, whose indentation falls with the area, the step is TOWARDS_TIP of the difference.
    """
    near_m, far_m = (measure_press_m(indentation_m, geometry, area) for area in (1.0, WIDER))
    step_m = TOWARDS_TIP * max(near_m - far_m, 0.0)
    return near_m + step_m, step_m


def find_contact_shape(
    indentation_m: Float32, geometry: SensorGeometry, noise_m: float, false_press_m: float = 0.0
) -> ContactShape:
    """Return the contact shape that an indentation (H, W), metres, shows.

    `noise_m` is the standard deviation of the indentation's noise, metres. `false_press_m` is the press depth that is
    falsely measured for the untouched gel, metres.

    The gel follows the object in the contact. Around the contact, its skirt slopes to the untouched surface.
    `find_contact` separates contact and skirt. The shape is cut at the indentation that gives the same contact area, so
    its press depth is smaller than the full press depth. The full press depth becomes the shape's `indentation_m`.

    Raises NoContactError when the press depth is below the detection limit.
    """
    press = _require_press(indentation_m, geometry, noise_m, false_press_m)
    contact = find_contact(indentation_m, press, geometry)
    observed = np.sort(indentation_m[geometry.observed_mask])
    pixels = min(int(np.count_nonzero(contact)), len(observed) - 1)
    level = float(observed[-pixels - 1])  # this many pixels are deeper
    if not SKIRT * press <= level <= MOST_SKIRT * press:
        level = min(max(level, SKIRT * press), MOST_SKIRT * press)
        contact = geometry.observed_mask & (indentation_m > level)
    cut = np.float32(press - level)
    depth = np.clip(np.float32(press) - indentation_m, 0, np.nextafter(cut, np.float32(0)))
    return ContactShape(np.where(contact, depth, cut).astype(np.float32), float(cut), press)


class Seen(NamedTuple):
    """What an image shows: the indentations (H, W), metres, of the gel and of a rigid gel, and the slopes (H, W, 2)."""

    indentation_m: Float32
    rigid_m: Float32
    slopes: Float32


def read_gel(estimator: PhotometricEstimator, image: Image, gel: Gel) -> Seen:
    """Return what an image (H, W, 3) shows. The surface of an elastic gel is recovered by contact mechanics."""
    integrated, slopes = estimator.read(image)
    if not gel.is_elastic:
        return Seen(integrated, integrated, slopes)
    return Seen(recover_indentation(integrated, slopes, replace(estimator.geometry, gel=gel)), integrated, slopes)


def recover_indentation(indentation_m: Float32, slopes: Float32, geometry: SensorGeometry) -> Float32:
    """Return the indentation (H, W), metres, of an elastic gel with slopes (H, W, 2).

    Only pixels at which the integrated `indentation_m` (H, W), metres, is large enough can touch the object. If it
    shows no contact, it is returned unchanged: the noise of untouched gel has no pressure.
    """
    press_m = measure_press_m(indentation_m, geometry)
    if press_m < LEAST_M:
        return indentation_m
    return recover_contact(slopes, indentation_m > TOUCHING * press_m, geometry).displacement_m


def find_gel_surface(
    indentation_m: Float32, geometry: SensorGeometry, noise_m: float, false_press_m: float = 0.0
) -> ContactShape:
    """Return the contact shape of an elastic gel, given the indentation (H, W), metres, that an image shows.

    The shape is the whole surface above the noise; `Touch.touching_shape` is the part that touches the object.
    `noise_m` and `false_press_m` are as for `find_contact_shape`, which raises the same error. The press depth is
    extrapolated to sharp tips.
    """
    _require_press(indentation_m, geometry, noise_m, false_press_m)
    press, std_m = extrapolate_press_m(indentation_m, geometry)
    press = min(press, geometry.max_depth_m)
    shown = geometry.observed_mask & (indentation_m > noise_m)
    depth = np.maximum(np.float32(press) - indentation_m, 0)
    return ContactShape(np.where(shown, depth, press).astype(np.float32), press, indentation_std_m=std_m)


def read_by_laws(seen: Seen, geometry: SensorGeometry, noise_m: float, false_press_m: float) -> ContactShape:
    """Return the contact shape of a measured elastic gel, and in `otherwise` the shapes by other laws of the gel.

    A real gel is no linear layer. The pressure of a layer shows the contact of light presses best. In heavy presses it
    spreads beyond the contact, which ends where the surface is steepest. A rigid gel is the other end of the laws.
    """
    surface = find_gel_surface(seen.indentation_m, geometry, noise_m, false_press_m)
    otherwise = []
    touching = surface.contact & find_contact(seen.indentation_m, surface.press_depth_m, geometry)
    if touching.any():
        otherwise.append((geometry.gel, replace(surface, touching=touching)))
    with suppress(NoContactError):
        rigid = find_contact_shape(seen.rigid_m, geometry, noise_m, false_press_m)
        otherwise.append((RIGID, rigid))
    return replace(surface, otherwise=tuple(otherwise))


def _require_press(indentation_m: Float32, geometry: SensorGeometry, noise_m: float, false_press_m: float) -> float:
    """Return the press depth, metres. Raises NoContactError if it is below the detection limit."""
    press = measure_press_m(indentation_m, geometry)
    least = max(LEAST_M, ABOVE_NOISE * noise_m, min(ABOVE_FALSE * false_press_m, MOST_FALSE_M))
    if press < least:
        raise NoContactError(
            f"no contact: the deepest press is {max(0.0, 1e3 * press):.2g} mm, below this image's detection limit of "
            f"{1e3 * least:.2g} mm"
        )
    return min(press, geometry.max_depth_m)


def find_contact(indentation_m: Float32, press_m: float, geometry: SensorGeometry) -> NDArray[np.bool_]:
    """Mark the pixels (H, W) of an indentation (H, W), metres, at which the gel touches the object.

    At the rim of a contact, the gel is bent around the object. The skirt is steep, and it is straight or bent the
    opposite way: its slope is more than HANGING_M times its curvature. At a steep wall of the object, the contact ends
    at the wall's edge.
    """
    pitch_m, surface = geometry.pixel_pitch_m, indentation_m.astype(np.float64)
    sigma = max(SMOOTHING_M / pitch_m, 0.5)
    slope = gaussian_filter(np.hypot(*np.gradient(surface, pitch_m)), sigma)
    bend = -gaussian_laplace(surface, sigma) / pitch_m**2
    hangs = (slope > STEEP * slope.max()) & (slope > HANGING_M * bend)
    parts, _ = label(binary_opening((surface > SKIRT * press_m) & ~hangs & geometry.observed_mask))
    deep = np.unique(parts[surface > 0.5 * press_m])
    return np.isin(parts, deep[deep > 0])


SMOOTHING_PX = 2.0  # standard deviation of the smoothing that removes the camera's noise
QUIETEST = 0.3  # share of the image that even a large contact leaves untouched
STEEP_SLOPE = 0.1  # least slope that counts: smaller slopes are mostly noise
FEWEST_STEEP = 0.01  # least share of steep pixels in the image
LEAST_LIGHT, LEAST_UNFIT = 3.0, 0.1  # least usual values of the two figures: counts, and a share
WARNED, REFUSED = 1.5, 2.5  # ratios to the calibration's worst press above which an image is doubtful or unusable


@dataclass(frozen=True)
class Health:
    """The health of a sensor in one image (H, W, 3).

    `light` is the QUIETEST quantile of the pixels' differences from the untouched gel, counts. A changed lamp changes
    the whole image, but even a large contact leaves this share of the pixels untouched.

    `unfit` is the share of the steep slopes that fits no surface: the RMS of the residuals divided by the RMS of the
    slopes. It is NaN if too few pixels are steep.
    """

    light: float
    unfit: float

    def compare(self, usual: Health) -> float:
        """Divide both figures by those of `usual`, the calibration's worst press, and return the larger ratio."""
        light = self.light / max(usual.light, LEAST_LIGHT)
        return float(np.fmax(light, self.unfit / np.fmax(usual.unfit, LEAST_UNFIT)))

    def record(self) -> dict[str, float | None]:
        """Return the figures as JSON values."""
        return {name: value if np.isfinite(value) else None for name, value in asdict(self).items()}

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> Health:
        """Return the health that `record` returned as JSON values."""
        return cls(*(np.nan if record[name] is None else float(record[name]) for name in ("light", "unfit")))


def measure_health(image: Image, untouched: Image, slopes: Float32, geometry: SensorGeometry) -> Health:
    """Return the health of an image (H, W, 3), given the estimated `slopes` (H, W, 2)."""
    difference = np.moveaxis(image.astype(np.float32) - untouched, -1, 0)
    smooth = np.stack([gaussian_filter(plane, SMOOTHING_PX) for plane in difference])
    light = float(np.quantile(np.abs(smooth).max(axis=0)[::2, ::2], QUIETEST))
    return Health(light, _measure_unfit(slopes, geometry))


def _measure_unfit(slopes: Float32, geometry: SensorGeometry) -> float:
    """Return the share of the steep slopes (H, W, 2) that the nearest surface does not explain.

    The share is NaN when too few pixels are steep.
    """
    steep = np.hypot(slopes[..., 0], slopes[..., 1]) > STEEP_SLOPE
    if np.count_nonzero(steep) < FEWEST_STEEP * steep.size:
        return float(np.nan)
    off = differentiate(integrate(slopes, geometry), geometry)[steep] - slopes[steep]
    return float(np.sqrt(np.sum(off**2) / np.sum(slopes[steep] ** 2, dtype=float)))


def find_worst(presses: Iterable[Health]) -> Health:
    """Return the largest value of each figure over several presses."""
    lights, unfits = zip(*((one.light, one.unfit) for one in presses), strict=True)
    known = [value for value in unfits if np.isfinite(value)]
    return Health(max(lights), max(known, default=float(np.nan)))


def require_healthy(found: Health, usual: Health) -> None:
    """Compare an image's health with that of the calibration's worst press.

    Logs a warning when the ratio is above WARNED. Raises TouchError when the ratio is above REFUSED.
    """
    figure = found.compare(usual)
    if figure <= WARNED:
        return
    of_light = figure == replace(found, unfit=np.nan).compare(usual)
    cause = "the light has changed" if of_light else "the slopes fit no surface"
    text = (
        f"the image deviates {figure:.1f} times as much as the calibration's worst press ({cause}); "
        "give a new image of the untouched gel (`zero`), or calibrate the sensor again"
    )
    if figure > REFUSED:
        raise TouchError(text)
    logger.warning(mention_source(text))
