"""A seeded model of the imperfections of real touches, in separable parts.

The parts, in order: the sensor's calibrated pose has an error. The press is measured with an error. The elastomer
rounds edges off. The contact's edge and the measured depth inside it vary randomly. Patches of contact are missed
(bubbles, dirt, a lifted border), and others appear (wear, markers, reflections). All sizes are metres on the sensing
surface, so the noise does not depend on the number of pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError, advise_choice
from tactile_loc.core.geometry.rigid import Poses, make_transform
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Index = NDArray[np.intp]

FAINTEST = 0.2  # least value of the varying threshold, as a share of its mean
SHALLOWEST = 0.1  # least measured press, as a share of the true one
REACH = 4.0  # standard deviations at which a Gaussian is cut off


class Centres(NamedTuple):
    """Points (P,) in a batch of images: the image of each, and its place there, x and y in metres."""

    image: Index
    x_m: Float64
    y_m: Float64


@dataclass(frozen=True, eq=False)
class Gel:
    """The pixels on the sensing rectangle: their `rows` and `columns` in the image, and their centres.

    `x_m` (W,) and `y_m` (H,) are on the undeformed surface, `pitch_m` is the pixel pitch, `rectangle_m` the rectangle.
    """

    rows: slice
    columns: slice
    x_m: Float64
    y_m: Float64
    pitch_m: tuple[float, float]
    rectangle_m: tuple[float, float, float, float]

    @classmethod
    def of(cls, geometry: SensorGeometry) -> Gel:
        """Find the pixels whose view of the undeformed surface lies on the sensing rectangle."""
        sx, sy = geometry.scale_at_surface
        x = (np.arange(geometry.width_px, dtype=np.float64) + 0.5 - geometry.cx) / sx
        y = (np.arange(geometry.height_px, dtype=np.float64) + 0.5 - geometry.cy) / sy
        x0, x1, y0, y1 = geometry.rectangle
        columns = slice(*np.searchsorted(x, [x0, np.nextafter(x1, np.inf)]).tolist())
        rows = slice(*np.searchsorted(y, [y0, np.nextafter(y1, np.inf)]).tolist())
        return cls(rows, columns, x[columns], y[rows], (1 / sx, 1 / sy), geometry.rectangle)

    def blur(self, images: Float32, sigma_m: float) -> Float32:
        """Blur images (N, H, W) with a Gaussian of `sigma_m` metres; beyond the rectangle, their border continues.

        Pixels are squares: a step between two of them becomes exactly the Gaussian's error function, at any pixel size.
        """
        x, y = (
            _make_blur_weights(len(a), sigma_m / p) for a, p in zip((self.x_m, self.y_m), self.pitch_m, strict=True)
        )
        return _transform_images(images, y, x)

    def draw_field(self, count: int, patch_m: float, rng: np.random.Generator) -> Float32:
        """Draw smooth random images (count, H, W) with mean 0 and variance 1 everywhere, unitless.

        White noise on a lattice of `patch_m` metres is blurred with a Gaussian of that standard deviation. The lattice
        belongs to the surface, so one seed gives one field at any image size.
        """
        x0, x1, y0, y1 = self.rectangle_m
        x, y = _make_field_weights(self.x_m, x0, x1, patch_m), _make_field_weights(self.y_m, y0, y1, patch_m)
        white = rng.standard_normal((count, y.shape[1], x.shape[1]), dtype=np.float32)
        return _transform_images(white, y, x)

    def mark_border(self, width_m: Float64, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Mark (N, H, W) a strip along one random side of each image's rectangle, with widths (N,) in metres."""
        x0, x1, y0, y1 = self.rectangle_m
        side = rng.integers(4, size=len(width_m))
        left, right, top, bottom = (np.where(side == k, width_m, -np.inf)[:, None] for k in range(4))
        columns = (self.x_m - x0 < left) | (x1 - self.x_m < right)
        rows = (self.y_m - y0 < top) | (y1 - self.y_m < bottom)
        return columns[:, None, :] | rows[:, :, None]

    def draw_points(self, counts: Index, rng: np.random.Generator) -> Centres:
        """Draw a number (N,) of points for each image, uniformly on the rectangle."""
        x0, x1, y0, y1 = self.rectangle_m
        image = np.repeat(np.arange(len(counts)), counts)
        return Centres(image, rng.uniform(x0, x1, len(image)), rng.uniform(y0, y1, len(image)))

    def draw_pixels(self, marked: NDArray[np.bool_], counts: Index, rng: np.random.Generator) -> Centres:
        """Draw a number (N,) of the marked (N, H, W) pixels of each image, with replacement; none if none is marked."""
        held = np.count_nonzero(marked, axis=(1, 2))
        image = np.repeat(np.arange(len(counts)), np.where(held > 0, counts, 0))
        nth = (np.cumsum(held) - held)[image] + (rng.random(len(image)) * held[image]).astype(np.intp)
        image, row, column = np.unravel_index(np.flatnonzero(marked)[nth], marked.shape)
        return Centres(image, self.x_m[column], self.y_m[row])


