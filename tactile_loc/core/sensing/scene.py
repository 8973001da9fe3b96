"""A scene is an object in front of a sensor, with a renderer. A view is one of several touches, with its scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Poses, invert, rotation_angle
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.sensing.contact import bring_to_contact
from tactile_loc.core.sensing.gel_surface import SLACK, deform_gel
from tactile_loc.core.sensing.imprints import Explained, Residuals, compare_imprints, measure_residuals
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch, compute_contact_depth

IOU_PX = 100
NATS_PER_IOU = 30.0  # nats of a prior, or of an error of a sensor pose, that count as much as an imprint IoU of 1

# The error of a measured indentation is a share of the indentation plus a constant. It limits how far a pose may move
# along z.
PRESS_ERROR, LEAST_PRESS_ERROR_M = 0.2, 5e-5


class DepthRenderer(Protocol):
    """The methods of a renderer that a scene and its keys need: see `slots.renderer.Renderer`."""

    def describe(self) -> dict[str, Any]:
        """Return what identifies the renderer's output, as JSON values."""

    def render(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths (N, H, W), metres, for poses (N, 4, 4)."""

    def render_apart(self, mesh: TriangleMesh, T_sensor_object: Poses, geometry: SensorGeometry) -> Float32:
        """Return camera depths (N, H, W), metres, for poses (N, 4, 4) with different rotations."""


@dataclass(frozen=True, eq=False)
class Scene:
    """An object, the sensor's geometry and a renderer."""

    object: ObjectModel
    geometry: SensorGeometry
    renderer: DepthRenderer

    def bring_to_contact(self, T_sensor_object: Poses) -> tuple[Poses, Bools]:
        """Move poses (N, 4, 4), metres, along z to contact. Also return which (N,) touch the sensing rectangle."""
        return bring_to_contact(self.object.mesh, T_sensor_object, self.geometry)

    def bring_near_contact(self, T_sensor_object: Poses, most_m: float, slack_m: float = 0.0) -> Poses:
        """Move poses (N, 4, 4) along z towards contact, by at most `most_m` metres, if `slack_m` or more is missing."""
        T, touching = self.bring_to_contact(T_sensor_object)
        by_m = T[:, 2, 3] - T_sensor_object[:, 2, 3]
        if slack_m:
            by_m = np.sign(by_m) * np.maximum(np.abs(by_m) - slack_m, 0.0)
        T[:, 2, 3] = T_sensor_object[:, 2, 3] + np.where(touching, np.clip(by_m, -most_m, most_m), 0.0)
        return T

    def press(self, indentation_m: float, press_depth_m: float | None = None) -> Scene:
        """Return the scene with the object pressed in by `indentation_m` metres: see `SensorGeometry.press`."""
        return dataclasses.replace(self, geometry=self.geometry.press(indentation_m, press_depth_m))

    def match_touch(self, touch: Touch) -> Scene:
        """Return the scene with the sensor geometry of a touch, which has the touch's press and pixels."""
        return dataclasses.replace(self, geometry=touch.geometry)

    def render_contact_depths(
        self, T_sensor_object: Poses, press_depth_m: float | None = None, grid: bool = False
    ) -> Float32:
        """Render contact depths (N, H, W), metres, of poses (N, 4, 4) that are already in contact.

        They are those in a rigid gel; `render_gel_depths` returns those that an elastic gel shows. They are cut at
        `press_depth_m` metres, by default at the maximal depth. With `grid`, this is fast if many poses have the same
        rotation.
        """
        geometry = self.geometry
        render = self.renderer.render if grid else self.renderer.render_apart
        depth = render(self.object.mesh, T_sensor_object, geometry.band)
        return compute_contact_depth(depth, geometry, geometry.max_depth_m if press_depth_m is None else press_depth_m)

    def render_gel_depths(self, T_sensor_object: Poses, press_depth_m: float | None = None) -> Float32:
        """Render the contact depths (N, H, W), metres, that the gel shows of pressed poses (N, 4, 4).

        They are cut at `press_depth_m` metres, by default at the maximal depth.
        """
        geometry, cut_m = self.geometry, self.geometry.max_depth_m if press_depth_m is None else press_depth_m
        if not geometry.gel.is_elastic or not geometry.indentation_m:
            return self.render_contact_depths(T_sensor_object, press_depth_m)
        pressed_m = geometry.indentation_m
        # all of the object below the undeformed surface decides what the gel shows
        whole = dataclasses.replace(self, geometry=dataclasses.replace(geometry, max_depth_m=pressed_m))
        shown = deform_gel(whole.render_contact_depths(T_sensor_object), pressed_m, geometry)
        return np.where(shown < np.float32(min(pressed_m, cut_m)), shown, np.float32(cut_m))

    def render_what_touch_shows(self, T_sensor_object: Poses, touch: Touch) -> Float32:
        """Render the contact depths (N, H, W), metres, that poses (N, 4, 4) would show instead of a touch.

        Poses move along z towards contact, by at most the error of the measured press.
        """
        if not touch.has_depths:
            return self._render_at_own_press(T_sensor_object, touch.contact_shape, _estimate_press_error_m(touch))
        T = self.bring_near_contact(T_sensor_object, _estimate_press_error_m(touch))
        return self.render_gel_depths(T, touch.press_depth_m)

    def contact_shape(self, T_sensor_object: Floats, press_depth_m: float) -> ContactShape:
        """Render the contact shape of one pose (4, 4), brought to contact, cut at `press_depth_m` metres.

        The shape's indentation is that of the scene, or the press depth if the scene's sensor is not pressed.
        """
        pressed = self if self.geometry.indentation_m else self.press(press_depth_m)
        T, _ = pressed.bring_to_contact(T_sensor_object[None])
        return ContactShape(
            pressed.render_gel_depths(T, press_depth_m)[0], press_depth_m, pressed.geometry.indentation_m
        )

    def show_like(self, T_sensor_object: Floats, touch: Touch) -> ContactShape:
        """Render the contact shape of one pose (4, 4), metres, as beside a touch: at its own press for a mask.

        The shape has the pixels of the scene, which may be fewer than those of the touch.
        """
        if touch.has_depths:
            return self.contact_shape(T_sensor_object, touch.press_depth_m)
        pressed = self if self.geometry.indentation_m else self.match_touch(touch)
        shown = pressed.render_what_touch_shows(T_sensor_object[None], touch)[0]
        return ContactShape(shown, touch.press_depth_m)

    def contact_iou(self, T_sensor_object: Floats, touch: Touch) -> float:
        """Return the contact IoU of one pose (4, 4), metres, with a touch: 0 to 1, unitless.

        The contact IoU is the intersection over union of the touch's contact and the pose's contact, over the observed
        pixels. The images have about IOU_PX pixels on the longer side. A pose may move along z only by the error of the
        measured press, so a pose far above the sensor has no contact.
        """
        return float(self.compare_imprints(T_sensor_object[None], touch).contact_ious[0])

    def imprint_ious(self, T_sensor_object: Poses, touch: Touch) -> Floats:
        """Return the imprint IoUs (N,) of poses (N, 4, 4), metres, with a touch: 0 to 1, unitless.

        At each pixel, the imprint is the press depth minus the contact depth. Where there is contact, OUTLINE_SHARE of
        the press depth is added. The imprint IoU is the sum of the smaller of both imprints over all pixels, divided by
        the sum of the larger. Pixels and movements along z are the same as for `contact_iou`.
        """
        return self.compare_imprints(T_sensor_object, touch).imprint_ious

    def compare_imprints(
        self, T_sensor_object: Poses, touch: Touch, pixels: int = IOU_PX, freedom_m: float = 0.0
    ) -> Explained:
        """Return the IoUs and the evidence of poses (N, 4, 4), metres, for a touch. Each pose is rendered once.

        Poses may move `freedom_m` metres farther along z than the error of the measured press.
        """
        return compare_imprints(*self._draw_beside(T_sensor_object, touch, pixels, freedom_m))

    def measure_residuals(self, T_sensor_object: Poses, touch: Touch, pixels: int = IOU_PX) -> Residuals:
        """Return what poses (N, 4, 4), metres, leave unexplained of a touch. They move along z as for IoUs."""
        return measure_residuals(*self._draw_beside(T_sensor_object, touch, pixels))

    def _draw_beside(
        self, T_sensor_object: Poses, touch: Touch, pixels: int, freedom_m: float = 0.0
    ) -> tuple[Float32, Float32, float, Bools, float]:
        """Draw poses (N, 4, 4), metres, beside a touch: the arguments of `compare_imprints`."""
        geometry, wanted = touch.thin(pixels)
        scene, press_m = dataclasses.replace(self, geometry=geometry), wanted.press_depth_m
        most_m = freedom_m + _estimate_press_error_m(touch)
        if not touch.has_depths:
            shown = scene._render_at_own_press(T_sensor_object, wanted, most_m)
            made = np.where(shown < np.float32(press_m), np.float32(0), np.float32(press_m))
            return made, wanted.depth_m, press_m, geometry.observed_mask, geometry.pixel_pitch_m
        made = scene.render_contact_depths(scene.bring_near_contact(T_sensor_object, most_m), press_m)
        if geometry.gel.is_elastic:
            # beside the contact, the object may be anywhere beyond the gel's surface
            pierced = made < touch.thin_surface(pixels).depth_m - np.float32(SLACK * press_m)
            made = np.where(wanted.contact | pierced, made, np.float32(press_m))
        return made, wanted.depth_m, press_m, geometry.observed_mask, geometry.pixel_pitch_m

    def _render_at_own_press(self, T_sensor_object: Poses, mask: ContactShape, most_m: float) -> Float32:
        """Render the contact depths (N, H, W), metres, of poses (N, 4, 4) at their own press, not that of a mask.

        Poses move along z, by at most `most_m` metres, only if their press is too far from that of the mask.
        """
        slack_m = mask.press_slack_m
        T = self.bring_near_contact(T_sensor_object, most_m, slack_m)
        deep_m = self.press(mask.deepest_m + slack_m).render_contact_depths(T)
        press = np.float32(mask.press_depth_m)
        return np.where(
            deep_m < np.float32(mask.deepest_m + slack_m), np.clip(deep_m - slack_m, 0, 0.999 * press), press
        )


def _estimate_press_error_m(touch: Touch) -> float:
    return LEAST_PRESS_ERROR_M + PRESS_ERROR * touch.indentation_m


@dataclass(frozen=True, eq=False)
class View:
    """One of several touches, with its scene and the transform from the first sensor's frame.

    The sensor's pose has an error with standard deviations of `sensor_std_m` metres along and `sensor_std_rad` radians
    about each axis. `T_sensor_first` (4, 4), metres, contains the errors of this sensor and of the first sensor.
    """

    touch: Touch
    scene: Scene
    T_sensor_first: Floats = field(default_factory=lambda: np.eye(4))
    sensor_std_m: float = 0.0
    sensor_std_rad: float = 0.0

    def compare_imprints(self, T_first_object: Poses, pixels: int = IOU_PX, freedom_m: float = 0.0) -> Explained:
        """Return how well poses (N, 4, 4), metres, in the first sensor's frame, explain this touch.

        The values are those of `Scene.compare_imprints`.
        """
        return self.scene.compare_imprints(self.T_sensor_first @ T_first_object, self.touch, pixels, freedom_m)

    def imprint_ious(self, T_first_object: Poses, pixels: int = IOU_PX, freedom_m: float = 0.0) -> Floats:
        """Return the imprint IoUs (N,) of poses (N, 4, 4), metres, in the first sensor's frame, with this touch."""
        return self.compare_imprints(T_first_object, pixels, freedom_m).imprint_ious


def view_touch(first: Touch, touch: Touch, scene: Scene) -> View:
    """Return the view of a touch, with its scene and the transform from the first touch's sensor frame to its own."""
    T = relate_sensors(first, touch)
    return View(touch, scene, T, touch.T_base_sensor_std_m, touch.T_base_sensor_std_rad)


def relate_sensors(first: Touch, touch: Touch) -> Floats:
    """Return T_sensor_first (4, 4), metres, from the first touch's sensor frame to that of another touch."""
    if touch is first:
        return np.eye(4)
    return invert(np.asarray(touch.T_base_sensor)) @ np.asarray(first.T_base_sensor)


def compare_where_seen(
    views: Sequence[View], T_first_object: Poses, seen: Poses | None = None, first: View | None = None
) -> tuple[Floats, Floats]:
    """Return imprint IoUs (K, N) and evidence (K, N), nats, of poses (K, 4, 4), metres, for each of N touches.

    `seen` (K, N, 4, 4), metres, are poses of the object in each sensor's frame that allow for an error of the sensor's
    reported pose. An error of s standard deviations costs s^2 / 2 nats, and each nat costs 1 / NATS_PER_IOU
    of imprint IoU. For each touch, the greater of the values with and without the error is returned. `first` is the
    first touch's view, by default the first of the views.
    """
    here = [view.compare_imprints(T_first_object) for view in views]
    ious, evidence = (np.stack([one[k] for one in here], axis=1) for k in (1, 2))
    if seen is None:
        return ious, evidence
    for number, view in enumerate(views):
        nats = compute_sensor_error_nats(
            view, first or views[0], seen[:, number] @ invert(view.T_sensor_first @ T_first_object)
        )
        there = view.scene.compare_imprints(seen[:, number], view.touch)
        ious[:, number] = np.maximum(ious[:, number], there.imprint_ious - nats / NATS_PER_IOU)
        evidence[:, number] = np.maximum(evidence[:, number], there.evidence - nats)
    return ious, evidence


def compute_sensor_error_nats(view: View, first: View, error: Poses) -> Floats:
    """Return the cost (K,), nats, of errors (K, 4, 4), metres, of a sensor's pose relative to the first one's."""
    std_m = max(float(np.hypot(view.sensor_std_m, first.sensor_std_m)), 1e-6)
    std_rad = max(float(np.hypot(view.sensor_std_rad, first.sensor_std_rad)), 1e-6)
    gel = np.array([0.0, 0.0, view.touch.geometry.standoff_m])
    shift_m = np.linalg.norm(error[:, :3, :3] @ gel + error[:, :3, 3] - gel, axis=-1)
    return np.asarray((shift_m / std_m) ** 2 + (rotation_angle(error[:, :3, :3]) / std_rad) ** 2) / 2


def compute_full_evidence(touch: Touch) -> float:
    """Return the evidence, nats, for a pose whose contact is exactly the touch's contact."""
    geometry, shape = touch.thin(IOU_PX)
    seen = shape.depth_m
    fully = compare_imprints(seen[None], seen, shape.press_depth_m, geometry.observed_mask, geometry.pixel_pitch_m)
    return float(fully.evidence[0])
