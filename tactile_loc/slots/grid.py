"""The grid slot: the poses, or the object's places, that are searched."""

from abc import abstractmethod

import numpy as np
from pydantic import Field

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.places.places import Places
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.slots.component import Component


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
        """True if `spacing_mm` is the mean spacing of the whole grid; then core corrects it for the effect of contact.

        Return False if options set some steps separately, such as tilts or a level of rotations.
        """
        return True

    @abstractmethod
    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Return candidate poses (N, 4, 4), metres, about `spacing_m` metres apart.

        Their z is arbitrary, because core brings them to contact.
        """

    def places(self, obj: ObjectModel, progress: Progress) -> Places:
        """Return the object's places, if the grid declares `Capabilities.places`.

        Such a grid does not list the poses that are searched. Each touch is aligned with the places by its deepest
        point, at `options.turns` yaws. `sample` and `random` return examples of the poses that this search covers.
        """
        raise NotImplementedError(f"{type(self).__name__} lists poses")

    @abstractmethod
    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, uniformly from the continuous set that the grid samples; z is arbitrary.

        On average, equally many poses must be drawn around each pose of the grid. A rotation that allows more positions
        over the sensor must therefore be drawn more often: see `draw_places`. Probabilities P(x | touch) that are
        fitted to touches at such poses have a uniform P_train. Fusers assume this for a posterior without `log_train`.
        """