def stamp(
    depth: Float32,
    gel: Gel,
    centres: Centres,
    radius_m: Float64,
    value_m: NDArray[np.floating[Any]],
    combine: Callable[..., Any],
) -> None:
    """Write discs of radii (P,), m, about `centres` into depths (N, H, W): `combine` is a ufunc of old and new."""
    left, right = _find_interval(gel.x_m, centres.x_m, radius_m)
    top, bottom = _find_interval(gel.y_m, centres.y_m, radius_m)
    for i, image in enumerate(centres.image):
        rows, columns = slice(top[i], bottom[i]), slice(left[i], right[i])
        dx, dy = gel.x_m[columns] - centres.x_m[i], gel.y_m[rows] - centres.y_m[i]
        inside = (dy * dy)[:, None] + dx * dx < radius_m[i] ** 2
        block = depth[image, rows, columns]
        combine(block, np.float32(value_m[i]), out=block, where=inside)


def _find_interval(pixels_m: Float64, centre_m: Float64, radius_m: Float64) -> tuple[Index, Index]:
    """Return the slice bounds of the sorted pixels (W,) within radii (P,) of centres (P,), metres."""
    return np.searchsorted(pixels_m, centre_m - radius_m), np.searchsorted(pixels_m, centre_m + radius_m)


def _transform_images(images: Float32, rows: Float32, columns: Float32) -> Float32:
    """Apply matrices (H, h) to the rows and (W, w) to the columns of images (N, h, w): (N, H, W)."""
    return np.asarray(rows @ (images @ columns.T))


@lru_cache(maxsize=64)
def _make_blur_weights(count: int, sigma_px: float) -> Float32:
    """Return weights (count, count) of pixel j's area in the Gaussian about pixel i's centre; outer pixels continue.

    The Gaussian is cut off at `REACH`, so that an imprint has an end.
    """
    from scipy.special import ndtr

    centre = np.arange(count) + 0.5
    edge = np.concatenate([[-np.inf], np.arange(1.0, count), [np.inf]])
    z = (edge[None] - centre[:, None]) / sigma_px
    share = np.where(z < -REACH, 0.0, np.where(z > REACH, 1.0, ndtr(z)))
    weights: Float32 = np.diff(share, axis=1).astype(np.float32)
    weights.flags.writeable = False  # cached for all touches
    return weights


def _make_field_weights(pixels_m: Float64, low_m: float, high_m: float, patch_m: float) -> Float32:
    """Return weights (W, K) of the lattice's K points at each pixel; their squares sum to one, for variance 1."""
    margin = int(REACH)
    lattice_m = low_m + patch_m * np.arange(-margin, np.ceil((high_m - low_m) / patch_m) + margin + 1)
    z = (pixels_m[:, None] - lattice_m) / patch_m
    weights = np.where(np.abs(z) < REACH, np.exp(-0.5 * z**2), 0.0)  # denormal numbers would be slow
    return np.asarray((weights / np.linalg.norm(weights, axis=1, keepdims=True)).astype(np.float32))


