"""The scene of a result, as pictures, pages, Rerun files and the app draw it: solids, outlines and poses. Metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.pose_words import format_pose_words
from tactile_loc.core.geometry.rigid import Floats, Poses, invert, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.sensing.scene import Scene, relate_sensors
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch, cut_to_touching
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.result_arrays import find_most_probable
from tactile_loc.view.palette import LIGHT, Palette

STEEL, GEL, HOUSING = map(Palette.rgb, (LIGHT.best, LIGHT.gel, LIGHT.housing))
EDGE, TRUTH = LIGHT.ink, LIGHT.truth
GEL_M, RIM_M = 1.5e-3, 1.6e-3  # drawn thickness of the gel, and drawn width of the housing around the gel
BODY, NARROW = 0.5, 0.6  # drawn length of a sensor's body and width of its end, in widths of the gel
DEVIATIONS = 2.0  # standard deviations of an ellipsoid's half axes


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """The uncertainty of a position: its middle (3,), metres, half axes (3,), metres, and their directions (3, 3).

    The directions are the columns of a rotation.
    """

    centre_m: Floats
    half_axes_m: Floats
    axes: Floats

    @classmethod
    def of(cls, centre_m: Floats, covariance: Floats) -> Ellipsoid:
        """Make the ellipsoid of a covariance (6, 6), as in RefinedPose; its half axes are DEVIATIONS deviations."""
        variances, axes = np.linalg.eigh(covariance[:3, :3])
        axes[:, 0] *= np.sign(np.linalg.det(axes))  # make the axes right-handed
        return cls(centre_m, DEVIATIONS * np.sqrt(np.maximum(variances, 0)), axes)


@dataclass(frozen=True, eq=False)
class DrawnSensor:
    """A sensor at a pose T_scene_sensor (4, 4), metres, and what it shows: a touch, an image (H, W, 3), or nothing."""

    geometry: SensorGeometry
    T_scene_sensor: Floats = field(default_factory=lambda: np.eye(4))
    touch: Touch | None = None
    image: NDArray[np.uint8] | None = None

    @classmethod
    def of(cls, touch: Touch, T_scene_sensor: Floats = np.eye(4)) -> DrawnSensor:  # noqa: B008 - it is not changed
        """Make the sensor of a touch."""
        return cls(touch.geometry, T_scene_sensor, touch, touch.image)

    @property
    def gel_m(self) -> Floats:
        """The triangles (12, 3, 3) of the gel, metres, in the scene's frame."""
        (x0, x1, y0, y1), top = self.geometry.rectangle, self.geometry.surface_m
        return self._place(make_box((x0, x1), (y0, y1), (top - GEL_M, top)))

    @property
    def housing_m(self) -> Floats:
        """The triangles (12, 3, 3) of the housing around the gel, metres, in the scene's frame."""
        x0, x1, y0, y1 = self.geometry.rectangle
        sides = (x0 - RIM_M, x1 + RIM_M), (y0 - RIM_M, y1 + RIM_M)
        return self._place(
            make_box(*sides, (self.geometry.surface_m - 2.2 * GEL_M, self.geometry.surface_m - 0.4 * GEL_M))
        )

    @property
    def body_m(self) -> Floats:
        """The triangles (12, 3, 3) of the body that holds the housing, metres, in the scene's frame.

        Its shape is only drawn, and says nothing about the real sensor.
        """
        x0, x1, y0, y1 = self.geometry.rectangle
        top_m, length_m = self.geometry.surface_m - 2.2 * GEL_M, BODY * max(x1 - x0, y1 - y0)
        body = make_box((x0 - RIM_M, x1 + RIM_M), (y0 - RIM_M, y1 + RIM_M), (top_m - length_m, top_m))
        middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
        end = body[..., 2] < top_m - 0.5 * length_m
        body[end, :2] = middle + NARROW * (body[end, :2] - middle)
        return self._place(body)

    @property
    def outlines_m(self) -> list[Floats]:
        """The closed outlines (P, 3) of the contact, metres, in the scene's frame; see `trace_outlines_m`."""
        if self.touch is None:
            return []
        lines = trace_outlines_m(self.touch.contact_shape, self.geometry)
        return [transform_points(self.T_scene_sensor, line) for line in lines]

    def _place(self, triangles_m: Floats) -> Floats:
        return move_triangles(triangles_m, self.T_scene_sensor)


