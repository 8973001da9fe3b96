"""Point-to-point ICP with a robust kernel, by the kiss-icp library (Vizzo et al., RA-L 2023).

The library is made for cars. It weights a pair that lies r apart by (k / (k + r^2))^2: its kernel k is compared with a
squared distance, so that it means another thing in every unit. Here a kernel is a length, as wide as the reach of its
pass, and squared before it is handed over; clouds are in mm, and the library's other lengths are set to suit.

Both clouds come from pixels, and nearest neighbours of two such lattices hold on to one another wherever the lattices
meet. The moving points are therefore spread along their surface, each by another part of a pixel.
"""

from __future__ import annotations

import numpy as np
from kiss_icp.mapping import VoxelHashMap
from kiss_icp.registration import Registration as KissRegistration
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import Cloud, CloudRefiner, Registration, make_orthonormal, transform_points

Floats = NDArray[np.float64]

BURST = 10  # iterations between looks at whether the pose still moves: the library does not say whether it converged
SETTLED_WIDE, SETTLED = 0.03, 1e-3  # a pose that moves less in a burst has settled: radians and mm, each pass
STEP = 1e-4  # a step smaller than this is the library's last in a burst: radians and mm
SPREAD = 1.4  # spacings between neighbouring points over which each is spread
STRIDES = np.array([0.8191725134, 0.6710436067, 0.5497004779])  # of Roberts' sequence, which fills a cube evenly
LEAST_WIDE, LEAST_NARROW = 4.0, 2.0  # reach of each pass, in spacings, however small the options are
DECIMALS = 7  # of radians and mm
FAR_MM = 1e6  # the library forgets points of its map that lie farther off: none


class KissIcpRefiner(CloudRefiner):
    """Registers in two passes, a wide one that finds the way and a narrow one that settles."""

    class Options(CloudRefiner.Options):
        """Distances in mm between points that may correspond, how many are kept, and how long to iterate."""

        wide_mm: float = Field(default=3.0, gt=0, description="largest distance of corresponding points at first, mm")
        narrow_mm: float = Field(default=0.7, gt=0, description="the same in the second pass, mm")
        max_iterations: int = Field(default=200, ge=1, description="iterations a pass")
        voxel_points: int = Field(
            default=20, ge=1, description="most points of the touch's cloud in a voxel, as wide as the pass reaches"
        )

    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return the transform, mm, of the last pass that found pairs in its reach (None: no pass did)."""
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
        """Register in bursts until one changes nothing; return T (4, 4), iterations at most, whether it settled."""
        seen = VoxelHashMap(reach_mm, FAR_MM, self.options.voxel_points)
        seen.add_points(target.points_mm)
        done, still = 0, False
        while done < self.options.max_iterations and not still:
            burst = min(BURST, self.options.max_iterations - done)
            registration = KissRegistration(burst, STEP, max_num_threads=1)  # several would add up in any order
            T_new = registration.align_points_to_map(moving_mm, seen, T, reach_mm, reach_mm**2)
            T_new = make_orthonormal(
                np.round(T_new, DECIMALS)
            )  # the library ends the process if it is given anything else
            T, still, done = T_new, bool(np.allclose(T_new, T, atol=settled)), done + burst
        return T, done, still


def spread(cloud: Cloud) -> Floats:
    """Return the cloud's points (P, 3), mm, each moved along its surface: evenly in all directions, the same always."""
    places = np.arange(len(cloud))[:, None] * STRIDES % 1.0 - 0.5
    along = places - cloud.normals * (places * cloud.normals).sum(axis=1, keepdims=True)
    return cloud.points_mm + SPREAD * cloud.spacing_mm * along


def has_pairs(moving_mm: Floats, target: Cloud, T: Floats, reach_mm: float) -> bool:
    """Tell whether any point (P, 3), moved by T (4, 4), is within reach of the target: the library does not say."""
    from scipy.spatial import cKDTree

    nearest = cKDTree(target.points_mm).query(transform_points(T, moving_mm), distance_upper_bound=reach_mm)[0]
    return bool(np.isfinite(nearest).any())
