"""The joint registration engine: fits poses of the object to all touches at once, by point-to-plane distances.

The points of a touch must lie on the object's surface. No part of the object may reach deeper into the gel than the
touch shows. Both conditions give residuals of one robust Gauss-Newton problem. Its main unknown is the object's pose.
The press depths and the sensor poses are unknowns too, with given standard deviations. The Hessian gives the pose's
covariance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from pydantic import Field

from tactile_loc.core.geometry.lie import adjoint, move_covariance
from tactile_loc.core.geometry.rigid import Bools, Floats, Poses
from tactile_loc.core.objects.blocks import Blocks, make_blocks
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.objects.surface_field import build_surface_field
from tactile_loc.core.poses.candidate import RefinedPose
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.registration.observations import MILLI, observe
from tactile_loc.core.registration.prior_factors import PriorFactors, fit_prior_factors
from tactile_loc.core.registration.registration_kernel import (
    NO_FACTORS,
    SETTLED_MM,
    RegisteredPoses,
    RegistrationProblem,
    Schedule,
)
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.sensing.scene import View, compare_where_seen

VERSION = 5  # part of the store's keys: raise it when the output changes
ROUGHLY = 0.02  # IoUs are counted in pixels, so a loss this small is ignored
FINELY = 4  # number of last steps, which use all points
EARLY = 2  # number of first steps, after which poses are compared
SAMPLES = 4000  # number of points of the object's surface that must not reach too deep into the gel
BLOCK = 16  # number of neighbouring samples that are skipped together
Covariances = list[Floats | None]


class RegistrationOptions(ComponentOptions):
    """Options for the points of a touch, their noise, and the scales of the robust weights."""

    image_px: int = Field(default=120, ge=16, description="the longer image side is thinned to about this, pixels")
    points: int = Field(default=300, ge=20, description="points of each touch's surface, thinned evenly")
    scale_mm: float = Field(default=3.0, gt=0, description="scale of the robust weights in the first step, mm")
    scale_end_mm: float = Field(default=0.1, gt=0, description="the same in the last step, mm")
    iterations: int = Field(default=15, ge=2, description="largest number of steps")
    stride: int = Field(default=3, ge=1, description="the first steps use one point out of this many")
    noise_mm: float = Field(default=0.03, gt=0, description="least standard deviation of a point of a touch, mm")
    patch_mm: float = Field(default=1.0, gt=0, description="distance within which errors of points are alike, mm")
    press_error: float = Field(default=0.05, ge=0, description="standard deviation of a press, as a share of it")


class JointRegistration:
    """Registers poses to touches. An engine holds only options, so it serves any object and any touches."""

    def __init__(self, options: RegistrationOptions | None = None) -> None:
        self.options = options or RegistrationOptions()

    def describe(self) -> dict[str, Any]:
        """Return everything that determines the engine's output, as JSON values."""
        return {"version": VERSION, "options": self.options.model_dump(mode="json")}

    def refine(self, views: Sequence[View], T_first_object: Poses, prior: Prior | None = None) -> list[RefinedPose]:
        """Refine poses (K, 4, 4), metres, in the first touch's sensor frame, against all touches.

        A pose that would explain the touches worse after registration is returned unchanged and marked not converged.
        A registered pose may explain them with errors of the sensor poses: see `compare_where_seen`. A `prior` over
        these poses decides where the touches leave a pose open. It does not count in the covariances.
        """
        if not len(T_first_object):
            return []
        found = self._register(
            self._pose_problem(views), T_first_object, self.list_scales_mm(self.options.iterations), FINELY, prior
        )
        after = _explain(views, found.T_first_object)
        before = np.ones_like(after)
        doubted = after[1] < 1 - ROUGHLY  # a pose that explains nearly the whole touch cannot be worse than before
        before[:, doubted] = _explain(views, T_first_object[doubted])
        good = ~doubted | (after[1] >= before[1] - ROUGHLY)
        worse = np.flatnonzero(~good)
        if len(views) > 1 and len(worse):
            seen = scale(found.registered.T_each[worse], 1 / MILLI)
            ious = compare_where_seen(views, found.T_first_object[worse], seen)[0]
            good[worse] = ious.mean(axis=1) >= before[1, worse] - ROUGHLY
        results = []
        for k, given in enumerate(T_first_object):
            T, (contact, imprint) = (found.T_first_object[k], after[:, k]) if good[k] else (given.copy(), before[:, k])
            settled = bool(good[k] and found.registered.moved[k] < SETTLED_MM and contact > 0)
            pose = RefinedPose(T, float(contact), settled, self.options.iterations, imprint_iou=float(imprint))
            results.append(pose)
        return found.add_to(results, good)

    def register_coarsely(
        self,
        views: Sequence[View],
        T_first_object: Poses,
        kept: int | None = None,
        prior: Prior | None = None,
        cell_m: float | None = None,
    ) -> Poses:
        """Register many poses (K, 4, 4), metres, roughly, and return the registered poses (K, 4, 4), metres.

        Only a fraction of the points is used. Nothing is rendered, so a registered pose can be worse than before. With
        `kept`, only this many poses are returned: those that explain the touches best after the first EARLY steps.
        `prior` is as for `refine`. `cell_m`, metres, is the size of the cells of the surface's field: see
        `build_surface_field`.
        """
        problem, scales_mm = self._pose_problem(views, cell_m), self.list_scales_mm(self.options.iterations)
        if kept is not None and kept < len(T_first_object):
            early = self._register(problem, T_first_object, scales_mm[:EARLY], prior=prior)
            T_first_object = early.T_first_object[np.argsort(early.registered.misfit, kind="stable")[:kept]]
            scales_mm = scales_mm[EARLY:]
        return self._register(problem, T_first_object, scales_mm, prior=prior).T_first_object

    def follow(self, views: Sequence[View], T_first_object: Poses, reported: bool = False) -> tuple[Poses, Covariances]:
        """Register poses (K, 4, 4), metres, that are almost right; return the new poses and their covariances.

        Use this method in control loops. Nothing is rendered, so a new pose can be worse than before. A covariance
        (6, 6) is as in RefinedPose. It is None if the touches give no information about the pose. If `reported`, poses
        and covariances are relative to the reported pose of the first sensor: see `Hypothesis.T_base_object`.
        """
        found = self._register(
            self._pose_problem(views), T_first_object, self.list_scales_mm(self.options.iterations), FINELY
        )
        poses = scale(found.registered.T_reported, 1 / MILLI) if reported else found.T_first_object
        return poses, found.compute_covariances(reported=reported)

    def step(self, views: Sequence[View], T_first_object: Poses, scale_mm: float) -> tuple[Poses, Covariances]:
        """Take one registration step from poses (K, 4, 4), metres; return the new poses and the covariances.

        Use this method in a larger optimization problem, which needs the touches' equations at a pose. `scale_mm` is
        the scale of the robust weights, mm. Covariances are as for `follow`, but at T_first_object.
        """
        found = self._register(self._pose_problem(views), T_first_object, np.array([scale_mm]), 1)
        return found.T_first_object, found.compute_covariances(T_first_object)

    def add_covariances(self, views: Sequence[View], poses: Sequence[RefinedPose]) -> list[RefinedPose]:
        """Return poses, in the first touch's sensor frame, with their covariances given the touches.

        Register the poses first. Their errors in the base frame are those of `RefinedPose.reported_covariance`.
        """
        T = np.stack([pose.T_sensor_object for pose in poses])
        found = self._register(self._pose_problem(views), T, np.array([self.options.scale_end_mm]), 1)
        own, reported = found.compute_covariances(T), found.compute_covariances(T, reported=True)
        return [
            dataclasses.replace(pose, covariance=one, reported_covariance=other)
            for pose, one, other in zip(poses, own, reported, strict=True)
        ]

    def measure_information(self, view: View, T_sensor_object: Poses, centre_m: Floats) -> Floats:
        """Return a touch's information (K, 6, 6) about poses (K, 4, 4), metres, in its own sensor's frame.

        The information is about twists (rad, then mm) about `centre_m` (3,), metres, along the sensor's axes. It
        contains the error of the press depth, but not that of the sensor's pose. It is the Hessian of the registration
        at the poses, scaled by their misfit, so a pose that explains the touch badly gets little information.
        """
        alone = View(view.touch, view.scene)
        found = self._register(self._pose_problem([alone]), T_sensor_object, np.array([self.options.scale_end_mm]), 1)
        middles = T_sensor_object[:, :3, :3] @ (found.problem.middle / MILLI) + T_sensor_object[:, :3, 3]
        to_middle = adjoint(np.eye(3), (middles - centre_m) * MILLI)
        return np.asarray(to_middle.swapaxes(1, 2) @ found.problem.inform(found.registered) @ to_middle)

    def list_scales_mm(self, count: int) -> Floats:
        """Return the scales (count,), mm, of the robust weights, one for each step.

        The scales shrink in the first half of the steps, then stay constant.
        """
        start, end = self.options.scale_mm, self.options.scale_end_mm
        return np.asarray(start * (end / start) ** np.clip(np.arange(count) / (0.5 * count), 0, 1))

    def _register(
        self, problem: RegistrationProblem, T: Poses, scales_mm: Floats, finely: int = 0, prior: Prior | None = None
    ) -> _Found:
        """Register poses (K, 4, 4), metres, to touches. The last `finely` steps use all points."""
        factors = NO_FACTORS
        if prior is not None:
            factors = scale_factors(fit_prior_factors(prior, T, problem.middle / MILLI))
        schedule = Schedule(scales_mm, finely, self.options.stride)
        return _Found(problem, problem.register(scale(T, MILLI), schedule, factors))

    def _pose_problem(self, views: Sequence[View], cell_m: float | None = None) -> RegistrationProblem:
        options, mesh = self.options, views[0].scene.object.mesh
        area_m2 = float(mesh.face_areas.sum()) / SAMPLES
        observed = observe(
            [view.touch for view in views],
            options.image_px,
            options.points,
            options.noise_mm / MILLI,
            options.patch_mm / MILLI,
            area_m2,
        )
        press_mm = [_press_std_m(view, options.press_error) * MILLI for view in views]
        sensor = [[view.sensor_std_rad] * 3 + [view.sensor_std_m * MILLI] * 3 for view in views]
        return RegistrationProblem(
            observed,
            scale(np.stack([view.T_sensor_first for view in views]), MILLI),
            np.square(sensor),
            np.outer(np.square(press_mm), [0, 0, 0, 0, 0, 1]),
            options.noise_mm,
            build_surface_field(mesh, cell_m).triangles_mm,
            _samples_mm(mesh),
            mesh.centroid_m * MILLI,
        )


