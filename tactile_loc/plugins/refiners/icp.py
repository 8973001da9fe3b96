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
SETTLED_WIDE, SETTLED = 0.03, 1e-4  # a pose that moves less in a burst has settled: radians and mm, each pass
DECIMALS = 7  # of radians and mm
ROUGHLY = 0.02  # overlaps are counted in pixels: a loss this small is none
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
        max_iterations: int = Field(default=20, ge=1, description="iterations a pass")
        image_px: int = Field(default=200, ge=16, description="the longer image side is thinned to about this, pixels")
        moving_points: int = Field(default=800, ge=50, description="points of the candidate's cloud, thinned evenly")
        fixed_points: int = Field(default=3000, ge=50, description="points of the touch's cloud, thinned evenly")
        walls: bool = Field(default=True, description="let the outline's walls take part, not the surface alone")

    def refine(self, touch: Touch, candidate: Candidate, scene: Scene) -> RefinedPose:
        """Move the candidate (4, 4), metres, by the transform that registers its contact cloud to the touch's.

        A registration whose own contact overlaps the touch's less than the candidate's is not returned.
        """
        step = max(1, round(max(touch.geometry.shape) / self.options.image_px))
        thinned = dataclasses.replace(scene, geometry=touch.geometry.every(step))
        start = thinned.in_contact(candidate.T_sensor_object[None])[0][0]  # the pose whose contact is registered
        seen, wanted = thinned.contact_shape(start, touch.press_depth_m), touch.contact_shape.every(step)
        before = seen.overlap(wanted, thinned.geometry.observed_mask)
        T, converged, iterations = self._register_clouds(seen, wanted, thinned.geometry)
        if T is not None:
            refined = T @ start
            after = scene.overlap(refined, touch)
            if after >= before - ROUGHLY:
                return RefinedPose(refined, after, converged, iterations)
        return RefinedPose(candidate.T_sensor_object.copy(), before, converged=False, iterations=iterations)

    def _register_clouds(
        self, seen: ContactShape, wanted: ContactShape, geometry: SensorGeometry
    ) -> tuple[NDArray[np.float64] | None, bool, int]:
        """Return the transform (4, 4), metres, from what a pose shows to what is wanted (None: no pairs), whether it
        converged, and the iterations."""
        options = self.options
        source, _ = self._cloud(seen, geometry, options.moving_points)
        target, normals = self._cloud(wanted, geometry, options.fixed_points)
        if len(source) < 3 or len(target) < 3:
            return None, False, 0
        moving, fixed = _point_cloud(source), _point_cloud(target, normals)
        T, found, converged, iterations = np.eye(4), False, False, 0
        for reach_mm, settled in ((options.wide_mm, SETTLED_WIDE), (options.narrow_mm, SETTLED)):
            T_new, steps, share, still = _register(moving, fixed, reach_mm, T, options.max_iterations, settled)
            iterations += steps
            if share > 0 and np.isfinite(T_new).all():  # a pass that finds no pairs in its reach has nothing to say
                T, found, converged = T_new, True, still
        T[:3, 3] /= MILLI
        return (_orthonormal(T) if found else None), converged, iterations

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


def _register(moving, fixed, reach_mm, T, max_iterations, settled):  # type: ignore[no-untyped-def]
    """Run ICP in bursts until a burst changes nothing: open3d does not say by itself whether it converged."""
    registration = o3d.pipelines.registration
    method = registration.TransformationEstimationPointToPlane()
    done, converged, matched = 0, False, 0.0
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        while done < max_iterations and not converged:
            burst = min(BURST, max_iterations - done)
            criteria = registration.ICPConvergenceCriteria(1e-3 * settled, 1e-3 * settled, burst)
            result = registration.registration_icp(moving, fixed, reach_mm, T, method, criteria)
            converged = np.allclose(result.transformation, T, atol=settled) and result.fitness > 0
            # open3d's threads add up in any order: rounding keeps that from growing from burst to burst
            T, matched, done = np.round(result.transformation, DECIMALS), float(result.fitness), done + burst
    return T, done, matched, converged


def _orthonormal(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Clear the rotation of T (4, 4) of rounding, by the nearest proper rotation."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    T = T.copy()
    T[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return T
