"""tactile-loc itself as a method of the benchmark."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import Field
from tactile_loc import Localizer, RunConfig, StageStore, localize_together
from tactile_loc.plugin import ComponentOptions, Touch, registry

from tactile_loc_benchmark.interfaces import LocatingProblem, Method, ScoredPoses

CALLER = "the method tactile-loc"
SLOTS = ("renderer", "grid", "encoder", "matcher", "refiner", "fuser")  # the problem has the sensor


class TactileLoc(Method):
    """Locates with `localize_together`, by default or with other settings."""

    class Options(ComponentOptions):
        """The settings."""

        settings: dict[str, Any] = Field(
            default_factory=dict, description="entries of a configuration, such as {refiner = 'icp'}"
        )

    def describe(self) -> dict[str, Any]:
        """Return what identifies the poses: the settings, and the components with hashes of their code."""
        chosen = RunConfig.from_dict(self.options.settings, CALLER)
        slots = {slot: getattr(chosen, slot) for slot in SLOTS}
        made = {slot: registry().create(slot, one.name, one.options).describe() for slot, one in slots.items()}
        return {**super().describe(), "components": made}

    def prepare(self, problem: LocatingProblem) -> None:
        """Build the object's model."""
        self._localizer = _make_localizer(self.options.settings, problem)
        self._localizer.source.describe_scores()
        _ = self._localizer.source.temperature_scaling

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return the listed poses with their probabilities, and the verdict."""
        found = localize_together([(self._localizer, touch) for touch in touches])
        T = np.asarray(found.touch.T_base_sensor) @ np.stack([h.T_sensor_object for h in found.hypotheses])
        p = np.array([hypothesis.probability for hypothesis in found.hypotheses])
        return ScoredPoses(T, p, p, found.verdict.value)


def _make_localizer(settings: dict[str, Any], problem: LocatingProblem) -> Localizer:
    config = RunConfig.from_dict({**settings, "sensor": dict(problem.sensor)}, CALLER)
    return Localizer(config, problem.object, StageStore(problem.folder))
