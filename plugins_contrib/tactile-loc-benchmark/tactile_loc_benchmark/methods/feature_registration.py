"""Global registration of the touched points to points of the model, by local features (open3d)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import Capabilities, Poses, Touch
from tactile_loc.plugin.helpers import invert, make_transform

from tactile_loc_benchmark.interfaces import LocatingProblem, Method, ScoredPoses
from tactile_loc_benchmark.methods.surface_fit import FitOptions, SurfaceFit
from tactile_loc_benchmark.methods.touched_points import TouchedPoints

MM = 1e3  # open3d gets millimetres
NORMALS_FROM, FEATURES_FROM = 2.0, 5.0  # radii, in spacings, as in open3d's tutorial on global registration
REACH = 1.5  # largest distance of corresponding points, in spacings, as in that tutorial
NEIGHBOURS = 100  # most neighbours of a feature
DECIMALS = 6  # to which mm and normals are rounded, so that rounding errors do not decide between features
SAMPLES = 4  # drawn points of the model for each square of one spacing, before they are thinned


@dataclass(frozen=True, eq=False)
class FeaturedCloud:
    """Points, mm, with normals, and an FPFH feature of each point."""

    points: o3d.geometry.PointCloud
    features: Any

    @classmethod
    def of(cls, points_m: NDArray[np.float64], normals: NDArray[np.float64], spacing_mm: float) -> FeaturedCloud:
        """Thin the points (P, 3), metres, to one in each cube with sides `spacing_mm`, and compute the features."""
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.round(MM * points_m, DECIMALS)))
        cloud.normals = o3d.utility.Vector3dVector(np.round(normals, DECIMALS))
        cloud = cloud.voxel_down_sample(spacing_mm)
        cloud.normalize_normals()
        near = o3d.geometry.KDTreeSearchParamHybrid(FEATURES_FROM * spacing_mm, NEIGHBOURS)
        return cls(cloud, o3d.pipelines.registration.compute_fpfh_feature(cloud, near))  # type: ignore[call-arg]


class FeatureRegistration(Method):
    """Registers the touched points by features, several times with different seeds, then refines the poses by ICP."""

    capabilities = Capabilities(deterministic=False)
    libraries: ClassVar[tuple[str, ...]] = ("open3d",)

    class Options(FitOptions):
        """The density of the points, and the number of runs."""

        points: int = Field(default=1500, ge=3, description="most points of all touches together")
        spacing_mm: float = Field(default=1.0, gt=0, description="side of the cubes that keep one point each, mm")
        runs: int = Field(default=5, ge=1, description="number of runs with different seeds")
        seed: int = Field(default=0, ge=0, description="seed of the first run")

    def prepare(self, problem: LocatingProblem) -> None:
        """Compute the features of the model, and its field of nearest surface points."""
        spacing_mm, mesh = self.options.spacing_mm, problem.object.mesh
        self._fit = SurfaceFit.of(problem.object, self.options)
        count = round(SAMPLES * mesh.face_areas.sum() * (MM / spacing_mm) ** 2)
        self._model = FeaturedCloud.of(*self._fit.sample_surface(count), spacing_mm)

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return the registered poses with the highest scores. Raises TouchError if no pose fits."""
        points = TouchedPoints.of(touches, self.options.points)
        touched = FeaturedCloud.of(points.points_m, points.normals, self.options.spacing_mm)
        found = []
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            for run in range(self.options.runs):
                o3d.utility.random.seed(self.options.seed + run)
                found.append(self.register(touched, self._model))
        T_object_first = np.stack(found)
        T = invert(make_transform(T_object_first[:, :3, :3], T_object_first[:, :3, 3] / MM))
        return self._fit.find_best(T, points, 1e-3 * REACH * self.options.spacing_mm)

    @abstractmethod
    def register(self, touched: FeaturedCloud, model: FeaturedCloud) -> Poses:
        """Return the transform (4, 4), mm, of the touched points to the model."""


class FpfhRansac(FeatureRegistration):
    """FPFH features (Rusu et al., ICRA 2009) and RANSAC, then ICP, with the settings of open3d's tutorial.

    The touched points are few and mostly smooth, so we add several runs and the choice among their results. Each run
    has its own seed. With several threads, open3d does not promise equal answers.
    """

    paper: ClassVar[str] = "Rusu et al., ICRA 2009"

    class Options(FeatureRegistration.Options):
        """The effort of RANSAC."""

        hypotheses: int = Field(default=100_000, ge=1, description="most hypotheses of a run")

    def register(self, touched: FeaturedCloud, model: FeaturedCloud) -> Poses:
        """Return the transform (4, 4), mm, with the most inliers."""
        of, reach_mm = o3d.pipelines.registration, REACH * self.options.spacing_mm
        checks = [of.CorrespondenceCheckerBasedOnEdgeLength(0.9), of.CorrespondenceCheckerBasedOnDistance(reach_mm)]
        found = of.registration_ransac_based_on_feature_matching(
            touched.points,
            model.points,
            touched.features,
            model.features,
            False,
            reach_mm,
            of.TransformationEstimationPointToPoint(),
            3,
            checks,
            of.RANSACConvergenceCriteria(self.options.hypotheses, 0.999),
        )
        return np.asarray(found.transformation)


class FastGlobalRegistration(FeatureRegistration):
    """FPFH features and fast global registration (Zhou, Park and Koltun, ECCV 2016), then ICP, as open3d offers them.

    Several runs with different seeds, which change the drawn tuples, are our addition.
    """

    paper: ClassVar[str] = "Zhou, Park and Koltun, ECCV 2016"

    class Options(FeatureRegistration.Options):
        """The effort of one run."""

        tuples: int = Field(default=1000, ge=1, description="most tuples of corresponding points")

    def register(self, touched: FeaturedCloud, model: FeaturedCloud) -> Poses:
        """Return the transform (4, 4), mm, that aligns the corresponding points robustly."""
        of = o3d.pipelines.registration
        options = of.FastGlobalRegistrationOption(
            use_absolute_scale=True,
            maximum_correspondence_distance=0.5 * self.options.spacing_mm,
            maximum_tuple_count=self.options.tuples,
        )
        found = of.registration_fgr_based_on_feature_matching(
            touched.points, model.points, touched.features, model.features, options
        )
        return np.asarray(found.transformation)
