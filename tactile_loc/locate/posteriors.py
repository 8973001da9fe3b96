"""From touches to what they say of the poses of a grid: build an object's model once; encode, match, calibrate."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from tactile_loc.core.errors import ConfigError, GridError, TouchError, quoted
from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.progress import Progress, StageTimes
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.simulation.listed_training import ListedProblem
from tactile_loc.core.simulation.noise import noise_level
from tactile_loc.core.simulation.place_training import PlaceProblem
from tactile_loc.core.simulation.touch_simulation import simulate_touches
from tactile_loc.core.slots.encoder import Checkpoints
from tactile_loc.core.slots.matcher import Matcher
from tactile_loc.core.slots.registry import registry
from tactile_loc.core.slots.scene import Scene, View
from tactile_loc.io.config import RunConfig, SlotConfig
from tactile_loc.io.meshes import Units
from tactile_loc.io.touches import read_touch
from tactile_loc.locate import conformal as conformal
from tactile_loc.locate import probabilities
from tactile_loc.locate.conformal import ConformalSets
from tactile_loc.locate.model import (
    STAGE_VERSIONS,
    ObjectPoseModel,
    build_bank,
    build_model,
    build_place_bank,
    encoder_key,
    place_encoder_key,
    train_encoder,
)
from tactile_loc.locate.probabilities import (
    FusedExample,
    FusedScaling,
    TemperatureScaling,
    fit_fused_scaling,
    fit_temperature_scaling,
)
from tactile_loc.locate.scoring import GridScores, Scores
from tactile_loc.locate.search import PlaceSearch, build_places, found_together
from tactile_loc.locate.stored_object import stored_object
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

EXAMPLE_TOUCHES = 50  # of simulated examples, in memory at once
EACH_LEVEL = 10_000  # between the seeds of examples with one level of noise and with the next
UNKNOWN = 1e3  # nats: the entropy of what no pose explains
SETTLING = {"points": 200, "iterations": 8, "image_px": 60}  # options of the joint refiner, for many poses


class TouchPosteriors:
    """What touches of one object by one sensor say of the object's grid, as probabilities; nothing is refined."""

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
        self.fuser = self._component("fuser")
        renderer = self._component("renderer")
        self.scene = Scene(obj, self.sensor.geometry, renderer, config.drawing)
        coarse = self.sensor.geometry.with_long_side(config.shape_px)
        coarse = coarse.pressed(coarse.max_depth_m)  # the grid's, at full press
        self.coarse_scene = dataclasses.replace(self.scene, geometry=coarse)

    @classmethod
    def create(
        cls, object: str | Path = "hook", *, units: Units = "auto", symmetry: str = "auto",
        store: StageStore | str | Path | None = None, progress: Progress | None = None, **settings: Any,
    ) -> Self:  # fmt: skip
        """Load an object (a mesh file or a demo object's name) and make its localizer; `store` may be a folder.

        `settings` are RunConfig's: slots by name (`refiner="icp"`) or with options
        (`grid={"name": "face", "spacing_mm": 3}`), `top`, `seed`, ... Raises TactileLocError for bad input.
        """
        chosen = {"path": str(object), "units": units, "symmetry": symmetry}
        config = RunConfig.from_dict({"object": chosen, **settings}, "Localizer.create")
        store = store if isinstance(store, StageStore) else StageStore(store)
        return cls(config, stored_object(object, units, symmetry, store), store, progress)

    def _component(self, slot: str) -> Any:
        chosen = getattr(self.config, slot)
        return registry().create(slot, chosen.name, chosen.options)

    def with_matcher(self, name: str) -> Self:
        """Return a localizer that compares by another matcher, and is the same otherwise."""
        if self.config.matcher.name == name:
            return self
        config = self.config.model_copy(update={"matcher": SlotConfig(name=name)})
        return type(self)(config, self.object, self.store, self.progress)

    def read_touch(self, path: str | Path, unit: str | None = None, press_depth_m: float | None = None) -> Touch:
        """Read a contact shape (npz, npy, 16-bit PNG) as this sensor's touch. Raises TouchError."""
        return read_touch(Path(path), self.sensor, unit, press_depth_m)

    def simulate(
        self, count: int = 1, seed: int = 0, press_depth_m: float | None = None, noise: str = "none"
    ) -> list[Touch]:
        """Make touches at random poses of the continuous set that the grid covers, with their true poses; metres.

        `noise` is none, mild or strong. Raises ConfigError for another, or a count or a seed below 0.
        """
        if min(count, seed) < 0:
            raise ConfigError(f"{count} touches of seed {seed} cannot be simulated; give whole numbers from 0 on")
        rng = np.random.default_rng(seed)
        return simulate_touches(self.sampler, self.scene, count, rng, press_depth_m, noise_level(noise))

    @cached_property
    def search(self) -> PlaceSearch | None:
        """What searches the whole object, if the grid knows its places: from the store, or built now."""
        if not self.sampler.capabilities.places:
            return None
        settler = registry().create("refiner", "joint", SETTLING)
        places, key = build_places(self.sampler, self.scene, self.store, self.progress)
        return PlaceSearch(
            places, key, self.scene, self.encoder, lambda: self._component("matcher"), settler, self.sampler.options,
            self._place_bank,
        )  # fmt: skip

    def _place_bank(self, press_depth_m: float) -> Scores | None:
        """The bank of the object's places, if the encoder learns: from the store, or built now, after training."""
        key = place_encoder_key(self.search.key, self.encoder, self.scene) if self.search else None
        if self.search is None or key is None:
            return None
        _ = self.trained
        return build_place_bank(self.search.places, key, self.encoder, press_depth_m, self.store, self.progress)

    @cached_property
    def model(self) -> ObjectPoseModel:
        """The object's grid and contact shapes: from the store, or built now."""
        return build_model(self.coarse_scene, self.sampler, self.store, self.progress)

    @cached_property
    def trained(self) -> str:
        """What identifies what the encoder learned: trained now, or read from the store; empty if it learns nothing."""
        encoder, sampler = self.encoder, self.sampler
        if self.search is None:
            return self._trained_on_grid() if encoder.capabilities.needs_training else ""
        places, key = self.search.places, place_encoder_key(self.search.key, encoder, self.scene)
        return train_encoder(
            encoder, key, lambda kept: PlaceProblem(places, self.scene, sampler, self.progress, kept), self.store
        )

    def _trained_on_grid(self) -> str:
        model, scene, sampler = self.model, self.coarse_scene, self.sampler

        def problem(kept: Checkpoints) -> ListedProblem:
            return ListedProblem(model.grid, scene, sampler, model.shapes.shards, self.progress, kept)

        return train_encoder(self.encoder, encoder_key(model.key, self.encoder, sampler), problem, self.store)

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
        simulated = {"sampler": self.sampler.describe(), **probabilities.describe_touches(*self._fitted_to)}
        return StageKey(probabilities.STAGE, probabilities.STAGE_VERSION, {**self.describe_scores(), **simulated})

    @property
    def _fitted_to(self) -> tuple[int, tuple[str, ...]]:
        """How many simulated touches the scaling is fitted to, and the levels of noise they have in turn."""
        if self.search is None:
            return probabilities.TOUCHES, (probabilities.TOUCH_NOISE,)
        return probabilities.SEARCHED, probabilities.SEARCHED_NOISE

    def _fit_temperature(self, work: Workspace) -> None:
        """Score simulated touches of known pose, and save the scaling that makes the true poses most probable."""
        exact = self.with_matcher("dense")
        scores: list[Scores] = []
        truth: list[int] = []
        number, levels = self._fitted_to
        with self.progress.task("fitting probabilities", number) as advance:
            for seed, count, level in probabilities.batches(number, levels):
                for touch in self.simulate(count, seed, noise=level):
                    ((grid, found),) = exact.scored([touch])
                    scores.append(found)
                    truth.append(self.true_index(grid, touch))
                    advance(1)
        fitted = fit_temperature_scaling(scores, np.array(truth), self.search is not None)
        work.save_json(probabilities.STAGE, asdict(fitted))

    @cached_property
    def fused_scaling(self) -> FusedScaling:
        """How sure several touches together make: fitted to simulated examples, unless a temperature was asked for."""
        if self.config.temperature is not None:
            return FusedScaling()
        numbers, count, seed = self._fused_examples
        described = self._describe_examples(numbers, count, seed)
        key = StageKey(probabilities.FUSED_STAGE, probabilities.FUSED_VERSION, described)
        return FusedScaling(**self.store.build(key, self._fit_fused_scaling).json(probabilities.FUSED_STAGE))

    @property
    def _fused_examples(self) -> tuple[tuple[int, ...], int, int]:
        """The numbers of touches that are fused to fit to, how many examples of each, and their seed."""
        if self.search is not None:
            return probabilities.SEARCHED_TOUCHES, probabilities.SEARCHED_EXAMPLES, probabilities.FUSED_SEED
        return probabilities.FUSED_TOUCHES, probabilities.FUSED_EXAMPLES, probabilities.FUSED_SEED

    def _fit_fused_scaling(self, work: Workspace) -> None:
        """Fuse simulated touches of known pose, and save how sure they are to make."""
        numbers, count, seed = self._fused_examples
        _, levels = self._fitted_to
        fused = [
            FusedExample(number, found.log_p, truth, best)
            for number in numbers
            for place, level in enumerate(levels)
            for found, truth, best in self._examples(number, count // len(levels), seed + EACH_LEVEL * place, level)
            if found is not None
        ]
        work.save_json(probabilities.FUSED_STAGE, asdict(fit_fused_scaling(fused, self.search is not None)))

    def conformal_sets(self, touches: int) -> ConformalSets:
        """Return how large sets of poses are to be, given so many touches, to hold the truth as often as asked for."""
        number = min(touches, conformal.MOST_TOUCHES)
        described = self._describe_examples([number], conformal.EXAMPLES, conformal.SEED)
        key = StageKey(conformal.STAGE, conformal.STAGE_VERSION, described)

        def score(work: Workspace) -> None:
            power = 1.0 if number == 1 else self.fused_scaling.power(number)
            scores, entropies = [], []
            for fused, truth, best in self._examples(number, conformal.EXAMPLES, conformal.SEED):
                posterior = None if fused is None else fused.tempered(power)
                if posterior is not None and self.search is not None and number > 1:
                    posterior = dataclasses.replace(posterior, elsewhere=self.fused_scaling.elsewhere(best))
                if posterior is None or truth < 0:
                    scores.append(conformal.NOT_FOUND)
                else:
                    scores.append(posterior.credible_level(truth))
                entropies.append(UNKNOWN if posterior is None else posterior.entropy)
            work.save_json(conformal.STAGE, {"scores": scores, "entropies": entropies})

        return ConformalSets(**self.store.build(key, score).json(conformal.STAGE))

    def _describe_examples(self, touches: Sequence[int], count: int, seed: int) -> dict[str, Any]:
        """What decides what is fused of so many simulated touches, as JSON values."""
        return {
            "touches": list(touches), "examples": count, "seed": seed, "fuser": self.fuser.describe(),
            "scores": self.temperature_key().digest, "temperature": self.config.temperature,
        }  # fmt: skip

    def _examples(
        self, touches: int, count: int, seed: int, noise: str = probabilities.TOUCH_NOISE
    ) -> Iterator[tuple[PosePosterior | None, int, float]]:
        """What so many simulated touches of the object at rest say, fused but not tempered, the true pose's index, and
        what a search's best pose explains of them.

        None where no pose touches all sensors. No touch is in two examples; their noise is that of the other fits.
        """
        exact = self.with_matcher("dense")
        at_once = max(1, EXAMPLE_TOUCHES // touches)
        with self.progress.task(f"fusing examples of {touches} touches", count) as advance:
            for start in range(0, count, at_once):
                number, drawn_seed = touches * min(at_once, count - start), seed + 100_000 * touches + start
                drawn = self.simulate(number, drawn_seed, noise=noise)
                posteriors = exact.posteriors(drawn) if self.search is None or touches == 1 else []
                for first in range(0, len(drawn), touches):
                    some, best = drawn[first : first + touches], 1.0
                    poses = np.stack([np.asarray(touch.T_sensor_object) for touch in some])
                    alone = posteriors[first : first + touches]
                    if self.search is not None and touches > 1:
                        seen_from = zip(some, poses @ invert(poses[0]), strict=True)
                        views = [View(touch, self.scene.of_touch(touch), T) for touch, T in seen_from]
                        found = found_together(views, [self.search] * touches, StageTimes())
                        alone, best = found.posteriors(views, [self.temperature_scaling] * touches, 0.0), found.best
                    truth = self.true_index(alone[0].grid, some[0])
                    try:
                        fused = self.fuser.fuse(alone, list(invert(poses)))
                        yield dataclasses.replace(fused, elsewhere=alone[0].elsewhere), truth, best
                    except GridError:
                        yield None, truth, best
                    advance(1)

    def describe_scores(self) -> dict[str, Any]:
        """Return what decides a touch's scores but for the touch, as JSON values; trains the encoder if need be.

        The matcher is not among it: all find the same scores, if they look at all poses.
        """
        searched = {"model": self.model.key.digest} if self.search is None else self.search.describe()
        return {
            **searched, "sensor": self.sensor.geometry.describe(), "trained": self.trained,
            "encoder": self.encoder.describe(), "training": STAGE_VERSIONS["encoder"], "bank": STAGE_VERSIONS["bank"],
        }  # fmt: skip

    def scores(self, touches: Sequence[Touch], times: StageTimes | None = None) -> list[Scores]:
        """Return how alike (N,) each touch and each pose of the grid are, unitless; adds to `times`.

        Raises TouchError when another sensor took one of the touches.
        """
        for touch in touches:
            self.require_own(touch)
        return self.grid_scores.scores(touches, times or StageTimes())

    def posteriors(
        self, touches: Sequence[Touch], times: StageTimes | None = None, prior: Prior | None = None
    ) -> list[PosePosterior]:
        """Return what each touch alone says of the grid's poses, before anything is fused with it.

        A `prior` only says where a whole object is searched the more. Raises TouchError when another sensor took one
        of the touches.
        """
        scaling = self.temperature_scaling
        return [scaling.posterior(grid, scores) for grid, scores in self.scored(touches, times, prior)]

    def scored(
        self, touches: Sequence[Touch], times: StageTimes | None = None, prior: Prior | None = None
    ) -> list[tuple[PoseGrid, Scores]]:
        """Return the poses that are compared with each touch, metres, and how alike they are (N,), unitless.

        They are those of the grid, or of a whole object the likeliest ones: see `PlaceSearch.found`. Raises TouchError
        as `scores` does.
        """
        if self.search is None:
            return list(zip(map(self.grid_of, touches), self.scores(touches, times), strict=True))
        for touch in touches:
            self.require_own(touch)
        return [self.search.found(touch, times or StageTimes(), prior) for touch in touches]

    def true_index(self, grid: PoseGrid, touch: Touch) -> int:
        """Return the index of the pose nearest to a touch's true one; -1 if a search did not find any near it."""
        (distance_m,), (index,) = grid.nearest(np.asarray(touch.T_sensor_object)[None])
        return -1 if self.search is not None and distance_m > self.search.found_m else int(index)

    def grid_of(self, touch: Touch) -> PoseGrid:
        """Return the poses that are searched, in metres, pressed as deep as the touch."""
        return self.model.grid.raised(self.scene.geometry.max_depth_m - touch.indentation_m)

    def require_own(self, touch: Touch) -> None:
        """Raise TouchError when another sensor took the touch, or it is none."""
        if not isinstance(touch, Touch):
            raise TouchError(f"{quoted(touch)} is no touch; `Localizer.read_touch` reads a file, `simulate` makes one")
        ours = self.scene.geometry
        if touch.geometry is not ours and not touch.geometry.is_same_sensor(ours):
            raise TouchError(
                f"{touch.name} was taken by another sensor than {self.config.sensor.name}: its camera, field or "
                "maximal depth differs; make a Localizer for the sensor that took it"
            )
