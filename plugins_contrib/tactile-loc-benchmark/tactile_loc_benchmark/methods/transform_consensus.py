"""Registration by consensus: pairs of touched points vote for transforms, which are verified and refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tactile_loc.plugin import Poses, Touch
from tactile_loc.plugin.helpers import invert, make_transform, rotation_about

from tactile_loc_benchmark.interfaces import LocatingProblem, Method, ScoredPoses
from tactile_loc_benchmark.methods.surface_fit import FitOptions, SurfaceFit
from tactile_loc_benchmark.methods.touched_points import TouchedPoints, spread_indices

ANGLES = 15  # classes of an angle from 0 to 180 degrees, as in Drost et al.
TURNS = 30  # classes of the rotation about a normal
DISTANCES = 1 << 12  # more than the classes of any distance
SAMPLES = 20_000  # points of the surface from which the model's points are chosen
PEAKS = 20  # hypotheses of each reference point

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class TransformConsensus(Method):
    """A global registration by consensus, with the ideas of TacLoc (Zhang et al., 2026): correspondences of points
    support each other if distances and normals agree; hypotheses are verified with all points, and refined by ICP.

    TacLoc searches cliques in a graph of correspondences. We count the votes of pairs of points with normals instead
    (Drost et al., CVPR 2010). A vote is an edge of that graph, and the votes of one transform are a clique. This is our
    own program, with the sampling density and the classes of Drost et al.; TacLoc's own program may find more.
    """

    paper: ClassVar[str] = "TacLoc: Zhang et al., 2026; Drost et al., 2010"

    class Options(FitOptions):
        """The density of the model's points, and the number of touched points that vote."""

        spacing: float = Field(default=0.05, gt=0, lt=1, description="distance of model points, share of the size")
        references: int = Field(default=15, ge=1, description="number of touched points that get hypotheses")
        partners: int = Field(default=100, ge=2, description="number of touched points that vote for a hypothesis")

    def prepare(self, problem: LocatingProblem) -> None:
        """Build the table of the model's pairs, and the field of nearest surface points."""
        self._fit = SurfaceFit.of(problem.object, self.options)
        self._spacing_m = self.options.spacing * float(np.linalg.norm(problem.object.mesh.extents_m))
        samples_m, normals = self._fit.sample_surface(SAMPLES)
        some = _thin(samples_m, normals, self._spacing_m)
        self._table = PairTable.of(samples_m[some], normals[some], self._spacing_m)

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return the verified poses with the highest scores. Raises TouchError if no pose fits."""
        points = TouchedPoints.of(touches, self.options.points)
        partners = points.thin(self.options.partners)
        found = [
            self._table.vote(partners.points_m, partners.normals, i)
            for i in spread_indices(len(partners.points_m), self.options.references)
        ]
        return self._fit.find_best(invert(np.concatenate(found)), points, self._spacing_m)


@dataclass(frozen=True, eq=False)
class PairTable:
    """All pairs of M model points, sorted by the class of their features.

    `classes` (N,), sorted, are the classes of the pairs, `references` (N,) the number of the first point of each pair,
    and `turns_rad` (N,) the direction to the second point about the first point's normal. `T_local_object` (M, 4, 4),
    metres, brings each point to the origin, and its normal to x.
    """

    classes: Ints
    references: Ints
    turns_rad: Floats
    T_local_object: Poses
    spacing_m: float

    @classmethod
    def of(cls, points_m: Floats, normals: Floats, spacing_m: float) -> PairTable:
        """Build the table of points (M, 3), metres, with normals (M, 3)."""
        T = np.stack([_make_local_frame(p, n) for p, n in zip(points_m, normals, strict=True)])
        rows = [describe_pairs(points_m, normals, i, T[i], spacing_m) for i in range(len(points_m))]
        classes, turns_rad = (np.concatenate(part) for part in zip(*rows, strict=True))
        references = np.repeat(np.arange(len(points_m)), [len(row[0]) for row in rows])
        order = np.argsort(classes, kind="stable")
        return cls(classes[order], references[order], turns_rad[order], T, spacing_m)

    def vote(self, points_m: Floats, normals: Floats, i: int) -> Poses:
        """Return the transforms T_object_points (PEAKS, 4, 4), metres, with the most votes of pairs with point i."""
        T_local_points = _make_local_frame(points_m[i], normals[i])
        classes, turns_rad = describe_pairs(points_m, normals, i, T_local_points, self.spacing_m)
        first, last = (np.searchsorted(self.classes, classes, side) for side in ("left", "right"))
        count = last - first
        which = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
        turn = (self.turns_rad[which] - np.repeat(turns_rad, count)) % (2 * np.pi)
        cell = self.references[which] * TURNS + np.minimum((turn * TURNS / (2 * np.pi)).astype(np.int64), TURNS - 1)
        votes = np.bincount(cell, minlength=len(self.T_local_object) * TURNS)
        reference, turned = np.divmod(np.argsort(-votes, kind="stable")[:PEAKS], TURNS)
        R = rotation_about([1, 0, 0], (turned + 0.5) * 2 * np.pi / TURNS)
        return np.asarray(invert(self.T_local_object[reference]) @ make_transform(R, np.zeros(3)) @ T_local_points)


def describe_pairs(
    points_m: Floats, normals: Floats, i: int, T_local_points: Poses, spacing_m: float
) -> tuple[Ints, Floats]:
    """Return the classes (J,) of the pairs of point i with other points, and the directions to these, radians.

    The features of a pair are the distance, the angles of both normals with the line between the points, and the angle
    between the normals. A point nearer than half a spacing, metres, makes no pair.
    """
    line = points_m - points_m[i]
    length_m = np.linalg.norm(line, axis=1)
    far = length_m > 0.5 * spacing_m
    line, length_m, others = line[far], length_m[far], normals[far]
    cosines = [line @ normals[i] / length_m, np.einsum("ij,ij->i", line, others) / length_m, others @ normals[i]]
    classes = np.minimum((length_m / spacing_m).astype(np.int64), DISTANCES - 1)
    for cosine in cosines:
        angle = np.arccos(np.clip(cosine, -1, 1))
        classes = classes * ANGLES + np.minimum((angle * ANGLES / np.pi).astype(np.int64), ANGLES - 1)
    local = line @ T_local_points[:3, :3].T
    return classes, np.arctan2(local[:, 2], local[:, 1])


def _make_local_frame(point_m: Floats, normal: Floats) -> Poses:
    """Return the transform (4, 4), metres, that brings a point (3,) to the origin and its normal (3,) to x."""
    x = normal / np.linalg.norm(normal)
    y = np.cross(x, np.eye(3)[np.abs(x).argmin()])
    y /= np.linalg.norm(y)
    R = np.stack([x, y, np.cross(x, y)])
    return make_transform(R, -R @ point_m)


def _thin(points_m: Floats, normals: Floats, spacing_m: float) -> Ints:
    """Return the indices of one point in each cube with sides `spacing_m`, for each rough direction of the normals."""
    cells = np.column_stack([np.floor(points_m / spacing_m), np.round(normals)])
    return np.sort(np.unique(cells, axis=0, return_index=True)[1])
