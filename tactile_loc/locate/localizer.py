"""The method, read aloud: build an object's model once; encode a touch, match it, fuse, find the modes, refine them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_loc.core.errors import TouchError
from tactile_loc.core.interfaces import Candidate, Matcher, Prior, RefinedPose, Scene
from tactile_loc.core.noise import noise as noise_called
from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.posterior import PosePosterior
from tactile_loc.core.progress import Progress, timed
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import Touch
from tactile_loc.core.simulation import simulate_touches
from tactile_loc.io.config import RunConfig, SlotConfig
from tactile_loc.io.meshes import Units, load_object
from tactile_loc.io.touches import read_touch
from tactile_loc.locate.model import STAGE_VERSION as TRAINING_VERSION
from tactile_loc.locate.model import STAGE_VERSIONS, ObjectPoseModel, build_bank, build_model, train_encoder
from tactile_loc.locate.probabilities import Confidence, learn_confidence
from tactile_loc.locate.result import Hypothesis, Localization, distinct
from tactile_loc.store.store import StageStore

if TYPE_CHECKING:
    from numpy.typing import NDArray

logger = logging.getLogger(__name__)

PRESS_STEP_M = 1e-4  # banks are made for press depths in these steps
MOST_MATCHERS = 8  # as many are kept in memory, the last used
MODE_RADIUS = 2.0  # grid spacings between poses that count as one hypothesis
SAME_POSE = 0.25  # mode radii between refined poses that count as one


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
        self.scene = Scene(obj, self.sensor.geometry, renderer)
        self.coarse_scene = Scene(obj, self.sensor.geometry.with_long_side(config.shape_px), renderer)
        self._matchers: dict[float, Matcher] = {}

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
        return simulate_touches(self.sampler, self.scene, count, rng, press_depth_m, noise_called(noise))

    def _component(self, slot: str) -> Any:
        chosen = getattr(self.config, slot)
        return registry().create(slot, chosen.name, chosen.options)

    @cached_property
    def model(self) -> ObjectPoseModel:
        """The object's grid and contact shapes: from the store, or built now."""
        return build_model(self.coarse_scene, self.sampler, self.store, self.progress)

    @cached_property
    def _trained(self) -> str:
        """Train the encoder, or load it from the store; what identifies what it learned."""
        return train_encoder(self.encoder, self.model, self.coarse_scene, self.sampler, self.store, self.progress)

    @cached_property
    def confidence(self) -> Confidence:
        """How scores become probabilities: by the temperature asked for, or as simulated touches have taught."""
        asked = self.config.temperature
        return learn_confidence(self) if asked is None else Confidence(asked)

    def with_matcher(self, name: str) -> Localizer:
        """Return a localizer that compares by another matcher, and is the same otherwise."""
        if self.config.matcher.name == name:
            return self
        config = self.config.model_copy(update={"matcher": SlotConfig(name=name)})
        return Localizer(config, self.object, self.store, self.progress)

    def describe_scores(self) -> dict[str, Any]:
        """Return what decides a touch's scores but for the touch, as JSON values; trains the encoder if need be.

        The matcher is not among it: all find the same scores, if they look at all poses.
        """
        return {
            "model": self.model.key.digest, "sensor": self.sensor.geometry.describe(), "trained": self._trained,
            "encoder": self.encoder.describe(), "training": TRAINING_VERSION, "bank": STAGE_VERSIONS["bank"],
        }  # fmt: skip

    def localize(self, touch: Touch, prior: Prior | None = None, top: int | None = None) -> Localization:
        """Return the distribution over poses given a touch, and its `top` distinct hypotheses, refined.

        `prior` maps poses (N, 4, 4) in metres to log-weights (N,). Raises TactileLocError when nothing fits.
        """
        seconds: dict[str, float] = {}
        return self._explained(touch, self.posterior(touch, prior, seconds), seconds, top, prior)

    def localize_many(self, touches: Sequence[Touch], top: int | None = None) -> list[Localization]:
        """Localise touches of this sensor, each for itself, as `localize` does; those of one press are matched at once.

        Raises TactileLocError when nothing fits one of them.
        """
        for touch in touches:
            self._require_own(touch)
        press_m = [self._bank_press(touch.press_depth_m) for touch in touches]
        found: dict[int, Localization] = {}
        for pressed_m in sorted(set(press_m)):
            numbers = [number for number, m in enumerate(press_m) if m == pressed_m]
            rows, seconds = self._matched([touches[number] for number in numbers], pressed_m)
            for number, scores in zip(numbers, rows, strict=True):
                times = dict(seconds)
                posterior = self._fused(touches[number], scores, None, times)
                found[number] = self._explained(touches[number], posterior, times, top)
        return [found[number] for number in range(len(touches))]

    def _matched(self, touches: Sequence[Touch], press_m: float) -> tuple[NDArray[np.float32], dict[str, float]]:
        """Scores (M, N) of touches against the bank of one press, metres, and seconds a stage for each of them."""
        matcher = self.matcher(press_m)
        seconds: dict[str, float] = {}
        queries = timed(seconds, "encode", lambda: np.concatenate([self._encode(touch, press_m) for touch in touches]))
        rows = timed(seconds, "match", lambda: matcher.scores(queries))
        return rows, {stage: duration / len(touches) for stage, duration in seconds.items()}

    def _explained(
        self, touch: Touch, posterior: PosePosterior, seconds: dict[str, float], top: int | None,
        prior: Prior | None = None,
    ) -> Localization:  # fmt: skip
        """A posterior's modes, refined, in the order of how well they explain the touch."""
        modes = timed(seconds, "modes", lambda: posterior.modes(self.mode_radius_m, top or self.config.top))
        refined = timed(seconds, "refine", lambda: self.refine_many(touch, posterior, [m.index for m in modes]))
        poses = np.stack([r.T_sensor_object for r in refined])
        explained = timed(seconds, "choose", lambda: self.scene.explained(poses, touch))
        hypotheses = [
            Hypothesis(m.probability, m.T_sensor_object, r, m.index, len(m.members), float(e))
            for m, r, e in zip(modes, refined, explained, strict=True)
        ]
        found = distinct(hypotheses, self.model.grid.metric, self.same_pose_m, prior)
        return Localization(touch, posterior, found, seconds)

    def posterior(
        self, touch: Touch, prior: Prior | None = None, seconds: dict[str, float] | None = None
    ) -> PosePosterior:
        """Return the posterior over the grid's poses: encode, match, fuse. `seconds` is filled with their times.

        Raises TouchError when the touch was taken by another sensor.
        """
        seconds = {} if seconds is None else seconds
        return self._fused(touch, self.scores(touch, seconds), prior, seconds)

    def single_posterior(self, touch: Touch) -> PosePosterior:
        """Return what a touch alone says of the grid's poses, before anything is fused with it. Raises TouchError."""
        return self.confidence.posterior(self.model.grid, self.scores(touch))

    @property
    def mode_radius_m(self) -> float:
        """How near to one another poses count as one hypothesis, metres."""
        spacing_mm: float = self.sampler.options.spacing_mm
        return MODE_RADIUS * spacing_mm * 1e-3

    @property
    def same_pose_m(self) -> float:
        """How near to one another refined poses count as one, metres."""
        return SAME_POSE * self.mode_radius_m

    def scores(self, touch: Touch, seconds: dict[str, float] | None = None) -> NDArray[np.float32]:
        """Return how alike (N,) a touch and each pose of the grid are, unitless. `seconds` is filled with the times.

        Raises TouchError when the touch was taken by another sensor.
        """
        self._require_own(touch)
        seconds = {} if seconds is None else seconds
        matcher = self.matcher(touch.press_depth_m)
        press_m = self._bank_press(touch.press_depth_m)
        query = timed(seconds, "encode", lambda: self._encode(touch, press_m))
        scores: NDArray[np.float32] = timed(seconds, "match", lambda: matcher.scores(query)[0])
        return scores

    def _fused(
        self, touch: Touch, scores: NDArray[np.float32], prior: Prior | None, seconds: dict[str, float]
    ) -> PosePosterior:
        """The posterior of a touch's scores (N,) and the prior."""
        single = self.confidence.posterior(self.model.grid, scores)
        return timed(seconds, "fuse", lambda: self.fuser.fuse([single], [touch.T_base_sensor], prior))

    def refine(self, touch: Touch, posterior: PosePosterior, index: int) -> RefinedPose:
        """Refine one pose of the posterior's grid against the touch."""
        return self.refine_many(touch, posterior, [index])[0]

    def refine_many(self, touch: Touch, posterior: PosePosterior, indices: Sequence[int]) -> list[RefinedPose]:
        """Refine several poses of the posterior's grid against the touch, in the order of their indices."""
        poses = posterior.grid.T_sensor_object
        candidates = [Candidate(poses[index], int(index), float(posterior.log_p[index])) for index in indices]
        refined: list[RefinedPose] = self.refiner.refine_many(touch, candidates, self.scene)
        return refined

    def best_pose(self, touch: Touch) -> RefinedPose:
        """Return the most probable pose, refined: the shortest way, for a control loop."""
        posterior = self.posterior(touch)
        return self.refine(touch, posterior, int(posterior.log_p.argmax()))

    def _require_own(self, touch: Touch) -> None:
        ours = self.scene.geometry
        if touch.geometry is not ours and not touch.geometry.is_same_sensor(ours):
            raise TouchError(
                f"{touch.name} was taken by another sensor than {self.config.sensor.name}: its camera, field or "
                "maximal depth differs; make a Localizer for the sensor that took it"
            )

    def matcher(self, press_depth_m: float) -> Matcher:
        """Return the matcher whose bank was cut at this press depth (metres), built at first use."""
        press_m = self._bank_press(press_depth_m)
        matcher = self._matchers.pop(press_m, None) or self._indexed(press_m)
        self._matchers[press_m] = matcher  # the last used comes last
        while len(self._matchers) > MOST_MATCHERS:
            del self._matchers[next(iter(self._matchers))]
        return matcher

    def _indexed(self, press_m: float) -> Matcher:
        bank = build_bank(
            self.model, self.coarse_scene, self.encoder, press_m, self.store, self.progress, self._trained
        )  # fmt: skip
        matcher: Matcher = self._component("matcher")
        matcher.index(bank)
        return matcher

    def _bank_press(self, press_depth_m: float) -> float:
        """The press depth, rounded down to a step, at which touch and bank are compared."""
        if not self.encoder.capabilities.follows_press_depth:
            return self.scene.geometry.max_depth_m
        return round(max(1, int(press_depth_m / PRESS_STEP_M + 1e-6)) * PRESS_STEP_M, 9)

    def _encode(self, touch: Touch, press_depth_m: float) -> NDArray[np.float32]:
        shape = touch.contact_shape.pressed_to(press_depth_m)
        # The press the shape is really cut at: below the bank's, its pixels without contact would count as contact.
        press_m = shape.press_depth_m
        embedding: NDArray[np.float32] = self.encoder.encode(shape.depth_m[None], press_m, touch.geometry)
        return embedding
