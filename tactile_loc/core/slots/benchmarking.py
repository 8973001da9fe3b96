"""The two kinds of component that a benchmark combines: sources of touches with known poses, and methods.

A source prepares a sensor, for instance by calibrating it on images of the source itself. It then presses objects on
this sensor, or reads recorded touches. A method gets touches of one object, and returns poses with scores.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.core.slots.component import Component
from tactile_loc.core.slots.scene import Scene

Image = NDArray[np.uint8]


class TouchSource(Component):
    """A source of touches with known poses. Derive from `SimulatedSource` or `RecordedSource`.

    `licence` is the licence of the source's software or data. `libraries` are the distributions whose versions a
    benchmark records.
    """

    slot = "touch-source"
    licence: ClassVar[str] = ""
    libraries: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def prepare_sensor(self, folder: Path) -> Mapping[str, Any]:
        """Return the sensor's table: its `name`, and its options. Files of a calibrated sensor are put into `folder`.

        Images must be read by a sensor that was calibrated on images of this source, as a user would do it.
        """


class SimulatedSource(TouchSource):
    """A simulator that presses an object on the sensor in any pose."""

    @abstractmethod
    def press(self, scene: Scene, T_sensor_object: Poses, rng: np.random.Generator) -> Image | ContactShape:
        """Return what the sensor sees: an image (H, W, 3) uint8, or a contact shape.

        `scene` has the object, and the sensor's geometry with its `indentation_m`. `T_sensor_object` (4, 4), metres, is
        the pose of the pressed object. `Scene.render_contact_depths` draws the object by ray casting.
        """


@dataclass(frozen=True, eq=False)
class RecordedTouch:
    """A real touch: its `image` (H, W, 3) uint8, and the true pose `T_sensor_object` (4, 4), metres."""

    image: Image
    T_sensor_object: Poses
    name: str = "touch"


class RecordedSource(TouchSource):
    """Recorded touches of certain objects. Each of them is located alone."""

    @abstractmethod
    def find_objects(self) -> Mapping[str, ObjectModel]:
        """Return the touched objects by name. Raises TactileLocError if the recording is missing."""

    @abstractmethod
    def read_touches(self, name: str) -> Iterable[RecordedTouch]:
        """Return the touches of the object with this name."""


@dataclass(frozen=True, eq=False)
class LocatingProblem:
    """What a method knows before the touches: the object, and the sensor with its table and its geometry.

    `sensor` has the component's `name` and its options, as in a configuration. The method may keep files in `folder`.
    """

    object: ObjectModel
    sensor: Mapping[str, Any]
    geometry: SensorGeometry
    folder: Path


@dataclass(frozen=True, eq=False)
class ScoredPoses:
    """The answer of a method: poses `T_base_object` (K, 4, 4), metres, the best first, and their `scores` (K,).

    `probabilities` (K,) are None if the method does not state them. `verdict` is the method's own judgement. Raises
    ConfigError if the arrays do not fit each other.
    """

    T_base_object: Poses
    scores: NDArray[np.float64]
    probabilities: NDArray[np.float64] | None = None
    verdict: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.scores)
        fit = [(self.T_base_object, (count, 4, 4)), (self.scores, (count,))]
        fit += [] if self.probabilities is None else [(self.probabilities, (count,))]
        if count == 0 or any(np.shape(array) != shape or not np.isfinite(array).all() for array, shape in fit):
            shapes = ", ".join(str(np.shape(array)) for array, _ in fit)
            raise ConfigError(
                f"a method returned arrays of shapes {shapes}; return K >= 1 finite poses (K, 4, 4) and K scores"
            )


class Method(Component):
    """A method that locates an object from touches. A benchmark makes one instance for each object and sensor."""

    slot = "method"

    def prepare(self, problem: LocatingProblem) -> None:
        """Build what depends only on the object and the sensor. This time is measured apart."""

    @abstractmethod
    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return poses of the object, given touches with contact shapes and `T_base_sensor`.

        Raises TactileLocError if the method finds no pose.
        """
