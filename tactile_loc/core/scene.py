"""An object before a sensor: renders the contact shape of any pose."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.interfaces import Renderer
from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.poses import Poses
from tactile_loc.core.sensing import ContactShape, SensorGeometry, Touch, contact_depth

OVERLAP_PX = 100


@dataclass(frozen=True, eq=False)
class Scene:
    """The object, the sensor's geometry and the renderer that draws the one for the other."""

    object: ObjectModel
    geometry: SensorGeometry
    renderer: Renderer

    def in_contact(self, T_sensor_object: Poses) -> tuple[Poses, NDArray[np.bool_]]:
        """Bring poses (N, 4, 4) to contact along z; also return which (N,) touch the sensing rectangle. Metres."""
        from tactile_loc.core.contact import bring_to_contact

        return bring_to_contact(self.object.mesh, T_sensor_object, self.geometry)

    def contact_depths(self, T_sensor_object: Poses, press_depth_m: float | None = None) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres of poses (N, 4, 4) that are in contact already."""
        depth = self.renderer.render(self.object.mesh, T_sensor_object, self.geometry)
        return contact_depth(
            depth, self.geometry, self.geometry.max_depth_m if press_depth_m is None else press_depth_m
        )

    def contact_shape(self, T_sensor_object: NDArray[np.float64], press_depth_m: float) -> ContactShape:
        """Render the contact shape of one pose (4, 4), brought to contact, at a press depth in metres."""
        T, _ = self.in_contact(T_sensor_object[None])
        return ContactShape(self.contact_depths(T, press_depth_m)[0], press_depth_m)

    def overlap(self, T_sensor_object: NDArray[np.float64], touch: Touch) -> float:
        """Return how well a pose (4, 4), metres, explains a touch: 0 (not at all) to 1, unitless.

        The intersection over union of the touch's contact and the one that the pose makes at the same press depth,
        where the sensor observes, on about OVERLAP_PX pixels a side.
        """
        step = max(1, round(max(touch.geometry.shape) / OVERLAP_PX))
        geometry = touch.geometry.every(step)
        made = dataclasses.replace(self, geometry=geometry).contact_shape(T_sensor_object, touch.press_depth_m)
        return made.overlap(touch.contact_shape.every(step), geometry.observed_mask)