@dataclass(frozen=True, eq=False)
class _Found:
    """Poses of the object registered to touches."""

    problem: RegistrationProblem
    registered: RegisteredPoses

    @cached_property
    def T_first_object(self) -> Poses:  # noqa: N802 - the field's name
        """The poses (K, 4, 4), metres, in the first sensor's frame."""
        return scale(self.problem.view_from_first(self.registered), 1 / MILLI)

    def compute_covariances(self, T: Poses | None = None, reported: bool = False) -> Covariances:
        """Return the covariances of the poses, or of the reported poses: see `convert_to_covariances`.

        With T (K, 4, 4), metres, they belong to these poses instead, from which the last step began.
        """
        at = self.T_first_object if T is None else T
        information = self.problem.inform(self.registered, reported)
        return convert_to_covariances(information, at[:, :3, :3] @ (self.problem.middle / MILLI))

    def add_to(self, poses: Sequence[RefinedPose], good: Bools) -> list[RefinedPose]:
        """Return the refined poses; those that are `good` (K,) get covariances and poses in other frames."""
        found = self.registered
        each, reported = scale(found.T_each, 1 / MILLI), scale(found.T_reported, 1 / MILLI)
        own, others = self.compute_covariances(), self.compute_covariances(reported=True)
        return [
            dataclasses.replace(
                pose,
                covariance=own[k],
                T_sensors_object=each[k],
                T_reported_object=reported[k],
                reported_covariance=others[k],
            )
            if good[k]
            else pose
            for k, pose in enumerate(poses)
        ]


