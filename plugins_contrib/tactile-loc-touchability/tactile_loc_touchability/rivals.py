"""The pairs of poses that touches confuse: near symmetries, slides, turns and places that look alike.

A rival of a touch is a wrong pose that explains it as well as the best one. It follows from the true pose by a motion
of the object. Touches at several places may share a motion. The same evidence as in `choose_next_touch` tells at which
places a touch separates the two poses of a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from tactile_loc import PoseModes, choose_next_touch
from tactile_loc.plugin import ConfigError, ObjectModel, Poses
from tactile_loc.plugin.helpers import (
    PoseMetric,
    axis_angle,
    invert,
    name_direction,
    name_line,
    rotation_angle,
    spread_points,
)

from tactile_loc_touchability.study import Study
from tactile_loc_touchability.words import write_place, write_share

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

MERGED = 0.05  # motions that differ by less than this share of the diameter are one
MOST_PAIRS = 6
SMALL_GROUP = 12  # symmetries
TOLD_NATS = 1.0  # a touch separates two poses if it gives at least this evidence, as for `NextTouch.alike`
FEW = 0.1  # a smaller share of places are few
OFF_DEG = 3.0  # an angle that differs by less is a part of a turn
MOST_TURNS = 4  # about one axis, that are compared
SMALL_TURN_RAD, ALONG = np.radians(8.0), np.cos(np.radians(15.0))
SHIFTED = 0.05  # shares of the diameter: a smaller shift along the axis does not count,
FAR, NEAR_LINES = 2.0, 0.1  # a line is no axis if it is farther off, and lines that are nearer are one
PARTS_OF_TURN = (2, 3, 4, 5, 6, 8)
SMALL_PART_DEG = 45  # a smaller turn that touches confuse is one along a round surface
LOOK_ALIKE = "places of the part look alike"


@dataclass(frozen=True, eq=False)
class ConfusedPair:
    """Poses of the object that touches confuse: the others follow from the first by `motions` (K, 4, 4), metres.

    The motions are one, or several turns about one axis, the most frequent first. `confused` (N,) marks the presses
    with such a rival, and `told` (N,) those that separate the first pose from all others.
    """

    motions: Poses
    words: str
    reason: str
    confused: Bools
    told: Bools

    def describe(self) -> str:
        """Return the pair, the reason and the places in words."""
        share, told = write_share(float(self.confused.mean())), write_share(float(self.told.mean()))
        where = (
            "no simulated touch tells them apart"
            if not self.told.any()
            else f"only {told} of the places tell them apart"
            if self.told.mean() < FEW
            else f"{told} of the places tell them apart"
        )
        return f"{self.words}: {share} of the touches fit the poses equally well ({self.reason}); {where}"


def find_pairs(study: Study, most: int = MOST_PAIRS) -> list[ConfusedPair]:
    """Return the pairs of poses that most touches of a study confuse, the most frequent first."""
    listed = [(n, np.reshape(one["motion"], (4, 4))) for n, row in enumerate(study.rows) for one in row["rivals"]]
    if not listed:
        return []
    obj = study.localizer.object
    owner, motions = np.array([n for n, _ in listed]), choose_equivalents(obj, np.stack([T for _, T in listed]))
    label = merge_motions(obj, motions, MERGED * study.diameter_m)
    counts = {k: len(np.unique(owner[label == k])) for k in np.unique(label).tolist()}
    families: list[tuple[AxisTurn | None, list[int]]] = []
    for k in sorted(counts, key=lambda k: -counts[k]):
        turn = find_turn(motions[k], obj, study.diameter_m)
        alike = [some for other, some in families if turn and other and other.shares_axis(turn)]
        if alike:
            alike[0].append(k)
        else:
            families.append((turn, [k]))
    found = [_make_pair(study, motions, label, owner, some[:MOST_TURNS]) for _, some in families]
    kept = sorted(found, key=lambda pair: -int(pair.confused.sum()))[:most]
    return [replace(pair, told=tell_apart(study, pair.motions)) for pair in kept]


def _make_pair(study: Study, motions: Poses, label: Ints, owner: Ints, some: Sequence[int]) -> ConfusedPair:
    """Return the pair of some motions of one family, the most frequent first, without the places that tell it apart."""
    confused = np.isin(np.arange(len(study.rows)), owner[np.isin(label, some)])
    words, reason = describe_motions(motions[list(some)], study.localizer.object, study.diameter_m)
    return ConfusedPair(motions[list(some)], words, reason, confused, np.zeros(len(study.rows), bool))


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


def choose_equivalents(obj: ObjectModel, motions: Poses) -> Poses:
    """Return for each motion (K, 4, 4) the least motion that is the same by the object's symmetry.

    A motion after a symmetry is the same, too, which is tried only for small groups.
    """
    metric, group = PoseMetric(obj), obj.symmetry.list_elements()
    if len(group) == 1:
        return motions
    start, least = metric.embed(np.eye(4)[None]), motions.copy()
    for k, T in enumerate(motions):
        before = group[:, None] if len(group) <= SMALL_GROUP else np.eye(4)
        same = (before @ T @ group).reshape(-1, 4, 4)
        least[k] = same[np.linalg.norm(metric.embed(same) - start, axis=1).argmin()]
    return least


def tell_apart(study: Study, motions: Poses, obj: ObjectModel | None = None) -> Bools:
    """Return which presses (N,) of a study separate the pose of an object from those after motions (K, 4, 4), metres.

    `obj` replaces the object of the study, for instance by one with another feature.
    """
    return np.asarray(np.all([_tell_two_apart(study, motion, obj or study.localizer.object) for motion in motions], 0))


def _tell_two_apart(study: Study, motion: Poses, obj: ObjectModel) -> Bools:
    geometry, told = study.localizer.scene.geometry, np.zeros(len(study.presses), bool)
    modes = PoseModes((obj, obj), np.stack([np.eye(4), motion]), np.full(2, 0.5), geometry, study.press_m)
    try:
        rated = choose_next_touch(modes, study.list_approaches()).ranked
    except ConfigError:  # no approach is within reach
        return told
    q = 1 / (1 + np.exp(TOLD_NATS))
    least = np.log(2) + q * np.log(q) + (1 - q) * np.log(1 - q)
    for one in rated:
        told[int(one.approach.name)] = one.information >= least
    return told


@dataclass(frozen=True, eq=False)
class AxisTurn:
    """A turn by an angle about a line: the `axis` (3,), unitless, through a point (3,), metres, near the centre.

    Lines that are within `near_m` of each other, and point alike, are one.
    """

    angle_rad: float
    axis: Floats
    point_m: Floats
    near_m: float

    def shares_axis(self, other: AxisTurn) -> bool:
        """Return whether another turn is about the same line."""
        return bool(abs(self.axis @ other.axis) >= ALONG and np.linalg.norm(self.point_m - other.point_m) < self.near_m)

    def name_axis(self, centre_m: Floats) -> str:
        """Return the line in words; its point is left out if it is near the object's centre."""
        name = name_line(self.axis)
        if np.linalg.norm(self.point_m - centre_m) < self.near_m:
            return name
        return f"an axis along {name} through {write_place(self.point_m)} mm"


