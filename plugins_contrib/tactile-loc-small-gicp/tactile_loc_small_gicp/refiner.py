"""Generalised ICP of a candidate's contact cloud to the touch's cloud, with small_gicp (Koide, JOSS 2024)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import small_gicp
from pydantic import Field
from tactile_loc.plugin.helpers import Cloud, CloudRefiner, Registration, is_rigid

FEWEST_POINTS = 10  # after downsampling; covariances of fewer points are not reliable
LEAST_REACH = 4.0  # least correspondence distance, in spacings of neighbouring points
RIGID = 1e-3  # tolerance of the test that a result is a rotation
ALL = 100_000  # points; a limit above the size of clouds, so that only voxels downsample them


@dataclass(frozen=True, eq=False)
class Prepared:
    """A cloud in the library's form, in mm and with covariances, and the search tree of its points."""

    points: small_gicp.PointCloud
    tree: small_gicp.KdTree


class SmallGicpRefiner(CloudRefiner):
    """Registers each candidate's contact cloud to the touch's cloud, once, starting at the candidate's pose."""

    class Options(CloudRefiner.Options):
        """The points, distances and iterations of the registration."""

        moving_points: int = Field(default=ALL, ge=50, description="points of the candidate's cloud, before voxels")
        fixed_points: int = Field(default=ALL, ge=50, description="points of the touch's cloud, before voxels")
        walls: bool = Field(default=False, description="include the walls at the contact's outline")
        voxel_mm: float = Field(default=0.25, gt=0, description="voxel size for thinning both clouds, mm")
        reach_mm: float = Field(default=2.0, gt=0, description="largest distance of corresponding points, mm")
        iterations: int = Field(default=40, ge=1, description="most iterations")

    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return the library's registration, in mm, or one without a motion if no points are within reach."""
        return self.register_many([source], target)[0]

    def register_many(self, sources: Sequence[Cloud], target: Cloud) -> list[Registration]:
        """Register the clouds of several candidates. The touch's cloud is prepared only once."""
        fixed, reach_mm = self.prepared(target), max(self.options.reach_mm, LEAST_REACH * target.spacing_mm)
        return [self._register(self.prepared(source), fixed, reach_mm) for source in sources]

    def prepared(self, cloud: Cloud) -> Prepared | None:
        """Downsample a cloud with voxels. Return None if fewer than `FEWEST_POINTS` points are left."""
        if len(cloud) < FEWEST_POINTS:
            return None
        points, tree = small_gicp.preprocess_points(cloud.points_mm, self.options.voxel_mm)
        return None if points.size() < FEWEST_POINTS else Prepared(points, tree)

    def _register(self, moving: Prepared | None, fixed: Prepared | None, reach_mm: float) -> Registration:
        """Register two clouds. If either is None, return a registration without a motion."""
        if moving is None or fixed is None:
            return Registration()
        limits = {"max_correspondence_distance": reach_mm, "max_iterations": self.options.iterations}
        result = small_gicp.align(fixed.points, moving.points, fixed.tree, np.eye(4), "GICP", **limits)
        T_mm = np.array(result.T_target_source)
        if result.num_inliers == 0 or not is_rigid(T_mm, RIGID):
            return Registration(iterations=int(result.iterations))
        return Registration(T_mm, bool(result.converged), int(result.iterations))
