"""Touches drawn by a renderer of tactile-loc, with its model of the gel and of noise."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from tactile_loc.plugin import ComponentOptions, ContactShape, Poses, Scene, registry
from tactile_loc.plugin.helpers import NoiseLevel, make_noise

from tactile_loc_benchmark.interfaces import SimulatedSource


class RenderedTouches(SimulatedSource):
    """Draws contact shapes with a renderer that the default method does not use."""

    licence: ClassVar[str] = "own"

    class Options(ComponentOptions):
        """The renderer, the sensor and the noise."""

        renderer: Literal["raycast", "zbuffer", "heightmap", "pyrender"] = Field(
            default="zbuffer", description="the renderer that draws the touches"
        )
        sensor: str = Field(default="gelsight-mini", description="the sensor's name")
        gel: Literal["rigid", "layer"] = Field(default="rigid", description="the sensor's gel: rigid or layer")
        noise: NoiseLevel = Field(default="none", description="the noise of the touches: none, mild or strong")

    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the sensor's table; nothing has to be calibrated."""
        return {"name": self.options.sensor, "gel": self.options.gel}

    def press(self, scene: Scene, T_sensor_object: Poses, rng: np.random.Generator) -> ContactShape:
        """Return the contact shape that the gel shows."""
        renderer = registry().create("renderer", self.options.renderer, {})
        geometry, press_m = scene.geometry, scene.geometry.indentation_m
        clean = Scene(scene.object, geometry, renderer).render_gel_depths(T_sensor_object[None])
        noise, press = make_noise(self.options.noise), np.array([press_m])
        measured_m = noise.measure_press(press, geometry.max_depth_m, rng)
        depth_m = noise.cut(noise.corrupt(clean, press, geometry, rng), press, measured_m)
        return ContactShape(depth_m[0], float(measured_m[0]))
