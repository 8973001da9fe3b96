"""Fitted probabilities: temperatures, fitted to simulated touches of the object and stored."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.poses.posterior import NoPoseLeft, PosePosterior
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.scene import View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.probability import probabilities
from tactile_loc.locate.probability.probabilities import (
    AnyScalings,
    FusedExample,
    FusedScaling,
    Scalings,
    TemperatureScaling,
)
from tactile_loc.locate.sources.scoring import Scores
from tactile_loc.locate.sources.source import PoseSource
from tactile_loc.slots.fuser import Fuser
from tactile_loc.store.keys import StageKey
from tactile_loc.store.workspace import Workspace

EXAMPLE_TOUCHES = 50  # simulated touches in memory at once
EACH_LEVEL = 10_000  # step between the seeds of two noise levels


@dataclass(frozen=True, eq=False)
class Example:
    """One or more simulated touches, fused but not tempered.

    `fused` is their posterior; None if no pose makes contact with all sensors. `truth` is the index of the pose nearest
    to the true pose; -1 if the search found none near it. If several touches were searched together, `best`, 0 to 1, is
    the best mean imprint IoU of any pose found; otherwise 1.
    """

    fused: PosePosterior | None
    truth: int
    best: float


class FittedProbabilities:
    """The temperature and the tempering of fused touches of one localizer, fitted at first use.

    `source` scores poses with an exact matcher. If the user gives a `temperature`, nothing is fitted.
    """

    def __init__(self, source: PoseSource, fuser: Fuser) -> None:
        setup = source.setup
        self.source, self.setup, self.fuser = source, setup, fuser
        self.temperature, self.store, self.progress = setup.config.temperature, setup.store, setup.progress
        self.plan = source.plan_fit()

    @cached_property
    def temperature_scaling(self) -> TemperatureScaling:
        """The scaling from scores to probabilities, with the user's temperature or one fitted to simulated touches."""
        if self.temperature is not None:
            return TemperatureScaling(self.temperature)
        artifact = self.store.build(self.temperature_key(), self._fit_temperature)
        return TemperatureScaling(**artifact.load_json(probabilities.STAGE))

    def temperature_key(self) -> StageKey:
        """Return the store key of the temperature scaling, made from all inputs of the fit."""
        touches = probabilities.describe_touches(self.plan.touches, self.plan.noise)
        inputs = {**self.source.describe_scores(), "sampler": self.setup.sampler.describe(), **touches}
        return StageKey(probabilities.STAGE, probabilities.STAGE_VERSION, inputs)

    def _fit_temperature(self, work: Workspace) -> None:
        """Score simulated touches, and save the scaling that makes their true poses most probable."""
        scores: list[Scores] = []
        truth: list[int] = []
        number, levels = self.plan.touches, self.plan.noise
        drawn = (
            touch
            for seed, count, level in probabilities.batches(number, levels)
            for touch in self.setup.simulate(count, seed, level)
        )
        with self.progress.task("fitting probabilities", number) as advance:
            for found, index in map_in_threads(self._score, drawn):
                scores.append(found)
                truth.append(index)
                advance(1)
        fitted = probabilities.fit_temperature_scaling(scores, np.array(truth), self.plan.misses)
        work.save_json(probabilities.STAGE, asdict(fitted))

    def _score(self, touch: Touch) -> tuple[Scores, int]:
        """Return the scores of a simulated touch, and the index of its true pose, -1 if the search missed it."""
        ((grid, found),) = self.source.score([touch], StageTimes())
        return found, self.source.find_truth(grid, touch)

    @cached_property
    def fused_scaling(self) -> FusedScaling:
        """The tempering of several touches, fitted to simulated examples unless the user gave a temperature."""
        if self.temperature is not None:
            return FusedScaling()
        described = self._describe_examples(self.plan.fused_touches, self.plan.fused_examples, probabilities.FUSED_SEED)
        key = StageKey(probabilities.FUSED_STAGE, probabilities.FUSED_VERSION, described)
        return FusedScaling(**self.store.build(key, self._fit_fused_scaling).load_json(probabilities.FUSED_STAGE))

    def _fit_fused_scaling(self, work: Workspace) -> None:
        """Fuse simulated touches, and save the scaling that makes their true poses most probable."""
        levels = self.plan.noise
        count, seed = self.plan.fused_examples // len(levels), probabilities.FUSED_SEED
        fused = [
            FusedExample(number, example.fused.log_p, example.truth, example.best)
            for number in self.plan.fused_touches
            for place, level in enumerate(levels)
            for example in self._examples(number, count, seed + EACH_LEVEL * place, level)
            if example.fused is not None
        ]
        fitted = probabilities.fit_fused_scaling(fused, self.plan.misses)
        work.save_json(probabilities.FUSED_STAGE, asdict(fitted))

    def _describe_examples(self, touches: Sequence[int], count: int, seed: int) -> dict[str, Any]:
        return {
            "touches": list(touches),
            "examples": count,
            "seed": seed,
            "fuser": self.fuser.describe(),
            "scores": self.temperature_key().digest,
            "temperature": self.temperature,
        }

    def _examples(
        self, touches: int, count: int, seed: int, noise: TouchNoise = probabilities.TOUCH_NOISE
    ) -> Iterator[Example]:
        """Yield `count` examples, each of different simulated touches of the object at rest."""
        from tactile_loc.core.runtime.compiled import map_in_threads

        _ = self.temperature_scaling  # fitted first, not by one of the threads
        with self.progress.task(f"fusing examples of {touches} touches", count) as advance:
            for example in map_in_threads(self._fuse, self._draw_examples(touches, count, seed, noise)):
                yield example
                advance(1)

    def _draw_examples(self, touches: int, count: int, seed: int, noise: TouchNoise) -> Iterator[list[Touch]]:
        at_once = max(1, EXAMPLE_TOUCHES // touches)
        for start in range(0, count, at_once):
            number, drawn_seed = touches * min(at_once, count - start), seed + 100_000 * touches + start
            drawn = self.setup.simulate(number, drawn_seed, noise)
            yield from (drawn[first : first + touches] for first in range(0, len(drawn), touches))

    def _fuse(self, touches: Sequence[Touch]) -> Example:
        """Fuse touches of known pose as if all had been made on one object at rest, by differently placed sensors."""
        poses = np.stack([np.asarray(touch.T_sensor_object) for touch in touches])
        seen_from = zip(touches, poses @ invert(poses[0]), strict=True)
        views = [View(touch, self.setup.scene.match_touch(touch), T) for touch, T in seen_from]
        unfused: Sequence[AnyScalings] = [Scalings(self.temperature_scaling, FusedScaling())] * len(touches)
        scored = self.source.search(views, [self.source] * len(touches), unfused, StageTimes())
        truth = self.source.find_truth(scored.alone[0].grid, touches[0])
        fused = self.fuser.fuse(scored.alone, list(invert(poses)))
        if isinstance(fused, NoPoseLeft):
            return Example(None, truth, scored.best)
        return Example(dataclasses.replace(fused, elsewhere=scored.alone[0].elsewhere), truth, scored.best)
