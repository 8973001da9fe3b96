"""The pairs of poses that touches confuse: near symmetries, slides, turns and places that look alike.

A rival of a touch is a wrong pose that explains it as well as the best one. It follows from the true pose by a motion
of the object. Touches at several places may share a motion. The same evidence as in `choose_next_touch` tells at which
places a touch separates the two poses of a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tactile_loc import Approach, PoseModes, choose_next_touch
from tactile_loc.commands import format_percent
from tactile_loc.plugin import ConfigError, ObjectModel, Poses
from tactile_loc.plugin.helpers import PoseMetric, invert, make_translation, rotation_angle

from tactile_loc_touchability.study import Study

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

MERGED = 0.05  # motions that differ by less than this share of the diameter are one
MOST_PAIRS = 6
TOLD_NATS = 1.0  # a touch separates two poses if it gives at least this evidence, as for `NextTouch.alike`
FEW = 0.1  # a smaller share of places are few
PART_OF_TURN_RAD = np.radians(3.0)  # an angle that differs by less is a part of a turn
SMALL_TURN_RAD, ALONG = np.radians(8.0), np.cos(np.radians(15.0))
SHIFTED = 0.05  # share of the diameter below which the centre counts as not moved
WHOLE_TURN_PARTS = (2, 3, 4, 5, 6, 8)


@dataclass(frozen=True, eq=False)
class ConfusedPair:
    """Two poses of the object that touches confuse: the second follows from the first by `motion` (4, 4), metres.

    `confused` (N,) marks the presses with this rival, and `told` (N,) those that separate the two poses.
    """

    motion: Poses
    words: str
    reason: str
    confused: Bools
    told: Bools

    def describe(self) -> str:
        """Return the pair, the reason and the places in words."""
        share, told = format_percent(float(self.confused.mean())), format_percent(float(self.told.mean()))
        where = (
            "no simulated touch tells the two poses apart"
            if not self.told.any()
            else f"only {told} of the places tell the two poses apart"
            if self.told.mean() < FEW
            else f"{told} of the places tell the two poses apart"
        )
        return f"{self.words}: {share} of the touches fit both poses ({self.reason}); {where}"


def find_pairs(study: Study, most: int = MOST_PAIRS) -> list[ConfusedPair]:
    """Return the pairs of poses that most touches of a study confuse, the most frequent first."""
    listed = [(n, np.reshape(one["motion"], (4, 4))) for n, row in enumerate(study.rows) for one in row["rivals"]]
    if not listed:
        return []
    obj = study.localizer.object
    owner, motions = np.array([n for n, _ in listed]), _choose_equivalents(obj, np.stack([T for _, T in listed]))
    label = merge_motions(obj, motions, MERGED * study.diameter_m)
    counts = {k: len(np.unique(owner[label == k])) for k in np.unique(label).tolist()}
    found = []
    for k in sorted(counts, key=lambda k: -counts[k])[:most]:
        confused = np.isin(np.arange(len(study.rows)), owner[label == k])
        words, reason = describe_motion(motions[k], obj, study.diameter_m)
        found.append(ConfusedPair(motions[k], words, reason, confused, tell_apart(study, motions[k])))
    return found


def merge_motions(obj: ObjectModel, motions: Poses, radius_m: float) -> NDArray[np.int64]:
    """Return for each motion (K, 4, 4), metres, the number of the first one that is nearer than `radius_m`, or inverse.

    A motion and its inverse lead to the same pair of poses.
    """
    metric = PoseMetric(obj)
    points, back = metric.embed(motions), metric.embed(invert(motions))
    label, kept = np.full(len(motions), -1), list[int]()
    for k in range(len(motions)):
        near = np.minimum(
            np.linalg.norm(points[kept] - points[k], axis=1), np.linalg.norm(points[kept] - back[k], axis=1)
        )
        if len(kept) and near.min() < radius_m:
            label[k] = kept[int(near.argmin())]
        else:
            label[k] = k
            kept.append(k)
    return label


def _choose_equivalents(obj: ObjectModel, motions: Poses) -> Poses:
    """Return for each motion (K, 4, 4) the least motion that is the same by the object's symmetry."""
    metric, group = PoseMetric(obj), obj.symmetry.list_elements()
    if len(group) == 1:
        return motions
    start, least = metric.embed(np.eye(4)[None]), motions.copy()
    for k, T in enumerate(motions):
        same = (group[:, None] @ T @ group[None]).reshape(-1, 4, 4)
        least[k] = same[np.linalg.norm(metric.embed(same) - start, axis=1).argmin()]
    return least


