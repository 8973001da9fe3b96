"""The touches that an evaluation asks about: simulated, as contact shapes or as the images that show them."""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_loc.calibration.folder import Calibration
from tactile_loc.core.errors import ConfigError, TouchError
from tactile_loc.core.noise import noise_level
from tactile_loc.core.sensing import Touch
from tactile_loc.imaging.simulate import touch_images
from tactile_loc.locate.localizer import Localizer

log = logging.getLogger(__name__)

MOST_DRAWS = 20  # of a touch whose image shows none


@dataclass(frozen=True)
class SimulatedTouches:
    """Touches of a localizer's object, of a noise that `tactile_loc.core.noise` names.

    Number i of a seed is always the same touch: how many there are, and the encoder, play no part. With `images` the
    sensor, which must have been calibrated on simulated images, reads it from an image made with the same lamps; the
    camera's is then the only noise. Raises ConfigError for another noise than "none" with images.
    """

    noise: str = "none"
    seed: int = 0
    images: bool = False

    def __post_init__(self) -> None:
        if self.images and self.noise != "none":
            raise ConfigError(
                f"noise {self.noise!r} is of contact shapes; images have their camera's own: leave --noise out"
            )

    def touch(self, localizer: Localizer, number: int) -> Touch:
        """Return touch `number` with its true pose.

        One whose image shows no contact is drawn anew, with a warning. Raises CalibrationError, ConfigError or
        TouchError when no image can be made or read.
        """
        for draw in range(MOST_DRAWS):
            drawn = self._drawn(localizer, number, draw)
            if not self.images:
                return drawn
            try:
                return _seen(localizer, drawn, np.random.default_rng(self.random(number, 2)))
            except TouchError as error:
                log.warning("%s of %s is drawn anew: %s", drawn.name, localizer.object.name, error)
        raise TouchError(f"hardly any image of {localizer.object.name} shows contact; calibrate the sensor better")

    def require_readable(self, localizer: Localizer) -> None:
        """Refuse a localizer whose sensor cannot read these touches. Raises CalibrationError, ConfigError."""
        if self.images:
            calibration_of(localizer)

    def in_words(self) -> str:
        """Return what kind of touches these are, for titles."""
        return "as images" if self.images else f"noise: {self.noise}"

    def random(self, number: int, purpose: int) -> np.random.SeedSequence:
        """Return the randomness of a touch (purpose 0), beside it (1) and of its image (2)."""
        return np.random.SeedSequence([self.seed, number, purpose])

    def describe(self, localizer: Localizer) -> dict[str, Any]:
        """Return what identifies the touches of a localizer, as JSON values."""
        described: dict[str, Any] = {"noise": noise_level(self.noise).describe(), "seed": self.seed}
        return described | ({"images": localizer.sensor.describe()} if self.images else {})

    def _drawn(self, localizer: Localizer, number: int, draw: int) -> Touch:
        sequence = self.random(number, 0)
        seed = int((sequence.spawn(draw)[-1] if draw else sequence).generate_state(1, np.uint64)[0])
        return dataclasses.replace(localizer.simulate(1, seed, noise=self.noise)[0], name=f"touch-{number:04d}")


def calibration_of(localizer: Localizer) -> Calibration:
    """Return the calibration by which a localizer's sensor reads images, one made on simulated images.

    Raises CalibrationError or ConfigError when no image can be made for the sensor.
    """
    chosen = localizer.config.sensor
    if chosen.name != "calibrated":
        raise ConfigError(
            f"sensor {chosen.name!r} reads no images; make one that does with tactile-loc calibrate --simulated and "
            "give its folder as --sensor"
        )
    calibration: Calibration = localizer.sensor.calibration
    _ = calibration.optics
    return calibration


def _seen(localizer: Localizer, touch: Touch, rng: np.random.Generator) -> Touch:
    """The touch as the sensor reads it from an image. Raises TouchError when it shows no contact."""
    depth_m, geometry, press_m = touch.contact_shape.depth_m[None], touch.geometry, np.array([touch.press_depth_m])
    calibration = calibration_of(localizer)
    image = touch_images(depth_m, press_m, geometry, calibration.optics, rng, background=calibration.background)[0]
    shape = localizer.sensor.contact_shape(image)
    return Touch(shape, geometry, touch.name, T_sensor_object=touch.T_sensor_object, image=image)
