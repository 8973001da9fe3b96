"""Simulated touches for evaluations."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import SlotConfig
from tactile_loc.locate.localizer import Localizer
from tactile_loc.simulate.touch_simulation import draw_touches
from tactile_loc.slots.registry import registry


@dataclass(frozen=True)
class SimulatedTouches:
    """Touches of a localizer's object with a noise of `tactile_loc.core.sensing.noise`.

    Touch i of a seed is always the same, with any number of touches and any encoder. `renderer` draws the touches; by
    default, the localizer's own does.
    """

    noise: str = "none"
    seed: int = 0
    renderer: SlotConfig | None = None

    def draw_touch(self, localizer: Localizer, number: int) -> Touch:
        """Return touch `number` with its true pose; see `draw_counted`."""
        return self.draw_counted(localizer, number)[0]

    def draw_counted(self, localizer: Localizer, number: int) -> tuple[Touch, int]:
        """Return touch `number` with its true pose, and the number of presses refused before it."""
        seed = int(self.seed_touch(number, 0).generate_state(1, np.uint64)[0])
        rng, noise = np.random.default_rng(seed), make_noise(self.noise)
        (touch,), refused = draw_touches(localizer.sampler, self._make_scene(localizer), 1, rng, noise=noise)
        return dataclasses.replace(touch, name=f"touch-{number:04d}"), refused

    def seed_touch(self, number: int, purpose: int) -> np.random.SeedSequence:
        """Return a seed for a touch: for the touch (purpose 0) or the protocol (1)."""
        return np.random.SeedSequence([self.seed, number, purpose])

    def describe(self, localizer: Localizer) -> dict[str, Any]:
        """Return all inputs of a localizer's touches, as JSON values."""
        renderer = {} if self.renderer is None else {"renderer": self._make_scene(localizer).renderer.describe()}
        return {"noise": make_noise(self.noise).describe(), "seed": self.seed, **renderer}

    def _make_scene(self, localizer: Localizer) -> Scene:
        """Return the localizer's scene with the renderer that draws the touches."""
        if self.renderer is None:
            return localizer.scene
        renderer = registry().create("renderer", self.renderer.name, self.renderer.options)
        return dataclasses.replace(localizer.scene, renderer=renderer)


def require_true_pose(touch: Touch) -> Floats:
    """Return a touch's true pose (4, 4), metres. Raises TouchError if the pose is unknown."""
    if touch.T_sensor_object is None:
        raise TouchError(f"{touch.name} has no true pose to compare with; give a touch from tactile-loc simulate")
    return touch.T_sensor_object
