"""Whether an image is what the calibrated sensor would see: the figure that a worn gel or a moved lamp raises.

Two things are looked at. Where the gel is untouched it looks as it did: the light. And slopes are those of a surface,
whose differences around any loop add up to nothing; slopes that are read from colours of other lamps are not.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tactile_loc.calibration.labels import Float32, Image
from tactile_loc.calibration.surface import differentiate, integrate
from tactile_loc.core.errors import TouchError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

logger = logging.getLogger(__name__)

SMOOTHING_PX = 2.0  # of the difference from the untouched gel: the camera's noise is no change of the light
QUIETEST = 0.3  # of the image, in which a change is one of the light
STEEP = 0.1  # of slopes: flatter ones are noise to a good part, of which nothing can be told
FEWEST_STEEP = 0.01  # of the image
LEAST_LIGHT, LEAST_UNFIT = 3.0, 0.1  # counts, and a share: what calibration presses have, at least
WARNED, REFUSED = 1.5, 2.5  # times the worst of the calibration's presses


@dataclass(frozen=True)
class Health:
    """What an image (H, W, 3) shows of its sensor.

    `light` is by how much all but three tenths of the image differs from the untouched gel, counts: the lamps light
    all of it, while a large contact leaves that much untouched; `unfit` which share
    of the steep slopes is no surface's (root of the share of squares), NaN when too little is steep to tell.
    """

    light: float
    unfit: float

    def compare(self, usual: Health) -> float:
        """Return how many times as far off this is as the calibration's worst press, `usual`; the worse of both."""
        return float(np.fmax(self._compare_light(usual), self.unfit / np.fmax(usual.unfit, LEAST_UNFIT)))

    def _compare_light(self, usual: Health) -> float:
        return self.light / max(usual.light, LEAST_LIGHT)

    def explain(self, usual: Health) -> str:
        """Return which of both is the worse, in words."""
        return "the light has changed" if self._compare_light(usual) >= self.compare(usual) else "no surface looks so"

    def record(self) -> dict[str, float | None]:
        """Return it as JSON values."""
        return {name: value if np.isfinite(value) else None for name, value in asdict(self).items()}

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> Health:
        """Read what `record` returned."""
        return cls(*(np.nan if record[name] is None else float(record[name]) for name in ("light", "unfit")))


def measure_health(image: Image, untouched: Image, slopes: Float32 | None, geometry: SensorGeometry) -> Health:
    """Return the health of an image (H, W, 3), of whose gel `slopes` (H, W, 2) were read, if any were."""
    from scipy.ndimage import gaussian_filter

    difference = np.moveaxis(image.astype(np.float32) - untouched, -1, 0)
    smooth = np.stack([gaussian_filter(plane, SMOOTHING_PX) for plane in difference])
    light = float(np.quantile(np.abs(smooth).max(axis=0)[::2, ::2], QUIETEST))
    return Health(light, np.nan if slopes is None else _measure_unfit(slopes, geometry))


def _measure_unfit(slopes: Float32, geometry: SensorGeometry) -> float:
    """The share of the steep slopes (H, W, 2) that the nearest surface does not have."""
    steep = np.hypot(slopes[..., 0], slopes[..., 1]) > STEEP
    if np.count_nonzero(steep) < FEWEST_STEEP * steep.size:
        return float(np.nan)
    off = differentiate(integrate(slopes, geometry), geometry)[steep] - slopes[steep]
    return float(np.sqrt(np.sum(off**2) / np.sum(slopes[steep] ** 2, dtype=float)))


def find_worst(presses: Iterable[Health]) -> Health:
    """Return the worst of each of several presses."""
    lights, unfits = zip(*((one.light, one.unfit) for one in presses), strict=True)
    known = [value for value in unfits if np.isfinite(value)]
    return Health(max(lights), max(known, default=float(np.nan)))


def require_healthy(found: Health, usual: Health) -> None:
    """Warn of an image that is farther off than any of the calibration's presses, and refuse one that is much farther.

    Raises TouchError.
    """
    figure = found.compare(usual)
    if figure <= WARNED:
        return
    said = (
        f"{figure:.1f} times as far off as the calibration's worst press ({found.explain(usual)}): a worn gel, a moved "
        "lamp, or another sensor? Give a new image of the untouched gel (--zero), or calibrate again"
    )
    if figure > REFUSED:
        raise TouchError(f"the image is not what this sensor sees, {said}")
    logger.warning("the image is %s", said)
