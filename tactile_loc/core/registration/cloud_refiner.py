"""What refiners by registration share: contact clouds of touch and candidates, and when to believe a registration."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.deprecation import make_getattr
from tactile_loc.core.sensing.clouds import make_contact_cloud
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.core.slots.component import ComponentOptions
from tactile_loc.core.slots.refiner import Candidate, RefinedPose, Refiner
from tactile_loc.core.slots.scene import Scene

ROUGHLY = 0.02  # overlaps are counted in pixels: a loss this small is none
MILLI = 1e3  # clouds are registered in mm: the thresholds of registration suit numbers near one
FEWEST_POINTS = 3


@dataclass(frozen=True, eq=False)
class Cloud:
    """Surface points (P, 3) in mm, sensor frame, their unit normals (P, 3), and about how far neighbours are apart."""

    points_mm: NDArray[np.float64]
    normals: NDArray[np.float64]
    spacing_mm: float

    def __len__(self) -> int:
        return len(self.points_mm)


@dataclass(frozen=True, eq=False)
class Registration:
    """What a registration found: `T_mm` (4, 4), translation in mm, that moves the source onto the target, or None."""

    T_mm: NDArray[np.float64] | None = None
    converged: bool = False
    iterations: int = 0


class CloudRefiner(Refiner):
    """Registers the contact cloud of each candidate to the touch's: a subclass says how, `register`.

    Options of a subclass derive from this class's.
    """

    class Options(ComponentOptions):
        """How densely the clouds are sampled, and what they hold."""

        image_px: int = Field(default=200, ge=16, description="the longer image side is thinned to about this, pixels")
        moving_points: int = Field(default=800, ge=50, description="points of the candidate's cloud, thinned evenly")
        fixed_points: int = Field(default=3000, ge=50, description="points of the touch's cloud, thinned evenly")
        walls: bool = Field(default=True, description="let the outline's walls take part, not the surface alone")

    @abstractmethod
    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return the transform that moves a candidate's cloud onto the touch's; both have points."""

    def register_many(self, sources: Sequence[Cloud], target: Cloud) -> list[Registration]:
        """Do the same for several candidates of one touch; override it where that is faster than one by one."""
        return [self.register(source, target) for source in sources]

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Move the candidate (4, 4), metres, by the transform that registers its contact cloud to the touch's.

        A registration whose own contact overlaps the touch's less than the candidate's is not returned.
        """
        return self.refine_many(touch, [candidate], scene)[0]

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, as `refine` does each; they are rendered together."""
        if not candidates:
            return []
        geometry, wanted = touch.thin(self.options.image_px)
        thinned = dataclasses.replace(scene, geometry=geometry)
        given = np.stack([candidate.T_sensor_object for candidate in candidates])
        starts = thinned.bring_to_contact(given)[0]  # the poses whose contact is registered
        seen = [
            ContactShape(d, touch.press_depth_m) for d in thinned.render_contact_depths(starts, touch.press_depth_m)
        ]
        before = [shape.contact_iou(wanted, geometry.observed_mask) for shape in seen]
        found = self._register_shapes(seen, wanted, geometry)
        poses = np.stack([_move(start, f.T_mm) for start, f in zip(starts, found, strict=True)])
        rows = zip(found, poses, scene.contact_ious(poses, touch), given, before, strict=True)
        return [_choose_better(*row) for row in rows]

    def _register_shapes(
        self, seen: Sequence[ContactShape], wanted: ContactShape, geometry: SensorGeometry
    ) -> list[Registration]:
        """Register what poses show to what is wanted; clouds of hardly a point stay where they are."""
        target = self._cloud(wanted, geometry, self.options.fixed_points)
        if len(target) < FEWEST_POINTS:
            return [Registration()] * len(seen)
        sources = [self._cloud(shape, geometry, self.options.moving_points) for shape in seen]
        results = iter(self.register_many([s for s in sources if len(s) >= FEWEST_POINTS], target))
        return [next(results) if len(s) >= FEWEST_POINTS else Registration() for s in sources]

    def _cloud(self, shape: ContactShape, geometry: SensorGeometry, most: int) -> Cloud:
        """A contact shape's cloud, thinned evenly to about `most` points."""
        points, normals = make_contact_cloud(shape, geometry, self.options.walls)
        every = max(1, round(len(points) / most))
        return Cloud(points[::every] * MILLI, normals[::every], geometry.pixel_pitch_m * MILLI * every**0.5)


def make_orthonormal(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transform (4, 4) with its rotation cleared of rounding: the nearest proper one."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    T = T.copy()
    T[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return T


def _move(T_sensor_object: NDArray[np.float64], T_mm: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """The pose (4, 4), metres, after a transform in mm, if there is one."""
    if T_mm is None:
        return T_sensor_object
    T = T_mm.copy()
    T[:3, 3] /= MILLI
    return make_orthonormal(T) @ T_sensor_object


def _choose_better(
    found: Registration, pose: NDArray[np.float64], after: float, given: NDArray[np.float64], before: float
) -> RefinedPose:
    """The registered pose (4, 4) if its overlap with the touch is not less than the given candidate's, else that."""
    if found.T_mm is not None and after >= before - ROUGHLY:
        return RefinedPose(pose, after, found.converged and after > 0, found.iterations)
    return RefinedPose(given.copy(), before, converged=False, iterations=found.iterations)


__getattr__ = make_getattr(__name__)
