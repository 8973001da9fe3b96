"""The method that locates touches: what is asked, and the components that answer it, in the order of the pipeline."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tactile_loc.core.geometry.lie import move_covariance
from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.posterior import Mode, NoPoseLeft, PosePosterior
from tactile_loc.core.poses.priors import Prior, SeenFrom, count_touches, temper
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.scene import View, view_touch
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.hypotheses import compute_imprint_ious
from tactile_loc.locate.probability.conformal import LISTED
from tactile_loc.locate.probability.temperature import SHARED
from tactile_loc.locate.result.hypothesis import Hypothesis, RefinedBy
from tactile_loc.locate.sources.source import PoseSource, Posteriors, rate_poses
from tactile_loc.slots.fuser import Fuser
from tactile_loc.slots.refiner import Refiner

PROPOSED = 10  # modes of a listed grid, at least, however few are listed
JOINT = "joint registration"
REFINED_WITH_PRIOR = 12  # of the likeliest modes are also refined with the prior


@dataclass(frozen=True, eq=False)
class Query:
    """Touches of one object to locate together, each in a view, and what is asked about them.

    Poses are in the first touch's sensor frame. The `prior` is over these poses. At least `top` hypotheses are
    refined, and `top` are listed, or as many as contain the true pose with the probability `coverage`. The poses
    `starts` (K, 4, 4), metres, are refined in any case; without `searches`, they are the only ones. The duration of
    each stage is added to `times`. `outlined` is the query by the law of the gel that knows the contact's outline best,
    if the touches are read by several laws.
    """

    views: Sequence[View]
    prior: Prior | None = None
    top: int = 1
    coverage: float | None = None
    starts: Poses | None = None
    searches: bool = True
    times: StageTimes = field(default_factory=StageTimes)
    outlined: Sequence[Query] = ()

    @property
    def touches(self) -> list[Touch]:
        """The touches, in their order."""
        return [view.touch for view in self.views]

    def read_otherwise(self) -> list[Query]:
        """Return the query, and the query by each other law of the gels: see `Touch.read_otherwise`."""
        each, queries = [touch.read_otherwise() for touch in self.touches], [self]
        for law in range(max(map(len, each))):
            views = []
            for view, others in zip(self.views, each, strict=True):
                touch = others[min(law, len(others) - 1)] if others else view.touch
                views.append(replace(view, touch=touch, scene=view.scene.match_touch(touch)))
            queries.append(replace(self, views=views))
        return [replace(query, outlined=queries[1:2]) for query in queries]

    def leave_out(self, outliers: Collection[int]) -> Query:
        """Return the query without some touches, in the sensor frame of the first of the others."""
        left = [view for k, view in enumerate(self.views) if k not in outliers]
        before, first = self.views[0].touch, left[0].touch
        views = [view_touch(first, view.touch, view.scene) for view in left]
        prior, starts = self.prior, self.starts
        if first is not before:
            T_before_first = invert(np.asarray(before.T_base_sensor)) @ np.asarray(first.T_base_sensor)
            prior = None if prior is None else SeenFrom(prior, T_before_first)
            starts = None if starts is None else invert(T_before_first) @ starts
        return replace(self, views=views, prior=prior, starts=starts, outlined=())


@dataclass(frozen=True)
class Refinement:
    """The chosen refiner, its name, and the joint registration, which refines poses against contact masks."""

    refiner: Refiner
    name: str
    registration: JointRegistration

    def refine(
        self, views: Sequence[View], candidates: Sequence[Candidate], prior: Prior | None = None
    ) -> list[RefinedPose]:
        """Refine candidates against one touch, or against several.

        A `prior` over poses in the first touch's sensor frame decides where the touches leave a pose open.
        """
        if self._needs_registration([view.touch for view in views]):
            poses = np.stack([candidate.T_sensor_object for candidate in candidates])
            return self.registration.refine(views, poses, prior)
        if prior is None:
            return self.refiner.refine_together(views, candidates)
        return self.refiner.refine_with_prior(views, candidates, prior)

    def _needs_registration(self, touches: Sequence[Touch]) -> bool:
        """Return whether the joint registration refines, because a touch is a contact mask without depths."""
        return self.refiner.capabilities.refines and not all(touch.has_depths for touch in touches)

    def refine_modes(
        self, views: Sequence[View], modes: Sequence[Mode], prior: Prior | None = None
    ) -> list[tuple[Mode, RefinedPose]]:
        """Refine modes against one touch, or against several, and return each with its refined pose.

        With a `prior`, the first modes are refined twice: by the touches alone, and with the prior, which decides what
        the touches leave open.
        """
        candidates = [Candidate(m.T_sensor_object, m.index, float(np.log(max(m.probability, 1e-300)))) for m in modes]
        refined = self.refine(views, candidates)
        if prior is not None:
            refined = [*refined, *self.refine(views, candidates[:REFINED_WITH_PRIOR], prior)]
            modes = [*modes, *(replace(mode, probability=0.0) for mode in modes[:REFINED_WITH_PRIOR])]
        return list(zip(modes, refined, strict=True))

    def describe(self, touches: Sequence[Touch], searches: bool) -> RefinedBy:
        """Return what refines the poses of touches. `searches` states whether the whole object is searched."""
        capabilities, masks = self.refiner.capabilities, self._needs_registration(touches)
        poses = JOINT if masks else self.name if capabilities.refines else None
        at_once = masks or self.refiner.refines_together
        return RefinedBy(
            search=JOINT if searches else None,
            poses=poses,
            touches=None if len(touches) < 2 or poses is None else "together" if at_once else "alone",
            covariances=None if poses is None else self.name if capabilities.covariances and not masks else JOINT,
        )

    def describe_other_tasks(self, searches: bool) -> str:
        """Return the tasks that the joint registration does instead of the refiner, and the reason; "" if none.

        `searches` states whether the whole object is searched.
        """
        if self.refiner.capabilities.covariances:
            return ""
        others = "improves the poses in the search of the whole object" if searches else ""
        if not self.refiner.capabilities.refines:
            return f"the joint registration {others}, because {self.name} does not refine" if others else ""
        also = f". The joint registration also {others}" if others else ""
        return (
            f"{self.name} refines the poses; their covariances come from the joint registration, because "
            f"{self.name} gives none{also}"
        )

    def add_covariances(self, views: Sequence[View], hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
        """Add covariances, given the touches, to hypotheses whose refiner gives none, or none for the base frame.

        They come from the joint registration. Poses that were not refined get no covariance. If a refiner gives only a
        covariance in the sensor frame, the error of the sensor's pose is added to it.
        """
        found = [h.refined for h in hypotheses]
        unknown = [k for k, pose in enumerate(found) if pose.covariance is None]
        if unknown and self.refiner.capabilities.refines:
            for k, pose in zip(
                unknown, self.registration.add_covariances(views, [found[k] for k in unknown]), strict=True
            ):
                found[k] = pose
        refined = (_add_sensor_error(views[0], pose) for pose in found)
        return tuple(replace(h, refined=pose) for h, pose in zip(hypotheses, refined, strict=True))


@dataclass(frozen=True, eq=False)
class LocatingMethod:
    """The components that locate the touches of a query.

    `sources` are those of each touch's localizer. The other components, and the options of `config`, are
    those of the first touch's localizer.
    """

    sources: Sequence[PoseSource]
    fuser: Fuser
    refinement: Refinement
    config: RunConfig

    @property
    def source(self) -> PoseSource:
        """The first touch's source, which searches with all touches."""
        return self.sources[0]

    @property
    def metric(self) -> PoseMetric:
        """The distance between two poses of the object."""
        return self.source.setup.metric

    def leave_out(self, outliers: Collection[int]) -> LocatingMethod:
        """Return the method for a query without some touches."""
        left = [k for k in range(len(self.sources)) if k not in outliers]
        return replace(self, sources=[self.sources[k] for k in left])

    def temper_prior(self, query: Query) -> Prior | None:
        """Return the prior, tempered for all touches, because an earlier posterior was tempered only for its own."""
        told = count_touches(query.prior)
        if query.prior is None or not told:
            return query.prior
        power = self.compute_power
        return temper(query.prior, lambda count: power(len(query.views) + told) / power(count))

    def search(self, query: Query) -> Posteriors:
        """Return each touch's own posterior, from the source, or over the poses that the query gives."""
        if not query.searches:
            poses, options = np.asarray(query.starts), self.config.search
            ious = compute_imprint_ious(query.views, poses, options.image_px, 1e-3 * options.free_z_mm)
            return rate_poses(query.views, self.sources, poses, ious)
        return self.source.search(query.views, self.sources, query.times, query.prior)

    def fuse(self, alone: Posteriors, query: Query) -> PosePosterior | NoPoseLeft:
        """Fuse the touches' posteriors, each tempered for the number of touches, and the prior."""
        count = len(alone) + count_touches(query.prior)
        power = self.compute_power(count)
        T_base_sensor = [touch.T_base_sensor for touch in query.touches]
        with query.times.stage("fuse"):
            each = [posterior.temper(power) for posterior in alone]
            fused = self.fuser.fuse(each, T_base_sensor, self.temper_prior(query))
        if isinstance(fused, NoPoseLeft):
            outlier = self._find_excluding(alone, T_base_sensor)
            return replace(fused.name_touch([touch.name for touch in query.touches]), outlier=outlier)
        return replace(fused, touches=count)

    def compute_power(self, touches: int) -> float:
        """Return the power to which the posterior of each of several touches is raised: see `SHARED`.

        With the user's temperature, posteriors are multiplied as they are.
        """
        return 1.0 if self.config.temperature is not None else float(max(1, touches) ** -SHARED)

    def _find_excluding(self, alone: Posteriors, T_base_sensor: Sequence[Poses | None]) -> int | None:
        """Return the number of the only touch without which the other touches, at least two, share a pose."""
        if len(alone) < 3:
            return None
        rests = ([n for n in range(len(alone)) if n != k] for k in range(len(alone)))
        fused = [self.fuser.fuse([alone[n] for n in rest], [T_base_sensor[n] for n in rest]) for rest in rests]
        found = [k for k, one in enumerate(fused) if not isinstance(one, NoPoseLeft)]
        return found[0] if len(found) == 1 else None

    def propose(self, alone: Posteriors, posterior: PosePosterior, query: Query) -> list[Mode]:
        """Return the modes of the posterior to refine, and the poses that the query gives.

        A query that lists fewer than PROPOSED poses has the same modes, and so the same verdict.
        """
        modes, nothing = [], np.empty(0, np.int64)
        with query.times.stage("modes"):
            if query.searches:
                top = max(query.top, self.config.top, PROPOSED if query.coverage is None else LISTED)
                modes = self.source.propose(query.views, alone, posterior, self.temper_prior(query), top)
            if query.starts is None:
                return modes
            nearest = posterior.grid.nearest(query.starts)[1]
            p = 0.0 if query.searches else posterior.probabilities[nearest]
            given = zip(nearest, np.broadcast_to(p, len(nearest)), query.starts, strict=True)
            return [*modes, *(Mode(int(k), float(share), T, nothing) for k, share, T in given)]


def _add_sensor_error(view: View, pose: RefinedPose) -> RefinedPose:
    """Return the pose with a `reported_covariance`, if it has none: its covariance plus the error of the sensor's pose.

    The error of the sensor's pose is a twist about the middle of the gel.
    """
    if pose.covariance is None or pose.reported_covariance is not None:
        return pose
    error = np.diag([view.sensor_std_m**2] * 3 + [view.sensor_std_rad**2] * 3)
    moved = move_covariance(error, pose.T_sensor_object[:3, 3] - view.touch.geometry.gel_middle_m)
    return replace(pose, reported_covariance=pose.covariance + moved)
