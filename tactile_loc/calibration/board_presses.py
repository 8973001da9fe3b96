"""Presses of the two calibration boards, simulated: what an estimator learns from without a robot or a ball.

As many as in Bauza et al. (CoRL 2020, appendix), half of them of each board.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.calibration.estimator import Image, LabelledPresses
from tactile_loc.calibration.labels import PressLabel, surface_label
from tactile_loc.core.progress import Progress
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import SensorGeometry
from tactile_loc.imaging.gel import SOFTNESS_M
from tactile_loc.imaging.optics import Optics
from tactile_loc.imaging.shading import background
from tactile_loc.imaging.simulate import board_presses
from tactile_loc.store.keys import StageKey
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

STAGE_VERSION = 3
SHARD = 64  # presses rendered, saved and resumed at once, under lamps of their own
DEEPEST = 65535  # indentations are 16-bit shares of the sensor's deepest press
VARIATION = 0.25  # of the lamps, of what one make's specimens differ by


@dataclass(frozen=True, eq=False)
class SimulatedPresses(LabelledPresses):
    """Presses of the boards on a sensor, SHARD in each of `images` (S, H, W, 3) and `codes` (S, H, W), but the last.

    `background` (H, W, 3) is the untouched gel that all of them change, `key` identifies the whole.
    """

    geometry: SensorGeometry
    background: Image
    images: Sequence[NDArray[np.uint8]]
    codes: Sequence[NDArray[np.uint16]]
    key: StageKey

    def __len__(self) -> int:
        """Return the number of presses."""
        return sum(len(shard) for shard in self.images)

    def press(self, number: int) -> tuple[Image, PressLabel]:
        """Return an image (H, W, 3) and its label, the indentation of what touches: press - depth, metres."""
        shard, place = divmod(number, SHARD)
        indentation = self.codes[shard][place] * np.float32(self.geometry.max_depth_m / DEEPEST)
        label = surface_label(indentation, indentation > 0, self.geometry)
        return np.array(self.images[shard][place]), label

    def name(self, number: int) -> str:
        """Return what people know a press by."""
        return f"simulated press {number}"


def simulated_presses(
    geometry: SensorGeometry, optics: Optics, count: int, seed: int, store: StageStore,
    progress: Progress | None = None, variation: float = VARIATION,
) -> SimulatedPresses:  # fmt: skip
    """Press the boards `count` times on a sensor, or fetch from the store what was pressed with the same `seed`.

    `variation` (unitless) is how far the lamps of each SHARD of presses are from `optics`, see `Optics.varied`; the
    untouched gel is that of `optics` in all of them. Raises TouchError when the boards leave no imprint on the sensor.
    """
    renderer = registry().create("renderer", "heightmap", {})
    untouched = background(geometry, optics)
    key = StageKey("board-presses", STAGE_VERSION, {
        "geometry": geometry.describe(), "optics": optics.describe(), "variation": variation, "count": count,
        "seed": seed, "softness_m": SOFTNESS_M, "renderer": renderer.describe(), "shard": SHARD,
    })  # fmt: skip

    def shard(number: int, size: int) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        rng = np.random.default_rng([seed, number])
        lamps = optics.varied(rng, variation)
        done = list(board_presses(geometry, size, lamps, rng, renderer, background=untouched))
        indentation = np.concatenate([batch.indentation_m for batch in done])
        codes = np.ceil(indentation * np.float32(DEEPEST / geometry.max_depth_m))  # no contact is rounded away
        return np.concatenate([batch.images for batch in done]), np.minimum(codes, DEEPEST).astype(np.uint16)

    def render(work: Workspace) -> None:
        with (progress or Progress()).task("pressing the calibration boards", count) as advance:
            for number, size in enumerate(_sizes(count)):
                if work.load(_images(number)) is None or work.load(_codes(number)) is None:
                    images, codes = shard(number, size)
                    work.save_array(_images(number), images)
                    work.save_array(_codes(number), codes)
                advance(size)

    artifact = store.build(key, render)
    images, codes = ([artifact.array(name(n)) for n in range(len(_sizes(count)))] for name in (_images, _codes))
    return SimulatedPresses(geometry, untouched, images, codes, key)


def _sizes(count: int) -> list[int]:
    return [min(SHARD, count - start) for start in range(0, count, SHARD)]


def _images(number: int) -> str:
    return f"images-{number:04d}"


def _codes(number: int) -> str:
    return f"indentation-{number:04d}"
