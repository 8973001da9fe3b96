"""The held-out examples of conformal sets: simulated touches of the object, located as a user's touches are."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tactile_loc.core.geometry.rigid import invert
from tactile_loc.core.poses.posterior import NoPoseLeft
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.progress import NOTE
from tactile_loc.core.sensing.scene import view_touch
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import compute_nats
from tactile_loc.locate.method import LocatingMethod, Query
from tactile_loc.locate.outliers import localize_agreeing
from tactile_loc.locate.probability import misses
from tactile_loc.locate.probability.conformal import ELSEWHERE, LISTED, POWER, RARE, ConformalSets, rank
from tactile_loc.locate.probability.probabilities import FUSED_VERSION, SEARCHED_NOISE
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.sources.source import SourceSetup
from tactile_loc.store.keys import StageKey
from tactile_loc.store.workspace import Workspace

log = logging.getLogger(__name__)

STAGE, STAGE_VERSION = "conformal", 4
# The examples of each number of touches, with each of the three levels of noise. Strong noise takes longest, and its
# touches seldom have a pose that is listed.
EXAMPLES = {1: (12, 12, 6), 2: (10, 10, 3), 3: (10, 8, 3), 5: (5, 4, 1)}
NOISE = SEARCHED_NOISE
RIGHT_M = 1e-3  # surface distance within which a refined pose counts as the true pose
WEIGHED = np.array([0.0, 0.5, 0.8, 0.95, 0.99, 1.0])  # imprint IoUs whose log-weights identify how poses are weighed
SEED = 0xC0DE  # differs from the seeds of evaluations and fits


@dataclass(frozen=True, eq=False)
class ConformalFit:
    """Fits conformal sets to simulated examples of one to five touches of an object, located by a method for one touch.

    Without refinement, a pose is right within the radius of a mode.
    """

    method: LocatingMethod

    @property
    def setup(self) -> SourceSetup:
        """The object, the sensor and the store."""
        return self.method.source.setup

    @property
    def radius_m(self) -> float:
        """The distance, metres, within which a pose is right."""
        return RIGHT_M if self.method.refinement.refiner.capabilities.refines else self.setup.mode_radius_m

    def load(self) -> ConformalSets:
        """Return the sets, fitted now or loaded from the store."""
        temperature = self.method.scalings[0].temperature_scaling  # fitted first, with its own progress
        method, config = self.method, self.setup.config
        inputs: dict[str, Any] = {
            **method.source.describe_scores(),
            "temperature": asdict(temperature),
            "sampler": self.setup.sampler.describe(),
            "fuser": method.fuser.describe(),
            "refiner": method.refinement.refiner.describe(),
            "together": config.together,
            "hypotheses": config.hypotheses.model_dump(mode="json"),
            "listed": LISTED,
            "examples": [[number, *counts] for number, counts in EXAMPLES.items()],
            "noise": [level.describe() for level in NOISE],
            "seed": SEED,
            "weights": compute_nats(WEIGHED, 2).round(6).tolist(),
            "misses": list(misses.WEIGHTS),
            "power": POWER,
            "rare": RARE,
            "radius_m": self.radius_m,
            "fused": FUSED_VERSION,
        }
        key = StageKey(STAGE, STAGE_VERSION, inputs, self.setup.scene.object.name)
        return ConformalSets(**self.setup.store.build(key, self._fit).load_json(STAGE))

    def _fit(self, work: Workspace) -> None:
        """Locate the examples, and save their scores."""
        total = sum(sum(counts) for counts in EXAMPLES.values())
        said = "the sets of poses for %s and this sensor are fitted once, to %d simulated examples"
        log.log(NOTE, said, self.setup.scene.object.name, total)
        scores: list[float] = []
        with self.setup.progress.task("fitting the sets of poses", total) as advance:
            for score in map_in_threads(self._score, self._draw_examples()):
                advance(1)
                if score is not None:
                    scores.append(score)
        work.save_json(STAGE, asdict(ConformalSets(scores, self.radius_m)))

    def _score(self, touches: Sequence[Touch]) -> float | None:
        """Return the score of an example; None if no pose fits its touches, as a user's touches then get no set."""
        scene, count = self.setup.scene, len(touches)
        views = [view_touch(touches[0], touch, scene.match_touch(touch)) for touch in touches]
        config = self.setup.config.model_copy(update={"drop_outliers": False})
        method = replace(
            self.method, sources=[*self.method.sources] * count, scalings=[*self.method.scalings] * count, config=config
        )
        found = localize_agreeing(Query(views, top=LISTED), method)
        if isinstance(found, NoPoseLeft):
            return None
        return rank(found.hypotheses, count).score(self._find_right(found))

    def _draw_examples(self) -> Iterator[list[Touch]]:
        """Yield the touches of each example; all are of one object at rest, at the base's origin."""
        for number, counts in EXAMPLES.items():
            for level, (noise, count) in enumerate(zip(NOISE, counts, strict=True)):
                drawn = self.setup.simulate(number * count, SEED + 1000 * number + level, noise)
                placed = [replace(t, T_base_sensor=invert(np.asarray(t.T_sensor_object))) for t in drawn]
                yield from (placed[first : first + number] for first in range(0, len(placed), number))

    def _find_right(self, found: Localization) -> int:
        """Return the number of the first hypothesis that is right, or ELSEWHERE."""
        T = np.stack([h.T_sensor_object for h in found.hypotheses])
        truth = np.broadcast_to(np.asarray(found.touch.T_sensor_object), T.shape)
        right = np.flatnonzero(self.setup.metric.symmetric_distance(T, truth) <= self.radius_m)
        return int(right[0]) if len(right) else ELSEWHERE
