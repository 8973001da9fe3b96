"""The method, read aloud: what touches say of the grid's poses is fused, its modes are found and refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError, GridError, TouchError
from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import Prior, SeenFrom, tempered, touches_behind
from tactile_loc.core.progress import Progress, StageTimes
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.common_poses import require_sensor_poses
from tactile_loc.core.slots.refiner import Candidate, RefinedPose, Refiner
from tactile_loc.core.slots.registry import registry
from tactile_loc.core.slots.scene import View
from tactile_loc.io.config import RunConfig
from tactile_loc.locate.agreement import agreed, best_alone, require_within_reach
from tactile_loc.locate.conformal import PoseSet
from tactile_loc.locate.hypotheses import REFINED, best_apart, find_hypotheses, likeliest, proposed
from tactile_loc.locate.posteriors import TouchPosteriors
from tactile_loc.locate.result import Agreement, Hypothesis, Localization
from tactile_loc.locate.search import found_together
from tactile_loc.store.store import StageStore

MODE_RADIUS = 2.0  # grid spacings between poses that count as one hypothesis
PROPOSAL_RADIUS = 0.25  # mode radii between poses that are refined
SAME_POSE = 0.25  # mode radii between refined poses that count as one
SEARCHED = 20  # poses of a whole object that are refined, at least, and a tenth of what was found
DOUBTED = 12  # modes that are refined again without a touch that may contradict the others


class Localizer(TouchPosteriors):
    """Locates one object with one sensor. Build it once, then ask it about any number of touches."""

    def __init__(
        self, config: RunConfig, obj: ObjectModel, store: StageStore | None = None, progress: Progress | None = None
    ) -> None:
        super().__init__(config, obj, store, progress)
        self.refiner = self._component("refiner")

    @cached_property
    def refiner_of_several(self) -> Refiner:
        """What refines against several touches: a refiner that knows one at a time gives way to the joint one."""
        one_at_a_time = type(self.refiner).refine_together is Refiner.refine_together
        if self.config.together == "each" or not (one_at_a_time and self.refiner.capabilities.refines):
            return self.refiner
        joint: Refiner = self._joint
        return joint

    @cached_property
    def _joint(self) -> Any:
        return registry().create("refiner", "joint", {})

    def with_covariances(self, views: Sequence[View], hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
        """Return hypotheses with the covariances that the joint registration finds where the refiner says none.

        They are of the touches `views`. A pose that was not refined has none.
        """
        unknown = [k for k, h in enumerate(hypotheses) if h.refined.covariance is None]
        if not unknown or not self.refiner.capabilities.refines:
            return tuple(hypotheses)
        found = list(hypotheses)
        poses = np.stack([hypotheses[k].T_sensor_object for k in unknown])
        for k, covariance in zip(unknown, self._joint.covariances(views, poses), strict=True):
            refined = replace(hypotheses[k].refined, covariance=covariance)
            found[k] = replace(hypotheses[k], refined=refined)
        return tuple(found)

    @property
    def mode_radius_m(self) -> float:
        """How near to one another poses count as one hypothesis, metres."""
        spacing_mm: float = self.sampler.options.spacing_mm
        return MODE_RADIUS * spacing_mm * 1e-3

    @property
    def same_pose_m(self) -> float:
        """How near to one another refined poses count as one, metres."""
        return SAME_POSE * self.mode_radius_m

    def posterior(self, touch: Touch, prior: Prior | None = None, times: StageTimes | None = None) -> PosePosterior:
        """Return the posterior over the grid's poses of a touch and a prior: encode, match, fuse; adds to `times`."""
        return posterior_together([(self, touch)], prior, times)

    def localize(
        self, touch: Touch, prior: Prior | None = None, top: int | None = None, coverage: float | None = None
    ) -> Localization:
        """Return the distribution over poses given a touch, and its `top` distinct hypotheses, refined.

        `prior` maps poses (N, 4, 4) in metres to log-weights (N,). With a `coverage`, 0 to 1, the hypotheses are all
        modes of a set that holds the truth as often: see `PoseSet`. Raises TactileLocError when nothing fits.
        """
        return localize_together([(self, touch)], prior, top, coverage)

    def localize_many(self, touches: Sequence[Touch], top: int | None = None) -> list[Localization]:
        """Localise touches of this sensor, each for itself, as `localize` does; those of one press are matched at once.

        Raises TactileLocError when nothing fits one of them.
        """
        times = StageTimes()
        alone = self.posteriors(touches, times)
        return [
            _located([(self, touch)], [posterior], None, top, times.shared_among(len(touches)))
            for touch, posterior in zip(touches, alone, strict=True)
        ]

    def most_probable_pose(self, touch: Touch) -> RefinedPose:
        """Return the most probable pose of the grid, refined: the shortest way, for a control loop."""
        posterior = self.posterior(touch)
        return self.refine(touch, posterior, [int(posterior.log_p.argmax())])[0]

    def refine(self, touch: Touch, posterior: PosePosterior, indices: Sequence[int]) -> list[RefinedPose]:
        """Refine poses of the posterior's grid against the touch, in the order of their indices."""
        poses = posterior.grid.T_sensor_object
        candidates = [Candidate(poses[index], int(index), float(posterior.log_p[index])) for index in indices]
        refined: list[RefinedPose] = self.refiner.refine_many(touch, candidates, self.scene.of_touch(touch))
        return refined


