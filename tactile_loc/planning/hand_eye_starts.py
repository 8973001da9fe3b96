"""A first guess of a sensor's mount: the mount on which most touches agree.

Two hypotheses of different touches are compatible if the part, seen from the sensor, moved by the same screw as the
flange. Three hypotheses that are pairwise compatible give a mount, which is then scored by all touches. The consensus
is found as in RANSAC, but from all compatible triples rather than random triples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.hand_eye import predict, screws_agree, solve_closed_form
from tactile_loc.core.geometry.rigid import Bools, Floats, Ints, Poses, rotation_angle
from tactile_loc.core.poses.metric import PoseMetric, measure_distances

AGREES_M = 4e-3  # largest surface distance between a hypothesis and a predicted pose that agree
ANGLE_RAD, SLIDE_M = np.radians(5.0), 5e-3  # largest difference between compatible screws
TURN_RAD = np.radians(6.0)  # step between the tried rotations of a continuous symmetry
MOST_SEEN = 20_000  # hypotheses that are used, including their equivalents by symmetry
ANCHORS, TRIANGLES = 100, 300  # hypotheses from which triples are formed, and triples tried for each
ANOTHER_M, ANOTHER_RAD = 8e-3, np.radians(15.0)  # two guesses that differ by more than this are different


@dataclass(frozen=True, eq=False)
class HandEyeStart:
    """A guess of the mount T_flange_sensor (4, 4) and the object's pose T_base_object (4, 4), both in metres.

    The mount predicts the object's pose in each of N sensor frames. `off_m` (N,) are surface distances, metres, from
    the predicted pose to the touch's nearest hypothesis.
    """

    T_flange_sensor: Floats
    T_base_object: Floats
    off_m: Floats


def list_hand_eye_starts(
    T_base_flange: Poses,
    hypotheses: Sequence[Poses],
    metric: PoseMetric,
    count: int,
    allowed: Callable[[Poses], Bools] | None = None,
) -> list[HandEyeStart]:
    """Return at most `count` different mounts on which touches agree, the best first; there may be none.

    `T_base_flange` is (N, 4, 4), metres. `hypotheses` has the poses T_sensor_object (K, 4, 4), metres, of each of N
    touches, the likeliest first. `allowed` takes mounts T_flange_sensor (B, 4, 4) and returns which (B,) may be
    considered.
    """
    nodes = _Nodes.of(T_base_flange, hypotheses, metric)
    found: list[HandEyeStart] = []
    for anchor in nodes.anchors():
        triples = nodes.triples(anchor)
        if not len(triples):
            continue
        X, Y = solve_closed_form(T_base_flange[nodes.touch[triples]], nodes.poses[triples])
        if allowed is not None:
            right = allowed(X)
            X, Y = X[right], Y[right]
        off_m = measure_distances_to_hypotheses(predict(T_base_flange, X, Y), hypotheses, metric)
        found += [HandEyeStart(X[k], Y[k], off_m[k]) for k in np.argsort(-_score(off_m), kind="stable")[:count]]
    return _choose_different(found, count)


def measure_distances_to_hypotheses(T_sensor_object: Poses, hypotheses: Sequence[Poses], metric: PoseMetric) -> Floats:
    """Return surface distances (B, N), metres, from poses (B, N, 4, 4) to each touch's nearest hypothesis."""
    off_m = np.full(T_sensor_object.shape[:2], np.inf)
    for k, poses in enumerate(hypotheses):
        if len(poses) and len(off_m):
            points = metric.embed_orbits(T_sensor_object[:, k])[0]
            same = metric.embed_orbits(poses)
            off_m[:, k] = measure_distances(points, same.reshape(-1, same.shape[-1])).min(axis=1)
    return off_m


def _score(off_m: Floats) -> Floats:
    """Count the touches that agree, (...,), given distances (..., N), metres.

    The worse a touch agrees, the less it counts (MSAC).
    """
    return np.maximum(0.0, 1.0 - (off_m / AGREES_M) ** 2).sum(axis=-1)