def find_turn(motion: Poses, obj: ObjectModel, diameter_m: float) -> AxisTurn | None:
    """Return the turn that a motion (4, 4), metres, is; None if it also moves the object along the axis, or far away.

    The turn's point is the point of the line that is nearest to the object's centre c. It follows from the shift s of
    the centre: p = c + (s + cot(angle / 2) axis x s) / 2, because s is perpendicular to the axis.
    """
    angle, shift = float(rotation_angle(motion[:3, :3])), _find_shift(motion, obj)
    if angle < SMALL_TURN_RAD:
        return None
    axis = axis_angle(motion[:3, :3])[1]
    across = shift - (shift @ axis) * axis
    beside = 0.5 * (across + np.cross(axis, across) / np.tan(angle / 2))
    if abs(shift @ axis) > SHIFTED * diameter_m or np.linalg.norm(beside) > FAR * diameter_m:
        return None
    return AxisTurn(angle, axis, obj.mesh.centroid_m + beside, NEAR_LINES * diameter_m)


def describe_motions(motions: Poses, obj: ObjectModel, diameter_m: float) -> tuple[str, str]:
    """Return a motion, or turns about one axis, (K, 4, 4), metres, in words, and the reason why touches miss it."""
    turns = [turn for motion in motions if (turn := find_turn(motion, obj, diameter_m)) is not None]
    if turns:
        angles = sorted({round(float(np.degrees(turn.angle_rad))) for turn in turns})
        listed = " or ".join(filter(None, (", ".join(map(str, angles[:-1])), str(angles[-1]))))
        whole = [n for n in PARTS_OF_TURN if all(abs(a - round(a * n / 360) * 360 / n) < OFF_DEG for a in angles)]
        same = f"these places look alike after 1/{whole[0]} of a turn" if whole else ""
        alike = "these places are nearly round about this axis" if angles[0] < SMALL_PART_DEG else LOOK_ALIKE
        return f"turned by {listed} degrees about {turns[0].name_axis(obj.mesh.centroid_m)}", same or alike
    shift, R = _find_shift(motions[0], obj), motions[0, :3, :3]
    moved = f"moved by {1e3 * np.linalg.norm(shift):.1f} mm along {name_direction(shift)}"
    if rotation_angle(R) < SMALL_TURN_RAD:
        return moved, "these places look alike along this direction"
    turned = f"turned by {np.degrees(rotation_angle(R)):.0f} degrees about {name_direction(axis_angle(R)[1])}"
    return f"{turned} and {moved}", LOOK_ALIKE


def _find_shift(motion: Poses, obj: ObjectModel) -> Floats:
    """Return how a motion (4, 4) moves the object's centre, (3,), metres."""
    return np.asarray(motion[:3, :3] @ obj.mesh.centroid_m + motion[:3, 3] - obj.mesh.centroid_m)


def choose_marks(places_m: Floats, marked: Bools, count: int) -> Sequence[int]:
    """Return at most `count` of the marked places (N, 3), far apart from each other."""
    some = np.flatnonzero(marked)
    return [int(k) for k in some[spread_points(places_m[some], count)]] if len(some) else []