Observation = tuple[Localizer, Touch]


def posterior_together(
    observations: Sequence[Observation], prior: Prior | None = None, times: StageTimes | None = None
) -> PosePosterior:
    """Return the posterior over the first localizer's grid given touches of one object, as for `localize_together`."""
    _require_one_object(observations)
    times = times or StageTimes()
    return _fused(observations, _each(observations, times, prior), _beside(observations, prior), times)


def localize_together(
    observations: Sequence[Observation], prior: Prior | None = None, top: int | None = None,
    coverage: float | None = None,
) -> Localization:  # fmt: skip
    """Return the distribution over poses given touches of one object, and its `top` distinct hypotheses, refined.

    Each touch comes with the localizer of its object and its sensor, which may be of different kinds; of several, each
    knows `T_base_sensor` (4, 4), metres. The answer is in the first touch's sensor frame, over its localizer's grid;
    `prior` maps that grid's poses (N, 4, 4) to log-weights (N,); `coverage` is as for `Localizer.localize`.
    Raises TactileLocError when nothing fits all of them.

    A touch that contradicts the others is named (`Localization.outliers`); if the first localizer's configuration says
    `drop_outliers`, it is `left_out`, and the answer is that of the others alone, in the first one's frame of them.
    """
    _require_one_object(observations)
    require_within_reach([touch for _, touch in observations], observations[0][0].object)
    times = StageTimes()
    first, left = observations[0], list(range(len(observations)))
    while True:
        some = [observations[k] for k in left]
        known = _prior_of(prior, first[1], some[0][1])
        posteriors = _each(some, times, known)
        try:
            found = _located(some, posteriors, known, top, times, coverage)
            outliers = found.agreement.outliers
        except GridError as error:
            outliers = _excluding(some, posteriors)
            if not outliers:
                raise
            if not first[0].config.drop_outliers:
                name = some[outliers[0]][1].name
                raise GridError(f"{error}; without {name} the others agree: --drop-outliers leaves it out") from error
        if not outliers or not first[0].config.drop_outliers:
            left_out = tuple(touch for k, (_, touch) in enumerate(observations) if k not in left)
            return replace(found, left_out=left_out)
        left = [k for place, k in enumerate(left) if place not in outliers]


def _excluding(observations: Sequence[Observation], alone: Sequence[PosePosterior]) -> tuple[int, ...]:
    """Which one of three touches or more excludes all poses of the others: its number; empty if none or several do."""
    if len(observations) < 3:
        return ()
    excluding = []
    for k in range(len(observations)):
        rest = [observations[i] for i in range(len(observations)) if i != k]
        try:
            rest[0][0].fuser.fuse([*alone[:k], *alone[k + 1 :]], [touch.T_base_sensor for _, touch in rest])
        except GridError:
            continue
        excluding.append(k)
    return tuple(excluding) if len(excluding) == 1 else ()


def _prior_of(prior: Prior | None, first: Touch, other: Touch) -> Prior | None:
    """A prior over poses in the first touch's sensor frame as one over those in another's."""
    if prior is None or other is first:
        return prior
    T_first_other = invert(np.asarray(first.T_base_sensor)) @ np.asarray(other.T_base_sensor)
    return SeenFrom(prior, T_first_other)


