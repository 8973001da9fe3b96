"""Calibrates a sensor: trains an estimator on most presses, and measures its errors on the others."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import CalibrationError, SensorError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.sensor_files import read_camera
from tactile_loc.sensors.calibration.folder import CHECKED, WEIGHTS, write_calibration
from tactile_loc.sensors.calibration.labels import Image, PressLabel
from tactile_loc.sensors.calibration.presses import PressFolder, choose_size_px, read_presses
from tactile_loc.sensors.reading.circles import thin
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.passport import ASPECT, EQUAL_SCALES, Examination, measure_usual
from tactile_loc.sensors.reading.passport import FEWEST as FEWEST_CHECKED
from tactile_loc.sensors.reading.photometric import EstimatorRecipe, PhotometricEstimator
from tactile_loc.sensors.reading.reading import find_worst, measure_health, read_gel
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

HELD_OUT = 0.2  # share of the presses on which the errors are measured
FEWEST = 5  # fewest presses for a calibration: four for training and one held out
STAGE_VERSION, RECORD = 9, "held-out"
MOST_CHECKED = 12  # largest number of presses for which the sensor's checks are measured
LOOKED_AT = 60  # largest number of presses for which the health is measured
QUANTITIES = {
    "slope_deg": ("surface angle in the contact", 1, ".2f", "°"),
    "shape_m": ("indentation in the contact, up to a constant", 1e3, ".3f", " mm"),
    "depth_m": ("indentation in the contact", 1e3, ".3f", " mm"),
    "untouched_m": ("indentation outside the contact", 1e3, ".3f", " mm"),
}


@dataclass(frozen=True, eq=False)
class CalibrationOutcome:
    """A trained `estimator`, its `presses`, and a record as JSON values.

    The record has the errors on the held-out presses, the noise of the untouched gel (`noise_m`, metres), and the worst
    health of the training presses. `doubts` are sentences about the ball and the scale, if they cannot be as stated.
    `facts` are sentences about the presses and the gel, if it was measured.
    """

    presses: PressFolder
    estimator: PhotometricEstimator
    record: dict[str, Any]
    facts: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def held_out(self) -> list[int]:
        """The numbers of the presses that were not used for training."""
        return list(self.record["held_out"]["presses"])

    @property
    def mean_errors(self) -> dict[str, float]:
        """The mean errors on the held-out presses by name: see `measure_press`."""
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
        slope = {"slope_rad": math.radians(mean.pop("slope_deg"))} if "slope_deg" in mean else {}
        return {**slope, **mean}

    def write(self, folder: Path) -> Path:
        """Write the calibration folder, and return it. Raises OutputError as `write_calibration` does."""
        record = {"presses": len(self.presses), **self.record}
        return write_calibration(folder, self.estimator, self.presses.untouched, record)


def calibrate(presses: PressFolder, recipe: EstimatorRecipe, progress: Progress | None = None) -> CalibrationOutcome:
    """Train an estimator on four fifths of the presses, and measure its errors on the other presses.

    Raises CalibrationError when there are fewer than FEWEST presses.
    """
    if len(presses) < FEWEST:
        raise CalibrationError(f"there are only {len(presses)} presses; give at least {FEWEST}, better 30")
    made = PhotometricEstimator(presses.geometry, presses.background, recipe.options)
    learned, held_out = split(len(presses), recipe.seed)
    made.fit(presses.read_presses(learned), progress or Progress())
    mean = average_errors([measure_press(made, *press) for press in presses.read_presses(held_out)])
    images = (presses.read_press(number)[0] for number in thin(learned, LOOKED_AT))
    usual = find_worst(measure_health(i, made.untouched, made.read(i)[1], made.geometry) for i in images)
    record = {"noise_m": mean.get("untouched_m", 0.0), "held_out": {"presses": list(held_out), "mean": mean}}
    return CalibrationOutcome(presses, made, {**record, "health": usual.record()})


def split(count: int, seed: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Draw the held-out presses from `count` presses. Return the numbers of the training and the held-out presses.

    Both tuples are sorted.
    """
    drawn = np.random.default_rng(seed).permutation(count)
    few = max(1, round(HELD_OUT * count))
    return tuple(sorted(drawn[few:].tolist())), tuple(sorted(drawn[:few].tolist()))


