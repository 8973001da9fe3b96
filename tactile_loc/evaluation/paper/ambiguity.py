"""Ambiguity of a touch: whether noise hides the difference between its contact and that of a distant pose.

Let C be the true pose's contact depths and C' those of another pose, both drawn without noise at the touch's press. Let
N1, N2 be two noisy measurements of the true pose. All depths are taken at the observed pixels and blurred by 0.3 mm.
With the direction u = (C' - C) / |C' - C|,

    ratio  =  |C' - C|  /  sqrt( mean of ( u . (N1 - N2) )^2 ),      unitless

compares the distance of the two shapes with the effect of noise along the line between them. Noise across this line
does not count, because it does not affect a test that decides between the two shapes. With Gaussian noise, the best
such test errs with probability Phi(-ratio / sqrt 2), about 1/4 at a ratio of 1.

A touch's ratio is the least ratio over all distant poses. Below 1, the touch is ambiguous, and no method can be blamed
for a wrong pose.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from tactile_loc.core.geometry.rigid import Float32, Floats, Poses
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.runtime.compiled import njit, run_in_threads
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.noise import NOISE, GelPixels, TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.evaluation.simulated_touches import require_true_pose
from tactile_loc.locate.localizer import Localizer
from tactile_loc.simulate.touch_simulation import PressNoise
from tactile_loc.slots.refiner import Refiner
from tactile_loc.slots.registry import registry

AMBIGUOUS = 1.0  # touches with a lower ratio are ambiguous
DISTANT_M = 5e-3  # root mean square surface distance; nearer poses count as the true pose
RIVALS = 6  # distant poses to refine
MEASUREMENTS = 12  # noisy measurements of the true pose
EVERY = 3  # step through the observed pixels, in the search for rivals
BLUR_M = 3e-4  # blur of all compared contacts, because single pixels of an outline are not evidence
REFINER = "filterreg"  # always the same, so that ambiguity does not depend on the evaluated method


def choose_judging_noise(noise: str) -> str:
    """Return the noise that judges the ambiguity of touches: their own noise, or mild noise for clean touches."""
    return "mild" if NOISE[noise] == TouchNoise() else noise


def measure_ambiguity(
    localizer: Localizer, touches: Sequence[Touch], noise: TouchNoise, rngs: Sequence[np.random.Generator]
) -> Floats:
    """Return the ratio (T,) of each touch, unitless; infinite if the grid has no distant pose.

    `noise` is added to measurements of the true poses, drawn with one of `rngs` for each touch. Raises TouchError for a
    touch without a true pose.
    """
    truths = np.stack([require_true_pose(touch) for touch in touches])
    distances = _measure_shape_distances(localizer, touches, truths)
    apart_m = localizer.sampler.options.spacing_mm * 1e-3
    judge = _Judge(localizer.scene.use_pressed_drawing(), make_refiner(), noise)
    ratios = []
    for touch, T_true, apart, rng in zip(touches, truths, distances, rngs, strict=True):
        rivals = find_rivals(localizer.listed.press_grid(touch), T_true, apart, apart_m)
        ratios.append(judge.find_ratio(touch, T_true, rivals, rng))
    return np.array(ratios)


def make_refiner() -> Refiner:
    """Return the refiner of the rivals."""
    refiner: Refiner = registry().create("refiner", REFINER, {})
    return refiner


def find_rivals(grid: PoseGrid, T_true: Poses, apart: Float32, radius_m: float) -> Poses:
    """Return at most RIVALS distant grid poses (R, 4, 4), metres, at least `radius_m` from each other.

    Distant poses are farther than DISTANT_M from the true pose (4, 4) and its symmetric poses. `apart` (N,) are the
    distances of the grid poses' contact shapes from the true one; the poses with the least distances are chosen.
    """
    left = np.where(grid.distances(T_true) > DISTANT_M, apart, np.inf)
    chosen: list[int] = []
    while len(chosen) < RIVALS and np.isfinite(left.min()):
        chosen.append(int(left.argmin()))
        left[np.linalg.norm(grid.phi - grid.phi[chosen[-1]], axis=1) <= radius_m] = np.inf
    return grid.T_sensor_object[chosen]


def compute_noise_ratio(true: Floats, others: Floats, measured: Floats) -> Floats:
    """Return the ratios (R,), unitless, of contact depths `others` (R, P) to the true ones (P,), all in metres.

    `measured` (K, P), metres, are noisy measurements of the true pose. A shape equal to the true one has ratio 0.
    """
    difference = others - true
    length = np.linalg.norm(difference, axis=1)
    along = measured @ (difference / np.maximum(length, 1e-30)[:, None]).T
    noise = np.sqrt(2 * along.var(axis=0, ddof=1))  # standard deviation of the difference of two measurements
    return np.where(length > 0, length / np.maximum(noise, 1e-30), 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class _Judge:
    """Compares a touch's true pose with its rivals, in a scene at rest."""

    scene: Scene
    refiner: Refiner
    noise: TouchNoise

    def find_ratio(self, touch: Touch, T_true: Poses, rivals: Poses, rng: np.random.Generator) -> float:
        """Return the least ratio of the rivals (R, 4, 4), refined or not; infinite if there is no rival."""
        pressed = self.scene.match_touch(touch)
        truth = pressed.bring_to_contact(T_true[None])[0][0]
        clean = ContactShape(pressed.render_gel_depths(truth[None])[0], touch.press_depth_m, touch.indentation_m)
        poses = self._keep_distant(pressed, truth, np.concatenate([rivals, self._refine(touch, clean, rivals)]))
        if len(poses) == 0:
            return np.inf
        measured = self._measure(touch, truth, rng)
        true, others, noisy = (
            _blur_gently(depths, touch.geometry)
            for depths in (clean.depth_m[None], pressed.render_gel_depths(poses), measured)
        )
        return float(compute_noise_ratio(true[0], others, noisy).min())

    def _keep_distant(self, pressed: Scene, truth: Poses, poses: Poses) -> Poses:
        """Return those of the poses (R, 4, 4), metres, that have contact and are far from the true pose (4, 4)."""
        poses, touching = pressed.bring_to_contact(poses)
        away_m = PoseMetric(pressed.object).symmetric_distance(np.broadcast_to(truth, poses.shape), poses)
        return poses[touching & (away_m > DISTANT_M)]

    def _refine(self, touch: Touch, clean: ContactShape, rivals: Poses) -> Poses:
        """Return the rivals (R, 4, 4) refined against the clean shape, to remove the error of the grid's spacing."""
        try:
            target = dataclasses.replace(touch, contact_shape=clean)
        except TouchError:  # without noise, the touch shows only a flat face
            return rivals
        candidates = [Candidate(T, k, 0.0) for k, T in enumerate(rivals)]
        refined = self.refiner.refine_many(target, candidates, self.scene.match_touch(target))
        return np.array([pose.T_sensor_object for pose in refined]).reshape(-1, 4, 4)

    def _measure(self, touch: Touch, T_true: Poses, rng: np.random.Generator) -> Float32:
        """Return noisy measurements (K, H, W), metres, of the contact at a touch's true pose, press and press depth."""
        press = PressNoise(self.noise, self.scene, touch.indentation_m, rng)
        T, _ = self.scene.bring_to_contact(np.repeat(T_true[None], MEASUREMENTS, axis=0))
        cut_m = np.float32(touch.press_depth_m)
        measured = np.full((MEASUREMENTS, *touch.geometry.shape), cut_m)
        for depth, shape in zip(measured, press.press(T, 0.0)[1], strict=True):
            if shape is not None:  # the shape is None if noise leaves no contact
                np.minimum(depth, shape.depth_m, out=depth, where=shape.contact)
        return measured


