"""Maps photos to images of equal scale: for a camera with a lens, a tilted view, or unequal scales of x and y.

A sensor's image shows a rectangle of the gel at the same scale everywhere. The rectangle's corners lie anywhere in the
camera's photo. Between them, the map is a homography, and then the distortion of the lens. Pixel coordinates begin at
the upper left corner of the upper left pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import SensorError, TouchError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

Array = NDArray[np.float64]
Corner = tuple[float, float]
Corners = tuple[Corner, Corner, Corner, Corner]

UNIT = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])  # the corners' order: clockwise from the upper left
FACTORS = 5  # largest number of distortion factors: k1, k2, p1, p2, k3
STEPS, START, SAME_PX = 20, 0.5, 0.01  # to undo a distortion: steps, first share of the offset, and largest error


@dataclass(frozen=True)
class Lens:
    """A pinhole camera with a distorting lens, as OpenCV describes it.

    `fx`, `fy`, `cx`, `cy` are the camera matrix, pixels, and `distortion` are k1, k2, p1, p2, k3 or the first of these.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def distort(self, ideal_px: Array) -> Array:
        """Return the places (N, 2) in the photo, pixels, of places (N, 2) in the photo of a lens without distortion."""
        k1, k2, p1, p2, k3 = (*self.distortion, *(0.0,) * (FACTORS - len(self.distortion)))
        x, y = ((ideal_px - [self.cx, self.cy]) / [self.fx, self.fy]).T
        r2 = x**2 + y**2
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        moved = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        return np.asarray(np.stack(moved, axis=1) * [self.fx, self.fy] + [self.cx, self.cy])

    def undistort(self, photo_px: Array) -> Array:
        """Undo `distort` by Newton's method. Raises SensorError if the lens shows no point at one of the places."""
        middle, steps = np.array([self.cx, self.cy]), 1e-3 * np.eye(2)
        ideal_px = middle + START * (photo_px - middle)  # from the middle, where the lens does not fold the view
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # it may diverge beyond what the lens shows
            for _ in range(STEPS):
                missed = photo_px - self.distort(ideal_px)
                (a, c), (b, d) = (((self.distort(ideal_px + s) - self.distort(ideal_px - s)) / 2e-3).T for s in steps)
                scaled = np.stack([d * missed[:, 0] - b * missed[:, 1], a * missed[:, 1] - c * missed[:, 0]], axis=1)
                area = a * d - b * c
                ideal_px = ideal_px + scaled / area[:, None]
            missed = photo_px - self.distort(ideal_px)
            mirrored = ((ideal_px - middle) * (photo_px - middle)).sum(axis=1) < 0
        if not ((np.abs(missed).max(axis=1) < SAME_PX) & (area > 0) & ~mirrored).all():
            raise SensorError("the lens shows no point at the photo's corners; check the camera matrix and distortion")
        return ideal_px


