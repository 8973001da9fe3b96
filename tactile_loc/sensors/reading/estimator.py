"""Estimators of the gel's indentation from its image: base class, input and storage.

The estimators are `photometric` and `cnn`.
"""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file
from scipy.ndimage import gaussian_filter

from tactile_loc.core.runtime.errors import CalibrationError, MissingLibraryError, WeightsError, advise_choice
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.calibration.labels import Float32, Image, LabelledPresses
from tactile_loc.slots.encoder import Checkpoints
from tactile_loc.slots.options import validate_options

_HERE = "tactile_loc.sensors.reading"
ESTIMATORS = {"photometric": f"{_HERE}.photometric:PhotometricEstimator", "cnn": f"{_HERE}.cnn:CnnEstimator"}
DIFFERENCE, FIXED = 3, 5  # number of input planes that a touch changes, and of constant planes
PLANES = DIFFERENCE + FIXED
COLOUR_STEP = 64.0  # colour difference that is scaled to 1, counts of 255
BACKGROUND_M = 2e-4  # standard deviation of the smoothing that removes the background's grain


@dataclass(frozen=True)
class EstimatorRecipe:
    """How to learn an estimator: its name, its options by name, and the seed that draws the held-out presses."""

    estimator: str = "photometric"
    options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0


class GelEstimator(ABC):
    """Estimates the indentation of the gel from its image and an image of the untouched gel.

    `background` (H, W, 3) shows the untouched gel at the time of training. Images are compared with `untouched`, which
    is the same image or a newer image of the untouched gel. `sees_skirt` states whether the indentation includes the
    skirt. The skirt is the gel around the contact that is pressed down without touching the object.
    """

    name: ClassVar[str]
    sees_skirt: ClassVar[bool] = True

    class Options(ComponentOptions):
        """No options."""

    def __init__(self, geometry: SensorGeometry, background: Image, options: ComponentOptions | None = None) -> None:
        self.geometry, self.background, self.untouched = geometry, background, background
        self._fixed = stack_fixed_features(background, geometry)
        self.options: Any = options if options is not None else self.Options()

    @abstractmethod
    def fit(self, presses: LabelledPresses, progress: Progress, checkpoints: Checkpoints) -> None:
        """Learn from labelled presses, or resume from the checkpoints.

        Raises CalibrationError when no press shows contact, and TrainingError when the training fails.
        """

    @abstractmethod
    def read(self, image: Image) -> tuple[Float32, Float32 | None]:
        """Return the indentation (H, W), metres, and the slopes (H, W, 2), unitless.

        The indentation is about 0 where the gel is untouched. The slopes are None if the estimator does not use slopes.
        """

    def read_indentation(self, image: Image) -> Float32:
        """Return the indentation (H, W), metres. It is about 0 where the gel is untouched."""
        return self.read(image)[0]

    @abstractmethod
    def list_weights(self) -> Mapping[str, NDArray[np.generic]]:
        """Return what was learned, by name, as views: a change of their values changes the estimator."""

    def save(self, path: Path) -> None:
        """Write what was learned to a safetensors file."""
        save_file({name: np.asarray(one, order="C") for name, one in self.list_weights().items()}, path)

    def load(self, path: Path) -> None:
        """Read what was learned from a safetensors file.

        Raises WeightsError when the file is damaged or belongs to another estimator.
        """
        mine = self.list_weights()
        try:
            stored = load_file(path)
            if {name: one.shape for name, one in stored.items()} != {name: one.shape for name, one in mine.items()}:
                raise ValueError("its tensors have other names or shapes")
        except (SafetensorError, ValueError, OSError) as error:
            reason = str(error).splitlines()[0]
            raise WeightsError(
                f"{path} cannot be read as the weights of a {self.name} estimator ({reason}); calibrate the sensor "
                "again"
            ) from error
        for name, one in mine.items():
            np.copyto(one, stored[name])


def make_estimator(name: str, options: Mapping[str, Any], geometry: SensorGeometry, background: Image) -> GelEstimator:
    """Return the untrained estimator named `name` of a sensor.

    Raises CalibrationError when the name is unknown, MissingLibraryError when its library is not installed, and
    ConfigError for unknown or ill-typed options.
    """
    if name not in ESTIMATORS:
        raise CalibrationError(f"there is no estimator {name!r}; {advise_choice(name, ESTIMATORS)}")
    module, _, attribute = ESTIMATORS[name].partition(":")
    try:
        kind: type[GelEstimator] = getattr(importlib.import_module(module), attribute)
    except ImportError as error:
        raise MissingLibraryError(
            f"the estimator {name!r} needs {error.name}, which is not installed: pip install 'tactile-loc[learned]'"
        ) from error
    return kind(geometry, background, validate_options(kind.Options, options, f"the estimator {name!r}"))


def scale_difference(image: Image, background: Image) -> Float32:
    """Return an image (H, W, 3) minus the background (H, W, 3), scaled to about -1 to 1.

    Both may be crops of the whole images at the same place.
    """
    return (image.astype(np.float32) - background) / np.float32(COLOUR_STEP)


def stack_features(image: Image, background: Image, fixed: Float32) -> Float32:
    """Return an estimator's input (H, W, PLANES), about -1 to 1, for an image (H, W, 3) or a crop of an image.

    The first planes are the colour difference from the `background` (H, W, 3). The others are `fixed` (H, W, FIXED).
    """
    return np.concatenate([scale_difference(image, background), fixed], axis=-1)


def stack_fixed_features(background: Image, geometry: SensorGeometry) -> Float32:
    """Return the constant planes (H, W, FIXED): the smoothed background's colours and the pixels' x and y.

    The values are between -1 and 1.
    """
    sigma = BACKGROUND_M / geometry.pixel_pitch_m
    colour = gaussian_filter(background.astype(np.float32), (sigma, sigma, 0), mode="nearest") / 127.5 - 1
    height, width = geometry.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    return np.concatenate([colour, x[..., None], y[..., None]], axis=-1).astype(np.float32)