def _choose_different(found: list[HandEyeStart], count: int) -> list[HandEyeStart]:
    best: list[HandEyeStart] = []
    for guess in sorted(found, key=lambda one: -_score(one.off_m)):
        X = guess.T_flange_sensor
        others = np.array([one.T_flange_sensor for one in best]).reshape(-1, 4, 4)
        rotated = rotation_angle(X[:3, :3].T @ others[:, :3, :3]) > ANOTHER_RAD
        moved = np.linalg.norm(X[:3, 3] - others[:, :3, 3], axis=1) > ANOTHER_M
        if len(best) < count and (rotated | moved).all():
            best.append(guess)
    return best


@dataclass(frozen=True, eq=False)
class _Nodes:
    """The nodes: all hypotheses with their equivalents by symmetry.

    `touch` (M,) are touch numbers. `flanges` and `poses` (M, 4, 4), metres, are the flange's and the object's poses.
    `own` are the indices of the hypotheses without the equivalents. Equivalents of a triple's first hypothesis are not
    tried, because the object's frame is arbitrary.
    """

    touch: Ints
    flanges: Poses
    poses: Poses
    own: Ints

    @classmethod
    def of(cls, T_base_flange: Poses, hypotheses: Sequence[Poses], metric: PoseMetric) -> _Nodes:
        """Make the nodes of touches at flange poses (N, 4, 4), each with its hypotheses (K, 4, 4), metres."""
        S = metric.object.symmetry.list_elements(TURN_RAD)
        most = max(1, MOST_SEEN // (len(S) * len(hypotheses)))
        poses = [(some[:most, None] @ S).reshape(-1, 4, 4) for some in hypotheses]
        touch = np.repeat(np.arange(len(poses)), [len(some) for some in poses])
        own = np.arange(0, len(touch), len(S))
        return cls(touch, T_base_flange[touch], np.concatenate(poses), own)

    def anchors(self) -> Iterator[int]:
        """Yield at most ANCHORS of the `own` nodes, first the nodes that are compatible with the most touches."""
        with_touches = [len(np.unique(self.touch[self._partners(k)])) for k in self.own]
        order = np.argsort(np.negative(with_touches), kind="stable")
        yield from (int(self.own[k]) for k in order[:ANCHORS] if with_touches[k] >= 2)

    def triples(self, anchor: int) -> Ints:
        """Return triples (B, 3) of the anchor and two nodes, pairwise compatible, of three touches.

        There are at most TRIANGLES, spread evenly from likely to unlikely hypotheses.
        """
        partners = self._partners(anchor)
        second, third = np.triu_indices(len(partners), 1)
        second, third = partners[second], partners[third]
        apart = self.touch[second] != self.touch[third]
        second, third = second[apart], third[apart]
        good = self._rotate_alike(second, third)
        second, third = second[good], third[good]
        good = self._agree(second, third)
        pairs = np.stack([second[good], third[good]], axis=1)
        pairs = pairs[np.linspace(0, len(pairs) - 1, min(TRIANGLES, len(pairs))).astype(int)]
        return np.concatenate([np.full((len(pairs), 1), anchor), pairs], axis=1)

    def _partners(self, k: int) -> Ints:
        """Return the nodes (P,) of other touches that are compatible with node k."""
        others = np.flatnonzero(self.touch != self.touch[k])
        others = others[self._rotate_alike(np.full(len(others), k), others)]
        return others[self._agree(np.full(len(others), k), others)]

    def _rotate_alike(self, first: Ints, second: Ints) -> Bools:
        """Return whether pairs of nodes rotated by about the same angle as their flanges: a quick first test."""
        angles = [
            np.arccos(np.clip(0.5 * (np.einsum("nij,nij->n", T[first, :3, :3], T[second, :3, :3]) - 1.0), -1.0, 1.0))
            for T in (self.flanges, self.poses)
        ]
        return np.asarray(np.abs(angles[0] - angles[1]) < ANGLE_RAD)

    def _agree(self, first: Ints, second: Ints) -> Bools:
        F, S = self.flanges, self.poses
        return screws_agree(F[first], F[second], S[first], S[second], ANGLE_RAD, SLIDE_M)
