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
from tactile_loc.sensors.calibration.calibrate import learn_stage
from tactile_loc.sensors.calibration.labels import Image, LabelledPresses, PressLabel, label_surface
from tactile_loc.sensors.optics.gel import SOFTNESS_M
from tactile_loc.sensors.optics.lamps import OPTICS, Optics, choose_optics, find_optics
from tactile_loc.sensors.optics.shading import render_background
from tactile_loc.sensors.optics.simulate import press_boards
from tactile_loc.sensors.reading.estimator import CalibrationProblem, EstimatorRecipe, GelEstimator
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
class SimulatedPresses(LabelledPresses):
    """Presses of the boards on a sensor, in shards of at most SHARD presses.

    Each shard has `images` (S, H, W, 3) and `codes` (S, H, W), the indentations in steps of 1/DEEPEST of the maximal
    depth. `background` (H, W, 3) is the image of the untouched gel for all presses. `key` identifies the set in the
    store.
    """

    geometry: SensorGeometry
    background: Image
    images: Sequence[NDArray[np.uint8]]
    codes: Sequence[NDArray[np.uint16]]
    key: StageKey

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


def simulate_presses(
    geometry: SensorGeometry,
    optics: Optics,
    count: int,
    seed: int,
    store: StageStore,
    progress: Progress | None = None,
    variation: float = VARIATION,
) -> SimulatedPresses:
    """Press the boards `count` times on a sensor, or load the stored presses of the same `seed`.

    `variation` (unitless) scales the difference between each shard's lamps and `optics` (see `Optics.vary`). All shards
    have the same image of the untouched gel, which is rendered with `optics`. Raises TouchError when the boards leave
    no imprint on the sensor.
    """
    renderer = registry().create("renderer", "heightmap", {})
    untouched = render_background(geometry, optics)
    described = {"geometry": geometry.describe(), "optics": optics.describe(), "renderer": renderer.describe()}
    numbers = {"variation": variation, "count": count, "seed": seed, "softness_m": SOFTNESS_M, "shard": SHARD}
    key = StageKey("board-presses", STAGE_VERSION, {**described, **numbers})

    def shard(number: int, size: int) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        rng = np.random.default_rng([seed, number])
        lamps = optics.vary(rng, variation)
        done = list(press_boards(geometry, size, lamps, rng, renderer, background=untouched))
        indentation = np.concatenate([batch.indentation_m for batch in done])
        codes = np.ceil(indentation * np.float32(DEEPEST / geometry.max_depth_m))  # keeps every pixel in contact
        return np.concatenate([batch.images for batch in done]), np.minimum(codes, DEEPEST).astype(np.uint16)

    def render(work: Workspace) -> None:
        with (progress or Progress()).task("pressing the calibration boards", count) as advance:
            for number, size in enumerate(_split_shards(count)):
                names = [name.format(number) for name in PIECES]
                if any(work.load(name) is None for name in names):
                    images, codes = shard(number, size)
                    work.save_array(names[0], images)
                    work.save_array(names[1], codes)
                advance(size)

    artifact = store.build(key, render)
    shards = range(len(_split_shards(count)))
    images, codes = ([artifact.load_array(name.format(number)) for number in shards] for name in PIECES)
    return SimulatedPresses(geometry, untouched, images, codes, key)


def _split_shards(count: int) -> list[int]:
    return [min(SHARD, count - start) for start in range(0, count, SHARD)]


def find_sensor(sensor: str, lamps: str | None = None) -> tuple[SensorGeometry, Optics]:
    """Return the geometry of a sensor, given its name or its file (.toml), and the optics named `lamps`.

    By default, the optics are those of the sensor, or generic optics for a sensor file. Raises ConfigError for unknown
    `lamps`, SensorError for a sensor file that cannot be read, and CalibrationError for another sensor that cannot be
    simulated.
    """
    chosen = find_optics(lamps) if lamps else choose_optics(sensor)
    if sensor.endswith(".toml"):
        return read_sensor_file(Path(sensor)), chosen
    if sensor not in OPTICS:
        raise CalibrationError(
            f"no images can be simulated for the sensor {sensor!r}; choose {', '.join(OPTICS)}, or give a "
            "sensor file (.toml)"
        )
    geometry: SensorGeometry = registry().create("sensor", sensor, {}).geometry
    return geometry, chosen


def find_camera_px(sensor: str) -> list[int] | None:
    """Return the size (rows, columns) of the images that a named sensor's camera takes, or None for a sensor file."""
    return list(registry().create("sensor", sensor, {}).native.shape) if sensor in OPTICS else None


def calibrate_simulated(
    geometry: SensorGeometry,
    lamps: Optics,
    count: int | None,
    recipe: EstimatorRecipe,
    store: StageStore,
    progress: Progress | None = None,
) -> tuple[SimulatedPresses, GelEstimator, dict[str, Any]]:
    """Calibrate on `count` presses of the simulated boards, or load the stored result.

    The default number of presses is in PRESSES. Return the presses, the estimator, and a record of the estimator's
    errors and the optics, as JSON values. Raises ConfigError for wrong options, CalibrationError for too few presses,
    and TrainingError when the training fails.
    """
    recipe.make_estimator(geometry, render_background(geometry, lamps))  # reports wrong options before rendering
    watcher = progress or Progress()
    presses = simulate_presses(geometry, lamps, count or PRESSES[recipe.estimator], recipe.seed, store, watcher)
    problem = CalibrationProblem(geometry, presses.background, presses, watcher)
    made, record = learn_stage(problem, recipe, {"presses": presses.key.digest}, store)
    return presses, made, {**record, "simulated": {"optics": lamps.describe(), "variation": VARIATION}}
