"""What turns an image of the gel into its indentation; `photometric` and `cnn` are the two that there are."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.labels import PressLabel
from tactile_loc.core.errors import CalibrationError, MissingLibraryError, did_you_mean
from tactile_loc.core.interfaces import Checkpoints, ComponentOptions
from tactile_loc.core.progress import Progress
from tactile_loc.core.registry import validate_options
from tactile_loc.core.sensing import SensorGeometry

Image = NDArray[np.uint8]

_HERE = "tactile_loc.calibration"
ESTIMATORS = {"photometric": f"{_HERE}.photometric:PhotometricEstimator", "cnn": f"{_HERE}.cnn:CnnEstimator"}


class LabelledPresses(ABC):
    """Images of known presses, as many as `len` says: small sets in memory, large ones rendered when asked for."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of presses."""

    @abstractmethod
    def press(self, number: int) -> tuple[Image, PressLabel]:
        """Return an image (H, W, 3) and what is known of the gel in it."""

    def name(self, number: int) -> str:
        """Return what people know a press by."""
        return f"press {number}"

    def presses(self) -> Iterator[tuple[Image, PressLabel]]:
        """Yield every press."""
        return (self.press(number) for number in range(len(self)))


@dataclass(frozen=True, eq=False)
class Chosen(LabelledPresses):
    """Some presses of a set, by number."""

    whole: LabelledPresses
    numbers: Sequence[int]

    def __len__(self) -> int:
        """Return the number of presses."""
        return len(self.numbers)

    def press(self, number: int) -> tuple[Image, PressLabel]:
        """Return an image (H, W, 3) and what is known of the gel in it."""
        return self.whole.press(self.numbers[number])

    def name(self, number: int) -> str:
        """Return what people know a press by."""
        return self.whole.name(self.numbers[number])


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """What an estimator learns from: presses on a sensor of `geometry`; `background` (H, W, 3) is its untouched gel."""

    geometry: SensorGeometry
    background: Image
    presses: LabelledPresses
    progress: Progress = field(default_factory=Progress)
    checkpoints: Checkpoints = field(default_factory=Checkpoints)


class GelEstimator(ABC):
    """Estimates how far the gel is pressed in, from its image and that of the untouched gel.

    `sees_skirt` says whether that includes the gel that hangs down around the contact, or is of the contact alone.
    """

    name: ClassVar[str]
    sees_skirt: ClassVar[bool] = True

    class Options(ComponentOptions):
        """No options."""

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        self.geometry, self.background = geometry, background
        self.options: Any = options if options is not None else self.Options()

    @abstractmethod
    def fit(self, problem: CalibrationProblem) -> None:
        """Learn from labelled presses. Raises TrainingError when that goes wrong."""

    @abstractmethod
    def indentation(self, image: Image) -> NDArray[np.float32]:
        """Return how far the gel is pressed in (H, W), metres, about 0 where it is untouched."""

    @abstractmethod
    def save(self, path: Path) -> None:
        """Write what was learned to a safetensors file."""

    @abstractmethod
    def load(self, path: Path) -> None:
        """Read what was learned. Raises WeightsError when the file is damaged or of another estimator."""


def estimator_class(name: str) -> type[GelEstimator]:
    """Return the estimator called `name`. Raises CalibrationError for another, MissingLibraryError without torch."""
    if name not in ESTIMATORS:
        raise CalibrationError(
            f"there is no estimator {name!r}; give one of {', '.join(ESTIMATORS)}.{did_you_mean(name, ESTIMATORS)}"
        )
    module, _, attribute = ESTIMATORS[name].partition(":")
    try:
        found: type[GelEstimator] = getattr(importlib.import_module(module), attribute)
    except ImportError as error:
        raise MissingLibraryError(
            f"a sensor that is calibrated for images needs {error.name}; install it with pip install "
            "'tactile-loc[learned]'"
        ) from error
    return found


def estimator_options(kind: type[GelEstimator], options: Mapping[str, Any]) -> ComponentOptions:
    """Return an estimator's options. Raises ConfigError for unknown or ill-typed ones."""
    chosen: ComponentOptions = validate_options(kind.Options, options, f"estimator {kind.name!r}")
    return chosen
