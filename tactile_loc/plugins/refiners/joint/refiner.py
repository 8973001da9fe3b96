"""The joint refiner: one pose against all touches at once, point to plane on the object's own surface.

What a touch shows lies on the object's surface, and no other surface reaches deeper into the gel than it shows: both
are residuals of one robust Gauss-Newton problem, whose unknowns are the pose and, within their standard deviations, the
press depth of every touch and the pose of every sensor but the first. One touch is the case of a single one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import (
    Candidate,
    Capabilities,
    ComponentOptions,
    NearestTriangles,
    RefinedPose,
    Refiner,
    Scene,
    Touch,
    TriangleMesh,
    View,
    in_threads,
    surface_field,
)
from tactile_loc.plugins.refiners.joint.kernels import register
from tactile_loc.plugins.refiners.joint.observed import MILLI, Seen, observe

ROUGHLY = 0.02  # ious are counted in pixels: a loss this small is none
SETTLED_MM = 1e-3
FINELY = 6  # of the steps, the last, that look at all points
SAMPLES = 4000  # points of the object's surface that must not reach into the gel
Floats = NDArray[np.float64]


class JointRefiner(Refiner):
    """Registers the object's surface to all touches at once; knows how sure the pose is."""

    capabilities = Capabilities(uses_normals=True)

    class Options(ComponentOptions):
        """What is measured of a touch and how far to trust it, and how the registration becomes narrower."""

        image_px: int = Field(default=120, ge=16, description="the longer image side is thinned to about this, pixels")
        points: int = Field(default=300, ge=20, description="points of each touch's surface, thinned evenly")
        scale_mm: float = Field(default=3.0, gt=0, description="residuals beyond this are mistrusted at first, mm")
        scale_end_mm: float = Field(default=0.1, gt=0, description="the same at last, mm")
        iterations: int = Field(default=15, ge=2, description="most steps")
        noise_mm: float = Field(default=0.03, gt=0, description="least standard deviation of a point of a touch, mm")
        patch_mm: float = Field(default=1.0, gt=0, description="points nearer to one another err alike, mm")
        press_error: float = Field(default=0.05, ge=0, description="standard deviation of a press, share of it")

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Return the pose (4, 4), metres, that explains the touch best near the candidate's."""
        return self.refine_together([View(touch, scene)], [candidate])[0]

    def refine_many(self, touch: Touch, candidates: Sequence[Candidate], scene: Scene) -> list[RefinedPose]:
        """Refine several candidates of one touch, each as `refine` does."""
        return self.refine_together([View(touch, scene)], candidates)

    def refine_together(self, views: Sequence[View], candidates: Sequence[Candidate]) -> list[RefinedPose]:
        """Refine candidates against several touches; one that explains them worse afterwards is left as it was."""
        if not candidates:
            return []
        given = np.stack([candidate.T_sensor_object for candidate in candidates])
        poses, each, information, moved_mm = self._registered(views, given, self._scales_mm, FINELY)
        before, after = (_explained(views, T) for T in (given, poses))
        good = after[1] >= before[1] - ROUGHLY
        results = []
        for k in range(len(given)):
            T, iou = (poses[k], after[0][k]) if good[k] else (given[k].copy(), before[0][k])
            settled = bool(good[k] and moved_mm[k] < SETTLED_MM and iou > 0)
            covariance = _covariance(information[k], _lever_m(views[0], T)) if good[k] else None
            seen = each[k] if good[k] else None
            results.append(RefinedPose(T, float(iou), settled, self.options.iterations, covariance, seen))
        return results

    def covariances(self, views: Sequence[View], T_first_object: Floats) -> list[Floats | None]:
        """Return the covariance (6, 6), as RefinedPose's, of each pose (K, 4, 4), metres, that was refined to touches.

        None where they say nothing of it.
        """
        information = self._registered(views, T_first_object, self._scales_mm[-1:], 1)[2]
        return [_covariance(A, _lever_m(views[0], T)) for A, T in zip(information, T_first_object, strict=True)]

    def settled(self, views: Sequence[View], T_first_object: Floats) -> Floats:
        """Return where poses (K, 4, 4), metres, end that are registered roughly, whether they explain more or not.

        For many poses: a fraction of the points is looked at, and nothing is drawn.
        """
        return self._registered(views, T_first_object, self._scales_mm, 0)[0]

    @property
    def _scales_mm(self) -> Floats:
        """The scale of the robust weights (I,), iteration by iteration: narrower up to the middle."""
        start, end, count = self.options.scale_mm, self.options.scale_end_mm, self.options.iterations
        return np.asarray(start * (end / start) ** np.clip(np.arange(count) / (0.5 * count), 0, 1))

    def _registered(
        self, views: Sequence[View], given: Floats, scales_mm: Floats, finely: int
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """The poses (K, 4, 4), metres, that the given ones end at, and where each sensor sees them (K, N, 4, 4); the
        information (K, 6, 6), mm and rad, at the poses before the last steps, and how long those were (K,), mm. The
        last `finely` steps look at all points."""
        options, mesh = self.options, views[0].scene.object.mesh
        area_m2 = float(mesh.face_areas.sum()) / SAMPLES
        seen = [self._seen(view) for view in views]
        observed = observe(seen, options.points, options.noise_mm / MILLI, options.patch_mm / MILLI, area_m2)
        T, count = given.copy(), len(given)
        T[:, :3, 3] *= MILLI
        each = np.empty((count, len(views), 4, 4))
        parts, moved = np.zeros((count, 2, 6, 6)), np.full(count, np.inf)
        samples, middle = _samples_mm(mesh), mesh.centroid_m * MILLI
        in_threads(
            register, count, T, observed, _triangles_mm(mesh), samples, middle, scales_mm, finely, each, parts, moved
        )  # fmt: skip
        levers_mm = T[:, :3, :3] @ middle + T[:, :3, 3] - observed.centres[0]
        information = _of_first(parts, seen[0], levers_mm)
        T[:, :3, 3] /= MILLI
        each[:, :, :3, 3] /= MILLI
        return T, each, information, moved

    def _seen(self, view: View) -> Seen:
        geometry, shape = view.touch.thinned(self.options.image_px)
        press_m = max(self.options.press_error * view.touch.indentation_m, 1e-6)
        variance = np.array([view.sensor_std_rad] * 3 + [view.sensor_std_m] * 3) ** 2
        return Seen(shape, geometry, view.T_sensor_first, variance, press_m**2)


def _explained(views: Sequence[View], T_first_object: Floats) -> tuple[Floats, Floats]:
    """Contact IoUs and imprint IoUs (K,) of poses (K, 4, 4) in the first sensor's frame: means over the touches."""
    each = [view.explained(T_first_object) for view in views]
    return np.mean([one.contact_ious for one in each], axis=0), np.mean([one.imprint_ious for one in each], axis=0)


def _of_first(parts: Floats, first: Seen, levers_mm: Floats) -> Floats:
    """The information (K, 6, 6), mm and rad, of twists about the object's centre in the first sensor's frame.

    Of `parts` (K, 2, 6, 6) the first touch's is direct, but for its press; the others' reaches it through the error of
    the first sensor's pose. `levers_mm` (K, 3) lead from the middle of the first touch, about which it may be off by
    both, to the object's centre.
    """
    to_centre = np.zeros((len(parts), 1, 6, 6)) + np.eye(6)
    to_centre[:, 0, 3:, :3] = np.cross(np.eye(3), levers_mm[:, None]).swapaxes(1, 2)  # w x lever
    allowed = np.stack([first.press_variance, first.variance]) * [1.0, 1.0, 1.0, MILLI**2, MILLI**2, MILLI**2]
    off = to_centre @ (allowed[:, :, None] * np.eye(6)) @ to_centre.swapaxes(-1, -2)
    total = np.linalg.solve(np.eye(6) + parts @ off, parts).sum(axis=1)
    return np.asarray((total + total.swapaxes(1, 2)) / 2)


def _lever_m(view: View, T: Floats) -> Floats:
    """From the object frame's origin to the centroid (3,), metres, along the sensor's axes."""
    return np.asarray(T[:3, :3] @ view.scene.object.mesh.centroid_m)


def _covariance(information: Floats, lever_m: Floats) -> Floats | None:
    """The covariance (6, 6), x, y, z in m before rotations in rad, of information in mm whose rotations come first.

    The information is about the object's centroid, which is at `lever_m` (3,) from the frame's origin, whose
    covariance it becomes.
    """
    swapped = information[[3, 4, 5, 0, 1, 2]][:, [3, 4, 5, 0, 1, 2]]
    values, vectors = np.linalg.eigh(swapped)
    if not values[-1] > 0:
        return None
    # what no touch says anything of is known to some 30 mm, or 3 rad
    covariance = (vectors / np.maximum(values, 1e-3)) @ vectors.T
    unit = np.array([1 / MILLI] * 3 + [1.0] * 3)
    x, y, z = lever_m
    to_origin = np.eye(6)
    to_origin[:3, 3:] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]  # w x (origin - centroid)
    result: Floats = to_origin @ (covariance * unit * unit[:, None]) @ to_origin.T
    return result


@lru_cache(maxsize=16)
def _samples_mm(mesh: TriangleMesh) -> Floats:
    return mesh.sample(SAMPLES, np.random.default_rng(0)) * MILLI


@lru_cache(maxsize=16)
def _triangles_mm(mesh: TriangleMesh) -> NearestTriangles:
    found = surface_field(mesh).triangles
    return found._replace(corners=found.corners * MILLI, low=found.low * MILLI, cell=found.cell * MILLI)
