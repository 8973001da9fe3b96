"""Registers a candidate's contact cloud to the observed cloud by point-to-plane ICP (open3d)."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import open3d as o3d
from pydantic import Field

from tactile_loc.plugin import Poses
from tactile_loc.plugin.helpers import Cloud, CloudRefiner, Registration

BURST = 8  # iterations between tests for convergence
SETTLED_WIDE, SETTLED = 0.03, 1e-4  # largest move in a burst at convergence, for each pass: radians and mm
DECIMALS = 7  # decimals to which rotations and mm are rounded
_ALONE = threading.Lock()  # the number of open3d's threads is the same for the whole process


class IcpRefiner(CloudRefiner):
    """Registers in two passes: a wide one for coarse alignment, then a narrow one."""

    class Options(CloudRefiner.Options):
        """Largest distances of corresponding points, and the number of iterations."""

        wide_mm: float = Field(default=3.0, gt=0, description="largest distance of paired points in pass 1, mm")
        narrow_mm: float = Field(default=0.5, gt=0, description="largest distance of paired points in pass 2, mm")
        max_iterations: int = Field(default=20, ge=1, description="most iterations in each pass")

    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return the registration (mm) of the last pass that found correspondences, or an empty registration."""
        options = self.options
        moving, fixed = _wrap_cloud(source), _wrap_cloud(target, with_normals=True)
        T, found, converged, iterations = np.eye(4), False, False, 0
        for reach_mm, settled in ((options.wide_mm, SETTLED_WIDE), (options.narrow_mm, SETTLED)):
            T_new, steps, share, still = _register(moving, fixed, reach_mm, T, options.max_iterations, settled)
            iterations += steps
            if share > 0 and np.isfinite(T_new).all():
                T, found, converged = T_new, True, still
        return Registration(T if found else None, converged, iterations)


@contextmanager
def _use_one_thread() -> Iterator[None]:
    """Let open3d use one thread in the block, because its threads add up in any order, so that the last digits vary."""
    with _ALONE:
        threads = o3d.utility.get_max_threads()
        o3d.utility.set_max_threads(1)
        try:
            yield
        finally:
            o3d.utility.set_max_threads(threads)


def _wrap_cloud(cloud: Cloud, with_normals: bool = False) -> o3d.geometry.PointCloud:
    wrapped = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points_mm))
    if with_normals:
        wrapped.normals = o3d.utility.Vector3dVector(cloud.normals)
    return wrapped


def _register(
    moving: o3d.geometry.PointCloud,
    fixed: o3d.geometry.PointCloud,
    reach_mm: float,
    T: Poses,
    max_iterations: int,
    settled: float,
) -> tuple[Poses, int, float, bool]:
    """Run ICP in bursts until a burst changes nothing, because open3d does not report convergence.

    Return the transform (4, 4), mm, the number of iterations, the share of matched points, and whether ICP converged.
    """
    registration = o3d.pipelines.registration
    method = registration.TransformationEstimationPointToPlane()
    done, converged, matched = 0, False, 0.0
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error), _use_one_thread():
        while done < max_iterations and not converged:
            burst = min(BURST, max_iterations - done)
            criteria = registration.ICPConvergenceCriteria(1e-3 * settled, 1e-3 * settled, burst)
            result = registration.registration_icp(moving, fixed, reach_mm, T, method, criteria)
            converged = np.allclose(result.transformation, T, atol=settled) and result.fitness > 0
            # processors round differently: rounding prevents small differences from growing between bursts
            T, matched, done = np.round(result.transformation, DECIMALS), float(result.fitness), done + burst
    return T, done, matched, converged
