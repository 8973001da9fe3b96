"""The grid slot: the poses, or the object's places, that are searched."""

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
        """The options of every grid: its density, and the contact that a pose must make."""

        spacing_mm: float = Field(default=3.0, gt=0, description="mean distance between neighbouring poses, mm")
        min_contact_percent: float = Field(
            default=0.25, ge=0, le=100, description="least share of the observed pixels in contact, percent"
        )

    @property
    def spacing_is_mean(self) -> bool:
        """Whether `spacing_mm` is the mean over the whole grid; if so, core corrects it for the effect of contact.

        False if options set some steps separately, such as tilts or a level of rotations.
        """
        return True

    @abstractmethod
    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return candidate poses (N, 4, 4), about `spacing_m` metres apart; z is free, core brings them to contact."""

    def places(self, obj: ObjectModel, progress: Progress) -> Places:
        """Return the object's places that can touch first; they are searched if `Capabilities.places` is declared.

        Poses are then not listed: a touch is aligned by its deepest point, at `options.turns` yaws. `sample` and
        `random` describe the set of poses that this covers.
        """
        raise NotImplementedError(f"{type(self).__name__} lists poses")

    @abstractmethod
    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw `count` poses (count, 4, 4) uniformly from the continuous set that the grid samples; z is free.

        On average, equally many are drawn around each pose of the grid. Probabilities P(x | touch) fitted to touches at
        such poses have a uniform P_train, which fusers assume for a posterior without `log_train`. So a rotation with
        more places over the sensor must be drawn more often: see `draw_places`.
        """
