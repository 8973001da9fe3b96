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
# Of the press depth, what a pixel counts for being in contact at all: as much as the deepest imprint does. With less,
# the depth, which noise falsifies first, decides between poses; with more, depth hardly matters.
OUTLINE_SHARE = 1.0


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
        depth = self.renderer.render_apart(self.object.mesh, T_sensor_object, self.geometry)
        return contact_depth(
            depth, self.geometry, self.geometry.max_depth_m if press_depth_m is None else press_depth_m
        )

    def grid_depths(self, T_sensor_object: Poses) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres, at full press, of a grid's poses: many share a rotation."""
        depth = self.renderer.render(self.object.mesh, T_sensor_object, self.geometry)
        return contact_depth(depth, self.geometry, self.geometry.max_depth_m)

    def contact_shape(self, T_sensor_object: NDArray[np.float64], press_depth_m: float) -> ContactShape:
        """Render the contact shape of one pose (4, 4), brought to contact, at a press depth in metres."""
        T, _ = self.in_contact(T_sensor_object[None])
        return ContactShape(self.contact_depths(T, press_depth_m)[0], press_depth_m)

    def overlap(self, T_sensor_object: NDArray[np.float64], touch: Touch) -> float:
        """Return how well a pose (4, 4), metres, explains a touch: 0 (not at all) to 1, unitless."""
        return self.overlaps(T_sensor_object[None], touch)[0]

    def overlaps(self, T_sensor_object: Poses, touch: Touch) -> list[float]:
        """Return how well each of the poses (N, 4, 4), metres, explains a touch: 0 (not at all) to 1, unitless.

        The intersection over union of the touch's contact and the one that the pose makes at the same press depth,
        where the sensor observes, on about OVERLAP_PX pixels a side.
        """
        return self.overlaps_and_explained(T_sensor_object, touch)[0]

    def explained(self, T_sensor_object: Poses, touch: Touch) -> NDArray[np.float64]:
        """Return how well poses (N, 4, 4), metres, explain a touch in depth and outline: (N,), 0 to 1, unitless.

        A generalised intersection over union: the sum of the smaller over the sum of the larger of what pose and touch
        press in, raised by OUTLINE_SHARE of the press depth wherever there is contact. At the touch's press depth,
        where the sensor observes, on about OVERLAP_PX pixels a side. A pose without contact explains nothing.
        """
        return self.overlaps_and_explained(T_sensor_object, touch)[1]

    def overlaps_and_explained(self, T_sensor_object: Poses, touch: Touch) -> tuple[list[float], NDArray[np.float64]]:
        """Return both scores of poses (N, 4, 4), metres, which are drawn once."""
        geometry, wanted = touch.thinned(OVERLAP_PX)
        coarse, press_m = dataclasses.replace(self, geometry=geometry), touch.press_depth_m
        made = coarse.contact_depths(coarse.in_contact(T_sensor_object)[0], press_m)
        overlaps = [ContactShape(depth, press_m).overlap(wanted, geometry.observed_mask) for depth in made]
        a, b = (_imprint(depth_m, press_m, geometry.observed_mask) for depth_m in (made, wanted.depth_m))
        common, either = (np.sum(both, axis=(-2, -1), dtype=float) for both in (np.minimum(a, b), np.maximum(a, b)))
        return overlaps, np.asarray(common / np.maximum(either, 1.0), float)


def _imprint(depth_m: NDArray[np.float32], press_depth_m: float, observed: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Shares of the press depth (..., H, W) by which contact depths are pressed in, raised where there is contact."""
    press = np.float32(press_depth_m)
    return np.where((depth_m < press) & observed, np.float32(1 + OUTLINE_SHARE) - depth_m / press, np.float32(0))
