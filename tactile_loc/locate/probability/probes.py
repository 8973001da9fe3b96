"""Probes: poses just beyond the tolerance of a pose, along the directions that the touches determine least.

The covariance of a refined pose is only as good as its model of noise. Probes are compared with the touches as all
other poses are, so they show what the touches leave open: a turn of a shaft, or a slide of a rail.
"""

from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.lie import move
from tactile_loc.core.geometry.rigid import Floats, Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.tolerance import Tolerance

DIRECTIONS = 3  # directions with a probe on either side
BEYOND = 1.2  # distance of a probe, in tolerances
SCALES = 0.05 * 1.4 ** np.arange(24)  # of a motion by about a tolerance, which are tried
MOST_TURN_RAD = 2.0  # along directions that change nothing, such as a turn about an axis of symmetry
STEP = 1e-5  # metres and radians, for derivatives


@dataclass(frozen=True, eq=False)
class Probes:
    """Probes of a pose: `T` (2 D, 4, 4), metres, two for each of D directions, the least determined direction first.

    `motions` (2 D, 6) lead from the pose to the probes, in the order and frame of `RefinedPose.covariance`. `std_m`
    (D,) are the root mean square displacements of the surface, metres, for one standard deviation along each direction.
    """

    T: Poses
    motions: Floats
    std_m: Floats


def place_probes(T: Poses, covariance: Floats, obj: ObjectModel, tolerance: Tolerance) -> Probes:
    """Return the probes of a pose (4, 4), metres, with a covariance (6, 6) as in RefinedPose.

    Along the principal axes of the covariance, in the metric of surface displacements, each probe is placed BEYOND
    tolerances away, up to symmetry. It is nearer if no motion up to MOST_TURN_RAD is that far.
    """
    values, vectors = np.linalg.eigh(covariance)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    J = _differentiate(T, obj)
    variances, axes = np.linalg.eigh(spread.T @ J.T @ J @ spread)
    chosen = np.argsort(-variances, kind="stable")[:DIRECTIONS]
    std_m = np.sqrt(np.maximum(variances[chosen], 1e-30))
    directions = (spread @ axes[:, chosen]).T
    unit_m = tolerance.distance_m or 1e-3
    units = np.repeat(directions * (unit_m / std_m)[:, None], 2, axis=0) * np.tile([1.0, -1.0], DIRECTIONS)[:, None]
    tried = move(T, (SCALES[:, None, None] * units).reshape(-1, 6))
    ratios = tolerance.measure_ratios(obj, T, tried).reshape(len(SCALES), -1)
    ratios[SCALES[:, None] * np.linalg.norm(units[:, 3:], axis=1) > MOST_TURN_RAD] = 0.0
    motions = units * np.array([_find_scale(column) for column in ratios.T])[:, None]
    return Probes(move(T, motions), motions, std_m)


def _find_scale(ratios: Floats) -> float:
    """Return the least scale at which a pose is BEYOND tolerances away, or else farthest, given ratios at SCALES.

    Beyond half a step of a rotational symmetry, a larger turn leads to a nearer pose.
    """
    far = np.flatnonzero(ratios >= BEYOND)
    if not len(far):
        return float(SCALES[ratios.argmax()])
    k = int(far[0])
    before, scale = (0.0, 0.0) if k == 0 else (ratios[k - 1], SCALES[k - 1])
    return float(scale + (SCALES[k] - scale) * (BEYOND - before) / (ratios[k] - before))


def _differentiate(T: Poses, obj: ObjectModel) -> Floats:
    """Return the derivatives (D, 6) of the point of a pose (4, 4) in the metric up to symmetry, by its motions."""
    steps = STEP * np.concatenate([np.eye(6), -np.eye(6)])
    points = PoseMetric(obj).embed_orbits(move(T, steps))[0]
    return np.asarray((points[:6] - points[6:]).T / (2 * STEP))
