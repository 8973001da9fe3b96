"""The modes of an object's pose: a few distinct poses with probabilities, which the next touch has to distinguish.

If several objects are possible, the modes are pairs of an object and its pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Poses
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.merging import merge_modes
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.locate.identify import LEAST_REPORTED, Identification
from tactile_loc.locate.result.localization import Localization

MOST_MODES = 30
NOISY, SHARPEST = 0.25, 5.0  # unexplained share of an imprint with strong noise; largest sharpness
SAME_POSE_M = 5e-4  # modes at a smaller surface distance, symmetry included, are merged


@dataclass(frozen=True, eq=False)
class PoseModes:
    """K modes of an object's pose: `T_base_object` (K, 4, 4), metres, and their probabilities (K,), which sum to one.

    `unlisted`, 0 to 1, is the probability of poses left out, which favour no approach. `geometry` is that of the next
    touch's sensor. `press_m`, metres, is the press depth of approaches that state none. `sharpness`, 1 or more, is the
    ratio of the evidence that contacts give to their evidence with strong noise: see `measure_sharpness`. `objects` are
    those of the K modes. Raises TouchError unless there are as many objects and probabilities as poses.
    """

    objects: tuple[ObjectModel, ...]
    T_base_object: Poses
    probabilities: Floats
    geometry: SensorGeometry
    press_m: float
    unlisted: float = 0.0
    sharpness: float = 1.0

    def __post_init__(self) -> None:
        counts = len(self.objects), len(self.T_base_object), len(self.probabilities)
        if len(set(counts)) > 1:
            raise TouchError(
                "modes have {} objects, {} poses and {} probabilities; give one of each for each mode".format(*counts)
            )

    @classmethod
    def of(cls, found: Localization) -> PoseModes:
        """Return a localisation's hypotheses in the base frame or, if unknown, in its touch's sensor frame."""
        touch, every = found.touch, found.hypotheses
        poses = np.stack([h.T_sensor_object if h.T_base_object is None else h.T_base_object for h in every])
        p, ious = np.array([h.probability for h in every]), [h.imprint_iou for h in every]
        obj = found.posterior.grid.metric.object
        return find_distinct_modes(obj, poses, p, touch.geometry, touch.indentation_m, ious)

    @classmethod
    def of_objects(cls, found: Identification) -> PoseModes | None:
        """Return the pairs of an object and its pose that are still possible, which the next touch has to distinguish.

        They are those of objects with a probability of at least LEAST_REPORTED; None if there is no such object.
        """
        probable = [one for one in found.objects if one.probability >= LEAST_REPORTED]
        known = [(cls.of(one.found), one.probability) for one in probable if one.found is not None]
        return join_modes(*zip(*known, strict=True)) if known else None

    @property
    def entropy(self) -> float:
        """The entropy of the modes, nats: 0 if one mode is certain."""
        return float(compute_entropy(self.probabilities))

    @cached_property
    def by_object(self) -> tuple[tuple[ObjectModel, NDArray[np.int64]], ...]:
        """Each object with the numbers (K,) of its modes, the object of the first mode first."""
        distinct = dict.fromkeys(self.objects)
        return tuple((one, np.flatnonzero([other is one for other in self.objects])) for one in distinct)

    @property
    def object_names(self) -> str:
        """The name of the object, or the names of all possible objects."""
        return " or ".join(obj.name for obj, _ in self.by_object)

    @property
    def symmetries(self) -> str:
        """The symmetry of the object, or those of all possible objects."""
        return " or ".join(str(obj.symmetry) for obj, _ in self.by_object)

    def name_mode(self, number: int) -> str:
        """Return a mode's number, from 0, as people count, with the object's name if several objects are possible."""
        return f"{number + 1} ({self.objects[number].name})" if len(self.by_object) > 1 else str(number + 1)


def measure_sharpness(imprint_ious: Sequence[float]) -> float:
    """Return how many times as much evidence contacts give as with strong noise.

    The evidence, in nats, was fitted to noisy touches: their true pose leaves a share NOISY of the imprint unexplained.
    If the best hypothesis leaves a smaller share, smaller differences count. `imprint_ious`, 0 to 1, are those of
    hypotheses.
    """
    return float(np.clip(NOISY / max(1 - max(imprint_ious, default=0.0), 1e-6), 1.0, SHARPEST))


def find_distinct_modes(
    obj: ObjectModel,
    T_base_object: Poses,
    probabilities: Floats,
    geometry: SensorGeometry,
    press_m: float,
    imprint_ious: Sequence[float] = (),
) -> PoseModes:
    """Return poses (K, 4, 4), metres, and probabilities (K,) as modes, at most MOST_MODES; merge equivalent poses.

    The modes' sharpness comes from `imprint_ious`, 0 to 1. Raises TouchError if all probabilities are 0.
    """
    order = np.argsort(-probabilities, kind="stable")
    order = order[probabilities[order] > 0]
    if not len(order):
        raise TouchError("no mode of the result has a probability above 0; locate the object again")
    of = merge_modes(T_base_object[order], PoseMetric(obj), SAME_POSE_M, MOST_MODES)
    kept, listed = np.unique(of[of >= 0]), of >= 0
    mass = np.bincount(of[listed], probabilities[order[listed]])[kept]
    likelier = np.argsort(-mass, kind="stable")
    p, poses = mass[likelier], T_base_object[order[kept[likelier]]]
    unlisted, sharpness = max(0.0, 1 - float(p.sum())), measure_sharpness(imprint_ious)
    return PoseModes((obj,) * len(p), poses, p / p.sum(), geometry, press_m, unlisted, sharpness)


def join_modes(every: Sequence[PoseModes], shares: Sequence[float]) -> PoseModes:
    """Return the modes of several objects as pairs of an object and its pose, at most MOST_MODES, the likeliest first.

    `every` has the modes of each object, in a common frame and for the same sensor. `shares` are the probabilities of
    the objects; what they lack to 1 belongs to other objects, and counts as unlisted. Raises TouchError without any
    modes.
    """
    if not every:
        raise TouchError("no object has a mode; identify the touches again")
    weights = [(1 - m.unlisted) * share for m, share in zip(every, shares, strict=True)]
    listed = np.concatenate([weight * m.probabilities for m, weight in zip(every, weights, strict=True)])
    objects = [obj for m in every for obj in m.objects]
    order = np.argsort(-listed, kind="stable")[:MOST_MODES]
    p, poses = listed[order], np.concatenate([m.T_base_object for m in every])[order]
    return replace(
        every[0],
        objects=tuple(objects[k] for k in order),
        T_base_object=poses,
        probabilities=p / p.sum(),
        unlisted=max(0.0, 1 - float(p.sum())),
        sharpness=max(m.sharpness for m in every),
    )


def compute_entropy(p: Floats) -> Floats:
    """Return the Shannon entropy (...,) in nats of probabilities (..., K)."""
    return np.asarray(-(p * np.log(np.where(p > 0, p, 1.0))).sum(axis=-1))