def _blur_gently(depths_m: Float32, geometry: SensorGeometry) -> Floats:
    """Return contact depths (N, H, W), metres, blurred by BLUR_M on the gel, at the observed pixels: (N, P)."""
    gel = GelPixels.of(geometry)
    blurred = gel.blur(depths_m[:, gel.rows, gel.columns], BLUR_M)
    return blurred[:, geometry.observed_mask[gel.rows, gel.columns]].astype(float)


def _measure_shape_distances(localizer: Localizer, touches: Sequence[Touch], truths: Poses) -> Float32:
    """Return squared distances (T, N), m^2, between the contact shapes of the grid and of true poses (T, 4, 4).

    The shapes have no noise, and are cut at the touch's press depth. Only every EVERY-th observed pixel of the grid's
    image is used.
    """
    pixels = np.flatnonzero(localizer.coarse_scene.geometry.observed_mask)[::EVERY]
    press = np.array([touch.press_depth_m for touch in touches], np.float32)
    wanted = _draw_true_shapes(localizer, touches, truths).reshape(len(touches), -1)[:, pixels]
    parts = []
    for depths in localizer.model.shapes.shards():  # at full press; `_compare` cuts these depths
        shapes = np.ascontiguousarray(depths.reshape(len(depths), -1)[:, pixels].T)
        parts.append(np.zeros((len(touches), shapes.shape[1]), np.float32))
        run_in_threads(_compare, len(wanted), shapes, wanted, press, parts[-1])
    return np.concatenate(parts, axis=1)


def _draw_true_shapes(localizer: Localizer, touches: Sequence[Touch], truths: Poses) -> Float32:
    """Return clean contact depths (T, H, W) of the true poses, metres, each cut at its touch's press depth."""
    shapes = []
    for touch, T in zip(touches, truths, strict=True):
        pressed = localizer.coarse_scene.press(touch.indentation_m, touch.press_depth_m)
        shapes.append(pressed.render_gel_depths(pressed.bring_to_contact(T[None])[0])[0])
    return np.stack(shapes)


@njit
def _compare(first, last, depths, wanted, press, found):  # type: ignore[no-untyped-def]
    """Add to `found` (T, S) the squared distances between depths (P, S), cut at `press` (T,), and `wanted` (T, P)."""
    for q in range(first, last):
        for p in range(len(depths)):
            for i in range(depths.shape[1]):
                difference = min(depths[p, i], press[q]) - wanted[q, p]
                found[q, i] += difference * difference