@dataclass(frozen=True, eq=False)
class DrawnScene:
    """An object at poses in the frame of a scene, and the sensors that touch it.

    `mesh` is the object's surface in its own frame. `poses` (K, 4, 4), metres, are T_scene_object, the most probable
    first, with `probabilities` (K,) and `covariances` (K), each (6, 6) as in RefinedPose, or None. `T_true` (4, 4) is
    the true pose, if it is known. `likely_poses` (N, 4, 4) are the most probable poses of the posterior, with their
    probabilities `likely` (N,). `imprint_iou`, 0 to 1, states how well the first pose explains the touches; NaN if
    unknown. `text` describes the scene in words.
    """

    mesh: TriangleMesh
    sensors: tuple[DrawnSensor, ...]
    poses: Poses = field(default_factory=lambda: np.empty((0, 4, 4)))
    probabilities: Floats = field(default_factory=lambda: np.empty(0))
    covariances: Sequence[Floats | None] = ()
    T_true: Floats | None = None
    likely_poses: Poses = field(default_factory=lambda: np.empty((0, 4, 4)))
    likely: Floats = field(default_factory=lambda: np.empty(0))
    imprint_iou: float = math.nan
    text: str = ""

    @classmethod
    def of(cls, found: Localization, in_base: bool = False) -> DrawnScene:
        """Make the scene of a result in the first touch's sensor frame or, `in_base` and if it is known, the base."""
        first, kept = found.touch, find_most_probable(found.posterior)
        T = first.T_base_sensor if in_base and first.T_base_sensor is not None else np.eye(4)
        moved = T is first.T_base_sensor
        known = [one for one in found.touches if one is first or one.T_base_sensor is not None]
        sensors = tuple(DrawnSensor.of(one, T @ invert(relate_sensors(first, one))) for one in known)
        poses = [h.T_base_object if moved else h.T_sensor_object for h in found.hypotheses]
        return cls(
            found.object.mesh,
            sensors,
            np.array(poses),
            np.array([h.probability for h in found.hypotheses]),
            tuple(h.base_covariance if moved else h.covariance for h in found.hypotheses),
            None if first.T_sensor_object is None else T @ first.T_sensor_object,
            T @ found.posterior.grid.T_sensor_object[kept],
            found.posterior.probabilities[kept],
            found.best.imprint_iou,
            first.name,
        )

    @classmethod
    def of_frame(
        cls, scene: Scene, located: LocatedFrame | None, sensor: DrawnSensor | None = None, text: str = ""
    ) -> DrawnScene:
        """Make the scene of a frame in its sensor's frame. `scene` has the object and the sensor's geometry."""
        sensors = (sensor or DrawnSensor(scene.geometry),)
        mesh, said = scene.object.mesh, describe_located(located, text)
        if located is None or located.T_sensor_object is None:
            return cls(mesh, sensors, text=said)
        covariances = (located.covariance, *(None for _ in located.probabilities[1:]))
        poses, shares = located.T_sensor_object_modes, located.probabilities
        return cls(mesh, sensors, poses, shares, covariances, imprint_iou=located.imprint_iou, text=said)

    @cached_property
    def object_m(self) -> Floats:
        """The triangles (F, 3, 3) of the object at its first pose, metres."""
        return move_triangles(self.mesh.triangles_m, self.poses[0])

    @cached_property
    def truth_m(self) -> Floats | None:
        """The triangles (F, 3, 3) of the object at its true pose, metres, if it is known."""
        return None if self.T_true is None else move_triangles(self.mesh.triangles_m, self.T_true)

    def find_ellipsoid(self, number: int = 0) -> Ellipsoid | None:
        """Return the uncertainty of the position of pose `number`, from 0; None if it is unknown."""
        covariance = self.covariances[number] if number < len(self.covariances) else None
        return None if covariance is None else Ellipsoid.of(self.poses[number, :3, 3], covariance)


def describe_located(found: LocatedFrame | None, text: str = "") -> str:
    """Describe a frame's pose in words, in mm, degrees and per cent; `text` is added."""
    if found is None:
        return text
    said = text or found.says
    if found.T_sensor_object is None:
        return "\n".join(line for line in (found.word, said) if line)
    words = format_pose_words(found.T_sensor_object, found.std)
    std = "" if found.std is None else f"\nstd {words.place_std} mm; {words.turn_std} about x, y, z"
    lines = (
        f"{found.word}, {format_percent(float(found.probabilities[0]))}",
        f"{words.place} mm, rotated {words.turn} about {words.axis}{std}",
        said,
    )
    return "\n".join(line for line in lines if line)


def trace_outlines_m(shape: ContactShape, geometry: SensorGeometry) -> list[Floats]:
    """Return the closed outlines (P, 3) of a contact shape (H, W), metres, in the sensor frame, on the undeformed gel.

    They surround the part at which the gel touches the object.
    """
    from contourpy import contour_generator

    left, right, bottom, top = find_extent_m(geometry)
    height, width = geometry.shape
    touching = cut_to_touching(shape, geometry).contact & geometry.observed_mask
    framed = np.pad(touching.astype(float), 1)  # outlines close at the image's border
    borders: Any = contour_generator(z=framed).lines(0.5)
    found = []
    for line in borders:
        column, row = (np.clip(line - 0.5, 0, [width, height]) / [width, height]).T
        z = np.full(len(line), geometry.surface_m)
        found.append(np.stack([left + column * (right - left), top + row * (bottom - top), z], axis=1))
    return found


def find_extent_m(geometry: SensorGeometry) -> tuple[float, float, float, float]:
    """Return the image's borders (left, right, bottom, top) on the sensing surface, metres; y points down."""
    sx, sy = geometry.scale_at_surface
    x0, x1 = -geometry.cx / sx, (geometry.width_px - geometry.cx) / sx
    y0, y1 = -geometry.cy / sy, (geometry.height_px - geometry.cy) / sy
    return x0, x1, y1, y0


def move_triangles(triangles_m: Floats, T: Floats) -> Floats:
    """Return triangles (F, 3, 3), metres, moved by a transform (4, 4), metres."""
    return transform_points(T, triangles_m.reshape(-1, 3)).reshape(-1, 3, 3)


def make_box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Floats:
    """Return the triangles (12, 3, 3) of an axis-aligned box."""
    corners = np.array([(a, b, c) for c in z for b in y for a in x])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return corners[np.array([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))])]
