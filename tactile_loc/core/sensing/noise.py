"""A seeded model of the imperfections of real touches. Each part can be switched off.

The parts are applied in this order. The sensor's calibrated pose has an error. The press is measured with an error. The
elastomer rounds edges off. The edge of the contact and the measured depth inside it vary randomly. Patches of contact
are missed (bubbles, dirt, a lifted border), and false contacts appear (wear, markers, reflections). All sizes are
metres on the sensing surface, so the noise does not depend on the number of pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Poses, make_transform, vector_to_rotation
from tactile_loc.core.runtime.errors import ConfigError, advise_choice
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Index = NDArray[np.intp]

FAINTEST = 0.2  # least value of the varying threshold, as a share of its mean
SHALLOWEST = 0.1  # least measured press depth, as a share of the true press depth
REACH = 4.0  # number of standard deviations at which a Gaussian is cut off


class Centres(NamedTuple):
    """P points in a batch of images: the number of each point's image, and the point's x and y, metres; each (P,)."""

    image: Index
    x_m: Floats
    y_m: Floats


@dataclass(frozen=True, eq=False)
class GelPixels:
    """The pixels on the sensing rectangle: their `rows` and `columns` in the image, and their centres.

    `x_m` (W,) and `y_m` (H,) are the centres on the undeformed surface. `pitch_m` are the pixel's sizes along x and y.
    `rectangle_m` is the sensing rectangle.
    """

    rows: slice
    columns: slice
    x_m: Floats
    y_m: Floats
    pitch_m: tuple[float, float]
    rectangle_m: tuple[float, float, float, float]

    @classmethod
    def of(cls, geometry: SensorGeometry) -> GelPixels:
        """Return the gel's pixels: those that see the undeformed surface inside the sensing rectangle."""
        sx, sy = geometry.scale_at_surface
        x = (np.arange(geometry.width_px, dtype=np.float64) + 0.5 - geometry.cx) / sx
        y = (np.arange(geometry.height_px, dtype=np.float64) + 0.5 - geometry.cy) / sy
        x0, x1, y0, y1 = geometry.rectangle
        columns = slice(*np.searchsorted(x, [x0, np.nextafter(x1, np.inf)]).tolist())
        rows = slice(*np.searchsorted(y, [y0, np.nextafter(y1, np.inf)]).tolist())
        return cls(rows, columns, x[columns], y[rows], (1 / sx, 1 / sy), geometry.rectangle)

    def blur(self, images: Float32, sigma_m: float) -> Float32:
        """Blur images (N, H, W) with a Gaussian of `sigma_m` metres. Beyond the rectangle, border values continue.

        Pixels are treated as squares. A step between two pixels therefore becomes exactly the Gaussian's error function
        at any pixel size.
        """
        x, y = (
            _make_blur_weights(len(a), sigma_m / p) for a, p in zip((self.x_m, self.y_m), self.pitch_m, strict=True)
        )
        return np.asarray(y @ (images @ x.T))

    def draw_field(self, count: int, patch_m: float, rng: np.random.Generator) -> Float32:
        """Draw smooth random images (count, H, W) with mean 0 and variance 1 everywhere, unitless.

        White noise on a lattice with a pitch of `patch_m` metres is blurred with a Gaussian whose standard deviation is
        also `patch_m`. The lattice is fixed to the surface, so one seed gives the same field at any image size.
        """
        x0, x1, y0, y1 = self.rectangle_m
        x, y = _make_field_weights(self.x_m, x0, x1, patch_m), _make_field_weights(self.y_m, y0, y1, patch_m)
        white = rng.standard_normal((count, y.shape[1], x.shape[1]), dtype=np.float32)
        return np.asarray(y @ (white @ x.T))

    def mark_border(self, width_m: Floats, rng: np.random.Generator) -> Bools:
        """Return a mask (N, H, W) of strips with widths (N,), metres, each along one random side of the rectangle."""
        x0, x1, y0, y1 = self.rectangle_m
        side = rng.integers(4, size=len(width_m))
        left, right, top, bottom = (np.where(side == k, width_m, -np.inf)[:, None] for k in range(4))
        columns = (self.x_m - x0 < left) | (x1 - self.x_m < right)
        rows = (self.y_m - y0 < top) | (y1 - self.y_m < bottom)
        return columns[:, None, :] | rows[:, :, None]

    def draw_points(self, counts: Index, rng: np.random.Generator) -> Centres:
        """Draw `counts` (N,) points for the N images, uniformly on the rectangle."""
        x0, x1, y0, y1 = self.rectangle_m
        image = np.repeat(np.arange(len(counts)), counts)
        return Centres(image, rng.uniform(x0, x1, len(image)), rng.uniform(y0, y1, len(image)))

    def draw_pixels(self, marked: Bools, counts: Index, rng: np.random.Generator) -> Centres:
        """Draw `counts` (N,) of the `marked` (N, H, W) pixels of N images, with replacement.

        For an image without marked pixels, no pixel is drawn.
        """
        held = np.count_nonzero(marked, axis=(1, 2))
        image = np.repeat(np.arange(len(counts)), np.where(held > 0, counts, 0))
        nth = (np.cumsum(held) - held)[image] + (rng.random(len(image)) * held[image]).astype(np.intp)
        image, row, column = np.unravel_index(np.flatnonzero(marked)[nth], marked.shape)
        return Centres(image, self.x_m[column], self.y_m[row])


