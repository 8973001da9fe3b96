"""Calibrating on simulation alone: the boards are pressed on a sensor whose lamps are known, as `simulate` shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tactile_loc.calibration.board_presses import VARIATION, SimulatedPresses, simulated_presses
from tactile_loc.calibration.estimator import GelEstimator, estimator_class, estimator_options
from tactile_loc.calibration.stage import learned
from tactile_loc.core.errors import CalibrationError
from tactile_loc.core.progress import Progress
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import SensorGeometry
from tactile_loc.imaging.optics import OPTICS, Optics, optics, optics_of
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.store.store import StageStore

PRESSES = {"photometric": 200, "cnn": 2000}  # by default; the paper's number for its network


def simulated_sensor(sensor: str, lamps: str | None = None) -> tuple[SensorGeometry, Optics]:
    """Return the geometry of a sensor, by its name or its file (.toml), and the optics called `lamps`.

    By default the optics are the sensor's own, or a usual sensor's. Raises SensorError, ConfigError or
    UnknownPluginError for what there is not, CalibrationError for a sensor that reads no images of its own.
    """
    chosen = optics(lamps) if lamps else optics_of(sensor)
    if sensor.endswith(".toml"):
        return read_sensor_file(Path(sensor)), chosen
    if sensor not in OPTICS:
        raise CalibrationError(
            f"there are no simulated images of a sensor {sensor!r}; give one of {', '.join(OPTICS)}, or a sensor file "
            "(.toml)"
        )
    geometry: SensorGeometry = registry().create("sensor", sensor, {}).geometry
    return geometry, chosen


def camera_px(sensor: str) -> list[int] | None:
    """Return the size (rows, columns) of the images of a sensor by its name; None for one in a file: its own."""
    return list(registry().create("sensor", sensor, {}).native.shape) if sensor in OPTICS else None


def calibrate_simulated(
    geometry: SensorGeometry, lamps: Optics, count: int | None, estimator: str, options: dict[str, Any], seed: int,
    store: StageStore, progress: Progress | None = None,
) -> tuple[SimulatedPresses, GelEstimator, dict[str, Any]]:  # fmt: skip
    """Calibrate on `count` presses of the simulated boards, by default PRESSES, or find what was.

    Return the presses, the estimator, and a record of JSON values: its errors, and the optics. Raises CalibrationError,
    ConfigError or TrainingError.
    """
    estimator_options(estimator_class(estimator), options)  # what is wrong is said before anything is rendered
    watcher = progress or Progress()
    presses = simulated_presses(geometry, lamps, count or PRESSES[estimator], seed, store, watcher)
    inputs = {"presses": presses.key.digest}
    made, record = learned(
        presses, geometry, presses.background, inputs, estimator, options, seed, store, watcher
    )  # fmt: skip
    return presses, made, {**record, "simulated": {"optics": lamps.describe(), "variation": VARIATION}}