def tell_apart(study: Study, motion: Poses, obj: ObjectModel | None = None) -> Bools:
    """Return which presses (N,) of a study separate the pose of an object and the pose after a motion (4, 4), metres.

    `obj` replaces the object of the study, for instance by one with another feature.
    """
    known = obj or study.localizer.object
    geometry = study.localizer.scene.geometry
    modes = PoseModes((known, known), np.stack([np.eye(4), motion]), np.full(2, 0.5), geometry, study.press_m)
    told = np.zeros(len(study.presses), bool)
    try:
        rated = choose_next_touch(modes, list_approaches(study)).ranked
    except ConfigError:  # no approach is within reach
        return told
    q = 1 / (1 + np.exp(TOLD_NATS))
    least = np.log(2) + q * np.log(q) + (1 - q) * np.log(1 - q)
    for one in rated:
        told[int(one.approach.name)] = one.information >= least
    return told


def list_approaches(study: Study) -> list[Approach]:
    """Return the presses of a study as approaches in the object's frame, each named by its number."""
    away_m = 2 * study.diameter_m
    back = make_translation([0.0, 0.0, -away_m])
    starts = invert(study.presses.T_sensor_object) @ back
    return [Approach(T, study.press_m, 2 * away_m, name=str(k)) for k, T in enumerate(starts)]


def describe_motion(motion: Poses, obj: ObjectModel, diameter_m: float) -> tuple[str, str]:
    """Return a motion (4, 4), metres, in words, and the reason why touches do not see it."""
    angle, shift = float(rotation_angle(motion[:3, :3])), motion[:3, :3] @ obj.mesh.centroid_m + motion[:3, 3]
    shift = shift - obj.mesh.centroid_m
    moved = f"moved by {1e3 * np.linalg.norm(shift):.1f} mm along {name_direction(shift)}"
    if angle < SMALL_TURN_RAD:
        return moved, "the surface looks alike along this direction"
    turned = f"turned by {np.degrees(angle):.0f} degrees about {name_direction(find_axis(motion[:3, :3]))}"
    if np.linalg.norm(shift) > SHIFTED * diameter_m:
        return f"{turned} and {moved}", "two places of the part look alike"
    parts = 2 * np.pi / angle
    nearest = min(WHOLE_TURN_PARTS, key=lambda n: abs(parts - n))
    if abs(angle - 2 * np.pi / nearest) < PART_OF_TURN_RAD:
        return turned, f"the part is nearly the same after 1/{nearest} of a turn"
    return turned, "the part is nearly round about this axis"


def find_axis(R: Floats) -> Floats:
    """Return the axis (3,) of a rotation (3, 3), about which it turns by 0 to 180 degrees."""
    values, vectors = np.linalg.eig(R)
    axis = np.real(vectors[:, np.abs(values - 1).argmin()])
    sign = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) @ axis
    return np.asarray(axis if sign >= 0 else -axis)


def name_direction(vector: Floats) -> str:
    """Return x, y or z for a vector (3,) near an axis of the part, with its sign, or else its direction as numbers."""
    unit = vector / max(float(np.linalg.norm(vector)), 1e-12)
    nearest = int(np.abs(unit).argmax())
    if abs(unit[nearest]) >= ALONG:
        return f"{'-' if unit[nearest] < 0 else ''}{'xyz'[nearest]}"
    return "({:z.2f}, {:z.2f}, {:z.2f})".format(*unit)


def choose_marks(places_m: Floats, marked: Bools, count: int) -> Sequence[int]:
    """Return at most `count` of the marked places (N, 3), far apart from each other."""
    some = np.flatnonzero(marked)
    if not len(some):
        return []
    chosen = [int(some[0])]
    far = np.linalg.norm(places_m[some] - places_m[some[0]], axis=1)
    while len(chosen) < min(count, len(some)) and far.max() > 0:
        chosen.append(int(some[far.argmax()]))
        far = np.minimum(far, np.linalg.norm(places_m[some] - places_m[chosen[-1]], axis=1))
    return chosen