def stamp(
    depth: Float32,
    gel: GelPixels,
    centres: Centres,
    radius_m: Floats,
    value_m: NDArray[np.floating[Any]],
    combine: Callable[..., Any],
) -> None:
    """Write discs with radii (P,), metres, about `centres` into depths (N, H, W).

    The ufunc `combine` computes the new depth from the old depth and the disc's `value_m` (P,).
    """
    left, right = (np.searchsorted(gel.x_m, centres.x_m + sign * radius_m) for sign in (-1, 1))
    top, bottom = (np.searchsorted(gel.y_m, centres.y_m + sign * radius_m) for sign in (-1, 1))
    for i, image in enumerate(centres.image):
        rows, columns = slice(top[i], bottom[i]), slice(left[i], right[i])
        dx, dy = gel.x_m[columns] - centres.x_m[i], gel.y_m[rows] - centres.y_m[i]
        inside = (dy * dy)[:, None] + dx * dx < radius_m[i] ** 2
        block = depth[image, rows, columns]
        combine(block, np.float32(value_m[i]), out=block, where=inside)


@lru_cache(maxsize=64)
def _make_blur_weights(count: int, sigma_px: float) -> Float32:
    """Return weights (count, count): the share of the Gaussian about pixel i's centre that lies on pixel j.

    The outer pixels continue beyond the border. The Gaussian is cut off at `REACH` standard deviations, so that a
    blurred imprint has an end.
    """
    from scipy.special import ndtr

    centre = np.arange(count) + 0.5
    edge = np.concatenate([[-np.inf], np.arange(1.0, count), [np.inf]])
    z = (edge[None] - centre[:, None]) / sigma_px
    share = np.where(z < -REACH, 0.0, np.where(z > REACH, 1.0, ndtr(z)))
    weights: Float32 = np.diff(share, axis=1).astype(np.float32)
    weights.flags.writeable = False  # cached for all touches
    return weights


def _make_field_weights(pixels_m: Floats, low_m: float, high_m: float, patch_m: float) -> Float32:
    """Return weights (W, K) of the K lattice points at each pixel. Their squares sum to one, so the variance is 1."""
    margin = int(REACH)
    lattice_m = low_m + patch_m * np.arange(-margin, np.ceil((high_m - low_m) / patch_m) + margin + 1)
    z = (pixels_m[:, None] - lattice_m) / patch_m
    weights = np.where(np.abs(z) < REACH, np.exp(-0.5 * z**2), 0.0)  # denormal numbers would be slow
    return np.asarray((weights / np.linalg.norm(weights, axis=1, keepdims=True)).astype(np.float32))


