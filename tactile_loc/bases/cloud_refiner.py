"""Base class for refiners that register candidates' contact clouds to that of a touch."""

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.sensing.clouds import make_contact_cloud
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.slots.refiner import Refiner

ROUGHLY = 0.02  # overlaps are counted in pixels, so a loss this small is ignored
MILLI = 1e3  # clouds are registered in mm, because the thresholds of registration suit numbers near one
FEWEST_POINTS = 3


@dataclass(frozen=True, eq=False)
class Cloud:
    """Surface points (P, 3), mm, in the sensor frame, their unit normals (P, 3), and the distance of neighbours, mm."""

    points_mm: Floats
    normals: Floats
    spacing_mm: float

    def __len__(self) -> int:
        return len(self.points_mm)


@dataclass(frozen=True, eq=False)
class Registration:
    """The result of a registration. `T_mm` (4, 4), mm, moves the source onto the target; None if there is no result."""

    T_mm: Floats | None = None
    converged: bool = False
    iterations: int = 0


class CloudRefiner(Refiner):
    """Base class for refiners that register the contact cloud of each candidate to that of the touch.

    A subclass defines `register`. Its own Options derive from `CloudRefiner.Options`.
    """

    class Options(ComponentOptions):
        """Options for the density and the contents of the clouds."""

        image_px: int = Field(default=200, ge=16, description="the longer image side is thinned to about this, pixels")
        moving_points: int = Field(default=800, ge=50, description="points of the candidate's cloud, thinned evenly")
        fixed_points: int = Field(default=3000, ge=50, description="points of the touch's cloud, thinned evenly")
        walls: bool = Field(default=True, description="use the outline's walls too, not just the surface")

    @abstractmethod
    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return the transform that moves a candidate's cloud onto the touch's. Neither cloud is empty."""

    def register_many(self, sources: Sequence[Cloud], target: Cloud) -> list[Registration]:
        """Register the clouds of several candidates. Override this method if you can register them faster together."""
        return [self.register(source, target) for source in sources]

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Move the candidate (4, 4), metres, by the transform that registers its contact cloud to the touch's.

        If the registered pose's contact overlaps the touch's contact less than the candidate's contact does, return the
        candidate unchanged.
        """
        return self.refine_many(touch, [candidate], scene)[0]

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch like `refine`, but render them together."""
        if not candidates:
            return []
        geometry, wanted = touch.thin(self.options.image_px)
        thinned = dataclasses.replace(scene, geometry=geometry)
        given = np.stack([candidate.T_sensor_object for candidate in candidates])
        starts = thinned.bring_to_contact(given)[0]
        seen = [
            ContactShape(d, touch.press_depth_m) for d in thinned.render_contact_depths(starts, touch.press_depth_m)
        ]
        before = [shape.contact_iou(wanted, geometry.observed_mask) for shape in seen]
        found = self._register_shapes(seen, wanted, geometry)
        poses = np.stack([_move(start, f.T_mm) for start, f in zip(starts, found, strict=True)])
        rows = zip(found, poses, scene.compare_imprints(poses, touch).contact_ious.tolist(), given, before, strict=True)
        return [_choose_better(*row) for row in rows]

    def _register_shapes(
        self, seen: Sequence[ContactShape], wanted: ContactShape, geometry: SensorGeometry
    ) -> list[Registration]:
        """Register the contact shapes of poses to the wanted shape. Clouds of too few points are not registered."""
        target = self._cloud(wanted, geometry, self.options.fixed_points)
        if len(target) < FEWEST_POINTS:
            return [Registration()] * len(seen)
        sources = [self._cloud(shape, geometry, self.options.moving_points) for shape in seen]
        results = iter(self.register_many([s for s in sources if len(s) >= FEWEST_POINTS], target))
        return [next(results) if len(s) >= FEWEST_POINTS else Registration() for s in sources]

    def _cloud(self, shape: ContactShape, geometry: SensorGeometry, most: int) -> Cloud:
        """Return a contact shape's cloud, evenly reduced to about `most` points."""
        points, normals = make_contact_cloud(shape, geometry, self.options.walls)
        every = max(1, round(len(points) / most))
        return Cloud(points[::every] * MILLI, normals[::every], geometry.pixel_pitch_m * MILLI * every**0.5)


def make_orthonormal(T: Floats) -> Floats:
    """Return the transform (4, 4) with its rotation replaced by the nearest proper rotation."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    T = T.copy()
    T[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return T


def _move(T_sensor_object: Floats, T_mm: Floats | None) -> Floats:
    """Return the pose (4, 4), metres, moved by a transform in mm, or unchanged if the transform is None."""
    if T_mm is None:
        return T_sensor_object
    T = T_mm.copy()
    T[:3, 3] /= MILLI
    return make_orthonormal(T) @ T_sensor_object


def _choose_better(found: Registration, pose: Floats, after: float, given: Floats, before: float) -> RefinedPose:
    """Return the registered pose, or the candidate if the candidate's contact overlaps the touch's contact better."""
    if found.T_mm is not None and after >= before - ROUGHLY:
        return RefinedPose(pose, after, found.converged and after > 0, found.iterations)
    return RefinedPose(given.copy(), before, converged=False, iterations=found.iterations)