@dataclass(frozen=True)
class TouchNoise:
    """The strength of each imperfection. Lengths in metres, angles in radians; zeros switch a part off.

    `press_share` (least, most) of the sensor's deepest press is drawn uniformly, and measured with a relative error of
    standard deviation `press_error`. `smoothing_m` is the elastomer's rounding: the standard deviation of a Gaussian on
    the imprint. An imprint shallower than `least_m` is not seen. This threshold varies with standard deviation `edge_m`
    over patches of `edge_patch_m`, but never falls below `FAINTEST` of `least_m`. The measured depth varies with
    standard deviation `drift_m` over patches of `drift_patch_m`, without losing contact. `missing` and `spurious` are
    mean numbers of round patches with radii up to `patch_m`. Contact is lost in a strip, up to `border_m` wide, along a
    random side of the sensing rectangle. `sensor_m`, `sensor_rad` are standard deviations of the sensor pose's
    calibration error, along and about each axis. Raises ConfigError for impossible values.
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
        """Whether the sensor's pose has an error."""
        return self.sensor_m > 0 or self.sensor_rad > 0

    def draw_press(self, count: int, max_depth_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw press depths (count,) in metres."""
        return rng.uniform(*self.press_share, count) * max_depth_m

    def measure_press(
        self, press_depth_m: NDArray[np.float64], max_depth_m: float, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return the measured press depths for true ones (N,), metres: with `press_error`, within the range."""
        factor = 1.0 + self.press_error * rng.normal(size=len(press_depth_m))
        return np.minimum(press_depth_m * np.maximum(factor, SHALLOWEST), max_depth_m)

    def misplace(self, T_sensor_object: Poses, geometry: SensorGeometry, rng: np.random.Generator) -> Poses:
        """Return the real poses for poses (N, 4, 4), metres, of a sensor whose own pose has an error.

        The sensor is rotated about the centre of its sensing rectangle, independent of the object's frame and the
        standoff. The poses returned are not brought to contact.
        """
        from scipy.spatial.transform import Rotation

        if not self.misplaces:
            return T_sensor_object.copy()
        count = len(T_sensor_object)
        R = Rotation.from_rotvec(self.sensor_rad * rng.normal(size=(count, 3))).as_matrix()
        shift = self.sensor_m * rng.normal(size=(count, 3))
        x0, x1, y0, y1 = geometry.rectangle
        centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, geometry.standoff_m])
        lever = (T_sensor_object[:, :3, 3] - centre)[..., None]
        return make_transform(R @ T_sensor_object[:, :3, :3], (R @ lever)[..., 0] + centre + shift)

    def corrupt(
        self, depth_m: Float32, press_depth_m: NDArray[np.float64], geometry: SensorGeometry, rng: np.random.Generator
    ) -> Float32:
        """Return noisy contact depths (N, H, W) float32, metres, from clean ones at full press; press depths are (N,).

        No contact is exactly the press depth. Pixels off the sensing rectangle stay clean: there is no elastomer.
        """
        press = np.asarray(press_depth_m, np.float32)[:, None, None]
        noisy = np.minimum(np.asarray(depth_m, np.float32), press)
        gel = Gel.of(geometry)
        depth = noisy[:, gel.rows, gel.columns]  # a view
        if self.smoothing_m > 0:
            depth[...] = np.maximum(press - gel.blur(press - depth, self.smoothing_m), 0.0)
        if self.least_m > 0 or self.edge_m > 0:
            np.copyto(depth, press, where=press - depth <= self._draw_threshold(len(depth), gel, rng))
        if self.drift_m > 0:
            drifted = depth + np.float32(self.drift_m) * gel.draw_field(len(depth), self.drift_patch_m, rng)
            np.copyto(depth, np.clip(drifted, 0, np.nextafter(press, np.float32(0))), where=depth < press)
        self._add_patches(depth, press, gel, rng)
        if self.border_m > 0:
            np.copyto(depth, press, where=gel.mark_border(self.border_m * rng.random(len(depth)), rng))
        return noisy

    def cut(self, depth_m: Float32, press_depth_m: NDArray[np.float64], measured_m: NDArray[np.float64]) -> Float32:
        """Return the contact depths (N, H, W) that a sensor reports if it measures presses (N,) as `measured_m` (N,).

        `depth_m` (N, H, W) are the noisy ones at the true presses; all in metres. A press measured as lighter loses the
        rim of its contact. A press measured as deeper shows no additional contact. No contact is the measured press.
        """
        press, measured = (np.asarray(p, np.float32)[:, None, None] for p in (press_depth_m, measured_m))
        return np.where(depth_m < np.minimum(press, measured), depth_m, measured)

    def _draw_threshold(self, count: int, gel: Gel, rng: np.random.Generator) -> Float32 | np.float32:
        """Draw the threshold below which no imprint is seen, metres: one number, or (count, H, W) if it varies."""
        least = np.float32(self.least_m)
        if self.edge_m == 0:
            return least
        wander = gel.draw_field(count, self.edge_patch_m, rng)
        return np.maximum(least + np.float32(self.edge_m) * wander, np.float32(FAINTEST) * least)

    def _add_patches(self, depth: Float32, press: Float32, gel: Gel, rng: np.random.Generator) -> None:
        """Remove round patches of contact from depths (N, H, W) at presses (N, 1, 1), metres, and add spurious ones."""
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
        press_share=(0.75, 1.0), press_error=0.03, smoothing_m=1.5e-4, least_m=5e-5, edge_m=5e-5, drift_m=3e-5,
        missing=0.5, spurious=0.2, patch_m=1.5e-3, border_m=5e-4, sensor_m=1e-4, sensor_rad=math.radians(0.3),
    ),
    "strong": TouchNoise(
        press_share=(0.5, 1.0), press_error=0.08, smoothing_m=3e-4, least_m=5e-5, edge_m=1.5e-4, drift_m=1e-4,
        missing=2.0, spurious=1.0, patch_m=2.5e-3, border_m=2e-3, sensor_m=3e-4, sensor_rad=math.radians(1.0),
    ),
}  # fmt: skip


def make_noise(name: str) -> TouchNoise:
    """Return the noise called none, mild or strong. Raises ConfigError for another name."""
    if name not in NOISE:
        raise ConfigError(f"there is no noise {name!r}; {advise_choice(name, NOISE)}")
    return NOISE[name]
