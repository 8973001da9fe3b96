"""An object before a sensor, as a renderer draws it, and one touch as seen from another."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.deprecation import keep_old_names
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.sensing.imprints import Explained, compare_imprints
from tactile_loc.core.sensing.sensor_geometry import Drawing, SensorGeometry, find_drawing
from tactile_loc.core.sensing.touch import ContactShape, Touch, compute_contact_depth
from tactile_loc.core.slots.renderer import Renderer

IOU_PX = 100


# Of an indentation, what its measurement may be off by: a pose is as good if it explains a touch that much deeper.
PRESS_ERROR, LEAST_PRESS_ERROR_M = 0.2, 5e-5


@keep_old_names(
    as_seen="use_pressed_drawing",
    in_contact="bring_to_contact",
    nearly_in_contact="bring_near_contact",
    pressed="press",
    of_touch="match_touch",
    contact_depths="render_contact_depths",
    grid_depths="render_grid_depths",
    depths_explaining="render_depths_to_compare",
    explained="compare_imprints",
)
@dataclass(frozen=True, eq=False)
class Scene:
    """The object, the sensor's geometry and the renderer that draws the one for the other, pressed or as in the paper.

    Poses are those of the pressed object either way: see `find_drawing`.
    """

    object: ObjectModel
    geometry: SensorGeometry
    renderer: Renderer
    drawing: Drawing = "pressed"

    def use_pressed_drawing(self) -> Scene:
        """Return the scene that draws what the sensor really sees, as touches show it."""
        return dataclasses.replace(self, drawing="pressed")

    def bring_to_contact(self, T_sensor_object: Poses) -> tuple[Poses, NDArray[np.bool_]]:
        """Bring poses (N, 4, 4) to contact along z; also return which (N,) touch the sensing rectangle. Metres."""
        from tactile_loc.core.sensing.contact import bring_to_contact

        return bring_to_contact(self.object.mesh, T_sensor_object, self.geometry)

    def bring_near_contact(self, T_sensor_object: Poses, most_m: float) -> Poses:
        """Move poses (N, 4, 4) along z towards contact, by at most `most_m` metres."""
        T, touching = self.bring_to_contact(T_sensor_object)
        by_m = T[:, 2, 3] - T_sensor_object[:, 2, 3]
        T[:, 2, 3] = T_sensor_object[:, 2, 3] + np.where(touching, np.clip(by_m, -most_m, most_m), 0.0)
        return T

    def press(self, indentation_m: float, press_depth_m: float | None = None) -> Scene:
        """Return the scene with the object pressed in: see `SensorGeometry.press`. Metres."""
        return dataclasses.replace(self, geometry=self.geometry.press(indentation_m, press_depth_m))

    def match_touch(self, touch: Touch) -> Scene:
        """Return the scene as the touch's sensor sees it: pressed as deep, with as many pixels."""
        return dataclasses.replace(self, geometry=touch.geometry)

    def render_contact_depths(self, T_sensor_object: Poses, press_depth_m: float | None = None) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres of poses (N, 4, 4) that are in contact already."""
        T, camera = find_drawing(T_sensor_object, self.geometry, self.drawing)
        depth = self.renderer.render_apart(self.object.mesh, T, camera.band)
        return compute_contact_depth(depth, camera, camera.max_depth_m if press_depth_m is None else press_depth_m)

    def render_grid_depths(self, T_sensor_object: Poses) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres, at full press, of a grid's poses: many share a rotation."""
        T, camera = find_drawing(T_sensor_object, self.geometry, self.drawing)
        return compute_contact_depth(self.renderer.render(self.object.mesh, T, camera.band), camera, camera.max_depth_m)

    def render_depths_to_compare(
        self, T_sensor_object: Poses, touch: Touch, freedom_m: float = 0.0
    ) -> NDArray[np.float32]:
        """Render contact depths (N, H, W) in metres of poses (N, 4, 4) as they are compared with a touch.

        A pose counts as it is, but for what the measured press may be off by, and `freedom_m` metres more.
        """
        freedom_m += LEAST_PRESS_ERROR_M + PRESS_ERROR * touch.indentation_m
        return self.render_contact_depths(self.bring_near_contact(T_sensor_object, freedom_m), touch.press_depth_m)

    def contact_shape(self, T_sensor_object: NDArray[np.float64], press_depth_m: float) -> ContactShape:
        """Render the contact shape of one pose (4, 4), brought to contact, cut at `press_depth_m` metres.

        It is pressed in as deep as the scene says, or by the press depth where the scene is that of no touch.
        """
        pressed = self if self.geometry.indentation_m else self.press(press_depth_m)
        T, _ = pressed.bring_to_contact(T_sensor_object[None])
        return ContactShape(
            pressed.render_contact_depths(T, press_depth_m)[0], press_depth_m, pressed.geometry.indentation_m
        )

    def contact_iou(self, T_sensor_object: NDArray[np.float64], touch: Touch) -> float:
        """Return the contact IoU of one pose (4, 4), metres: see `contact_ious`."""
        return self.contact_ious(T_sensor_object[None], touch)[0]

    def contact_ious(self, T_sensor_object: Poses, touch: Touch) -> list[float]:
        """Return how well each of the poses (N, 4, 4), metres, explains a touch: 0 (not at all) to 1, unitless.

        The intersection over union of the touch's contact and the one that the pose makes, where the sensor observes,
        on about IOU_PX pixels a side. A pose counts as it is, but for what the measured press may be off by: one that
        hovers over the sensor explains nothing.
        """
        return self.compare_imprints(T_sensor_object, touch).contact_ious.tolist()

    def imprint_ious(self, T_sensor_object: Poses, touch: Touch) -> NDArray[np.float64]:
        """Return how well poses (N, 4, 4), metres, explain a touch in depth and outline: (N,), 0 to 1, unitless.

        A generalised intersection over union: the sum of the smaller over the sum of the larger of what pose and touch
        press in, raised by OUTLINE_SHARE of the press depth wherever there is contact; otherwise as `contact_ious`.
        """
        return self.compare_imprints(T_sensor_object, touch).imprint_ious

    def compare_imprints(
        self, T_sensor_object: Poses, touch: Touch, pixels: int = IOU_PX, freedom_m: float = 0.0
    ) -> Explained:
        """Return how well poses (N, 4, 4), metres, which are drawn once, explain a touch: IoUs, and evidence.

        Poses may be `freedom_m` metres farther off along z than the measured press allows.
        """
        geometry, wanted = touch.thin(pixels)
        made = dataclasses.replace(self, geometry=geometry).render_depths_to_compare(T_sensor_object, touch, freedom_m)
        return compare_imprints(
            made, wanted.depth_m, touch.press_depth_m, geometry.observed_mask, geometry.pixel_pitch_m
        )


