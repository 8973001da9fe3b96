"""The localisation method: score poses for each touch, fuse the scores, propose modes, then refine and weigh them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.common_poses import NoCommonPoseError, require_sensor_poses
from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.places.places import Places
from tactile_loc.core.poses.candidate import Candidate, RefinedPose
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import Prior, SeenFrom, count_touches, temper
from tactile_loc.core.registration.joint_registration import JointRegistration
from tactile_loc.core.runtime.blas import use_one_blas_thread
from tactile_loc.core.runtime.errors import ConfigError, GridError, TouchError, quote
from tactile_loc.core.runtime.progress import Progress, StageTimes
from tactile_loc.core.sensing.noise import TouchNoise, make_noise
from tactile_loc.core.sensing.scene import Scene, View, view_touch
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import RunConfig
from tactile_loc.io.meshes.mesh_files import Units
from tactile_loc.io.touches import read_touch
from tactile_loc.locate.expected_poses import add_expected_modes, is_unexpected
from tactile_loc.locate.outliers import PoseTrials, find_agreement, require_within_reach
from tactile_loc.locate.probability.conformal import ConformalSets, PoseSet
from tactile_loc.locate.probability.conformal_fit import LISTED, RIGHT_M, ConformalFit, rank
from tactile_loc.locate.probability.fitted_probabilities import FittedProbabilities
from tactile_loc.locate.probability.probabilities import Scalings, TemperatureScaling
from tactile_loc.locate.refinement import Refinement
from tactile_loc.locate.result.hypothesis import Agreement, Hypothesis, JudgedHypothesis
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import judge
from tactile_loc.locate.sources.listed_model import STAGE_VERSIONS, ObjectPoseModel
from tactile_loc.locate.sources.place_banks import PlaceBanks
from tactile_loc.locate.sources.scoring import NewMatcher
from tactile_loc.locate.sources.source import GridSource, PlaceSource, PoseSource
from tactile_loc.locate.sources.stored_places import build_places, make_places_key
from tactile_loc.locate.sources.whole_object import Matched, PlaceSearch, search_together
from tactile_loc.locate.stored_object import load_stored_object
from tactile_loc.simulate.resting_touches import draw_resting_touches
from tactile_loc.simulate.touch_simulation import simulate_touches
from tactile_loc.slots.compatibility import require_compatible
from tactile_loc.slots.matcher import ExactMatcher
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore


class Localizer:
    """Locates one object with one sensor. Build it once, then use it for any number of touches.

    Several threads may use one localizer. A localizer can be pickled, for instance for other processes. The copy loads
    what is in the store, so the store's folder must exist there. `find_places`, if given, returns the object's places
    for a grid that lists places. Otherwise, they are found once and stored.
    """

    def __init__(
        self, config: RunConfig, obj: ObjectModel, store: StageStore | None = None, progress: Progress | None = None,
        find_places: Callable[[], Places] | None = None,
    ) -> None:  # fmt: skip
        self.config, self.object, self._find_places = config, obj, find_places
        self.store, self.progress = store or StageStore(), progress or Progress()
        self.sensor = self._create("sensor")
        self.sampler = self._create("grid")
        self.encoder = self._create("encoder")
        self.fuser = self._create("fuser")
        self.refinement = Refinement(self._create("refiner"), JointRegistration(), config.together)
        renderer = self._create("renderer")
        self._require_compatible(renderer)
        self.scene = Scene(obj, self.sensor.geometry, renderer, config.drawing)
        coarse = self.sensor.geometry.resize_long_side(config.shape_px)
        coarse = coarse.press(coarse.max_depth_m)  # the grid's shapes are at full press
        self.coarse_scene = replace(self.scene, geometry=coarse)

    @classmethod
    def create(
        cls, object: str | Path = "hook", *, units: Units = "auto", symmetry: str = "auto",
        store: StageStore | str | Path | None = None, progress: Progress | None = None, **settings: Any,
    ) -> Self:  # fmt: skip
        """Load an object (a mesh file, or a demo object's name) and make its localizer; `store` may be a folder.

        `settings` are the entries of RunConfig: slots by name (`refiner="icp"`) or with options (`grid={"name": "face",
        "spacing_mm": 3}`), `top`, `seed`, ... Raises TactileLocError for bad input.
        """
        chosen = {"path": str(object), "units": units, "symmetry": symmetry}
        config = RunConfig.from_dict({"object": chosen, **settings}, "Localizer.create")
        store = store if isinstance(store, StageStore) else StageStore(store)
        return cls(config, load_stored_object(object, units, symmetry, store), store, progress)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle only what the localizer was made from. The copy makes its components and loads the rest, if stored."""
        return type(self), (self.config, self.object, self.store, self.progress, self._find_places)

    def _create(self, slot: str) -> Any:
        chosen = getattr(self.config, slot)
        return registry().create(slot, chosen.name, chosen.options)

    def _require_compatible(self, renderer: Any) -> None:
        made = {
            "sensor": self.sensor, "grid": self.sampler, "encoder": self.encoder, "refiner": self.refinement.refiner,
            "fuser": self.fuser, "renderer": renderer, "matcher": self._create("matcher"),
        }  # fmt: skip
        require_compatible(made, {slot: getattr(self.config, slot).name for slot in made})

    # touches

    def read_touch(
        self, path: str | Path, unit: str | None = None, press_depth_m: float | None = None, kind: str | None = None
    ) -> Touch:
        """Read a contact shape (npz, npy, 16-bit PNG) as a touch of this sensor. Raises TouchError for a bad file.

        `kind` is the meaning of the depths if the file does not state it: see `Touch.from_depth`.
        """
        return read_touch(Path(path), self.sensor, unit, press_depth_m, kind)

    def simulate(
        self, count: int = 1, seed: int = 0, press_depth_m: float | None = None, noise: str = "none"
    ) -> list[Touch]:
        """Simulate touches with known true poses, drawn at random from the continuous set that the grid covers.

        `noise` is none, mild or strong. Raises ConfigError for another noise, or for a count or seed below 0.
        """
        rng = _make_generator(count, seed)
        return simulate_touches(self.sampler, self.scene, count, rng, press_depth_m, make_noise(noise))

    def simulate_together(
        self, count: int = 3, seed: int = 0, press_depth_m: float | None = None, noise: str = "none",
        opposed: bool = False,
    ) -> list[Touch]:  # fmt: skip
        """Simulate touches of one object at rest, with known true poses and sensor poses `T_base_sensor`.

        The touches are drawn as by `simulate`. With `opposed`, they are pairs of a gripper's two fingers, so that the
        second sensor of a pair faces the first. Raises as `simulate`, and TouchError for an odd number of opposed
        touches.
        """
        rng = _make_generator(count, seed)
        return draw_resting_touches(self.sampler, self.scene, count, rng, press_depth_m, make_noise(noise), opposed)

    def require_own(self, touch: Touch) -> None:
        """Raise TouchError unless `touch` is a Touch of this sensor."""
        if not isinstance(touch, Touch):
            raise TouchError(f"{quote(touch)} is not a Touch; read one from a file with `Localizer.read_touch`")
        if not touch.has_depths and self.encoder.capabilities.needs_training:
            raise TouchError(
                f"{touch.name} is a contact mask, but the encoder {self.config.encoder.name!r} is trained on depths; "
                "choose `encoder` pixel"
            )
        ours = self.scene.geometry
        if touch.geometry is not ours and not touch.geometry.is_same_sensor(ours):
            raise TouchError(
                f"{touch.name} was not taken by the sensor {self.config.sensor.name}: its camera, field, gel or "
                "maximal depth differs; make a Localizer for that sensor"
            )

    # parts that are built once

    @cached_property
    def source(self) -> PoseSource:
        """The source of candidate poses: a listed grid, or a search of the whole object."""
        return self._make_source(lambda: self._create("matcher"))

    def _make_source(self, new_matcher: NewMatcher) -> PoseSource:
        config = self.config
        if not self.sampler.capabilities.places:
            return GridSource(
                self.sampler, self.coarse_scene, self.encoder, new_matcher, self.store, self.progress,
                config.hypotheses, self.mode_radius_m,
            )  # fmt: skip
        if self._find_places is None:
            places, key = build_places(self.sampler, self.scene, self.store, self.progress)
        else:
            places, key = self._find_places(), make_places_key(self.sampler, self.scene)
        banks = PlaceBanks(places, key, self.scene, self.sampler, self.encoder, self.store, self.progress)
        search = PlaceSearch(
            places, key, self.scene, self.encoder, new_matcher, self.sampler.options, config.search, banks.bank,
            banks.mask_bank,
        )  # fmt: skip
        return PlaceSource(search, banks, config.hypotheses, self.mode_radius_m)

    @property
    def loaded_bytes(self) -> int:
        """The memory, bytes, of the places and banks of a search of the whole object, which `release` frees."""
        kept = [self.__dict__.get("source"), getattr(self.__dict__.get("probabilities"), "source", None)]
        searches = {id(one): one.search for one in kept if isinstance(one, PlaceSource)}
        return sum(search.nbytes for search in searches.values())

    def release(self) -> None:
        """Free the places, listed poses and banks. They are read from the store, or made, when they are next used."""
        for part in ("source", "probabilities"):
            self.__dict__.pop(part, None)

    @property
    def search(self) -> PlaceSearch | None:
        """The search of the whole object; None if the grid lists poses."""
        return self.source.search if isinstance(self.source, PlaceSource) else None

    @property
    def listed(self) -> GridSource:
        """The listed grid. Raises ConfigError if the grid lists places, not poses."""
        if isinstance(self.source, GridSource):
            return self.source
        raise ConfigError(
            f"the grid {self.config.grid.name!r} does not list its poses, which this command or encoder needs; "
            "choose `grid` face or `grid` hopf"
        )

    @property
    def model(self) -> ObjectPoseModel:
        """The object's listed grid and contact shapes, stored or built now. Raises ConfigError as `listed` does."""
        return self.listed.model

    @cached_property
    def probabilities(self) -> FittedProbabilities:
        """The fitted probabilities: temperatures, each fitted at first use and stored."""
        exact = self._create("matcher").capabilities.top_k_only
        source = self._make_source(ExactMatcher) if exact else self.source
        return FittedProbabilities(
            source, self.scene, self.fuser, self._simulate_to_fit, self.describe_scores,
            {"sampler": self.sampler.describe()}, self.config.temperature, self.store, self.progress,
        )  # fmt: skip

    @cached_property
    def conformal_sets(self) -> ConformalSets:
        """The conformal sets for a coverage, fitted at first use and stored: see `PoseSet`."""
        config = self.config
        temperature = self.probabilities.temperature_scaling  # fitted first, with its own progress
        described = {
            **self.describe_scores(), "temperature": asdict(temperature), "sampler": self.sampler.describe(),
            "fuser": self.fuser.describe(), "refiner": self.refinement.refiner.describe(), "together": config.together,
            "hypotheses": config.hypotheses.model_dump(mode="json"), "listed": LISTED,
        }  # fmt: skip
        radius_m = RIGHT_M if self.refinement.refiner.capabilities.refines else self.mode_radius_m
        return ConformalFit(
            self._simulate_to_fit, self._locate_example, PoseMetric(self.object), radius_m, described, self.store,
            self.progress,
        ).load()  # fmt: skip

    def _locate_example(self, touches: Sequence[Touch]) -> Localization:
        query = _Query.of([(self, touch) for touch in touches], None, LISTED, None, StageTimes())
        query = replace(query, coverage=None)
        return query.answer(query.score_each())

    def _simulate_to_fit(self, count: int, seed: int, noise: TouchNoise) -> list[Touch]:
        return simulate_touches(self.sampler, self.scene, count, np.random.default_rng(seed), noise=noise)

    def describe_scores(self) -> dict[str, Any]:
        """Return all inputs of the scores except the touch, as JSON values; trains the encoder if necessary.

        The matcher is left out, because all matchers that score all poses compute the same scores.
        """
        return {
            **self.source.describe(), "sensor": self.sensor.geometry.describe(), "encoder": self.encoder.describe(),
            "training": STAGE_VERSIONS["encoder"], "bank": STAGE_VERSIONS["bank"],
        }  # fmt: skip

    @property
    def other_refinement(self) -> str:
        """The tasks that the joint registration does instead of the chosen refiner, and the reason; "" if none."""
        return self.refinement.explain_others(self.config.refiner.name, self.sampler.capabilities.places)

    @property
    def mode_radius_m(self) -> float:
        """Distance below which poses belong to one mode, metres."""
        spacing_mm: float = self.sampler.options.spacing_mm
        return self.config.hypotheses.mode_radius * spacing_mm * 1e-3

    @property
    def merge_radius_m(self) -> float:
        """Distance below which refined poses count as one hypothesis, metres."""
        return self.config.hypotheses.merge_radius * self.mode_radius_m

    # answers

    def localize(
        self, touch: Touch, prior: Prior | None = None, top: int | None = None, coverage: float | None = None
    ) -> Localization:
        """Return the posterior over poses given a touch, and its `top` distinct hypotheses, refined.

        `prior` maps poses (N, 4, 4) in metres to log-weights (N,). With a `coverage`, 0 to 1, the hypotheses are a
        set that contains the true pose with that probability: see `PoseSet`. Raises TactileLocError if no
        pose fits the touch.
        """
        return localize_together([(self, touch)], prior, top, coverage)

    @use_one_blas_thread()
    def localize_many(self, touches: Sequence[Touch], top: int | None = None) -> list[Localization]:
        """Localise touches of this sensor separately, as `localize` does.

        Touches of equal press depth are matched together. Raises TactileLocError if no pose fits one of the touches.
        """
        times = StageTimes()
        alone = self.posteriors(touches, times)
        return [
            _Query.of([(self, touch)], None, top, None, times.shared_among(len(touches))).answer(_Scored([posterior]))
            for touch, posterior in zip(touches, alone, strict=True)
        ]

    def posterior(self, touch: Touch, prior: Prior | None = None, times: StageTimes | None = None) -> PosePosterior:
        """Return the posterior over the grid's poses given a touch and a prior. Adds stage durations to `times`."""
        return compute_posterior_together([(self, touch)], prior, times)

    @use_one_blas_thread()
    def posteriors(
        self, touches: Sequence[Touch], times: StageTimes | None = None, prior: Prior | None = None,
        scaling: TemperatureScaling | None = None,
    ) -> list[PosePosterior]:  # fmt: skip
        """Return each touch's own posterior over the grid's poses, before fusion. Adds stage durations to `times`.

        A `prior` only guides the search of a whole object. `scaling` is used instead of the fitted one. Raises
        TouchError for a touch of another sensor.
        """
        for touch in touches:
            self.require_own(touch)
        scaling = scaling or self.probabilities.temperature_scaling
        scored = self.source.score(touches, times or StageTimes(), prior)
        return [scaling.posterior(grid, scores) for grid, scores in scored]

    @use_one_blas_thread()
    def find_most_probable_pose(self, touch: Touch) -> JudgedHypothesis:
        """Return the most probable pose of the grid, refined, with its probability, verdict and covariance.

        This is the fastest way to locate a touch, for instance in a control loop. Only one pose is refined. So the
        probability is that of the grid poses near it, before refinement. `localize` also compares other poses after
        refinement, and may find a better one.
        """
        posterior, view = self.posterior(touch), make_view(touch, self, touch)
        index = posterior.find_likeliest()
        near = posterior.grid.find_within(self.mode_radius_m, index)
        (pose,) = self.refine(touch, posterior, [index])
        iou = view.imprint_ious(pose.T_sensor_object[None])[0] if pose.imprint_iou is None else pose.imprint_iou
        hypothesis = Hypothesis(
            float(posterior.probabilities[near].sum()), posterior.grid.T_sensor_object[index], pose, index, len(near),
            float(iou), (float(iou),), touch.T_base_sensor,
        )  # fmt: skip
        (known,) = self.refinement.add_covariances([view], [hypothesis])
        verdict = judge(known.probability, known.imprint_iou, posterior.elsewhere, depths_known=touch.has_depths)
        return JudgedHypothesis(**vars(known), verdict=verdict)

    @use_one_blas_thread()
    def refine(self, touch: Touch, posterior: PosePosterior, indices: Sequence[int]) -> list[RefinedPose]:
        """Refine poses of the posterior's grid, given by `indices`, against the touch; return them in this order."""
        poses = posterior.grid.T_sensor_object
        candidates = [Candidate(poses[index], int(index), float(posterior.log_p[index])) for index in indices]
        return self.refinement.refine([make_view(touch, self, touch)], candidates)


def _make_generator(count: int, seed: int) -> np.random.Generator:
    """Return the random generator of `count` simulated touches. Raises ConfigError for a count or seed below 0."""
    if min(count, seed) < 0:
        raise ConfigError(f"cannot simulate {count} touches with seed {seed}; give whole numbers, 0 or more")
    return np.random.default_rng(seed)


Observation = tuple[Localizer, Touch]


@use_one_blas_thread()
def localize_together(
    observations: Sequence[Observation], prior: Prior | None = None, top: int | None = None,
    coverage: float | None = None, scalings: Scalings | None = None, starts: Poses | None = None,
) -> Localization:  # fmt: skip
    """Return the posterior over poses given touches of one object, and its `top` distinct hypotheses, refined.

    Each touch comes with the localizer of its object and its sensor; sensors may differ. If there are several touches,
    each needs `T_base_sensor` (4, 4), metres. Poses are in the first touch's sensor frame, and the posterior is over
    the first localizer's grid. `prior` maps poses (N, 4, 4) of this grid to log-weights (N,). `coverage` is as for
    `Localizer.localize`. With `scalings`, nothing is fitted to the object: its probabilities are then rough, and the
    setting `coverage` has no effect. The poses `starts` (K, 4, 4), metres, in the first touch's sensor frame, are
    refined and compared in any case. Raises TactileLocError if no pose fits all touches.

    `Localization.outliers` are the touches that contradict the others. If the first localizer's configuration sets
    `drop_outliers`, the other touches are located again without the outliers. The outliers are then in
    `Localization.left_out`, and poses are in the sensor frame of the first remaining touch.
    """
    _require_one_object(observations)
    require_within_reach([touch for _, touch in observations], observations[0][0].object)
    query = _Query.of(observations, prior, top, coverage, StageTimes(), scalings, starts)
    while True:
        scored = query.score_each()
        try:
            found = query.answer(scored)
            outliers = found.agreement.outliers
        except GridError as error:
            outliers = query.find_excluding(scored.alone)
            if not outliers:
                raise
            if not query.first.config.drop_outliers:
                name = query.touches[outliers[0]].name
                raise GridError(f"{error}. Without {name}, the other touches agree: give `drop_outliers`") from error
        if not outliers or not query.first.config.drop_outliers:
            left_out = tuple(touch for _, touch in observations if all(touch is not one for one in query.touches))
            return replace(found, left_out=left_out)
        query = query.leave_out(outliers)


def compute_posterior_together(
    observations: Sequence[Observation], prior: Prior | None = None, times: StageTimes | None = None
) -> PosePosterior:
    """Return the posterior over the first localizer's grid given touches, as for `localize_together`.

    Adds stage durations to `times`.
    """
    _require_one_object(observations)
    query = _Query.of(observations, prior, None, None, times or StageTimes())
    return query.fuse(query.score_each().alone)


@dataclass(frozen=True, eq=False)
class _Scored:
    """Each touch's own posterior and, after a search with all touches, the places that match it."""

    alone: Sequence[PosePosterior]
    matched: Sequence[Matched] = ()


@dataclass(frozen=True, eq=False)
class _Query:
    """Touches to locate together, each with its localizer, and a prior over poses in the first touch's sensor frame."""

    observations: Sequence[Observation]
    views: Sequence[View]
    prior: Prior | None
    top: int
    coverage: float | None
    times: StageTimes
    scalings: Scalings | None = None
    starts: Poses | None = None

    @classmethod
    def of(
        cls, observations: Sequence[Observation], prior: Prior | None, top: int | None, coverage: float | None,
        times: StageTimes, scalings: Scalings | None = None, starts: Poses | None = None,
    ) -> _Query:  # fmt: skip
        """Make a query; if `top` or `coverage` is None, the first localizer's setting is used.

        With `scalings`, nothing is fitted, so the setting `coverage` has no effect. Raises TactileLocError if `top` is
        below 1, if one of several touches has no sensor pose, or if a coverage cannot be promised.
        """
        first, touch = observations[0]
        top = first.config.top if top is None else top
        if top < 1:
            raise ConfigError(f"cannot list {top} hypotheses; set `top` to 1 or more")
        if coverage is not None and scalings is not None:
            raise ConfigError(f"no `coverage` of {coverage:g} can be promised without a fit; leave out `scalings`")
        coverage = first.config.coverage if coverage is None and scalings is None else coverage
        masks = [touch.name for _, touch in observations if not touch.has_depths]
        if coverage is not None and masks:
            raise ConfigError(f"no `coverage` can be promised for {masks[0]}, which is a contact mask; leave it out")
        if len(observations) > 1:
            require_sensor_poses([touch.T_base_sensor for _, touch in observations])
        views = [make_view(touch, localizer, other) for localizer, other in observations]
        return cls(observations, views, prior, top, coverage, times, scalings, starts)

    @property
    def first(self) -> Localizer:
        return self.observations[0][0]

    @property
    def touches(self) -> list[Touch]:
        return [touch for _, touch in self.observations]

    def choose_scalings(self, localizer: Localizer) -> Scalings | FittedProbabilities:
        """Return the given scalings or, if there are none, those that are fitted to the localizer's object."""
        return self.scalings or localizer.probabilities

    @property
    def start_radius_m(self) -> float:
        return self.first.config.hypotheses.start_radius * self.first.mode_radius_m

    def score_each(self) -> _Scored:
        """Score poses for each touch, and add stage durations to `times`.

        The posterior is over the localizer's grid, or over the poses found by a search with all touches.
        """
        searches = [localizer.search for localizer, _ in self.observations]
        if len(searches) == 1 or not any(searches):
            return _Scored([
                one.posteriors([touch], self.times, self.prior, self.choose_scalings(one).temperature_scaling)[0]
                for one, touch in self.observations
            ])  # fmt: skip
        together = [search for search in searches if search is not None]
        if len(together) < len(searches):
            raise ConfigError("some localizers search the whole object and others a grid of listed poses; give all of "
                              "them the grid whole, or none")  # fmt: skip
        found = search_together(self.views, together, self.times, self.prior)
        scalings = [self.choose_scalings(localizer).temperature_scaling for localizer, _ in self.observations]
        elsewhere = self.choose_scalings(self.first).fused_scaling.elsewhere(found.best, len(self.views))
        return _Scored(found.posteriors(self.views, scalings, elsewhere), found.matched)

    def fuse(self, alone: Sequence[PosePosterior]) -> PosePosterior:
        """Fuse the touches' posteriors and the prior over the first touch's grid.

        All posteriors are tempered for the number of touches.
        """
        count = len(alone) + count_touches(self.prior)
        powers = [self.choose_scalings(localizer).fused_scaling.power(count) if count > 1 else 1.0
                  for localizer, _ in self.observations]  # fmt: skip
        with self.times.stage("fuse"):
            each = [posterior.temper(power) for posterior, power in zip(alone, powers, strict=True)]
            try:
                fused = self.first.fuser.fuse(each, [touch.T_base_sensor for touch in self.touches], self.known)
            except NoCommonPoseError as error:
                raise error.name_touch([touch.name for touch in self.touches]) from error
        return replace(fused, touches=count, elsewhere=max(posterior.elsewhere for posterior in alone))

    def answer(self, scored: _Scored) -> Localization:
        """Make the result from each touch's own posterior: fuse the posteriors, then propose, refine and weigh modes.

        Adds stage durations to `times`.
        """
        alone = scored.alone
        posterior = self.fuse(alone)
        with self.times.stage("modes"):
            top = self.top if self.coverage is None else max(self.top, LISTED)
            modes = self.first.source.propose(self.views, alone, posterior, top)
            if self.first.source.searched:
                modes = add_expected_modes(modes, posterior, self.known, self.start_radius_m)
            modes = [*modes, *self._list_starts(posterior)]
        hypotheses, agreement = self._refine(modes, scored, posterior)
        touch, *others = self.touches
        found = Localization(
            touch, posterior, hypotheses, self.times.seconds, tuple(others), None, agreement, config=self.first.config
        )
        middle_m = self.first.object.mesh.centroid_m
        found = replace(found, unexpected=is_unexpected(self.known, found.best.T_sensor_object, middle_m))
        pose_set = self._choose_set(found)
        with self.times.stage("choose"):
            kept = hypotheses[: self.top if pose_set is None else pose_set.poses]
            listed = self.first.refinement.add_covariances(self.views, kept)
        placed = tuple(replace(h, T_base_sensor=touch.T_base_sensor) for h in listed)
        return replace(found, hypotheses=placed, unlisted=hypotheses[len(placed) :], pose_set=pose_set)

    def _list_starts(self, posterior: PosePosterior) -> list[Mode]:
        """Return the poses `starts` as modes of the posterior, without members."""
        if self.starts is None:
            return []
        nearest = posterior.grid.nearest(self.starts)[1]
        return [Mode(int(index), 0.0, T, np.empty(0, np.int64)) for index, T in zip(nearest, self.starts, strict=True)]

    @property
    def known(self) -> Prior | None:
        """The prior, tempered for all touches, because an earlier posterior was tempered only for its own touches."""
        told = count_touches(self.prior)
        if self.prior is None or not told:
            return self.prior
        power = self.choose_scalings(self.first).fused_scaling.power
        return temper(self.prior, lambda count: power(len(self.observations) + told) / power(count))

    def _choose_set(self, found: Localization) -> PoseSet | None:
        """Return the hypotheses that a requested coverage needs; None if no coverage was requested."""
        if self.coverage is None:
            return None
        contradictory = found.agreement.contradictory
        return PoseSet.of(rank(found), self.first.conformal_sets, self.coverage, contradictory)

    def _refine(
        self, modes: Sequence[Mode], scored: _Scored, posterior: PosePosterior
    ) -> tuple[tuple[Hypothesis, ...], Agreement]:
        first, search = self.first, self.first.search
        improves = search is not None and first.refinement.refiner.capabilities.refines
        trials = PoseTrials(
            self.views, modes, partial(self._start_alone, scored), search.registration if search and improves else None,
            first.refinement.refine, posterior.grid.metric, self.known, first.config.hypotheses, self.start_radius_m,
            first.merge_radius_m, self.times,
        )  # fmt: skip
        return (trials.find(()), Agreement()) if len(self.views) == 1 else find_agreement(trials)

    def _start_alone(self, scored: _Scored, number: int) -> tuple[PoseGrid, NDArray[np.float64]]:
        """Return poses to refine against one touch alone, and their scores (K,)."""
        search = self.observations[number][0].search
        if search is None:
            posterior = scored.alone[number]
            listed = posterior.top(self.first.config.hypotheses.listed)
            return PoseGrid(posterior.grid.T_sensor_object[listed], posterior.grid.metric), posterior.log_p[listed]
        with self.times.stage("register"):
            view = self.views[number]
            return search.find_starts_alone(View(view.touch, view.scene), scored.matched[number])

    def find_excluding(self, alone: Sequence[PosePosterior]) -> tuple[int, ...]:
        """Return the number of the touch that excludes all poses of the other touches, as a tuple.

        The tuple is empty if there are fewer than three touches, or if none or several of them exclude the others'
        poses.
        """
        if len(self.observations) < 3:
            return ()
        excluding = []
        for k in range(len(self.observations)):
            rest = [*self.observations[:k], *self.observations[k + 1 :]]
            try:
                rest[0][0].fuser.fuse([*alone[:k], *alone[k + 1 :]], [touch.T_base_sensor for _, touch in rest])
            except GridError:
                continue
            excluding.append(k)
        return tuple(excluding) if len(excluding) == 1 else ()

    def leave_out(self, outliers: Sequence[int]) -> _Query:
        """Make a query of the touches that are not outliers, in the sensor frame of the first of these touches."""
        left = [one for k, one in enumerate(self.observations) if k not in outliers]
        before, after = self.touches[0], left[0][1]
        prior, starts = self.prior, self.starts
        if after is not before:
            T_before_after = invert(np.asarray(before.T_base_sensor)) @ np.asarray(after.T_base_sensor)
            prior = None if prior is None else SeenFrom(prior, T_before_after)
            starts = None if starts is None else invert(T_before_after) @ starts
        return _Query.of(left, prior, self.top, self.coverage, self.times, self.scalings, starts)


def make_view(first: Touch, localizer: Localizer, touch: Touch) -> View:
    """Return the view of a touch: its scene, and the transform from the first touch's sensor frame to its own."""
    return view_touch(first, touch, localizer.scene.match_touch(touch))


def _require_one_object(observations: Sequence[Observation]) -> None:
    if not observations:
        raise TouchError("there is no touch to localise; give at least one")
    for localizer, touch in observations:
        localizer.require_own(touch)
    objects = {localizer.object.mesh.digest for localizer, _ in observations}
    if len(objects) > 1:
        names = ", ".join(dict.fromkeys(localizer.object.name for localizer, _ in observations))
        raise TouchError(f"the localizers are of several objects ({names}); locate each object by its own touches")