@dataclass(frozen=True)
class TouchNoise:
    """The strength of each imperfection. Lengths are in metres, angles in radians. Zeros switch a part off.

    - The press depth is drawn uniformly from the range `press_share` (least, most), as a share of the maximal depth.
      Its measurement has a relative error with the standard deviation `press_error`.
    - The elastomer smooths the imprint, like a Gaussian with the standard deviation `smoothing_m`.
    - The sensor does not see an imprint shallower than `least_m`. This threshold varies with the standard deviation
      `edge_m` over patches of `edge_patch_m`, but never falls below `FAINTEST` times `least_m`.
    - The measured depth varies with the standard deviation `drift_m` over patches of `drift_patch_m`. This does not
      remove any contact.
    - `missing` and `spurious` are the mean numbers of round patches that lose or gain contact, with radii up to
      `patch_m`.
    - Contact is lost in a strip, up to `border_m` wide, along a random side of the sensing rectangle.
    - The calibrated pose of the sensor has errors with the standard deviations `sensor_m` along and `sensor_rad` about
      each axis.

    Raises ConfigError for impossible values.
    """

    press_share: tuple[float, float] = (1.0, 1.0)
    press_error: float = 0.0
    smoothing_m: float = 0.0
    least_m: float = 0.0
    edge_m: float = 0.0
    edge_patch_m: float = 1e-3
    drift_m: float = 0.0
    drift_patch_m: float = 5e-3
    missing: float = 0.0
    spurious: float = 0.0
    patch_m: float = 2e-3
    border_m: float = 0.0
    sensor_m: float = 0.0
    sensor_rad: float = 0.0

    def __post_init__(self) -> None:
        least, most = self.press_share
        if not 0 < least <= most <= 1:
            raise ConfigError(f"the noise's press_share is {least:g} to {most:g}; give 0 < least <= most <= 1")
        for name, value in asdict(self).items():
            if name != "press_share" and not (math.isfinite(value) and value >= 0):
                raise ConfigError(f"the noise's {name} is {value}; give 0 or a positive number")
        for name in ("edge_patch_m", "drift_patch_m"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"the noise's {name} is 0; give a positive number")

    def describe(self) -> dict[str, object]:
        """Return the settings, which identify the noise, as JSON values."""
        return {**asdict(self), "press_share": list(self.press_share)}

    @property
    def misplaces(self) -> bool:
        """True if the sensor's pose has an error."""
        return self.sensor_m > 0 or self.sensor_rad > 0

    def draw_press(self, count: int, max_depth_m: float, rng: np.random.Generator) -> Floats:
        """Draw press depths (count,), metres."""
        return rng.uniform(*self.press_share, count) * max_depth_m

    def measure_press(self, press_depth_m: Floats, max_depth_m: float, rng: np.random.Generator) -> Floats:
        """Return measured press depths (N,) for true press depths (N,), metres, with `press_error`."""
        factor = 1.0 + self.press_error * rng.normal(size=len(press_depth_m))
        return np.minimum(press_depth_m * np.maximum(factor, SHALLOWEST), max_depth_m)

    def misplace(self, T_sensor_object: Poses, geometry: SensorGeometry, rng: np.random.Generator) -> Poses:
        """Return the real poses (N, 4, 4), metres, for the poses (N, 4, 4) that a sensor with a pose error reports.

        The error rotates the sensor about the centre of its sensing rectangle. It therefore does not depend on the
        object frame or the standoff. The returned poses are not brought to contact.
        """
        if not self.misplaces:
            return T_sensor_object.copy()
        count = len(T_sensor_object)
        R = vector_to_rotation(self.sensor_rad * rng.normal(size=(count, 3)))
        shift = self.sensor_m * rng.normal(size=(count, 3))
        x0, x1, y0, y1 = geometry.rectangle
        centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, geometry.standoff_m])
        lever = (T_sensor_object[:, :3, 3] - centre)[..., None]
        return make_transform(R @ T_sensor_object[:, :3, :3], (R @ lever)[..., 0] + centre + shift)

    def corrupt(
        self, depth_m: Float32, press_depth_m: Floats, geometry: SensorGeometry, rng: np.random.Generator
    ) -> Float32:
        """Return noisy contact depths (N, H, W), float32, metres, for clean contact depths at the maximal depth.

        The noisy depths are cut at the press depths (N,), metres. A pixel without contact has exactly the press depth.
        Pixels outside the sensing rectangle get no noise, because there is no elastomer.
        """
        press = np.asarray(press_depth_m, np.float32)[:, None, None]
        noisy = np.minimum(np.asarray(depth_m, np.float32), press)
        gel = GelPixels.of(geometry)
        depth = noisy[:, gel.rows, gel.columns]  # a view of `noisy`, so that writing to it changes `noisy`
        if self.smoothing_m > 0:
            depth[...] = np.maximum(press - gel.blur(press - depth, self.smoothing_m), 0.0)
        if self.least_m > 0 or self.edge_m > 0:
            least = np.float32(self.least_m)
            if self.edge_m > 0:
                varying = least + np.float32(self.edge_m) * gel.draw_field(len(depth), self.edge_patch_m, rng)
                least = np.maximum(varying, np.float32(FAINTEST) * least)
            np.copyto(depth, press, where=press - depth <= least)
        if self.drift_m > 0:
            drifted = depth + np.float32(self.drift_m) * gel.draw_field(len(depth), self.drift_patch_m, rng)
            np.copyto(depth, np.clip(drifted, 0, np.nextafter(press, np.float32(0))), where=depth < press)
        self._add_patches(depth, press, gel, rng)
        if self.border_m > 0:
            np.copyto(depth, press, where=gel.mark_border(self.border_m * rng.random(len(depth)), rng))
        return noisy

    def cut(self, depth_m: Float32, press_depth_m: Floats, measured_m: Floats) -> Float32:
        """Return the contact depths (N, H, W) that a sensor reports if it measures the press depths as `measured_m`.

        All values are in metres. `depth_m` (N, H, W) are noisy contact depths at the true press depths (N,). If a press
        is measured too light, the rim of its contact is lost. If it is measured too deep, no contact is gained. A pixel
        without contact gets the measured press depth.
        """
        press, measured = (np.asarray(p, np.float32)[:, None, None] for p in (press_depth_m, measured_m))
        return np.where(depth_m < np.minimum(press, measured), depth_m, measured)

    def _add_patches(self, depth: Float32, press: Float32, gel: GelPixels, rng: np.random.Generator) -> None:
        """Remove round patches of contact from depths (N, H, W), cut at `press` (N, 1, 1), metres; add false ones."""
        if self.missing > 0:
            centres = gel.draw_pixels(depth < press, rng.poisson(self.missing, len(depth)), rng)
            radius = self.patch_m * rng.uniform(0.3, 1.0, len(centres.image))
            stamp(depth, gel, centres, radius, press[centres.image, 0, 0], np.maximum)
        if self.spurious > 0:
            centres = gel.draw_points(rng.poisson(self.spurious, len(depth)), rng)
            radius = self.patch_m * rng.uniform(0.2, 0.7, len(centres.image))
            imprint = rng.uniform(0.1, 0.5, len(centres.image))
            stamp(depth, gel, centres, radius, press[centres.image, 0, 0] * (1 - imprint), np.minimum)


NoiseLevel = Literal["none", "mild", "strong"]
NOISE: dict[str, TouchNoise] = {
    "none": TouchNoise(),
    "mild": TouchNoise(
        press_share=(0.75, 1.0),
        press_error=0.03,
        smoothing_m=1.5e-4,
        least_m=5e-5,
        edge_m=5e-5,
        drift_m=3e-5,
        missing=0.5,
        spurious=0.2,
        patch_m=1.5e-3,
        border_m=5e-4,
        sensor_m=1e-4,
        sensor_rad=math.radians(0.3),
    ),
    "strong": TouchNoise(
        press_share=(0.5, 1.0),
        press_error=0.08,
        smoothing_m=3e-4,
        least_m=5e-5,
        edge_m=1.5e-4,
        drift_m=1e-4,
        missing=2.0,
        spurious=1.0,
        patch_m=2.5e-3,
        border_m=2e-3,
        sensor_m=3e-4,
        sensor_rad=math.radians(1.0),
    ),
}


def make_noise(name: str) -> TouchNoise:
    """Return the noise called none, mild or strong. Raises ConfigError for another name."""
    if name not in NOISE:
        raise ConfigError(f"there is no noise {name!r}; {advise_choice(name, NOISE)}")
    return NOISE[name]
