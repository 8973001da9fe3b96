"""A first guess of a sensor's mount: the one on which most touches agree, whatever hypotheses each of them has.

Two hypotheses of different touches go together if the part, seen from the sensor, moved by the same screw as the flange
did; three that do so pairwise give a mount (consensus in the manner of RANSAC, but of all triples that can be right
rather than of random ones), and all touches say how well they agree with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.hand_eye import predict, screws_agree, solve_closed_form
from tactile_loc.core.geometry.rigid import Poses, rotation_angle
from tactile_loc.core.poses.metric import PoseMetric, measure_distances

AGREES_M = 4e-3  # of surface between a hypothesis and where a mount predicts the object
ANGLE_RAD, SLIDE_M = np.radians(5.0), 5e-3  # by which the screws of hypotheses may differ
TURN_RAD = np.radians(6.0)  # between the turns of a continuous symmetry that are tried
MOST_SEEN = 20_000  # hypotheses, equivalents by symmetry included
ANCHORS, TRIANGLES = 100, 300  # hypotheses that are begun with, and triples tried of each
ANOTHER_M, ANOTHER_RAD = 8e-3, np.radians(15.0)  # mounts that differ by more are different guesses
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MountGuess:
    """A mount T_flange_sensor (4, 4) and T_base_object (4, 4), metres, and how far off the N touches are.

    `off_m` (N,), metres of surface, is each one's nearest hypothesis from where the mount predicts the object.
    """

    T_flange_sensor: Floats
    T_base_object: Floats
    off_m: Floats

    @property
    def agreeing(self) -> NDArray[np.bool_]:
        """Which touches (N,) have a hypothesis that agrees."""
        return self.off_m < AGREES_M

    @property
    def score(self) -> float:
        """How many touches agree, those that agree less well counted less."""
        return float(_score(self.off_m))

    def is_another(self, other: MountGuess) -> bool:
        """Whether the other guess is of another mount."""
        X, Y = self.T_flange_sensor, other.T_flange_sensor
        turned = float(rotation_angle(X[:3, :3].T @ Y[:3, :3]))
        return turned > ANOTHER_RAD or float(np.linalg.norm(X[:3, 3] - Y[:3, 3])) > ANOTHER_M


def guess_mounts(
    T_base_flange: Poses, hypotheses: Sequence[Poses], metric: PoseMetric, count: int,
    allowed: Callable[[Poses], NDArray[np.bool_]] | None = None,
) -> list[MountGuess]:  # fmt: skip
    """Return at most `count` different mounts on which touches agree, the one with the most first; maybe none.

    `T_base_flange` (N, 4, 4), metres; `hypotheses` are the poses T_sensor_object (K, 4, 4) of each of N touches, the
    likeliest first; `allowed` says (B,) which mounts T_flange_sensor (B, 4, 4) are to be considered.
    """
    nodes = _Nodes.of(T_base_flange, hypotheses, metric)
    found: list[MountGuess] = []
    for anchor in nodes.anchors():
        triples = nodes.triples(anchor)
        if not len(triples):
            continue
        X, Y = solve_closed_form(T_base_flange[nodes.touch[triples]], nodes.poses[triples])
        if allowed is not None:
            right = allowed(X)
            X, Y = X[right], Y[right]
        off_m = measure_distances_to_hypotheses(predict(T_base_flange, X, Y), hypotheses, metric)
        found += [MountGuess(X[k], Y[k], off_m[k]) for k in np.argsort(-_score(off_m), kind="stable")[:count]]
    return _choose_different(found, count)


def measure_distances_to_hypotheses(T_sensor_object: Poses, hypotheses: Sequence[Poses], metric: PoseMetric) -> Floats:
    """Return how far (B, N), metres of surface, poses (B, N, 4, 4) are from the nearest hypothesis of each touch."""
    off_m = np.full(T_sensor_object.shape[:2], np.inf)
    for k, poses in enumerate(hypotheses):
        if len(poses) and len(off_m):
            points = metric.embed_orbits(T_sensor_object[:, k])[0]
            same = metric.embed_orbits(poses)
            off_m[:, k] = measure_distances(points, same.reshape(-1, same.shape[-1])).min(axis=1)
    return off_m


def _score(off_m: Floats) -> Floats:
    """How many touches agree, (...,) of (..., N), those that agree less well counted less (MSAC)."""
    return np.maximum(0.0, 1.0 - (off_m / AGREES_M) ** 2).sum(axis=-1)


def _choose_different(found: list[MountGuess], count: int) -> list[MountGuess]:
    best: list[MountGuess] = []
    for guess in sorted(found, key=lambda one: -one.score):
        if len(best) == count:
            break
        if all(guess.is_another(better) for better in best):
            best.append(guess)
    return best


@dataclass(frozen=True, eq=False)
class _Nodes:
    """All hypotheses with their equivalents by symmetry: the number of the touch (M,), its flange's pose, the pose.

    `own` are those that stand for themselves: one of a triple needs no equivalents, for the object's frame may be any.
    """

    touch: Ints
    flanges: Poses
    poses: Poses
    own: Ints

    @classmethod
    def of(cls, T_base_flange: Poses, hypotheses: Sequence[Poses], metric: PoseMetric) -> _Nodes:
        S = metric.object.symmetry.list_elements(TURN_RAD)
        most = max(1, MOST_SEEN // (len(S) * len(hypotheses)))
        poses = [(some[:most, None] @ S).reshape(-1, 4, 4) for some in hypotheses]
        touch = np.repeat(np.arange(len(poses)), [len(some) for some in poses])
        own = np.arange(0, len(touch), len(S))
        return cls(touch, T_base_flange[touch], np.concatenate(poses), own)

    def anchors(self) -> Iterator[int]:
        """The own nodes that go together with those of most touches, at most ANCHORS."""
        with_touches = [len(np.unique(self.touch[self._partners(k)])) for k in self.own]
        order = np.argsort(np.negative(with_touches), kind="stable")
        yield from (int(self.own[k]) for k in order[:ANCHORS] if with_touches[k] >= 2)

    def triples(self, anchor: int) -> Ints:
        """The triples (B, 3) of nodes that go together pairwise, at most TRIANGLES, of three touches, with the anchor.

        The likelier hypotheses come first.
        """
        partners = self._partners(anchor)
        second, third = np.triu_indices(len(partners), 1)
        second, third = partners[second], partners[third]
        apart = self.touch[second] != self.touch[third]
        second, third = second[apart], third[apart]
        good = self._turned_alike(second, third)
        second, third = second[good], third[good]
        good = self._agree(second, third)
        pairs = np.stack([second[good], third[good]], axis=1)
        pairs = pairs[np.linspace(0, len(pairs) - 1, min(TRIANGLES, len(pairs))).astype(int)]
        return np.concatenate([np.full((len(pairs), 1), anchor), pairs], axis=1)

    def _partners(self, k: int) -> Ints:
        """The nodes (P,) of other touches that go together with one."""
        others = np.flatnonzero(self.touch != self.touch[k])
        one = np.full(len(others), k)
        others = others[self._turned_alike(one, others)]
        return others[self._agree(np.full(len(others), k), others)]

    def _turned_alike(self, first: Ints, second: Ints) -> NDArray[np.bool_]:
        """Whether pairs of nodes turned by about the same angle as their flanges: asked first, it takes no product."""
        angles = [
            np.arccos(np.clip(0.5 * (np.einsum("nij,nij->n", T[first, :3, :3], T[second, :3, :3]) - 1.0), -1.0, 1.0))
            for T in (self.flanges, self.poses)
        ]  # fmt: skip
        return np.asarray(np.abs(angles[0] - angles[1]) < ANGLE_RAD)

    def _agree(self, first: Ints, second: Ints) -> NDArray[np.bool_]:
        F, S = self.flanges, self.poses
        return screws_agree(F[first], F[second], S[first], S[second], ANGLE_RAD, SLIDE_M)
