"""Which stages a sweep needs, and which of them the store lacks, found without building any."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tactile_loc.core.objects import ObjectModel
from tactile_loc.evaluation.protocol import evaluation_key
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.model import SHARD, STAGE_VERSIONS
from tactile_loc.locate.probabilities import TemperatureScaling
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.sweeps.combinations import Combination

STAGES = ("grid", "shapes", "encoder", "bank", "temperature", "evaluation")


def stages_to_build(
    combinations: Iterable[Combination], objects: Mapping[str, ObjectModel], store: Path
) -> dict[str, int]:
    """Return how many artifacts of each of STAGES these combinations need that the store lacks.

    Encoders that follow the press depth need a bank for each depth that touches have: of these, one is counted.
    """
    known, missing = StageStore(store), set()
    for one in combinations:
        planned = PlannedLocalizer(one.config, objects[one.object], known)
        missing |= {(key.stage, key.digest) for key in planned.stage_keys() if known.get(key) is None}
        evaluation = planned.evaluation_key(one.count)
        if evaluation is None or known.get(evaluation) is None:
            missing.add(("evaluation", one.key))
    return {stage: sum(name == stage for name, _ in missing) for stage in STAGES}


class PlannedLocalizer(Localizer):
    """A localizer that builds nothing, but knows the keys of its stages."""

    @cached_property
    def grid_key(self) -> StageKey:
        """The key of the grid, as `build_model` makes it."""
        return StageKey("grid", STAGE_VERSIONS["grid"], {
            "object": self.object.describe(), "sampler": self.sampler.describe(),
            "sensor": self.coarse_scene.geometry.describe(),
        })  # fmt: skip

    @cached_property
    def shapes_key(self) -> StageKey:
        """The key of the contact shapes, as `build_model` makes it."""
        return StageKey("shapes", STAGE_VERSIONS["shapes"], {
            "grid": self.grid_key.digest, "renderer": self.coarse_scene.renderer.describe(), "shard": SHARD,
        })  # fmt: skip

    @cached_property
    def encoder_key(self) -> StageKey | None:
        """The key of the trained encoder, as `train_encoder` makes it; None for one that needs no training."""
        if not self.encoder.capabilities.needs_training:
            return None
        return StageKey("encoder", STAGE_VERSIONS["encoder"], {
            "shapes": self.shapes_key.digest, "encoder": self.encoder.describe(), "sampler": self.sampler.describe(),
        })  # fmt: skip

    @cached_property
    def bank_key(self) -> StageKey:
        """The key of the bank at full press, as `build_bank` makes it."""
        return StageKey("bank", STAGE_VERSIONS["bank"], {
            "shapes": self.shapes_key.digest, "encoder": self.encoder.describe(), "trained": self._trained,
            "press_depth_m": self.grid_scores.bank_press_m(self.scene.geometry.max_depth_m),
        })  # fmt: skip

    @cached_property
    def model(self) -> Any:
        """What has the model's key, and nothing else."""
        return SimpleNamespace(key=self.shapes_key)

    @cached_property
    def _trained(self) -> str:
        return "" if self.encoder_key is None else self.encoder_key.digest

    def stage_keys(self) -> list[StageKey]:
        """Return the keys of all stages up to the evaluation."""
        keys = [self.grid_key, self.shapes_key, self.bank_key]
        keys += [] if self.encoder_key is None else [self.encoder_key]
        return keys + ([self.temperature_key()] if self.config.temperature is None else [])

    def evaluation_key(self, count: int) -> StageKey | None:
        """Return the key of the evaluation; None when it depends on a temperature that is still to be fitted."""
        if self.config.temperature is None:
            learned = self.store.get(self.temperature_key())
            if learned is None:
                return None
            self.__dict__["temperature_scaling"] = TemperatureScaling(**learned.json("temperature"))
        touches = SimulatedTouches(self.config.touch.noise, self.config.seed)
        return evaluation_key(self, count, touches)
