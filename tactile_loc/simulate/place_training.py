"""Training data for encoders with a search of places: each key is the complete patch of a place.

A touch is seen as in the search. Its patch is around its deepest point, and only as large as the sensor sees. The patch
is rotated back by the yaw that brings the touch nearest to one of the places.

The nearest place of a pose may be rotated by any yaw about the sensor's z axis. Write phi(T) of the pose metric as a
matrix P (3, k), with one column for each axis of the object's spread and one for its centroid. A rotation by a yaw
gives Rz P. The least |A - Rz B|^2 over yaws follows from the largest trace of Rz^T A B^T. Write rows 0 and 1 of A as
complex numbers a, those of B as b, and let z = sum a conj(b). The largest trace is |z| + A_2 . B_2, at the yaw arg z.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats, Ints, Poses, invert, make_transform
from tactile_loc.core.places.places import CAMERA, HIGHEST_M, PITCH_M, PRESS_STEP_M, Places
from tactile_loc.core.places.rotated_patches import find_anchor, rotate_patches
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.runtime.errors import ConfigError, GridError, TouchError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.simulate.contact_poses import draw_contacts
from tactile_loc.slots.encoder import Checkpoints, TrainingBatch, TrainingProblem, TrainingTouches
from tactile_loc.slots.grid import GridSampler

KEYS = 1024  # keys per shard
PIXEL_M = 0.8 * PITCH_M  # largest pixel size of the touches
LIGHTEST = 0.25  # lightest press, as a share of the maximal depth
REACH = 2.0  # grid spacings; a touch that is farther from all places is not used
MOST_ROUNDS = 50


class Labels(NamedTuple):
    """The labels of M touches: the nearest places, the yaws, rad, and the distances, metres; each (M,).

    The yaw rotates a touch so that it is nearest to its place.
    """

    numbers: Ints
    yaw_rad: Floats
    off_m: Floats


@dataclass(frozen=True, eq=False)
class PlaceProblem(TrainingProblem):
    """The problem of finding the nearest of an object's `places`, and the yaw of the touch.

    Touches are at random poses from `sampler`, whose option `turns` is the number of yaws in the search. They are
    rendered with `scene`, whose sensor is not pressed.
    """

    places: Places
    scene: Scene
    sampler: GridSampler
    progress: Progress = field(default_factory=Progress)
    checkpoints: Checkpoints = field(default_factory=Checkpoints)
    partly_seen = True

    @property
    def geometry(self) -> SensorGeometry:
        """The camera that sees patches."""
        return CAMERA

    @property
    def key_presses_m(self) -> Floats:
        """The depths (P,), metres, at which touches are cut, from that of a light press, in steps of PRESS_STEP_M."""
        geometry = self.scene.geometry
        deepest_m = min(HIGHEST_M, geometry.max_depth_m * geometry.gel.compared_share)
        first = max(1, round(LIGHTEST * deepest_m / PRESS_STEP_M))
        last = max(first, int(deepest_m / PRESS_STEP_M + 1e-6))
        return np.round(np.arange(first, last + 1, dtype=np.float64) * PRESS_STEP_M, 9)

    @property
    def grid(self) -> PoseGrid:
        """Raise ConfigError, because this problem lists places instead of poses."""
        raise ConfigError(
            f"this encoder learns from listed poses, but the grid lists an object's {len(self)} places; choose `grid` "
            "face, `grid` hopf, or another encoder"
        )

    @property
    def shapes(self) -> PoseGrid:
        """Raise ConfigError, because this problem lists places instead of poses."""
        return self.grid

    def __len__(self) -> int:
        return len(self.places)

    def clean_keys(self, press_m: float) -> Iterable[Float32]:
        """Yield the contact depths (S, PATCH_PX, PATCH_PX), metres, of the places, cut at `press_m`, in shards."""
        for start in range(0, len(self.places), KEYS):
            yield self.places.depths(press_m, slice(start, start + KEYS))

    def draw(self, count: int, noise: TouchNoise, rng: np.random.Generator) -> TrainingTouches:
        """Render `count` touches at random poses near a place. Raises GridError if hardly any pose is near a place."""
        kept_depths: list[Float32] = []
        kept_poses: list[Poses] = []
        missing = count
        misplace = partial(noise.misplace, geometry=self.fine.geometry, rng=rng)
        for _ in range(MOST_ROUNDS):
            for poses, depths in draw_contacts(self.sampler, self.fine, missing, rng, misplace):
                near = self._is_near_place(depths, poses)
                kept_depths.append(depths[near])
                kept_poses.append(poses[near])
                missing -= int(near.sum())
            if missing <= 0:
                return PlaceTouches(np.concatenate(kept_depths), np.concatenate(kept_poses), noise, self)
        raise GridError(
            f"hardly any random touch of {self.scene.object.name} is near a place of the grid; raise grid.directions"
        )

    def _is_near_place(self, depths_m: Float32, T_sensor_object: Poses) -> Bools:
        """Return which contact depths (M, H, W), metres, at the maximal depth, are valid touches near a place."""
        touches = [self.touch(depth, self.fine.geometry.max_depth_m) for depth in depths_m]
        near = np.array([touch is not None for touch in touches], np.bool_)
        some = [touch for touch in touches if touch is not None]
        if some:
            near[near] = self.labels(some, T_sensor_object[near]).off_m <= self.reach_m
        return near

    def key_distances(self, first: Ints, second: Ints) -> Floats:
        """Return the pose distances (K,), metres, between places `first` (K,) and `second` (K,) at the best yaw."""
        T = self.places.T_place_object
        return np.array(
            [RotatedPoses(T[[b]], self._metric).nearest(T[[a]])[0][0] for a, b in zip(first, second, strict=True)]
        )

    @cached_property
    def fine(self) -> Scene:
        """The scene of the touches: pressed to the maximal depth, with pixels a little finer than those of a patch."""
        geometry = self.scene.geometry
        pixels = int(np.ceil(geometry.pixel_pitch_m * max(geometry.shape) / PIXEL_M))
        geometry = geometry.resize_long_side(min(pixels, max(geometry.shape))).press(geometry.max_depth_m)
        return dataclasses.replace(self.scene, geometry=geometry)

    @cached_property
    def rotated(self) -> RotatedPoses:
        """The places as poses that may be rotated by any yaw."""
        return RotatedPoses(self.places.T_place_object, self._metric)

    @cached_property
    def _metric(self) -> PoseMetric:
        return PoseMetric(self.scene.object)

    @property
    def reach_m(self) -> float:
        """Largest distance, metres, of a touch from the nearest place, in the pose metric."""
        return REACH * 1e-3 * self.sampler.options.spacing_mm

    def touch(self, depth_m: Float32, press_m: float) -> Touch | None:
        """Return the touch with contact depths (H, W), metres, cut at `press_m`, or None if they are not valid.

        The object is pressed in by the maximal depth.
        """
        geometry = self.fine.geometry
        try:
            return Touch(ContactShape(depth_m, press_m, geometry.indentation_m), geometry)
        except TouchError:
            return None

    def labels(self, touches: Sequence[Touch], T_sensor_object: Poses) -> Labels:
        """Return the labels of M touches with true poses (M, 4, 4), metres."""
        off_m, numbers, yaw_rad = self.rotated.nearest(move_to_anchors(touches, T_sensor_object))
        return Labels(numbers, yaw_rad, off_m)


@dataclass(frozen=True, eq=False)
class PlaceTouches(TrainingTouches):
    """Contact depths (N, H, W), metres, without noise, at the maximal depth, and the reported poses (N, 4, 4)."""

    depth_m: Float32
    T_sensor_object: Poses
    noise: TouchNoise
    problem: PlaceProblem

    def __len__(self) -> int:
        return len(self.depth_m)

    def batch(self, count: int, rng: np.random.Generator, press_m: float) -> TrainingBatch:
        """Draw `count` different touches with noise. Their measured presses are at most a step deeper than `press_m`.

        A touch gets no noise if the noise would hide it or move it away from all places.
        """
        problem, chosen = self.problem, np.sort(rng.choice(len(self), count, replace=False))
        touches, labels = self._make_noisy(chosen, rng, press_m)
        step_rad = float(2 * np.pi / problem.sampler.options.turns)
        yaw_rad = labels.yaw_rad + step_rad * rng.uniform(-0.5, 0.5, count)
        turned = [
            rotate_patches(touch, *find_anchor(touch), yaw_rad[[k]], touch.find_known(press_m))
            for k, touch in enumerate(touches)
        ]
        depth_m, seen = (np.concatenate(parts) for parts in zip(*turned, strict=True))
        return TrainingBatch(np.minimum(depth_m, np.float32(press_m)), seen, np.full(count, press_m), labels.numbers)

    def _make_noisy(self, chosen: Ints, rng: np.random.Generator, press_m: float) -> tuple[list[Touch], Labels]:
        """Return the touches `chosen` (M,) with noise, or without it if noise would spoil them, and their labels."""
        problem, noise, poses = self.problem, self.noise, self.T_sensor_object[chosen]
        geometry, clean = problem.fine.geometry, self.depth_m[chosen]
        pressed_m = press_m / geometry.gel.compared_share
        believed_m = np.minimum(pressed_m + PRESS_STEP_M * rng.random(len(chosen)), geometry.max_depth_m)
        # if noise makes the measured press deeper by a factor, the true press is lighter by the same factor
        true_m = np.minimum(believed_m**2 / noise.measure_press(believed_m, np.inf, rng), geometry.max_depth_m)
        imprints = noise.corrupt(deform_gel(clean, true_m, geometry), true_m, geometry, rng)
        noisy = noise.cut(imprints, true_m, np.full(len(chosen), press_m))
        plain = [self._make_clean(depth, press_m) for depth in deform_gel(clean, pressed_m, geometry)]
        shown = [problem.touch(depth, press_m) for depth in noisy]
        touches = [one or other for one, other in zip(shown, plain, strict=True)]
        labels = problem.labels(touches, poses)
        far = np.flatnonzero(labels.off_m > problem.reach_m)
        if len(far):
            for k in far:
                touches[k] = plain[k]
            for whole, some in zip(labels, problem.labels([plain[k] for k in far], poses[far]), strict=True):
                whole[far] = some
        return touches, labels

    def _make_clean(self, depth_m: Float32, press_m: float) -> Touch:
        """Return a touch without noise, cut at `press_m`, metres, or at the maximal depth if there is no contact."""
        problem = self.problem
        light = problem.touch(np.minimum(depth_m, np.float32(press_m)), press_m)
        geometry = problem.fine.geometry
        return light or Touch(ContactShape(depth_m, geometry.max_depth_m), geometry)


def move_to_anchors(touches: Sequence[Touch], T_sensor_object: Poses) -> Poses:
    """Convert poses (M, 4, 4), metres, to frames at the deepest points of M touches, with z along the gel's normal."""
    anchors = [find_anchor(touch) for touch in touches]
    T_sensor_anchor = make_transform(np.stack([R for _, R in anchors]), np.stack([at_m for at_m, _ in anchors]))
    return np.asarray(invert(T_sensor_anchor) @ T_sensor_object)


