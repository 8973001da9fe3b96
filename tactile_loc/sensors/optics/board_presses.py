"""Calibration in simulation only: two boards are pressed on a sensor with known lamps, without a robot or a ball.

Half of the presses are made with each board. For the estimator `cnn`, the default number of presses is that of Bauza et
al. (CoRL 2020, appendix).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.sensor_files import read_sensor_file
from tactile_loc.sensors.calibration.labels import Image, LabelledPresses, PressLabel, label_surface
from tactile_loc.sensors.calibration.outcome import CalibrationOutcome, calibrate_stage
from tactile_loc.sensors.optics.lamps import OPTICS, Optics, choose_optics
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.optics.simulate import SOFTNESS_M, press_boards
from tactile_loc.sensors.reading.estimator import EstimatorRecipe, make_estimator
from tactile_loc.slots.registry import registry
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

STAGE_VERSION = 3
PIECES = "images-{:04d}", "indentation-{:04d}"  # names of a shard's arrays
SHARD = 64  # number of presses that are rendered and saved together, with the same lamps
DEEPEST = 65535  # indentations are 16-bit shares of the sensor's maximal depth
VARIATION = 0.25  # variation of the lamps between shards, relative to the spread between sensors of one make
PRESSES = {"photometric": 200, "cnn": 2000}  # default numbers of presses


@dataclass(frozen=True, eq=False)
class SimulatedSensor:
    """A sensor with known lamps. `camera_px` is the size (rows, columns) of its camera's images, if it is known."""

    geometry: SensorGeometry
    optics: Optics
    camera_px: tuple[int, int] | None = None

    @classmethod
    def find(cls, sensor: str, lamps: str | None = None) -> SimulatedSensor:
        """Return a sensor, given its name or its file (.toml), with the optics named `lamps`.

        By default, the optics are those of the sensor, or generic optics for a sensor file. Raises ConfigError for
        unknown `lamps`, SensorError for a sensor file that cannot be read, and CalibrationError for another sensor that
        cannot be simulated.
        """
        optics = choose_optics(sensor, lamps)
        if sensor.endswith(".toml"):
            return cls(read_sensor_file(Path(sensor)), optics)
        if sensor not in OPTICS:
            raise CalibrationError(
                f"no images can be simulated for the sensor {sensor!r}; choose {', '.join(OPTICS)}, or give a "
                "sensor file (.toml)"
            )
        made = registry().create("sensor", sensor, {})
        return cls(made.geometry, optics, made.native.shape)


@dataclass(frozen=True, eq=False)
class SimulatedPresses(LabelledPresses):
    """Presses of the boards on a sensor, in shards of at most SHARD presses.

    Each shard has `images` (S, H, W, 3) and `codes` (S, H, W), the indentations in steps of 1/DEEPEST of the maximal
    depth. `background` (H, W, 3) is the image of the untouched gel for all presses. `key` identifies the set in the
    store.
    """

    sensor: SimulatedSensor
    background: Image
    images: Sequence[NDArray[np.uint8]]
    codes: Sequence[NDArray[np.uint16]]
    key: StageKey

    @property
    def geometry(self) -> SensorGeometry:  # type: ignore[override]
        """The sensor's geometry."""
        return self.sensor.geometry

    def __len__(self) -> int:
        return sum(len(shard) for shard in self.images)

    def read_press(self, number: int) -> tuple[Image, PressLabel]:
        """Return the image (H, W, 3) and the label of a press. The labelled indentation is 0 outside the contact."""
        shard, place = divmod(number, SHARD)
        indentation = self.codes[shard][place] * np.float32(self.geometry.max_depth_m / DEEPEST)
        label = label_surface(indentation, indentation > 0, self.geometry)
        return np.array(self.images[shard][place]), label

    def name(self, number: int) -> str:
        """Return the name of a press."""
        return f"simulated press {number}"

    def describe(self) -> dict[str, Any]:
        """Return JSON values that identify the presses in store keys."""
        return {"presses": self.key.digest}

    def record(self) -> dict[str, Any]:
        """Return the optics, and the size of the camera's images if it is known, as JSON values."""
        camera = {} if self.sensor.camera_px is None else {"camera_px": list(self.sensor.camera_px)}
        return {"simulated": {"optics": self.sensor.optics.describe(), "variation": VARIATION}, **camera}


def simulate_presses(
    sensor: SimulatedSensor,
    count: int,
    seed: int,
    store: StageStore,
    progress: Progress | None = None,
    variation: float = VARIATION,
) -> SimulatedPresses:
    """Press the boards `count` times on a sensor, or load the stored presses of the same `seed`.

    `variation` (unitless) scales the difference between each shard's lamps and the sensor's (see `Optics.vary`). All
    shards have the same image of the untouched gel, which is rendered with the sensor's optics. Raises TouchError when
    the boards leave no imprint on the sensor.
    """
    geometry, optics = sensor.geometry, sensor.optics
    renderer = registry().create("renderer", "heightmap", {})
    untouched = render_background(geometry, optics)
    described = {"geometry": geometry.describe(), "optics": optics.describe(), "renderer": renderer.describe()}
    numbers = {"variation": variation, "count": count, "seed": seed, "softness_m": SOFTNESS_M, "shard": SHARD}
    key = StageKey("board-presses", STAGE_VERSION, {**described, **numbers})
    sizes = [min(SHARD, count - start) for start in range(0, count, SHARD)]

    def render(work: Workspace) -> None:
        with (progress or Progress()).task("pressing the calibration boards", count) as advance:
            for number, size in enumerate(sizes):
                names = [name.format(number) for name in PIECES]
                if any(work.load(name) is None for name in names):
                    rng = np.random.default_rng([seed, number])
                    lamps = optics.vary(rng, variation)
                    done = list(press_boards(geometry, size, lamps, rng, renderer, background=untouched))
                    work.save_array(names[0], np.concatenate([batch.images for batch in done]))
                    indentation_m = np.concatenate([batch.indentation_m for batch in done])
                    work.save_array(names[1], _encode(indentation_m, geometry))
                advance(size)

    artifact = store.build(key, render)
    images, codes = ([artifact.load_array(name.format(n)) for n in range(len(sizes))] for name in PIECES)
    return SimulatedPresses(sensor, untouched, images, codes, key)


def _encode(indentation_m: NDArray[np.float32], geometry: SensorGeometry) -> NDArray[np.uint16]:
    """Return indentations in steps of 1/DEEPEST of the maximal depth. Every pixel in contact stays in contact."""
    codes = np.ceil(indentation_m * np.float32(DEEPEST / geometry.max_depth_m))
    return np.minimum(codes, DEEPEST).astype(np.uint16)


def calibrate_simulated(
    sensor: SimulatedSensor,
    count: int | None,
    recipe: EstimatorRecipe,
    store: StageStore,
    progress: Progress | None = None,
) -> CalibrationOutcome:
    """Calibrate on `count` presses of the simulated boards, or load the stored result.

    The default number of presses is in PRESSES. The outcome's record has the optics, too. Raises ConfigError for wrong
    options, CalibrationError for too few presses, and TrainingError when the training fails.
    """
    untouched = render_background(sensor.geometry, sensor.optics)
    make_estimator(recipe.estimator, recipe.options, sensor.geometry, untouched)  # reports wrong options at once
    watcher = progress or Progress()
    presses = simulate_presses(sensor, count or PRESSES[recipe.estimator], recipe.seed, store, watcher)
    return calibrate_stage(presses, recipe, store, watcher)
