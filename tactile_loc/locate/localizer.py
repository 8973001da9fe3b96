"""The method, read aloud: build an object's model once; encode touches, match, fuse, find the modes, refine them."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import GridError, TouchError
from tactile_loc.core.geometry import invert
from tactile_loc.core.interfaces import Candidate, Matcher, Prior, RefinedPose, Refiner, Scene, View
from tactile_loc.core.noise import noise_level
from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.poses import PoseGrid
from tactile_loc.core.posterior import Mode, PosePosterior
from tactile_loc.core.priors import SeenFrom, tempered, touches_behind
from tactile_loc.core.progress import Progress, StageTimes
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import Touch
from tactile_loc.core.simulation import simulate_touches
from tactile_loc.io.config import RunConfig, SlotConfig
from tactile_loc.io.meshes import Units, load_object
from tactile_loc.io.touches import read_touch
from tactile_loc.locate import coverage as conformal
from tactile_loc.locate import probabilities
from tactile_loc.locate.agreement import agreed, best_alone
from tactile_loc.locate.coverage import ConformalSets, PoseSet
from tactile_loc.locate.hypotheses import REFINED, find_hypotheses, likeliest, proposed
from tactile_loc.locate.model import STAGE_VERSIONS, ObjectPoseModel, build_bank, build_model, train_encoder
from tactile_loc.locate.probabilities import (
    FusedScaling,
    TemperatureScaling,
    fit_fused_scaling,
    fit_temperature_scaling,
)
from tactile_loc.locate.result import Agreement, Hypothesis, Localization
from tactile_loc.locate.scoring import GridScores, Scores
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

logger = logging.getLogger(__name__)

MODE_RADIUS = 2.0  # grid spacings between poses that count as one hypothesis
PROPOSAL_RADIUS = 0.25  # mode radii between poses that are refined
SAME_POSE = 0.25  # mode radii between refined poses that count as one
DOUBTED = 12  # modes that are refined again without a touch that may contradict the others
EXAMPLE_TOUCHES = 50  # of simulated examples, in memory at once


class Localizer:
    """Locates one object with one sensor. Build it once, then ask it about any number of touches."""

    def __init__(
        self, config: RunConfig, obj: ObjectModel, store: StageStore | None = None, progress: Progress | None = None
    ) -> None:
        self.config = config
        self.object = obj
        self.store = StageStore() if store is None else store
        self.progress = progress or Progress()
        self.sensor = self._component("sensor")
        self.sampler = self._component("grid")
        self.encoder = self._component("encoder")
        self.refiner = self._component("refiner")
        self.fuser = self._component("fuser")
        renderer = self._component("renderer")
        self.scene = Scene(obj, self.sensor.geometry, renderer, config.drawing)
        coarse = self.sensor.geometry.with_long_side(config.shape_px)
        coarse = coarse.pressed(coarse.max_depth_m)  # the grid's, at full press
        self.coarse_scene = dataclasses.replace(self.scene, geometry=coarse)

    @classmethod
    def create(
        cls, object: str | Path = "hook", *, units: Units = "auto", symmetry: str = "auto",
        store: StageStore | None = None, progress: Progress | None = None, **settings: Any,
    ) -> Localizer:  # fmt: skip
        """Load an object (a mesh file or a demo object's name) and make its localizer.

        `settings` are RunConfig's: slots by name (`refiner="icp"`) or with options
        (`grid={"name": "face", "spacing_mm": 3}`), `top`, `seed`, ... Raises TactileLocError for bad input.
        """
        chosen = {"path": str(object), "units": units, "symmetry": symmetry}
        config = RunConfig.from_dict({"object": chosen, **settings}, "Localizer.create")
        return cls(config, load_object(object, units, symmetry), store, progress)

    def _component(self, slot: str) -> Any:
        chosen = getattr(self.config, slot)
        return registry().create(slot, chosen.name, chosen.options)

    def with_matcher(self, name: str) -> Localizer:
        """Return a localizer that compares by another matcher, and is the same otherwise."""
        if self.config.matcher.name == name:
            return self
        config = self.config.model_copy(update={"matcher": SlotConfig(name=name)})
        return Localizer(config, self.object, self.store, self.progress)

    def read_touch(self, path: str | Path, unit: str | None = None, press_depth_m: float | None = None) -> Touch:
        """Read a contact shape (npz, npy, 16-bit PNG) as this sensor's touch. Raises TouchError."""
        return read_touch(Path(path), self.sensor, unit, press_depth_m)

    def simulate(
        self, count: int = 1, seed: int = 0, press_depth_m: float | None = None, noise: str = "none"
    ) -> list[Touch]:
        """Make touches at random poses of the continuous set that the grid covers, with their true poses; metres.

        `noise` is none, mild or strong. Raises ConfigError for another.
        """
        rng = np.random.default_rng(seed)
        return simulate_touches(self.sampler, self.scene, count, rng, press_depth_m, noise_level(noise))

    @cached_property
    def model(self) -> ObjectPoseModel:
        """The object's grid and contact shapes: from the store, or built now."""
        return build_model(self.coarse_scene, self.sampler, self.store, self.progress)

    @cached_property
    def trained(self) -> str:
        """What identifies what the encoder learned: trained now, or read from the store; empty if it learns nothing."""
        return train_encoder(self.encoder, self.model, self.coarse_scene, self.sampler, self.store, self.progress)

    @cached_property
    def grid_scores(self) -> GridScores:
        """The comparison of touches with the grid's banks, each from the store, or built at first use."""
        max_depth_m = self.scene.geometry.max_depth_m
        return GridScores(self.encoder, lambda: self._component("matcher"), self._bank, max_depth_m)

    def _bank(self, press_depth_m: float) -> Scores:
        return build_bank(
            self.model, self.coarse_scene, self.encoder, press_depth_m, self.store, self.progress, self.trained
        )  # fmt: skip

    def matcher(self, press_depth_m: float) -> Matcher:
        """Return the matcher whose bank was cut at this press depth (metres), built at first use."""
        return self.grid_scores.matcher(press_depth_m)

    @cached_property
    def temperature_scaling(self) -> TemperatureScaling:
        """How scores become probabilities: by the temperature asked for, or as simulated touches have taught."""
        if self.config.temperature is not None:
            return TemperatureScaling(self.config.temperature)
        artifact = self.store.build(self.temperature_key(), self._fit_temperature)
        return TemperatureScaling(**artifact.json(probabilities.STAGE))

    def temperature_key(self) -> StageKey:
        """Return the key under which the temperature scaling is stored: everything that decides it."""
        simulated = {"sampler": self.sampler.describe(), **probabilities.describe_touches()}
        return StageKey(probabilities.STAGE, probabilities.STAGE_VERSION, {**self.describe_scores(), **simulated})

    def _fit_temperature(self, work: Workspace) -> None:
        """Score simulated touches of known pose, and save the scaling that makes the true poses most probable."""
        exact = self.with_matcher("dense")
        scores: list[Scores] = []
        truth: list[int] = []
        with self.progress.task("fitting probabilities", probabilities.TOUCHES) as advance:
            for seed, count in probabilities.batches():
                for touch in self.simulate(count, seed, noise=probabilities.TOUCH_NOISE):
                    scores += exact.scores([touch])
                    truth.append(int(self.grid_of(touch).nearest(np.asarray(touch.T_sensor_object)[None])[1][0]))
                    advance(1)
        work.save_json(probabilities.STAGE, asdict(fit_temperature_scaling(scores, np.array(truth))))

    @cached_property
    def fused_scaling(self) -> FusedScaling:
        """How sure several touches together make: fitted to simulated examples, unless a temperature was asked for."""
        if self.config.temperature is not None:
            return FusedScaling()
        key = StageKey(probabilities.FUSED_STAGE, probabilities.FUSED_VERSION, {
            **self._describe_fused(), **probabilities.describe_examples(),
        })  # fmt: skip
        return FusedScaling(**self.store.build(key, self._fit_fused_scaling).json(probabilities.FUSED_STAGE))

    def _fit_fused_scaling(self, work: Workspace) -> None:
        """Fuse simulated touches of known pose, and save how sure they are to make."""
        numbers, count, seed = probabilities.FUSED_TOUCHES, probabilities.FUSED_EXAMPLES, probabilities.FUSED_SEED
        fused = [
            (number, found.log_p, truth)
            for number in numbers
            for found, truth in self._examples(number, count, seed, probabilities.TOUCH_NOISE)
            if found is not None
        ]
        work.save_json(probabilities.FUSED_STAGE, asdict(fit_fused_scaling(fused)))

    def conformal_sets(self, touches: int) -> ConformalSets:
        """Return how large sets of poses are to be, given so many touches, to hold the truth as often as asked for."""
        number = min(touches, conformal.MOST_TOUCHES)
        described = {**self._describe_fused(), **conformal.describe_examples(number)}
        key = StageKey(conformal.STAGE, conformal.STAGE_VERSION, described)

        def score(work: Workspace) -> None:
            power = 1.0 if number == 1 else self.fused_scaling.power(number)
            examples = self._examples(number, conformal.EXAMPLES, conformal.SEED, conformal.NOISE)
            work.save_json(conformal.STAGE, [
                1.0 if fused is None else fused.tempered(power).credible_level(truth) for fused, truth in examples
            ])  # fmt: skip

        return ConformalSets(self.store.build(key, score).json(conformal.STAGE))

    def _describe_fused(self) -> dict[str, Any]:
        """What decides what is fused of simulated touches, but for the touches, as JSON values."""
        asked = self.config.temperature
        scaling = {"asked": asked} if asked is not None else {"fitted": self.temperature_key().digest}
        scores = {**self.describe_scores(), "sampler": self.sampler.describe()}
        return {**scores, "temperature": scaling, "fuser": self.fuser.describe()}

    def _examples(self, touches: int, count: int, seed: int, noise: str) -> Iterator[tuple[PosePosterior | None, int]]:
        """What so many simulated touches of the object at rest say, fused but not tempered, and the true pose's index.

        None where no pose touches all sensors. No touch is in two examples.
        """
        exact = self.with_matcher("dense")
        at_once = max(1, EXAMPLE_TOUCHES // touches)
        with self.progress.task(f"fusing examples of {touches} touches", count) as advance:
            for start in range(0, count, at_once):
                drawn = self.simulate(
                    touches * min(at_once, count - start), seed + 100_000 * touches + start, None, noise
                )
                posteriors = exact.posteriors(drawn)
                for first in range(0, len(drawn), touches):
                    poses = np.stack([np.asarray(touch.T_sensor_object) for touch in drawn[first : first + touches]])
                    alone = posteriors[first : first + touches]
                    truth = int(alone[0].grid.nearest(poses[:1])[1][0])
                    try:
                        yield self.fuser.fuse(alone, list(invert(poses))), truth
                    except GridError:
                        yield None, truth
                    advance(1)

    def describe_scores(self) -> dict[str, Any]:
        """Return what decides a touch's scores but for the touch, as JSON values; trains the encoder if need be.

        The matcher is not among it: all find the same scores, if they look at all poses.
        """
        return {
            "model": self.model.key.digest, "sensor": self.sensor.geometry.describe(), "trained": self.trained,
            "encoder": self.encoder.describe(), "training": STAGE_VERSIONS["encoder"], "bank": STAGE_VERSIONS["bank"],
        }  # fmt: skip

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

    def scores(self, touches: Sequence[Touch], times: StageTimes | None = None) -> list[Scores]:
        """Return how alike (N,) each touch and each pose of the grid are, unitless; adds to `times`.

        Raises TouchError when another sensor took one of the touches.
        """
        for touch in touches:
            self._require_own(touch)
        return self.grid_scores.scores(touches, times or StageTimes())

    def posteriors(self, touches: Sequence[Touch], times: StageTimes | None = None) -> list[PosePosterior]:
        """Return what each touch alone says of the grid's poses, before anything is fused with it.

        Raises TouchError when another sensor took one of the touches.
        """
        scaling = self.temperature_scaling
        scored = zip(touches, self.scores(touches, times), strict=True)
        return [scaling.posterior(self.grid_of(touch), scores) for touch, scores in scored]

    def grid_of(self, touch: Touch) -> PoseGrid:
        """Return the poses that are searched, in metres, pressed as deep as the touch."""
        return self.model.grid.raised(self.scene.geometry.max_depth_m - touch.indentation_m)

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

    def _require_own(self, touch: Touch) -> None:
        ours = self.scene.geometry
        if touch.geometry is not ours and not touch.geometry.is_same_sensor(ours):
            raise TouchError(
                f"{touch.name} was taken by another sensor than {self.config.sensor.name}: its camera, field or "
                "maximal depth differs; make a Localizer for the sensor that took it"
            )


Observation = tuple[Localizer, Touch]


def posterior_together(
    observations: Sequence[Observation], prior: Prior | None = None, times: StageTimes | None = None
) -> PosePosterior:
    """Return the posterior over the first localizer's grid given touches of one object, as for `localize_together`."""
    _require_one_object(observations)
    times = times or StageTimes()
    alone = [localizer.posteriors([touch], times)[0] for localizer, touch in observations]
    return _fused(observations, alone, _beside(observations, prior), times)


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
    times = StageTimes()
    alone = [localizer.posteriors([touch], times)[0] for localizer, touch in observations]
    first, left = observations[0], list(range(len(observations)))
    while True:
        some, posteriors = [observations[k] for k in left], [alone[k] for k in left]
        try:
            found = _located(some, posteriors, _prior_of(prior, first[1], some[0][1]), top, times, coverage)
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
    top = top or first.config.top
    views = [_view(touch, localizer, t) for localizer, t in observations]
    radius_m = PROPOSAL_RADIUS * first.mode_radius_m
    with times.stage("modes"):
        modes: list[Mode] = []
        if len(views) > 1:
            modes = proposed(views, alone, posterior, radius_m, REFINED)
        if poses is not None:
            modes += posterior.modes(first.mode_radius_m, None, core=poses.indices)
        elif len(views) == 1:
            modes = posterior.modes(first.mode_radius_m, top)
    refiner = first.refiner if len(views) == 1 else first.refiner_of_several

    def find(outliers: tuple[int, ...] = ()) -> tuple[Hypothesis, ...]:
        metric, some = posterior.grid.metric, modes
        if outliers:
            some = likeliest(modes, [v for k, v in enumerate(views) if k not in outliers], radius_m, DOUBTED)
        return find_hypotheses(views, some, refiner, metric, first.same_pose_m, known, times, outliers)

    def at_best() -> NDArray[np.float64]:
        with times.stage("refine"):
            return np.array([best_alone(v, p, refiner, radius_m) for v, p in zip(views, alone, strict=True)])

    found, agreement = (find(), Agreement()) if len(views) == 1 else agreed(find, at_best)
    with times.stage("choose"):
        listed = first.with_covariances(views, found if poses is not None else found[:top])
    return Localization(touch, posterior, listed, times.seconds, touches[1:], poses, agreement)


def _fused(
    observations: Sequence[Observation], alone: Sequence[PosePosterior], prior: Prior | None, times: StageTimes
) -> PosePosterior:
    """What touches and a prior say of the first one's grid, as sure as so many touches can make."""
    count = len(alone) + touches_behind(prior)
    powers = [localizer.fused_scaling.power(count) if count > 1 else 1.0 for localizer, _ in observations]
    with times.stage("fuse"):
        each = [posterior.tempered(power) for posterior, power in zip(alone, powers, strict=True)]
        fused: PosePosterior = observations[0][0].fuser.fuse(each, [t.T_base_sensor for _, t in observations], prior)
    return replace(fused, touches=count)


def _beside(observations: Sequence[Observation], prior: Prior | None) -> Prior | None:
    """A prior as it counts beside touches: an earlier posterior was as sure as its own touches alone could make."""
    told = touches_behind(prior)
    if prior is None or not told:
        return prior
    power = observations[0][0].fused_scaling.power
    return tempered(prior, lambda count: power(len(observations) + told) / power(count))


def _view(first: Touch, localizer: Localizer, touch: Touch) -> View:
    """A touch as hypotheses in the first one's sensor frame are compared with it."""
    scene = localizer.scene.of_touch(touch)
    if touch is first:
        return View(touch, scene)
    std_m = np.hypot(first.T_base_sensor_std_m, touch.T_base_sensor_std_m)
    std_rad = np.hypot(first.T_base_sensor_std_rad, touch.T_base_sensor_std_rad)
    T_sensor_first = invert(np.asarray(touch.T_base_sensor)) @ np.asarray(first.T_base_sensor)
    return View(touch, scene, T_sensor_first, float(std_m), float(std_rad))


def _require_one_object(observations: Sequence[Observation]) -> None:
    if not observations:
        raise TouchError("there is no touch to localise; give one at least")
    objects = {localizer.object.mesh.digest for localizer, _ in observations}
    if len(objects) > 1:
        names = ", ".join(dict.fromkeys(localizer.object.name for localizer, _ in observations))
        raise TouchError(f"the touches are of several objects ({names}); locate each by its own touches")
