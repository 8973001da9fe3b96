"""Estimators of the gel's indentation from its image: their input, training and storage.

There are two: `photometric` and `cnn`.
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tactile_loc.calibration.labels import Float32, Image, LabelledPresses
from tactile_loc.core.errors import CalibrationError, MissingLibraryError, WeightsError, advise_choice
from tactile_loc.core.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.slots.component import ComponentOptions
from tactile_loc.core.slots.encoder import Checkpoints
from tactile_loc.core.slots.registry import validate_options

if TYPE_CHECKING:
    from torch import nn

_HERE = "tactile_loc.calibration"
ESTIMATORS = {"photometric": f"{_HERE}.photometric:PhotometricEstimator", "cnn": f"{_HERE}.cnn:CnnEstimator"}
DIFFERENCE, FIXED = 3, 5  # planes that a touch changes, and constant planes
PLANES = DIFFERENCE + FIXED
COLOUR_STEP = 64.0  # counts of 255 that scale a colour difference to one
BACKGROUND_M = 2e-4  # standard deviation of the smoothing that removes the background's grain


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """An estimator's training data: presses on a sensor of `geometry`; `background` (H, W, 3) is its untouched gel."""

    geometry: SensorGeometry
    background: Image
    presses: LabelledPresses
    progress: Progress = field(default_factory=Progress)
    checkpoints: Checkpoints = field(default_factory=Checkpoints)


class GelEstimator(ABC):
    """Estimates the indentation of the gel from its image and an image of the untouched gel.

    `background` (H, W, 3) is the untouched gel during training. Images are compared with `untouched`, which may be a
    newer image of it. `sees_skirt` states whether the indentation includes the skirt, the gel that slopes down around
    the contact.
    """

    name: ClassVar[str]
    _network: nn.Module
    sees_skirt: ClassVar[bool] = True

    class Options(ComponentOptions):
        """No options."""

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        self.geometry, self.background, self.untouched = geometry, background, background
        self._fixed = stack_fixed_features(background, geometry)
        self.options: Any = options if options is not None else self.Options()

    @abstractmethod
    def fit(self, problem: CalibrationProblem) -> None:
        """Learn from labelled presses. Raises TrainingError when the training fails."""

    @abstractmethod
    def read(self, image: Image) -> tuple[Float32, Float32 | None]:
        """Return the indentation (H, W), metres, and the slopes (H, W, 2), unitless, if it is integrated from slopes.

        The indentation is about 0 where the gel is untouched.
        """

    def read_indentation(self, image: Image) -> Float32:
        """Return the indentation (H, W), metres, which is about 0 where the gel is untouched."""
        return self.read(image)[0]

    def save(self, path: Path) -> None:
        """Write the trained network to a safetensors file."""
        from safetensors.torch import save_file

        tensors = self._network.state_dict().items()
        save_file({name: tensor.detach().cpu().contiguous() for name, tensor in tensors}, path)

    def load(self, path: Path) -> None:
        """Read the network. Raises WeightsError for a file that is damaged or of another estimator."""
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        try:
            self._network.load_state_dict(load_file(path))
        except (SafetensorError, RuntimeError, OSError) as error:
            reason = str(error).splitlines()[0]
            raise WeightsError(
                f"{path} cannot be read as the weights of a {self.name} estimator ({reason}); calibrate the sensor "
                "again"
            ) from error


def load_estimator(name: str) -> type[GelEstimator]:
    """Return the estimator named `name`. Raises CalibrationError for an unknown name, MissingLibraryError without
    torch."""
    if name not in ESTIMATORS:
        raise CalibrationError(f"there is no estimator {name!r}; {advise_choice(name, ESTIMATORS)}")
    module, _, attribute = ESTIMATORS[name].partition(":")
    try:
        found: type[GelEstimator] = getattr(importlib.import_module(module), attribute)
    except ImportError as error:
        raise MissingLibraryError(
            f"a calibrated sensor needs {error.name}, which is not installed: pip install 'tactile-loc[learned]'"
        ) from error
    return found


def validate_estimator_options(kind: type[GelEstimator], options: Mapping[str, Any]) -> ComponentOptions:
    """Return an estimator's options. Raises ConfigError for unknown or ill-typed options."""
    chosen: ComponentOptions = validate_options(kind.Options, options, f"the estimator {kind.name!r}")
    return chosen


def scale_difference(image: Image, background: Image) -> Float32:
    """Return the difference of an image (H, W, 3), or a part of it, from that of the untouched gel: about -1 to 1."""
    return (image.astype(np.float32) - background) / np.float32(COLOUR_STEP)


def stack_features(image: Image, background: Image, fixed: Float32) -> Float32:
    """Return an estimator's input (H, W, PLANES), about -1 to 1, for an image (H, W, 3) or a part of it.

    It holds the colour's difference from the `background` (H, W, 3), and the constant planes `fixed` (H, W, 5).
    """
    return np.concatenate([scale_difference(image, background), fixed], axis=-1)


def stack_fixed_features(background: Image, geometry: SensorGeometry) -> Float32:
    """Return the constant planes (H, W, 5): the smoothed background's colour, and the position; about -1 to 1."""
    from scipy.ndimage import gaussian_filter

    sigma = BACKGROUND_M / geometry.pixel_pitch_m
    colour = gaussian_filter(background.astype(np.float32), (sigma, sigma, 0), mode="nearest") / 127.5 - 1
    height, width = geometry.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    return np.concatenate([colour, x[..., None], y[..., None]], axis=-1).astype(np.float32)