def measure_press(estimator: PhotometricEstimator, image: Image, label: PressLabel) -> dict[str, float]:
    """Return the errors of an estimator for one press by name, without unknown errors. Lengths are in metres.

    `slope_deg` is the mean absolute error of the surface's angles along x and y in the contact, degrees. `shape_m` is
    the RMS error of the indentation in the contact after the mean error is subtracted. `depth_m` is the RMS error
    without this subtraction. It is unknown if the label is not absolute. `untouched_m` is the RMS of the estimated
    indentation where the gel is untouched.
    """
    indentation, _, slopes = read_gel(estimator, image, estimator.geometry.gel)
    off = indentation - label.indentation_m
    inside = off[label.contact]
    known = label.contact & label.known
    errors = {}
    if known.any():
        off_rad = np.arctan(slopes[known]) - np.arctan(label.slope[known])
        errors["slope_deg"] = float(np.degrees(np.abs(off_rad)).mean())
    if inside.size:
        errors["shape_m"] = _rms(inside - inside.mean())
        errors |= {"depth_m": _rms(inside)} if label.absolute else {}
    untouched = off[label.known & ~label.contact]
    return {**errors, "untouched_m": _rms(untouched)} if untouched.size else errors


def average_errors(errors: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the mean of each error of `measure_press` over the presses for which the error is known."""
    known = {name: [one[name] for one in errors if name in one] for name in QUANTITIES}
    return {name: float(np.mean(values)) for name, values in known.items() if values}


def _rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def measure_folder(
    folder: Path,
    sensor: Path | SensorGeometry,
    median_background: bool = False,
    size_px: tuple[int, int] | None = None,
    progress: Progress | None = None,
) -> PressFolder:
    """Read a folder of presses by the `sensor` that took them, or its file, and measure the gel and the ball's size.

    The other arguments are those of `read_presses`; images are reduced as by `choose_size_px` by default. Raises
    CalibrationError when the folder cannot be used, and SensorError when the sensor's file cannot be read.
    """
    if not os.path.isdir(folder):
        raise CalibrationError(f"there is no folder {folder}; give a folder with images of presses and presses.csv")
    if isinstance(sensor, Path) and not os.path.isfile(sensor):
        raise SensorError(f"there is no sensor file {sensor}; write it (docs/files.md), or give `sensor`")
    camera, photo_map = (sensor, None) if isinstance(sensor, SensorGeometry) else read_camera(sensor)
    presses = read_presses(folder, camera, median_background, size_px or choose_size_px(camera), photo_map)
    return presses.measure_stretch().measure_gel(progress)


def calibrate_folder(
    folder: Path,
    sensor: Path | SensorGeometry,
    recipe: EstimatorRecipe | None = None,
    store: StageStore | None = None,
    progress: Progress | None = None,
) -> CalibrationOutcome:
    """Calibrate with a folder of presses and the `sensor` that took them, or its file, or load the stored result.

    Raises the errors of `measure_folder`, and ConfigError for wrong options.
    """
    measured = measure_folder(folder, sensor, progress=progress)
    return calibrate_measured(measured, recipe or EstimatorRecipe(), store, progress)


def calibrate_measured(
    presses: PressFolder, recipe: EstimatorRecipe, store: StageStore | None = None, progress: Progress | None = None
) -> CalibrationOutcome:
    """Calibrate with presses from `measure_folder`, or load the stored result. Raises ConfigError for wrong options."""
    made = PhotometricEstimator(presses.geometry, presses.background, recipe.options)
    described = {"options": made.options.model_dump(mode="json"), "seed": recipe.seed}

    def learn(work: Workspace) -> None:
        done = calibrate(presses, recipe, progress)
        work.save_file(WEIGHTS, done.estimator.save)
        work.save_json(RECORD, done.record)

    key = StageKey("calibration", STAGE_VERSION, {**presses.describe(), **described})
    artifact = (store or StageStore()).build(key, learn)
    made.load(artifact.find_file(WEIGHTS))
    record = {**artifact.load_json(RECORD), **presses.record(), CHECKED: _check_presses(presses, made)}
    return CalibrationOutcome(presses, made, record, tuple(presses.list_facts()), tuple(presses.list_doubts()))


def _check_presses(presses: PressFolder, estimator: PhotometricEstimator) -> dict[str, float]:
    """Return the values of the sensor's checks on some presses; none if there are too few."""
    some = np.array(thin(presses.images, MOST_CHECKED))
    if len(some) < FEWEST_CHECKED:
        return {}
    usual, stretch = measure_usual(Examination(estimator, UntouchedGel.of(presses.background), some)), presses.stretch
    if stretch is not None and stretch.is_clear:  # a stretched imprint is not usual, so that the checks report it
        usual |= {ASPECT: usual.get(ASPECT, 0.0) - math.log(stretch.ratio), EQUAL_SCALES: 0.0}
    return usual