def _press_std_m(view: View, press_error: float) -> float:
    """Return the standard deviation of a touch's press depth, metres, at least the share `press_error` of it."""
    shape = view.touch.contact_shape
    return max(press_error * shape.deepest_m, shape.indentation_std_m, 1e-6)


def scale(T: Floats, unit: float = MILLI) -> Floats:
    """Return transforms (..., 4, 4) with translations multiplied by `unit`, to convert them to another unit."""
    scaled = np.array(T)
    scaled[..., :3, 3] *= unit
    return scaled


def scale_factors(factors: PriorFactors) -> PriorFactors:
    """Return the factors of a prior, with lengths in mm."""
    unit = np.array([1.0] * 3 + [1 / MILLI] * 3)
    return PriorFactors(scale(factors.T, MILLI), factors.information * unit * unit[:, None])


def _explain(views: Sequence[View], T_first_object: Poses) -> Floats:
    """Return the mean contact IoUs and imprint IoUs (2, K), over all touches, of poses (K, 4, 4).

    The poses are in the first sensor's frame.
    """
    if not len(T_first_object):
        return np.empty((2, 0))
    each = [view.compare_imprints(T_first_object)[:2] for view in views]
    return np.asarray(np.mean(each, axis=0))


def convert_to_covariances(information: Floats, levers_m: Floats) -> Covariances:
    """Convert information (K, 6, 6), rotations (rad), then mm, to covariances (6, 6), x, y, z (m), then rotations.

    The information refers to rotations about the object's centroid, which is at `levers_m` (K, 3) from the origin of
    the object frame. The covariances refer to rotations about this origin. Without information, a covariance is None.
    """
    swapped = information[:, [3, 4, 5, 0, 1, 2]][:, :, [3, 4, 5, 0, 1, 2]]
    values, vectors = np.linalg.eigh(swapped)
    # a direction that no touch constrains gets a standard deviation of about 30 mm or 3 rad
    covariances = (vectors / np.maximum(values, 1e-3)[:, None]) @ vectors.swapaxes(1, 2)
    unit = np.array([1 / MILLI] * 3 + [1.0] * 3)
    moved = move_covariance(covariances * unit * unit[:, None], -levers_m)
    return [one if known else None for one, known in zip(moved, values[:, -1] > 0, strict=True)]


@lru_cache(maxsize=64)
def _samples_mm(mesh: TriangleMesh) -> Blocks:
    points = mesh.sample(SAMPLES, np.random.default_rng(0)) * MILLI
    return make_blocks(points[:, None], BLOCK)