@keep_old_names(explained="compare_imprints")
@dataclass(frozen=True, eq=False)
class View:
    """One of several touches: what it shows, the object before its sensor, and where that is seen from the first.

    This sensor's pose is off by an error whose standard deviations are `sensor_std_m` metres along and `sensor_std_rad`
    radians about each axis, each sensor's by its own: `T_sensor_first` (4, 4), metres, by this one's and the first's.
    """

    touch: Touch
    scene: Scene
    T_sensor_first: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    sensor_std_m: float = 0.0
    sensor_std_rad: float = 0.0

    def compare_imprints(self, T_first_object: Poses, pixels: int = IOU_PX, freedom_m: float = 0.0) -> Explained:
        """Return how well poses (N, 4, 4) in the first sensor's frame, metres, explain this touch: see Scene's."""
        return self.scene.compare_imprints(self.T_sensor_first @ T_first_object, self.touch, pixels, freedom_m)

    def imprint_ious(self, T_first_object: Poses, pixels: int = IOU_PX, freedom_m: float = 0.0) -> NDArray[np.float64]:
        """Return the imprint IoUs (N,) of poses (N, 4, 4) in the first sensor's frame, metres: `compare_imprints`."""
        return self.compare_imprints(T_first_object, pixels, freedom_m).imprint_ious
