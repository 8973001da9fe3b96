"""The outcome of a calibration: the estimator, its errors in words, and its folder."""

from __future__ import annotations

import dataclasses
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_loc.core.runtime.errors import CalibrationError, SensorError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.sensors.calibration.calibrate import calibrate_stage
from tactile_loc.sensors.calibration.folder import write_calibration
from tactile_loc.sensors.calibration.gel_fit import GelFit
from tactile_loc.sensors.calibration.labels import Image, LabelledPresses
from tactile_loc.sensors.calibration.presses import PressFolder, choose_size_px, read_presses
from tactile_loc.sensors.reading.estimator import EstimatorRecipe, GelEstimator
from tactile_loc.store.store import StageStore

QUANTITIES = {
    "slope_deg": ("surface angle in the contact", 1, ".2f", "°"),
    "shape_m": ("indentation in the contact, up to a constant", 1e3, ".3f", " mm"),
    "depth_m": ("indentation in the contact", 1e3, ".3f", " mm"),
    "untouched_m": ("indentation outside the contact", 1e3, ".3f", " mm"),
}


@dataclass(frozen=True, eq=False)
class CalibrationOutcome:
    """A trained `estimator`, its `presses`, the image (H, W, 3) of the untouched gel, and a record as JSON values.

    `facts` are sentences about the gel, if it was measured.
    """

    presses: LabelledPresses
    estimator: GelEstimator
    background: Image
    record: dict[str, Any]
    facts: tuple[str, ...] = ()

    @property
    def held_out(self) -> list[int]:
        """The numbers of the presses that were not used for training."""
        return list(self.record["held_out"]["presses"])

    @property
    def mean_errors(self) -> dict[str, float]:
        """The mean errors on the held-out presses by name; lengths in metres, angles in degrees."""
        return dict(self.record["held_out"]["mean"])

    @property
    def title(self) -> str:
        """The number of held-out presses in words."""
        return f"{len(self.held_out)} of {len(self.presses)} presses were held out"

    def list_errors(self) -> list[str]:
        """Return the mean errors in words, each as a line."""
        mean = self.mean_errors
        return [
            f"{label}: {scale * mean[name]:{digits}}{unit}"
            for name, (label, scale, digits, unit) in QUANTITIES.items()
            if name in mean
        ]

    def convert_errors(self) -> dict[str, float]:
        """Return the mean errors with angles in radians, too."""
        mean = self.mean_errors
        slope = {"slope_rad": math.radians(mean["slope_deg"])} if "slope_deg" in mean else {}
        return {**slope, **{name: value for name, value in mean.items() if name != "slope_deg"}}

    def write(self, folder: Path) -> Path:
        """Write the calibration folder, and return it. Raises OutputError as `write_calibration` does."""
        record = {"presses": len(self.presses), **self.record}
        return write_calibration(folder, self.estimator.geometry, self.background, self.estimator, record)


@dataclass(frozen=True)
class FolderReading:
    """How to read a folder of presses.

    With `median_background`, the untouched gel is the median of the images: see `read_presses`. Images are reduced to
    `size_px` (width, height), by default as by `choose_size_px`. With `curved`, the surface of a curved gel is learned.
    """

    median_background: bool = False
    size_px: tuple[int, int] | None = None
    curved: bool = False


def calibrate_folder(
    folder: Path,
    sensor: Path | SensorGeometry,
    recipe: EstimatorRecipe | None = None,
    reading: FolderReading | None = None,
    store: StageStore | None = None,
    progress: Progress | None = None,
) -> CalibrationOutcome:
    """Calibrate with a folder of presses and the `sensor` that took them, or its file, or load the stored result.

    Raises CalibrationError when the folder cannot be used, SensorError when the sensor's file cannot be read, and
    ConfigError for wrong options.
    """
    if not os.path.isdir(folder):
        raise CalibrationError(f"there is no folder {folder}; give a folder with images of presses and presses.csv")
    recipe, reading, watcher = recipe or EstimatorRecipe(), reading or FolderReading(), progress or Progress()
    camera = sensor if isinstance(sensor, SensorGeometry) else _read_geometry(sensor)
    presses = read_presses(folder, camera, reading.median_background, reading.size_px or choose_size_px(camera))
    if reading.curved:
        presses = _curve_gel(presses, recipe.seed, watcher)
    presses = presses.measure_gel(progress=watcher)
    made, record = calibrate_stage(presses, folder, recipe, store or StageStore(), watcher)
    facts = (*(_describe_curve(presses) if reading.curved else ()), *_describe_gel(presses))
    return CalibrationOutcome(presses, made, presses.untouched, {**record, **presses.record()}, facts)


def _read_geometry(path: Path) -> SensorGeometry:
    if not os.path.isfile(path):
        raise SensorError(f"there is no sensor file {path}; write it (docs/files.md), or give `sensor`")
    return read_sensor_file(path)


def _curve_gel(presses: PressFolder, seed: int, progress: Progress) -> PressFolder:
    from tactile_loc.sensors.reading.relief import learn_relief

    relief_m = learn_relief(presses, seed, progress)
    return dataclasses.replace(presses, geometry=dataclasses.replace(presses.geometry, relief_m=relief_m))


def _describe_curve(presses: PressFolder) -> list[str]:
    relief_m = presses.geometry.relief_m
    if relief_m is None:
        return []
    return [f"the gel is curved: its edge is up to {-1e3 * relief_m.min():.2f} mm lower than its top"]


def _describe_gel(presses: PressFolder) -> list[str]:
    elastic = [] if presses.fit is None else [_describe_elasticity(presses.fit)]
    return [*elastic, *_describe_dots(presses)]


def _describe_elasticity(fit: GelFit) -> str:
    mm = 1e3
    shares = f"{100 * fit.rms:.0f} % of the colour profiles unexplained, a rigid gel {100 * fit.rigid_rms:.0f} %"
    if not fit.is_elastic:
        return f"the gel is taken for rigid: an elastic gel leaves {shares}"
    return (
        f"the gel is elastic: effective thickness {mm * fit.thickness_m:.1f} mm (standard deviation "
        f"{mm * fit.std_m:.1f} mm), coating {mm * fit.coating_m:.2f} mm; it leaves {shares}"
    )


def _describe_dots(presses: PressFolder) -> list[str]:
    dots = presses.record().get("dots", {})
    if not dots.get("count"):
        return []
    return [
        f"the gel has {dots['count']} marker dots, {1e3 * dots['diameter_m']:.2f} mm wide and "
        f"{1e3 * dots['spacing_m']:.2f} mm apart; they cover {100 * dots['covered']:.0f} % of the image and are "
        "filled in"
    ]
