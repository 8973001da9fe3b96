"""Nominal sensors. Real sensors differ a little: for real work, measure your sensor and write a sensor file."""

import dataclasses
from typing import ClassVar

import numpy as np
from pydantic import Field

from tactile_loc.plugin import SensorGeometry
from tactile_loc.plugin.helpers import DepthSensor, GelOptions

# With parallel rays, images do not depend on the standoff. It only sets the surface's position in the sensor frame.
ORTHOGRAPHIC_STANDOFF_M = 10e-3


def make_orthographic(width_px: int, height_px: int, pixel_pitch_m: float, max_depth_m: float) -> SensorGeometry:
    """Return a centred orthographic camera with square pixels. Raises SensorError for impossible numbers."""
    scale = 1.0 / pixel_pitch_m
    return SensorGeometry(
        "orthographic",
        width_px,
        height_px,
        scale,
        scale,
        width_px / 2,
        height_px / 2,
        standoff_m=ORTHOGRAPHIC_STANDOFF_M,
        max_depth_m=max_depth_m,
    )


class Preset(DepthSensor):
    """A sensor of a known make: its `native` geometry, resized to `default_size_px` (width, height) by default."""

    native: ClassVar[SensorGeometry]
    default_size_px: ClassVar[tuple[int, int] | None] = None

    class Options(GelOptions):
        """`image_size_px` (width, height) and `max_depth_mm`; None keeps the preset's value."""

        image_size_px: tuple[int, int] | None = Field(None, description="image size (width, height), pixels")
        max_depth_mm: float | None = Field(None, description="deepest press that the sensor resolves, mm")

    def _make_geometry(self) -> SensorGeometry:
        geometry = self.native
        if self.options.max_depth_mm is not None:
            geometry = dataclasses.replace(geometry, max_depth_m=self.options.max_depth_mm * 1e-3)
        size = self.options.image_size_px or self.default_size_px
        return geometry if size is None else geometry.resize(*size)


class GelSlim(Preset):
    """GelSlim with the numbers of Bauza et al. (CoRL 2020): a pinhole camera that sees 40.3 x 40.7 mm of the surface.

    The native image of 470 x 470 px is resized to 200 x 200 px. The maximal depth is 2 mm. No thickness of the gel was
    found in the publications on the GelSlim, so an elastic gel is 4 mm thick by default.
    """

    native = SensorGeometry(
        "pinhole", 470, 470, fx=291.5, fy=289.0, cx=235.0, cy=235.0, standoff_m=25e-3, max_depth_m=2e-3
    )
    default_size_px = (200, 200)


class GelSightMini(Preset):
    """GelSight Mini, nominal: orthographic, 320 x 240 px of 0.0634 mm (20.3 x 15.2 mm), maximal depth 1 mm.

    The scale was measured for a public calibration set of 320 x 240 images with balls of 9.47 mm, in the repository
    gs_sdk. The maximal depth is nominal. The thickness of the gel, 4.25 mm, is that of the repository tactile-mnist,
    which simulates the GelSight Mini (`tactile_mnist/constants.py`).
    """

    native = make_orthographic(320, 240, 0.0634e-3, 1e-3)
    gel_thickness_m = 4.25e-3


class GelSightR15(Preset):
    """GelSight R1.5, nominal: orthographic, 240 x 320 px of 0.0877 mm (21.0 x 28.1 mm), maximal depth 1 mm.

    Size and scale are those of `GELSIGHT_R15_CFG` in Isaac Lab. The maximal depth is nominal. No thickness of the gel
    was found, so an elastic gel is 4 mm thick by default.
    """

    native = make_orthographic(240, 320, 0.0877e-3, 1e-3)


class Digit(Preset):
    """DIGIT, nominal: orthographic, 240 x 320 px of 0.063 mm (15.1 x 20.2 mm), maximal depth 1 mm.

    None of these numbers was measured, and public numbers disagree. A DIGIT fork of the Taxim simulator uses 640 x 480
    px of 0.0266 mm (12.8 x 17.0 mm). The configuration of digit-depth states a measured gel of 18.35 x 24.6 mm. The
    scale may be wrong by 20 %. The thickness of the gel, 4.6 mm, is that of the same configuration
    (`config/digit.yaml`). The real gel is curved: choose digit-curved, or measure your sensor and write a sensor file.
    """

    native = make_orthographic(240, 320, 0.063e-3, 1e-3)
    gel_thickness_m = 4.6e-3


class CurvedDigit(Digit):
    """DIGIT with a curved gel: a spherical cap with its top in the middle of the image. The rest is as in `Digit`.

    The radius of 35 mm is nominal. In the TACTO simulator, the corners of a gel of 20 x 30 mm lie 5 mm below the top.
    """

    class Options(Preset.Options):
        """The sphere's `radius_mm`. The standoff is the distance from the camera to the sphere's top."""

        radius_mm: float = Field(default=35.0, ge=15.0, description="radius of the gel's surface, mm")

    def _make_geometry(self) -> SensorGeometry:
        geometry, radius_m = super()._make_geometry(), 1e-3 * self.options.radius_mm
        x, y = geometry.pixel_slopes
        relief_m = np.sqrt(radius_m**2 - x[None] ** 2 - y[:, None] ** 2) - radius_m
        return dataclasses.replace(geometry, relief_m=relief_m.astype(np.float32))
