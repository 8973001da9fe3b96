"""Point-to-plane ICP (open3d) of the candidate's contact cloud to the observed one."""

from __future__ import annotations

import dataclasses

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.clouds import contact_cloud
from tactile_loc.core.interfaces import Candidate, Capabilities, ComponentOptions, RefinedPose, Refiner
from tactile_loc.core.scene import Scene
from tactile_loc.core.sensing import ContactShape, SensorGeometry, Touch

BURST = 8  # iterations between looks at whether the pose still moves
SETTLED = 1e-4  # radians and mm
DECIMALS = 7  # of radians and mm
MILLI = 1e3  # clouds are registered in mm: open3d's thresholds suit numbers near one


class IcpRefiner(Refiner):
    """Registers in two passes, a wide one that finds the way and a narrow one that settles."""

    capabilities = Capabilities(uses_normals=True)

    class Options(ComponentOptions):
        """Distances in mm between points that may correspond, and how long to iterate."""

        wide_mm: float = Field(
            default=3.0, gt=0, description="largest distance of corresponding points, first pass, mm"
        )
        narrow_mm: float = Field(default=0.5, gt=0, description="the same for the second pass, mm")
        max_iterations: int = Field(default=30, ge=1, description="iterations a pass")
        image_px: int = Field(default=200, ge=16, description="the longer image side is thinned to about this, pixels")
        moving_points: int = Field(default=800, ge=50, description="points of the candidate's cloud, thinned evenly")
        fixed_points: int = Field(default=3000, ge=50, description="points of the touch's cloud, thinned evenly")
        walls: bool = Field(default=True, description="let the outline's walls take part, not the surface alone")

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Move the candidate (4, 4), metres, by the transform that registers its contact cloud to the touch's."""
        options = self.options
        step = max(1, round(max(touch.geometry.shape) / options.image_px))
        thinned = dataclasses.replace(scene, geometry=touch.geometry.every(step))
        seen = thinned.contact_shape(candidate.T_sensor_object, touch.press_depth_m)
        source, _ = self._cloud(seen, thinned.geometry, options.moving_points)
        target, normals = self._cloud(touch.contact_shape.every(step), thinned.geometry, options.fixed_points)
        if len(source) < 3 or len(target) < 3:
            return RefinedPose(candidate.T_sensor_object.copy(), fitness=0.0, converged=False, iterations=0)
        moving, fixed = _point_cloud(source), _point_cloud(target, normals)
        T, iterations = np.eye(4), 0
        for reach_mm in (options.wide_mm, options.narrow_mm):
            T, steps, matched, converged = _register(moving, fixed, reach_mm, T, options.max_iterations)
            iterations += steps
        T[:3, 3] /= MILLI
        if matched == 0.0 or not np.isfinite(T).all():
            return RefinedPose(candidate.T_sensor_object.copy(), fitness=0.0, converged=False, iterations=iterations)
        refined = _orthonormal(T) @ candidate.T_sensor_object
        return RefinedPose(refined, scene.overlap(refined, touch), converged, iterations)

    def _cloud(
        self, shape: ContactShape, geometry: SensorGeometry, most: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (P, 3) in mm and normals (P, 3) of a contact shape, thinned evenly to about `most`."""
        points, normals = contact_cloud(shape, geometry, self.options.walls)
        every = max(1, round(len(points) / most))
        return points[::every] * MILLI, normals[::every]


def _point_cloud(points_mm: NDArray[np.float64], normals: NDArray[np.float64] | None = None) -> o3d.geometry.PointCloud:
    """Wrap points (P, 3) in mm and unit normals (P, 3) for open3d."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_mm))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud


def _register(moving, fixed, reach_mm, T, max_iterations):  # type: ignore[no-untyped-def]
    """Run ICP in bursts until a burst changes nothing: open3d does not say by itself whether it converged."""
    registration = o3d.pipelines.registration
    method = registration.TransformationEstimationPointToPlane()
    done, converged, matched = 0, False, 0.0
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        while done < max_iterations and not converged:
            burst = min(BURST, max_iterations - done)
            criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, burst)
            result = registration.registration_icp(moving, fixed, reach_mm, T, method, criteria)
            converged = np.allclose(result.transformation, T, atol=SETTLED) and result.fitness > 0
            # open3d's threads add up in any order: rounding keeps that from growing from burst to burst
            T, matched, done = np.round(result.transformation, DECIMALS), float(result.fitness), done + burst
    return T, done, matched, converged


def _orthonormal(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Clear the rotation of T (4, 4) of rounding, by the nearest proper rotation."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    T = T.copy()
    T[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return T
