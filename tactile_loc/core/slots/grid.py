"""The grid slot: the poses, or the places of the object, that are searched."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from pydantic import Field

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.places import Places
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.slots.component import Component, ComponentOptions


class GridSampler(Component):
    """Proposes the contact poses to search."""

    slot = "grid"

    class Options(ComponentOptions):
        """What every grid has: how dense it is, and how much contact a pose must make."""

        spacing_mm: float = Field(default=3.0, gt=0, description="mean distance between neighbouring poses, mm")
        min_contact_percent: float = Field(
            default=0.25, ge=0, le=100, description="least share of the observed pixels in contact, percent"
        )

    @property
    def spacing_is_mean(self) -> bool:
        """Whether `spacing_mm` is the mean over the whole grid, which core then corrects for what contact does to it.

        False where options set some steps apart from it, as tilts or a level of rotations.
        """
        return True

    @abstractmethod
    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return candidate poses (N, 4, 4), about `spacing_m` metres apart; z is free, core brings them to contact."""

    def places(self, obj: ObjectModel, progress: Progress) -> Places:
        """Return the places of an object that can touch first: what is searched if `Capabilities.places` is declared.

        Poses are not listed then: a touch shows where its deepest point is, and is turned by each of `options.turns`
        yaws. `sample` and `random` are of the set of poses that this covers.
        """
        raise NotImplementedError(f"{type(self).__name__} lists poses")

    @abstractmethod
    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw `count` poses (count, 4, 4) uniformly from the continuous set that the grid samples; z is free.

        As many are drawn about each pose of the grid: probabilities fitted to touches at such poses, P(x | touch), have
        a uniform P_train, which fusers take for granted where a posterior has no `log_train`. A rotation that has more
        places over the sensor must be drawn more often: see `draw_places`.
        """
