"""Simulated touches for evaluations, as contact shapes or as images."""

import dataclasses
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import ConfigError, TouchError, name_source
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.io.config import SlotConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.simulate.touch_simulation import draw_touches
from tactile_loc.slots.registry import registry

log = logging.getLogger(__name__)

MOST_DRAWS = 20  # most draws of one touch, in case its image shows no contact


@dataclass(frozen=True)
class SimulatedTouches:
    """Touches of a localizer's object with a noise of `tactile_loc.core.sensing.noise`.

    Touch i of a seed is always the same, with any number of touches and any encoder. With `images`, the sensor reads
    each touch from a simulated image made with the lamps of its calibration. The sensor must be calibrated on simulated
    images, and the only noise is the camera's. Raises ConfigError for `images` with any noise except "none".
    `renderer` draws the touches; by default, the localizer's own does.
    """

    noise: str = "none"
    seed: int = 0
    images: bool = False
    renderer: SlotConfig | None = None

    def __post_init__(self) -> None:
        if self.images and self.noise != "none":
            raise ConfigError(f"the noise {self.noise!r} is for contact shapes, not for images; leave out `noise`")

    def draw_touch(self, localizer: Localizer, number: int) -> Touch:
        """Return touch `number` with its true pose; see `draw_counted`."""
        return self.draw_counted(localizer, number)[0]

    def draw_counted(self, localizer: Localizer, number: int) -> tuple[Touch, int]:
        """Return touch `number` with its true pose, and the number of presses refused before it.

        A touch whose image shows no contact is drawn again, with a warning. Raises CalibrationError, ConfigError or
        TouchError if no image can be made or read.
        """
        refused = 0
        for draw in range(MOST_DRAWS):
            drawn, without_touch = self._draw_once(localizer, number, draw)
            refused += without_touch
            if not self.images:
                return drawn, refused
            try:
                return read_image(localizer, drawn, np.random.default_rng(self.seed_touch(number, 2))), refused
            except TouchError as error:
                refused += 1
                log.warning(
                    "%s of %s is replaced by another simulated touch: %s", drawn.name, localizer.object.name, error
                )
        raise TouchError(f"hardly any image of {localizer.object.name} shows contact; calibrate the sensor better")

    def require_readable(self, localizer: Localizer) -> None:
        """Raise CalibrationError or ConfigError if the localizer's sensor cannot read these touches."""
        if self.images:
            geometry = localizer.scene.geometry
            untouched = np.full(geometry.shape, geometry.max_depth_m, np.float32)
            shape = ContactShape(untouched, geometry.max_depth_m)
            with name_source(localizer.config.sensor.name):
                localizer.sensor.simulated_image(shape, np.random.default_rng(0))

    def describe_kind(self) -> str:
        """Return a short description of the touches, for titles."""
        return "as images" if self.images else f"noise: {self.noise}"

    def seed_touch(self, number: int, purpose: int) -> np.random.SeedSequence:
        """Return a seed for a touch: for the touch (purpose 0), the protocol (1), its image (2)."""
        return np.random.SeedSequence([self.seed, number, purpose])

    def describe(self, localizer: Localizer) -> dict[str, Any]:
        """Return all inputs of a localizer's touches, as JSON values."""
        described: dict[str, Any] = {"noise": make_noise(self.noise).describe(), "seed": self.seed}
        described |= {"images": localizer.sensor.describe()} if self.images else {}
        return described | (
            {} if self.renderer is None else {"renderer": self._make_scene(localizer).renderer.describe()}
        )

    def _make_scene(self, localizer: Localizer) -> Scene:
        """Return the localizer's scene with the renderer that draws the touches."""
        if self.renderer is None:
            return localizer.scene
        renderer = registry().create("renderer", self.renderer.name, self.renderer.options)
        return dataclasses.replace(localizer.scene, renderer=renderer)

    def _draw_once(self, localizer: Localizer, number: int, draw: int) -> tuple[Touch, int]:
        """Return the touch of one draw, and the number of presses refused before it."""
        sequence = self.seed_touch(number, 0)
        seed = int((sequence.spawn(draw)[-1] if draw else sequence).generate_state(1, np.uint64)[0])
        rng, noise = np.random.default_rng(seed), make_noise(self.noise)
        (touch,), refused = draw_touches(localizer.sampler, self._make_scene(localizer), 1, rng, noise=noise)
        return dataclasses.replace(touch, name=f"touch-{number:04d}"), refused


def require_true_pose(touch: Touch) -> Floats:
    """Return a touch's true pose (4, 4), metres. Raises TouchError if the pose is unknown."""
    if touch.T_sensor_object is None:
        raise TouchError(f"{touch.name} has no true pose to compare with; give a touch from tactile-loc simulate")
    return touch.T_sensor_object


def read_image(localizer: Localizer, touch: Touch, rng: np.random.Generator) -> Touch:
    """Return the touch that the sensor reads from a simulated image of `touch`.

    Raises TouchError if the image shows no contact.
    """
    image = localizer.sensor.simulated_image(touch.contact_shape, rng)
    shape = localizer.sensor.contact_shape(image)
    return dataclasses.replace(touch, contact_shape=shape, image=image)