AT_ONCE = 4_000_000  # largest number of pairs of poses compared together


class RotatedPoses:
    """N poses `T_sensor_object` (N, 4, 4), metres, each of which may be rotated by any yaw about the sensor's z."""

    def __init__(self, T_sensor_object: Poses, metric: PoseMetric) -> None:
        self.metric = metric
        self._across, self._along = _rows(metric.embed_orbits(T_sensor_object)[0])
        self._squared = _squared(self._across, self._along)

    def __len__(self) -> int:
        return len(self._squared)

    def nearest(self, T_sensor_object: Poses) -> tuple[Floats, Ints, Floats]:
        """Return the index (M,) and the yaw (M,), rad, of the rotated pose nearest to each pose (M, 4, 4), metres.

        The first return value is the distance (M,), metres, up to the object's symmetry.
        """
        count = len(T_sensor_object)
        found = np.empty(count), np.empty(count, np.int64), np.empty(count)
        step = max(1, AT_ONCE // len(self))
        for start in range(0, count, step):
            for whole, part in zip(found, self._nearest(T_sensor_object[start : start + step]), strict=True):
                whole[start : start + step] = part
        return found

    def _nearest(self, T_sensor_object: Poses) -> tuple[Floats, Ints, Floats]:
        rows = np.arange(len(T_sensor_object))
        least, index, yaw_rad = np.full(len(rows), np.inf), np.zeros(len(rows), np.int64), np.zeros(len(rows))
        for phi in self.metric.embed_orbits(T_sensor_object):
            across, along = _rows(phi)
            rotated = across @ self._across.conj().T
            gained = self._squared - 2 * (np.abs(rotated) + along @ self._along.T)
            best = gained.argmin(axis=1)
            squared = gained[rows, best] + _squared(across, along)
            better = squared < least
            least, index = np.where(better, squared, least), np.where(better, best, index)
            yaw_rad = np.where(better, np.angle(rotated[rows, best]), yaw_rad)
        return np.sqrt(np.maximum(least, 0.0)), index, yaw_rad


def _rows(phi: Floats) -> tuple[NDArray[np.complex128], Floats]:
    """Split points (N, 3 k) of the metric's space into rows 0 and 1, as complex numbers (N, k), and row 2 (N, k).

    The last three numbers of a point are the centroid. The numbers before are a matrix (3, k - 1), row by row.
    """
    matrix = phi[:, :-3].reshape(len(phi), 3, -1)
    columns = np.concatenate([matrix, phi[:, -3:, None]], axis=2)
    return columns[:, 0] + 1j * columns[:, 1], columns[:, 2]


def _squared(across: NDArray[np.complex128], along: Floats) -> Floats:
    return np.asarray((np.abs(across) ** 2).sum(axis=1) + (along**2).sum(axis=1))
