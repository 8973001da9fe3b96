"""The two kinds of component that a benchmark combines: sources of touches with known poses, and methods.

A source prepares a sensor, for instance by calibrating it on images of the source itself. It then presses objects on
this sensor, or reads recorded touches. A method gets touches of one object, and returns poses with scores.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from tactile_loc.plugin import ContactShape, ObjectModel, Poses, Scene, SensorGeometry, TactileLocError, Touch
from tactile_loc.plugin.helpers import Component, is_rigid

ROUNDING = 1e-4  # largest difference of an answer's rotations from proper ones, and of its probabilities' sum from 1

Image = NDArray[np.uint8]


class AnswerError(TactileLocError):
    """A method returned something that is no answer."""


class TouchSource(Component):
    """A source of touches with known poses. Derive from `SimulatedSource` or `RecordedSource`.

    `licence` is the licence of the source's software or data. `libraries` are the distributions whose versions a
    benchmark records. Increase `version` when the same presses give other touches: leaderboards then do not mix them.
    """

    slot = "touch-source"
    version: ClassVar[int] = 1
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

    `sensor` has the component's `name` and its options, as in a configuration. `folder` is that of the stage store. A
    method that keeps other files there makes a folder of its own name.
    """

    object: ObjectModel
    sensor: Mapping[str, Any]
    geometry: SensorGeometry
    folder: Path


@dataclass(frozen=True, eq=False)
class ScoredPoses:
    """The answer of a method: poses `T_base_object` (K, 4, 4), metres, the best first, and their `scores` (K,).

    `probabilities` (K,) are None if the method does not state them. `verdict` is the method's own judgement, or "".
    Raises AnswerError if the arrays are no poses, do not fit each other, or hold impossible probabilities.
    """

    T_base_object: Poses
    scores: NDArray[np.float64]
    probabilities: NDArray[np.float64] | None = None
    verdict: str = ""

    def __post_init__(self) -> None:
        """Convert the arrays to float64, and check them."""
        count = len(np.atleast_1d(self.scores))
        for name, shape in (("T_base_object", (count, 4, 4)), ("scores", (count,)), ("probabilities", (count,))):
            if (given := getattr(self, name)) is not None or name != "probabilities":
                object.__setattr__(self, name, _require_array(name, given, shape))
        if not is_rigid(self.T_base_object, ROUNDING):
            raise AnswerError(
                "a method returned poses that are not rigid transforms; return T_base_object with rotations, "
                "translations in metres, and last rows 0 0 0 1"
            )
        p = self.probabilities
        if p is not None and (p.min() < 0 or p.sum() > 1 + ROUNDING):
            raise AnswerError(
                f"a method returned probabilities from {p.min():.3g} with the sum {p.sum():.3g}; return numbers from 0 "
                "whose sum is at most 1, or None"
            )


def _require_array(name: str, given: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return an array of a method as float64. Raises AnswerError unless it has the shape, and only finite numbers."""
    try:
        found = np.asarray(given, np.float64)
    except (TypeError, ValueError) as error:
        raise AnswerError(f"a method returned {name} that are not numbers ({error}); return an array") from error
    if found.shape != shape or not found.size:
        raise AnswerError(
            f"a method returned {name} of shape {found.shape}, not {shape}; return K poses (K, 4, 4), K scores and, if "
            "any, K probabilities, with K at least 1"
        )
    if not np.isfinite(found).all():
        raise AnswerError(f"a method returned {name} that are not finite; raise TactileLocError if there is no pose")
    return found


class Method(Component):
    """A method that locates an object from touches. A benchmark makes one instance for each object and source.

    `paper` names the publication that the method follows. `libraries` are the distributions whose versions a benchmark
    records.
    """

    slot = "method"
    paper: ClassVar[str] = ""
    libraries: ClassVar[tuple[str, ...]] = ()

    def prepare(self, problem: LocatingProblem) -> None:
        """Build what depends only on the object and the sensor. This time is measured apart."""

    @abstractmethod
    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return poses of the object, given touches with contact shapes and `T_base_sensor`.

        Raises TactileLocError if the method finds no pose.
        """