def _located(
    observations: Sequence[Observation], alone: Sequence[PosePosterior], prior: Prior | None, top: int | None,
    times: StageTimes, coverage: float | None = None,
) -> Localization:  # fmt: skip
    """What touches say together, of each one's posterior alone."""
    first, touch = observations[0]
    touches = tuple(t for _, t in observations)
    coverage = first.config.coverage if coverage is None else coverage
    known = _beside(observations, prior)
    posterior = _fused(observations, alone, known, times)
    poses = None if coverage is None else PoseSet.of(posterior, first.conformal_sets(posterior.touches), coverage)
    top = first.config.top if top is None else top
    if top < 1:
        raise ConfigError(f"{top} hypotheses cannot be listed; `top` must be 1 or more")
    views = [view_of(touch, localizer, t) for localizer, t in observations]
    radius_m = PROPOSAL_RADIUS * first.mode_radius_m
    with times.stage("modes"):
        modes: list[Mode] = []
        if first.search is not None:
            modes = best_apart(posterior, radius_m, max(top, SEARCHED, len(posterior.grid) // 10))
        elif len(views) > 1:
            modes = proposed(views, alone, posterior, radius_m, REFINED)
        if poses is not None:
            modes += posterior.modes(first.mode_radius_m, None, core=poses.indices)
        elif not modes:
            modes = posterior.modes(first.mode_radius_m, top)
    refiner = first.refiner if len(views) == 1 else first.refiner_of_several

    def find(outliers: tuple[int, ...] = ()) -> tuple[Hypothesis, ...]:
        metric, some = posterior.grid.metric, modes
        if outliers:
            some = likeliest(modes, [v for k, v in enumerate(views) if k not in outliers], radius_m, DOUBTED)
        return find_hypotheses(views, some, refiner, metric, first.same_pose_m, known, times, outliers)

    def at_best() -> NDArray[np.float64]:
        own = alone if first.search is None else [_each([one], times)[0] for one in observations]
        with times.stage("refine"):
            return np.array([best_alone(v, p, refiner, radius_m) for v, p in zip(views, own, strict=True)])

    found, agreement = (find(), Agreement()) if len(views) == 1 else agreed(find, at_best)
    with times.stage("choose"):
        listed = first.with_covariances(views, found if poses is not None else found[:top])
    return Localization(touch, posterior, listed, times.seconds, touches[1:], poses, agreement)


def _each(observations: Sequence[Observation], times: StageTimes, prior: Prior | None = None) -> list[PosePosterior]:
    """What each touch says for itself: of its localizer's grid, or of the poses that a search of all together found.

    A prior over poses in the first sensor's frame only says where to search the more.
    """
    searches = [localizer.search for localizer, _ in observations if localizer.search is not None]
    if len(observations) == 1 or not searches:
        return [localizer.posteriors([touch], times, prior)[0] for localizer, touch in observations]
    if len(searches) < len(observations):
        raise ConfigError("some touches are searched for in the whole object and others in a grid of listed poses; "
                          "give all their localizers the grid whole, or none")  # fmt: skip
    require_sensor_poses([touch.T_base_sensor for _, touch in observations])
    first = observations[0][1]
    views = [view_of(first, localizer, touch) for localizer, touch in observations]
    found = found_together(views, searches, times, prior)
    elsewhere = observations[0][0].fused_scaling.elsewhere(found.best)
    return found.posteriors(views, [localizer.temperature_scaling for localizer, _ in observations], elsewhere)


def _fused(
    observations: Sequence[Observation], alone: Sequence[PosePosterior], prior: Prior | None, times: StageTimes
) -> PosePosterior:
    """What touches and a prior say of the first one's grid, as sure as so many touches can make."""
    count = len(alone) + touches_behind(prior)
    powers = [localizer.fused_scaling.power(count) if count > 1 else 1.0 for localizer, _ in observations]
    with times.stage("fuse"):
        each = [posterior.tempered(power) for posterior, power in zip(alone, powers, strict=True)]
        fused: PosePosterior = observations[0][0].fuser.fuse(each, [t.T_base_sensor for _, t in observations], prior)
    return replace(fused, touches=count, elsewhere=max(posterior.elsewhere for posterior in alone))


def _beside(observations: Sequence[Observation], prior: Prior | None) -> Prior | None:
    """A prior as it counts beside touches: an earlier posterior was as sure as its own touches alone could make."""
    told = touches_behind(prior)
    if prior is None or not told:
        return prior
    power = observations[0][0].fused_scaling.power
    return tempered(prior, lambda count: power(len(observations) + told) / power(count))


def view_of(first: Touch, localizer: Localizer, touch: Touch) -> View:
    """Return a touch as hypotheses in the first one's sensor frame are compared with it."""
    scene = localizer.scene.of_touch(touch)
    T = np.eye(4) if touch is first else invert(np.asarray(touch.T_base_sensor)) @ np.asarray(first.T_base_sensor)
    return View(touch, scene, T, touch.T_base_sensor_std_m, touch.T_base_sensor_std_rad)


def _require_one_object(observations: Sequence[Observation]) -> None:
    if not observations:
        raise TouchError("there is no touch to localise; give one at least")
    for localizer, touch in observations:
        localizer.require_own(touch)
    objects = {localizer.object.mesh.digest for localizer, _ in observations}
    if len(objects) > 1:
        names = ", ".join(dict.fromkeys(localizer.object.name for localizer, _ in observations))
        raise TouchError(f"the touches are of several objects ({names}); locate each by its own touches")
