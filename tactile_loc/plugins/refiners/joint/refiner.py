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
    Blocks,
    Candidate,
    ComponentOptions,
    NearestTriangles,
    RefinedPose,
    Refiner,
    Scene,
    Touch,
    TriangleMesh,
    View,
    blocks_of,
    covariance_at,
    surface_field,
)
from tactile_loc.plugins.refiners.joint.observed import MILLI, Seen, observe
from tactile_loc.plugins.refiners.joint.registration import SETTLED_MM, Registered, Registration

ROUGHLY = 0.02  # ious are counted in pixels: a loss this small is none
FINELY = 4  # of the steps, the last, that look at all points
SAMPLES = 4000  # points of the object's surface that must not reach into the gel
BLOCK = 16  # of them that are passed over together
Floats = NDArray[np.float64]


class JointRefiner(Refiner):
    """Registers the object's surface to all touches at once; knows how sure the pose is."""

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
        found = self._registered(views, given, self.scales_mm(self.options.iterations), FINELY)
        after = _explained(views, found.T)
        before = np.ones_like(after)
        doubted = after[1] < 1 - ROUGHLY  # what explains nearly everything explains no less than before
        before[:, doubted] = _explained(views, given[doubted])
        good = ~doubted | (after[1] >= before[1] - ROUGHLY)
        results = []
        for k in range(len(given)):
            T, iou = (found.T[k], after[0, k]) if good[k] else (given[k].copy(), before[0, k])
            settled = bool(good[k] and found.moved[k] < SETTLED_MM and iou > 0)
            covariance = _covariance(found.information[k], _lever_m(views[0], T)) if good[k] else None
            seen = found.T_each[k] if good[k] else None
            results.append(RefinedPose(T, float(iou), settled, self.options.iterations, covariance, seen))
        return results

    def covariances(self, views: Sequence[View], T_first_object: Floats) -> list[Floats | None]:
        """Return the covariance (6, 6), as RefinedPose's, of each pose (K, 4, 4), metres, that was refined to touches.

        None where they say nothing of it.
        """
        return self.stepped(views, T_first_object, self.options.scale_end_mm)[1]

    def settled(self, views: Sequence[View], T_first_object: Floats) -> Floats:
        """Return where poses (K, 4, 4), metres, end that are registered roughly, whether they explain more or not.

        For many poses: a fraction of the points is looked at, and nothing is drawn.
        """
        return self._registered(views, T_first_object, self.scales_mm(self.options.iterations), 0).T

    def followed(self, views: Sequence[View], T_first_object: Floats) -> tuple[Floats, list[Floats | None]]:
        """Return where poses (K, 4, 4), metres, end that are near already, and their covariances (6, 6), as `stepped`.

        For control loops: nothing is drawn, so that a pose may explain less than before.
        """
        found = self._registered(views, T_first_object, self.scales_mm(self.options.iterations), FINELY)
        return found.T, self._covariances(found, views[0])

    def stepped(
        self, views: Sequence[View], T_first_object: Floats, scale_mm: float
    ) -> tuple[Floats, list[Floats | None]]:
        """Return poses (K, 4, 4), metres, after one step of registration from T_first_object, and their covariances.

        For those who solve a larger problem, of which registration is a part: these are the equations of touches at a
        pose, solved. Residuals beyond `scale_mm` are mistrusted; covariances (6, 6) are as RefinedPose's, None where
        touches say nothing of it.
        """
        found = self._registered(views, T_first_object, np.array([scale_mm]), 1)
        return found.T, self._covariances(found._replace(T=T_first_object), views[0])

    def _covariances(self, found: Registered, view: View) -> list[Floats | None]:
        """The covariances (6, 6) of poses, None where touches say nothing of them."""
        return [_covariance(A, _lever_m(view, T)) for A, T in zip(found.information, found.T, strict=True)]

    def scales_mm(self, count: int) -> Floats:
        """Return the scale of the robust weights (count,), step by step: narrower up to the middle."""
        start, end = self.options.scale_mm, self.options.scale_end_mm
        return np.asarray(start * (end / start) ** np.clip(np.arange(count) / (0.5 * count), 0, 1))

    def _registered(self, views: Sequence[View], T: Floats, scales_mm: Floats, finely: int) -> Registered:
        """Register poses (K, 4, 4), metres, to touches; poses in metres, but information in mm and rad."""
        options, mesh = self.options, views[0].scene.object.mesh
        area_m2 = float(mesh.face_areas.sum()) / SAMPLES
        seen = [Seen(shape, geometry) for geometry, shape in (v.touch.thinned(options.image_px) for v in views)]
        observed = observe(seen, options.points, options.noise_mm / MILLI, options.patch_mm / MILLI, area_m2)
        press_mm = [max(options.press_error * view.touch.indentation_m, 1e-6) * MILLI for view in views]
        sensor = [[view.sensor_std_rad] * 3 + [view.sensor_std_m * MILLI] * 3 for view in views]
        registration = Registration(
            observed, _scaled(np.stack([view.T_sensor_first for view in views]), MILLI), np.square(sensor),
            np.outer(np.square(press_mm), [0, 0, 0, 0, 0, 1]), options.noise_mm, _triangles_mm(mesh), _samples_mm(mesh),
            mesh.centroid_m * MILLI,
        )  # fmt: skip
        found = registration.registered(_scaled(T, MILLI), scales_mm, finely)
        return found._replace(T=_scaled(found.T, 1 / MILLI), T_each=_scaled(found.T_each, 1 / MILLI))


def _scaled(T: Floats, unit: float) -> Floats:
    """Transforms (..., 4, 4) whose lengths are in another unit."""
    scaled = T.copy()
    scaled[..., :3, 3] *= unit
    return scaled


def _explained(views: Sequence[View], T_first_object: Floats) -> Floats:
    """Contact IoUs and imprint IoUs (2, K) of poses (K, 4, 4) in the first sensor's frame: means over the touches."""
    if not len(T_first_object):
        return np.empty((2, 0))
    each = [view.explained(T_first_object)[:2] for view in views]
    return np.asarray(np.mean(each, axis=0))


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
    return covariance_at(covariance * unit * unit[:, None], -lever_m)


@lru_cache(maxsize=64)
def _samples_mm(mesh: TriangleMesh) -> Blocks:
    points = mesh.sample(SAMPLES, np.random.default_rng(0)) * MILLI
    return blocks_of(points[:, None], BLOCK)


@lru_cache(maxsize=64)
def _triangles_mm(mesh: TriangleMesh) -> NearestTriangles:
    return surface_field(mesh).in_unit(MILLI)
