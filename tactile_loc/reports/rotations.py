"""A distribution over rotations, for pictures: the turn about the sensor's axis, and the side that faces the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

YAW_BINS, MOST_YAWS = 36, 120
AZIMUTHS, HEIGHTS = 36, 18
LEANS = 15
SAME_SIDE_DEG, CAP_DEG = 0.5, 60.0


@dataclass(frozen=True, eq=False)
class YawHistogram:
    """Probability by turn about the sensor's +z: `yaw_deg` (B,) are the bars' middles, `mass` (B,) sums to one."""

    yaw_deg: Array
    mass: Array
    width_deg: float


@dataclass(frozen=True, eq=False)
class SideMap:
    """Probability `mass` (Y, X), which sums to one, of which side of the object faces the sensor.

    "one": a single side, `normal` (3,) in the object frame; "lean": how far that side leans towards the sensor's x and
    y, degrees; "globe": the side's azimuth and elevation in the object frame, degrees, in bins of equal area. `x` and
    `y` are the bins' edges.
    """

    kind: Literal["one", "lean", "globe"]
    normal: Array
    x: Array
    y: Array
    mass: Array


def yaw_rad(R: Array) -> Array:
    """Return the turn (N,) about the sensor's z of rotations R_sensor_object (N, 3, 3), radians, -pi to pi.

    R = Rz(yaw) A, with A the smallest rotation that brings the side that faces the sensor there (`align_to_z`).
    """
    v = R[:, 2, :]  # what the sensor's +z is in the object frame
    x = np.zeros_like(v)
    x[:, 0] = 1.0
    below = v[:, 2] > -1 + 1e-9
    swing = np.where(below, v[:, 0] / np.maximum(1 + v[:, 2], 1e-12), 0.0)
    x -= swing[:, None] * (v + np.array([0.0, 0.0, 1.0]))
    turned = np.einsum("nij,nj->ni", R, x)
    return np.arctan2(turned[:, 1], turned[:, 0])


def yaw_histogram(R: Array, weights: Array) -> YawHistogram:
    """Sum weights (N,) of rotations R_sensor_object (N, 3, 3) by yaw: a bar a yaw of a lattice, or of ten degrees."""
    yaw_deg = np.degrees(yaw_rad(R)) % 360.0
    values, which = np.unique(np.round(yaw_deg, 2) % 360.0, return_inverse=True)
    step_deg = float(np.diff(values).min()) if len(values) > 1 else 360.0 / YAW_BINS
    if len(values) <= MOST_YAWS and step_deg >= 1.0:
        return YawHistogram(values, np.bincount(which.ravel(), weights, len(values)).astype(float), min(step_deg, 30.0))
    width_deg = 360.0 / YAW_BINS
    bins = np.minimum((yaw_deg / width_deg).astype(int), YAW_BINS - 1)
    middles = np.linspace(0.5, YAW_BINS - 0.5, YAW_BINS) * width_deg
    return YawHistogram(middles, np.bincount(bins, weights, YAW_BINS).astype(float), width_deg)


def side_map(R: Array, weights: Array) -> SideMap:
    """Sum weights (N,) of rotations R_sensor_object (N, 3, 3) by the side of the object that faces the sensor."""
    facing = -R[:, 2, :]
    mean = facing.mean(axis=0)
    if np.linalg.norm(mean) < 1e-6:
        return _globe(facing, weights)
    normal = mean / np.linalg.norm(mean)
    widest_deg = float(np.degrees(np.arccos(np.clip(facing @ normal, -1, 1))).max())
    if widest_deg > CAP_DEG:
        return _globe(facing, weights)
    return _lean(R, weights, normal, widest_deg)


def _globe(facing: Array, weights: Array) -> SideMap:
    azimuth_deg = np.degrees(np.arctan2(facing[:, 1], facing[:, 0]))
    x, heights = np.linspace(-180, 180, AZIMUTHS + 1), np.linspace(-1, 1, HEIGHTS + 1)
    mass, _, _ = np.histogram2d(np.clip(facing[:, 2], -1, 1), azimuth_deg, (heights, x), weights=weights)
    best = facing[weights.argmax()]
    return SideMap("globe", best, x, np.degrees(np.arcsin(heights)), mass)


def _lean(R: Array, weights: Array, normal: Array, widest_deg: float) -> SideMap:
    if widest_deg < SAME_SIDE_DEG:
        return SideMap("one", normal, np.zeros(0), np.zeros(0), np.ones((1, 1)))
    side = R @ normal
    lean_deg = np.degrees(np.arctan2(side[:, :2], -side[:, 2:]))
    edges = np.linspace(-1, 1, LEANS + 1) * (float(np.abs(lean_deg).max()) * (1 + 1 / LEANS))
    mass, _, _ = np.histogram2d(lean_deg[:, 1], lean_deg[:, 0], (edges, edges), weights=weights)
    return SideMap("lean", normal, edges, edges, mass)
