"""The touches that an evaluation asks about: simulated, as contact shapes or as the images that show them."""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError, TouchError
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.core.simulation.noise import make_noise
from tactile_loc.core.simulation.touch_simulation import draw_touches
from tactile_loc.locate.localizer import Localizer

log = logging.getLogger(__name__)

MOST_DRAWS = 20  # of a touch whose image shows none


@dataclass(frozen=True)
class SimulatedTouches:
    """Touches of a localizer's object, of a noise that `tactile_loc.core.simulation.noise` names.

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

    def draw_touch(self, localizer: Localizer, number: int) -> Touch:
        """Return touch `number` with its true pose; see `draw_counted`."""
        return self.draw_counted(localizer, number)[0]

    def draw_counted(self, localizer: Localizer, number: int) -> tuple[Touch, int]:
        """Return touch `number` with its true pose, and how many presses were refused before it showed a touch.

        One whose image shows no contact is drawn anew, with a warning. Raises CalibrationError, ConfigError or
        TouchError when no image can be made or read.
        """
        refused = 0
        for draw in range(MOST_DRAWS):
            drawn, without_touch = self._draw_once(localizer, number, draw)
            refused += without_touch
            if not self.images:
                return drawn, refused
            try:
                return _read_image(localizer, drawn, np.random.default_rng(self.seed_touch(number, 2))), refused
            except TouchError as error:
                refused += 1
                log.warning("%s of %s is drawn anew: %s", drawn.name, localizer.object.name, error)
        raise TouchError(f"hardly any image of {localizer.object.name} shows contact; calibrate the sensor better")

    def require_readable(self, localizer: Localizer) -> None:
        """Refuse a localizer whose sensor cannot read these touches. Raises CalibrationError, ConfigError."""
        if self.images:
            geometry = localizer.scene.geometry
            untouched = np.full(geometry.shape, geometry.max_depth_m, np.float32)
            try:
                localizer.sensor.simulated_image(
                    ContactShape(untouched, geometry.max_depth_m), np.random.default_rng(0)
                )
            except ConfigError as error:
                raise ConfigError(f"{localizer.config.sensor.name}: {error}") from error

    def describe_kind(self) -> str:
        """Return what kind of touches these are, for titles."""
        return "as images" if self.images else f"noise: {self.noise}"

    def seed_touch(self, number: int, purpose: int) -> np.random.SeedSequence:
        """Return the randomness of a touch (purpose 0), beside it (1), of its image (2), of measuring it again (3)."""
        return np.random.SeedSequence([self.seed, number, purpose])

    def describe(self, localizer: Localizer) -> dict[str, Any]:
        """Return what identifies the touches of a localizer, as JSON values."""
        described: dict[str, Any] = {"noise": make_noise(self.noise).describe(), "seed": self.seed}
        return described | ({"images": localizer.sensor.describe()} if self.images else {})

    def _draw_once(self, localizer: Localizer, number: int, draw: int) -> tuple[Touch, int]:
        """The touch of one draw, and how many presses were refused before it."""
        sequence = self.seed_touch(number, 0)
        seed = int((sequence.spawn(draw)[-1] if draw else sequence).generate_state(1, np.uint64)[0])
        rng, noise = np.random.default_rng(seed), make_noise(self.noise)
        (touch,), refused = draw_touches(localizer.sampler, localizer.scene, 1, rng, noise=noise)
        return dataclasses.replace(touch, name=f"touch-{number:04d}"), refused


def require_true_pose(touch: Touch) -> NDArray[np.float64]:
    """Return a touch's true pose (4, 4), metres. Raises TouchError when it is not known."""
    if touch.T_sensor_object is None:
        raise TouchError(f"{touch.name} has no true pose to compare with; simulate it")
    return touch.T_sensor_object


def _read_image(localizer: Localizer, touch: Touch, rng: np.random.Generator) -> Touch:
    """The touch as the sensor reads it from an image. Raises TouchError when it shows no contact."""
    image = localizer.sensor.simulated_image(touch.contact_shape, rng)
    shape = localizer.sensor.contact_shape(image)
    return Touch(shape, touch.geometry, touch.name, T_sensor_object=touch.T_sensor_object, image=image)
