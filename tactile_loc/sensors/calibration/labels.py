"""Labelled presses: the gel's indentation and slope at each pixel, under a ball.

The indentation is the depth of the surface below the untouched gel, metres. The slope is the indentation's derivative
along x and y of the sensor frame, unitless. Labels for a pinhole camera are approximate, because the image scale is
that at the untouched surface.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32
from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.reading.surface import differentiate

Image = NDArray[np.uint8]

SKIRT = 2.5  # distance from a ball's centre beyond which the gel is untouched, in radii of the visible circle
LARGEST_BALL_M = 1.0
STEEPEST = 0.98  # largest radius of a contact, share of the ball's radius
WIDEST = 1.6  # largest radius of a visible circle, share of the ball's: the gel around a deep press widens the circle


@dataclass(frozen=True, eq=False)
class PressLabel:
    """The label of one press: `indentation_m` (H, W) and `slope` (H, W, 2), float32, and `contact` (H, W), bool.

    `known` (H, W) marks the pixels at which the label holds. On a gel of unknown elasticity, the skirt between contact
    and untouched gel is unknown. `absolute` is False for a ball on such a gel, because the depth of its visible circle
    is unknown. The true indentation in the contact is then larger than the label by an unknown constant.
    """

    indentation_m: Float32
    slope: Float32
    contact: Bools
    known: Bools
    absolute: bool = True


def label_ball(
    geometry: SensorGeometry, centre_px: tuple[float, float], radius_px: float, ball_radius_m: float
) -> PressLabel:
    """Return the label of a ball from its visible circle in the image, with centre (x, y) and radius in pixels.

    Let rho be the distance from the centre on the surface, r the radius of the circle and R the radius of the ball. The
    indentation is sqrt(R^2 - rho^2) - sqrt(R^2 - r^2) inside the circle and 0 outside. In a press deeper than R, the
    circle is wider than the ball, and the label ends near the ball's equator, at STEEPEST radii. On a curved gel, the
    ball's centre is shifted until the ball's surface is parallel to the gel at the circle's centre. The mean
    indentation of the rim is then 0. Raises CalibrationError when the circle is wider than WIDEST radii, or when its
    centre is outside the image.
    """
    height, width = geometry.shape
    if not (0 <= centre_px[0] <= width and 0 <= centre_px[1] <= height):
        raise CalibrationError(
            f"the circle's centre ({centre_px[0]:g}, {centre_px[1]:g}) px is outside the image of {width} x {height} "
            "px; correct the centre"
        )
    r, R = radius_px * geometry.pixel_pitch_m, ball_radius_m
    if not (r > 0 and 0 < R <= LARGEST_BALL_M):
        raise CalibrationError(
            f"the circle's radius is {radius_px:g} px and the ball's is {1e3 * R:.3g} mm; both must be positive, and "
            f"the ball's at most {1e3 * LARGEST_BALL_M:g} mm"
        )
    if not r <= WIDEST * R:
        raise CalibrationError(
            f"the circle's radius is {radius_px:g} px or {1e3 * r:.3g} mm, more than {WIDEST:g} times the ball's "
            f"{1e3 * R:.3g} mm; check both radii and the pixel size"
        )
    skirt, r = SKIRT * r, min(r, STEEPEST * R)
    sx, sy = geometry.scale_at_surface
    x = ((np.arange(width) + 0.5 - centre_px[0]) / sx)[None, :]
    y = ((np.arange(height) + 0.5 - centre_px[1]) / sy)[:, None]
    rho2 = x**2 + y**2
    contact = rho2 < r**2
    relief_m = np.zeros(geometry.shape) if geometry.relief_m is None else geometry.relief_m.astype(float)
    gel = differentiate(relief_m, geometry)
    tilt_x, tilt_y = gel[contact].mean(axis=0) if contact.any() else np.zeros(2)
    length = np.sqrt(1 + tilt_x**2 + tilt_y**2)
    x, y = x + R * tilt_x / length, y + R * tilt_y / length
    below = np.sqrt(np.maximum(R**2 - (x**2 + y**2), (R * (1 - STEEPEST)) ** 2))
    pushed = below if geometry.relief_m is None else below + geometry.relief_m
    rim = np.sqrt(R**2 - r**2) if geometry.relief_m is None else _average_rim(pushed, rho2, r, geometry.pixel_pitch_m)
    indentation = np.where(contact, pushed - rim, 0.0).astype(np.float32)
    slope = (gel + np.stack([-x / below, -y / below], axis=-1)) * contact[..., None]
    return PressLabel(indentation, slope.astype(np.float32), contact, contact | (rho2 > skirt**2), False)


def _average_rim(pushed_m: NDArray[np.float64], rho2: NDArray[np.float64], r: float, width_m: float) -> float:
    """Return the mean of depths (H, W), metres, at the pixels within `width_m` of a circle with radius r, metres.

    `rho2` (H, W) are the squared distances from the circle's centre, m^2.
    """
    along = np.abs(np.sqrt(rho2) - r) < width_m
    return float(pushed_m[along].mean()) if along.any() else 0.0
