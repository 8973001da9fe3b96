"""Point-to-point ICP with a robust kernel, by the kiss-icp library (Vizzo et al., RA-L 2023).

The library weights a pair at distance r by (k / (k + r^2))^2, so its kernel k is a squared length. Here, k is the
square of the correspondence distance of a pass. Clouds are in mm.

Both clouds are sampled at pixels. If nearest neighbours are paired, two such lattices lock wherever they coincide.
Therefore, each moving point is shifted along the surface by a different fraction of a pixel.
"""

import numpy as np
from kiss_icp.mapping import VoxelHashMap
from kiss_icp.registration import Registration as KissRegistration
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin.helpers import Cloud, CloudRefiner, Registration, make_orthonormal, transform_points

Floats = NDArray[np.float64]

BURST = 10  # iterations between tests for convergence, which the library does not report
SETTLED_WIDE, SETTLED = 0.03, 1e-3  # largest move in a burst at convergence, for each pass: radians and mm
STEP = 1e-4  # step below which the library ends a burst: radians and mm
SPREAD = 1.4  # width of the shifts along the surface, in spacings of neighbouring points
STRIDES = np.array([0.8191725134, 0.6710436067, 0.5497004779])  # of Roberts' sequence, which fills a cube evenly
LEAST_WIDE, LEAST_NARROW = 4.0, 2.0  # least correspondence distance of each pass, in spacings
DECIMALS = 7  # decimals to which rotations and mm are rounded
VOXEL_POINTS = 20  # most points of the touch's cloud in a voxel of the correspondence distance
FAR_MM = 1e6  # distance at which the library drops map points: larger than any cloud


class KissIcpRefiner(CloudRefiner):
    """Registers in two passes: a wide one for coarse alignment, then a narrow one."""

    class Options(CloudRefiner.Options):
        """Largest distances of corresponding points, the density of the touch's cloud, and the iterations."""

        wide_mm: float = Field(default=3.0, gt=0, description="largest distance of paired points in pass 1, mm")
        narrow_mm: float = Field(default=0.7, gt=0, description="largest distance of paired points in pass 2, mm")
        max_iterations: int = Field(default=200, ge=1, description="most iterations in each pass")

    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return the registration (mm) of the last pass that found correspondences, or an empty registration."""
        moving_mm, spacing_mm = spread(source), target.spacing_mm
        wide_mm = max(self.options.wide_mm, LEAST_WIDE * spacing_mm)
        narrow_mm = max(self.options.narrow_mm, LEAST_NARROW * spacing_mm)
        T, found, converged, iterations = np.eye(4), False, False, 0
        for reach_mm, settled in ((wide_mm, SETTLED_WIDE), (narrow_mm, SETTLED)):
            if has_pairs(moving_mm, target, T, reach_mm):
                T, steps, converged = self._pass(moving_mm, target, reach_mm, settled, T)
                found, iterations = True, iterations + steps
        return Registration(T if found else None, converged, iterations)

    def _pass(
        self, moving_mm: Floats, target: Cloud, reach_mm: float, settled: float, T: Floats
    ) -> tuple[Floats, int, bool]:
        """Run bursts until a burst changes nothing.

        Return the transform (4, 4), an upper bound on the number of iterations, and whether the last burst changed
        nothing.
        """
        seen = VoxelHashMap(reach_mm, FAR_MM, VOXEL_POINTS)
        seen.add_points(target.points_mm)
        done, still = 0, False
        while done < self.options.max_iterations and not still:
            burst = min(BURST, self.options.max_iterations - done)
            registration = KissRegistration(burst, STEP, max_num_threads=1)  # several threads would sum in any order
            T_new = registration.align_points_to_map(moving_mm, seen, T, reach_mm, reach_mm**2)
            T_new = make_orthonormal(np.round(T_new, DECIMALS))  # the library aborts for other matrices
            T, still, done = T_new, bool(np.allclose(T_new, T, atol=settled)), done + burst
        return T, done, still


def spread(cloud: Cloud) -> Floats:
    """Return the cloud's points (P, 3), mm, each shifted along its surface by a deterministic, evenly spread offset."""
    places = np.arange(len(cloud))[:, None] * STRIDES % 1.0 - 0.5
    along = places - cloud.normals * (places * cloud.normals).sum(axis=1, keepdims=True)
    return cloud.points_mm + SPREAD * cloud.spacing_mm * along


def has_pairs(moving_mm: Floats, target: Cloud, T: Floats, reach_mm: float) -> bool:
    """Return whether any point (P, 3), mm, moved by T (4, 4), is within reach of the target."""
    from scipy.spatial import cKDTree

    nearest = cKDTree(target.points_mm).query(transform_points(T, moving_mm), distance_upper_bound=reach_mm)[0]
    return bool(np.isfinite(nearest).any())