@dataclass(frozen=True)
class PhotoMap:
    """The map from a camera's photos of `photo_px` (width, height) to images of `image_px` (width, height), pixels.

    `corners_px` (x, y) are the places in the photo of the image's corners, clockwise from the upper left. Raises
    SensorError if the corners are no convex quadrilateral in this order.
    """

    photo_px: tuple[int, int]
    image_px: tuple[int, int]
    corners_px: Corners
    lens: Lens | None = None

    def __post_init__(self) -> None:
        corners = np.array(self.corners_px)
        sides = np.roll(corners, -1, axis=0) - corners
        after = np.roll(sides, -1, axis=0)
        if not (sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0] > 0).all():
            listed = ", ".join(f"({x:g}, {y:g})" for x, y in self.corners_px)
            raise SensorError(
                f"the corners {listed} are not in order; give the gel's corners in the photo clockwise: upper left, "
                "upper right, lower right, lower left"
            )

    @cached_property
    def _homography(self) -> Array:
        """The homography (3, 3) from shares of the image's sides to the photo of a lens without distortion."""
        corners = np.array(self.corners_px)
        return fit_homography(UNIT, corners if self.lens is None else self.lens.undistort(corners))

    def locate(self, image_px: Array) -> Array:
        """Return the places (N, 2) in the photo of places (N, 2) in the image, pixels."""
        ideal_px = apply_homography(self._homography, np.asarray(image_px, float) / self.image_px)
        return ideal_px if self.lens is None else self.lens.distort(ideal_px)

    def locate_in_image(self, photo_px: Array) -> Array:
        """Return the places (N, 2) in the image of places (N, 2) in the photo, pixels."""
        ideal_px = np.asarray(photo_px, float) if self.lens is None else self.lens.undistort(photo_px)
        return apply_homography(np.linalg.inv(self._homography), ideal_px) * self.image_px

    def move_circle(self, circle: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return a circle (x, y, radius) in the photo as one of the same area in the image, pixels."""
        x, y, radius = circle
        places = np.array([[x, y], [x + radius, y], [x - radius, y], [x, y + radius], [x, y - radius]])
        middle, right, left, low, high = self.locate_in_image(places)
        (a, b), (c, d) = (right - left) / 2, (low - high) / 2
        return float(middle[0]), float(middle[1]), float(np.sqrt(abs(a * d - b * c)))

    @cached_property
    def places_px(self) -> Array:
        """The places (H, W, 2) in the photo of the centres of the image's pixels, pixels."""
        x, y = np.meshgrid(*(np.arange(size) + 0.5 for size in self.image_px))
        return self.locate(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(*x.shape, 2)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Pixels (H, W) of the image that lie in the photo."""
        return np.asarray(((self.places_px >= 0) & (self.places_px <= self.photo_px)).all(axis=2))

    def hide_unseen(self, sensor: SensorGeometry) -> SensorGeometry:
        """Return a sensor with images of this map, whose pixels beyond the photo are not observed."""
        seen = self.seen if sensor.observed is None else self.seen & sensor.observed
        return sensor if seen.all() else replace(sensor, observed=seen)

    @cached_property
    def _weights(self) -> Any:
        """A sparse matrix (H W, h w) of the weights of the photo's pixels in each pixel of the image."""
        from scipy.sparse import csr_array

        (width, height), places = self.photo_px, self.places_px.reshape(-1, 2) - 0.5
        x, y = (np.clip(places[:, axis], 0, size - 1) for axis, size in enumerate(self.photo_px))
        left, top = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
        x, y, first = x - left, y - top, width * top + left
        columns = np.stack([first, first + 1, first + width, first + width + 1], axis=1)
        weights = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], axis=1).astype(np.float32)
        starts = np.arange(0, columns.size + 1, 4)
        return csr_array((weights.ravel(), columns.ravel(), starts), (len(first), width * height))

    def rectify(self, photo: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the image (H, W, C) of a photo (h, w, C); pixels beyond the photo continue its border.

        Raises TouchError for a photo of another size.
        """
        if photo.shape[1::-1] != self.photo_px:
            got, want = (f"{size[0]} x {size[1]}" for size in (photo.shape[1::-1], self.photo_px))
            raise TouchError(
                f"the photo is {got} px (width x height) but the sensor's photos are {want} px; give photos of the "
                "same camera, neither cropped nor resized"
            )
        values = self._weights @ photo.reshape(-1, photo.shape[2]).astype(np.float32)
        return np.asarray(values + np.float32(0.5)).astype(np.uint8).reshape(*self.image_px[::-1], -1)

    def record(self) -> dict[str, Any]:
        """Return the map as values of a sensor file: `size_px`, `corners_px`, and `camera`, `distortion` of a lens."""
        corners = {"size_px": list(self.photo_px), "corners_px": [list(corner) for corner in self.corners_px]}
        if self.lens is None:
            return corners
        camera = [self.lens.fx, self.lens.fy, self.lens.cx, self.lens.cy]
        return {**corners, "camera": camera, "distortion": list(self.lens.distortion)}

    @classmethod
    def of_record(cls, record: Mapping[str, Any], image_px: tuple[int, int]) -> PhotoMap:
        """Return the map to images of `image_px` (width, height) that `record` describes."""
        (width, height), camera = record["size_px"], record.get("camera")
        factors = tuple(float(factor) for factor in record.get("distortion", ()))
        lens = None
        if camera is not None:
            fx, fy, cx, cy = (float(one) for one in camera)
            lens = Lens(fx, fy, cx, cy, factors)
        return cls((int(width), int(height)), image_px, to_corners(np.array(record["corners_px"], float)), lens)


def frame_view(photo_px: tuple[int, int], homography: Array, lens: Lens | None) -> PhotoMap:
    """Return the map from photos of `photo_px` (width, height) to an image of the gel between the photo's sides.

    `homography` (3, 3) maps the image's pixels, from any origin, to the photo of a lens without distortion. The image
    ends at the middles of the photo's sides.
    """
    width, height = photo_px
    middles = np.array([[0, height / 2], [width, height / 2], [width / 2, 0], [width / 2, height]], float)
    ideal_px = middles if lens is None else lens.undistort(middles)
    (x0, _), (x1, _), (_, y0), (_, y1) = apply_homography(np.linalg.inv(homography), ideal_px)
    size = np.rint([x1 - x0, y1 - y0])
    corners = np.array([x0 + x1, y0 + y1]) / 2 + (UNIT - 0.5) * size
    ideal_px = apply_homography(homography, corners)
    return PhotoMap(photo_px, (int(size[0]), int(size[1])), to_corners(ideal_px, lens), lens)


def to_corners(ideal_px: Array, lens: Lens | None = None) -> Corners:
    """Return the corners of a map at places (4, 2), pixels, in the photo of a lens without distortion."""
    one, two, three, four = ((float(x), float(y)) for x, y in (ideal_px if lens is None else lens.distort(ideal_px)))
    return one, two, three, four


def even_scales(camera: SensorGeometry) -> tuple[SensorGeometry, PhotoMap]:
    """Return a camera with square pixels that sees the same rectangle, and the map from the given camera's photos."""
    sx, sy = camera.scale_at_surface
    even = float(np.sqrt(sx * sy))
    width, height = round(camera.width_px * even / sx), round(camera.height_px * even / sy)
    size_px = camera.width_px, camera.height_px
    photo_map = PhotoMap(size_px, (width, height), to_corners(UNIT * size_px))
    return camera.resize(width, height), photo_map


def fit_homography(places: Array, others: Array) -> Array:
    """Return the homography (3, 3) that maps places (N, 2) to others (N, 2), by linear least squares."""
    rows = []
    for (x, y), (u, v) in zip(places, others, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    return np.asarray(np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3))


def apply_homography(homography: NDArray[np.floating], places: NDArray[np.floating]) -> Array:
    """Return the places (N, 2) to which a homography (3, 3) maps places (N, 2)."""
    x, y, w = homography @ np.stack([*places.T, np.ones(len(places))])
    return np.asarray(np.stack([x / w, y / w], axis=1))
