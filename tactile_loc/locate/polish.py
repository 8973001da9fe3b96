"""Polishes poses sideways, against a touch that was read from a photo.

The border of a contact is blurred in a photo. The joint registration uses no walls there, so it leaves a flat tip
loose by some tenths of a millimetre and a few degrees. The imprint IoU sees the border, but it is counted in pixels.
So many poses around a pose are drawn, and their mean is taken, weighed by how well they explain the touch. The spread
shrinks from round to round, as in the cross-entropy method (Rubinstein, Methodology and Computing in Applied
Probability 1, 1999).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, make_transform
from tactile_loc.core.sensing.clouds import make_contact_cloud
from tactile_loc.core.sensing.scene import View
from tactile_loc.locate.result.hypothesis import Hypothesis

Floats = NDArray[np.float64]

POLISHED = 3  # hypotheses
PIXELS = 200  # along the longer side of the drawn images
SPREAD_M, SHRINK, ROUNDS = 2e-4, 0.7, 4  # standard deviation of the first round's motions, and of later ones
PAIRS = 40  # of opposite motions in each round
UNLIKELY = 0.01  # loss of imprint IoU that divides a pose's weight by e


def polish(readings: Sequence[View], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses of one photo, the first POLISHED of them moved sideways and turned.

    They slide along the gel and turn about its normal, to where the photo's `readings` by several laws of the gel are
    explained best in the mean. All get the imprint IoU with the first reading, counted with PIXELS.
    """
    view = readings[0]
    points_m = make_contact_cloud(view.touch.touching_shape, view.touch.geometry, walls=False)[0]
    middle_m = points_m.mean(axis=0)
    lever_m = float(np.sqrt(np.square(points_m - middle_m)[:, :2].sum(axis=1).mean()))
    spread = SPREAD_M * np.array([1.0, 1.0, 1 / max(lever_m, SPREAD_M)])
    found = []
    for number, one in enumerate(hypotheses):
        motion = _find_motion(readings, one.T_sensor_object, middle_m, spread) if number < POLISHED else np.eye(4)
        found.append(_apply(motion, one))
    ious = view.imprint_ious(np.stack([one.T_sensor_object for one in found]), PIXELS).tolist()
    return [replace(one, imprint_iou=iou, imprint_ious=(iou,)) for one, iou in zip(found, ious, strict=True)]


def _find_motion(readings: Sequence[View], T: Poses, middle_m: Floats, spread: Floats) -> Poses:
    """Return the motion (4, 4), metres, of a pose T (4, 4) after which it explains the readings best."""
    at = np.zeros(3)
    for number in range(ROUNDS):
        motions = at + _draw_motions() * spread * SHRINK**number
        moved = _move(motions, middle_m) @ T
        ious = np.mean([view.imprint_ious(moved, PIXELS) for view in readings], axis=0)
        weights = np.exp((ious - ious.max()) / UNLIKELY)
        at = weights @ motions / weights.sum()
    return _move(at[None], middle_m)[0]


def _apply(motion: Poses, one: Hypothesis) -> Hypothesis:
    poses = {name: getattr(one.refined, name) for name in ("T_sensor_object", "T_sensors_object", "T_reported_object")}
    moved = {name: motion @ T for name, T in poses.items() if T is not None}
    return replace(one, refined=replace(one.refined, **moved))


def _move(motions: Floats, middle_m: Floats) -> Poses:
    """Return transforms (N, 4, 4), metres, of motions (N, 3): x and y in metres, and a turn about z through a point."""
    R = np.tile(np.eye(3), (len(motions), 1, 1))
    cosine, sine = np.cos(motions[:, 2]), np.sin(motions[:, 2])
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1] = cosine, -sine, sine, cosine
    return make_transform(R, middle_m - R @ middle_m + np.pad(motions[:, :2], [(0, 0), (0, 1)]))


@lru_cache(maxsize=1)
def _draw_motions() -> Floats:
    """Return motions (2 PAIRS + 1, 3) with standard deviations of 1, without a mean; the first one is 0."""
    drawn = np.random.default_rng(0).standard_normal((PAIRS, 3))
    return np.concatenate([np.zeros((1, 3)), drawn, -drawn])
