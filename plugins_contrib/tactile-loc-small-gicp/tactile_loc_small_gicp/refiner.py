"""Generalised ICP of a candidate's contact cloud to the touch's, by small_gicp (Koide, JOSS 2024)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.core.clouds import contact_cloud
from tactile_loc.core.geometry import is_rigid
from tactile_loc.core.interfaces import Candidate, ComponentOptions, RefinedPose, Refiner, Scene
from tactile_loc.core.sensing import ContactShape, SensorGeometry, Touch

Floats = NDArray[np.float64]

MILLI = 1e3  # clouds are registered in mm: the library's thresholds suit numbers near one
IMAGE_PX = 200  # clouds are made of images about this long: finer than voxels, fast enough
FEWEST_POINTS = 10  # after thinning: fewer have no covariances to speak of
ROUGHLY = 0.02  # overlaps are counted in pixels: a loss this small is none
LEAST_REACH = 4.0  # pixels, however small the option is: nearer than its neighbours there is nothing to find
RIGID = 1e-3  # a result that is less of a rotation than this is none


@dataclass(frozen=True, eq=False)
class Cloud:
    """A cloud as the library wants it, in mm, with covariances, and the tree of its points."""

    points: small_gicp.PointCloud
    tree: small_gicp.KdTree


@dataclass(frozen=True, eq=False)
class Found:
    """What the library found: `T_sensor_sensor` (4, 4), metres, that moves the candidate, or None."""

    T_sensor_sensor: Floats | None = None
    converged: bool = False
    iterations: int = 0


class SmallGicpRefiner(Refiner):
    """Registers the contact cloud of each candidate to the touch's, once, from where the candidate is."""

    class Options(ComponentOptions):
        """Lengths in mm of the sensing surface."""

        voxel_mm: float = Field(default=0.25, gt=0, description="both clouds are thinned to a point in a voxel, mm")
        reach_mm: float = Field(default=2.0, gt=0, description="largest distance of corresponding points, mm")
        iterations: int = Field(default=40, ge=1, description="most iterations")
        walls: bool = Field(default=False, description="let the outline's walls take part, not the surface alone")

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Move the candidate (4, 4), metres, by the transform that registers its contact cloud to the touch's.

        A registration whose own contact overlaps the touch's less than the candidate's is not returned.
        """
        return self.refine_many(touch, [candidate], scene)[0]

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, as `refine` does each; they are drawn together."""
        if not candidates:
            return []
        geometry, wanted = touch.thinned(IMAGE_PX)
        given = np.stack([candidate.T_sensor_object for candidate in candidates])
        thinned = dataclasses.replace(scene, geometry=geometry)
        starts, _ = thinned.in_contact(given)
        seen = [ContactShape(d, touch.press_depth_m) for d in thinned.contact_depths(starts, touch.press_depth_m)]
        target = self._cloud(wanted, geometry)
        reach_mm = max(self.options.reach_mm, LEAST_REACH * geometry.pixel_pitch_m * MILLI)
        found = [self._register(self._cloud(shape, geometry), target, reach_mm) for shape in seen]
        moved = [T if f.T_sensor_sensor is None else f.T_sensor_sensor @ T for T, f in zip(starts, found, strict=True)]
        before, after = scene.overlaps(given, touch), scene.overlaps(np.stack(moved), touch)
        return [_believed(*row) for row in zip(found, given, before, moved, after, strict=True)]

    def _register(self, source: Cloud | None, target: Cloud | None, reach_mm: float) -> Found:
        """Register two clouds; those of hardly a point stay where they are."""
        if source is None or target is None:
            return Found()
        result = small_gicp.align(
            target.points, source.points, target.tree, np.eye(4), "GICP",
            max_correspondence_distance=reach_mm, max_iterations=self.options.iterations,
        )  # fmt: skip
        T_mm = np.array(result.T_target_source)
        if result.num_inliers == 0 or not is_rigid(T_mm, RIGID):
            return Found(iterations=int(result.iterations))
        return Found(_in_metres(T_mm), bool(result.converged), int(result.iterations))

    def _cloud(self, shape: ContactShape, geometry: SensorGeometry) -> Cloud | None:
        """A contact shape's cloud, thinned; None if hardly anything is left."""
        points_m, _ = contact_cloud(shape, geometry, self.options.walls)
        if len(points_m) < FEWEST_POINTS:
            return None
        points, tree = small_gicp.preprocess_points(points_m * MILLI, self.options.voxel_mm)
        return None if points.size() < FEWEST_POINTS else Cloud(points, tree)


def _in_metres(T_mm: Floats) -> Floats:
    """A transform (4, 4) in mm as one in metres, its rotation cleared of rounding: the nearest proper one."""
    U, _, Vt = np.linalg.svd(T_mm[:3, :3])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = U @ Vt, T_mm[:3, 3] / MILLI
    return T


def _believed(found: Found, given: Floats, before: float, moved: Floats, after: float) -> RefinedPose:
    """The registered pose (4, 4) if it overlaps with the touch no less than the given candidate, else that."""
    if found.T_sensor_sensor is not None and after >= before - ROUGHLY:
        return RefinedPose(moved, after, found.converged and after > 0, found.iterations)
    return RefinedPose(given.copy(), before, converged=False, iterations=found.iterations)
