"""The faces of mesh files: polygons with any number of corners, which become triangles."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.runtime.errors import ObjectError

FLAT = 1e-10  # of a polygon's squared size: a corner with a smaller area is straight
MERGED = 1e-8  # of the file's unit: vertices that are equal after rounding to it are one vertex
EXPORT_AGAIN = "export it again as a surface mesh"


class Polygons(NamedTuple):
    """The surface in a file: `vertices` (V, 3), and for each face the count of its corners, `counts` (F,).

    The vertex numbers of all faces follow each other in `corners` (C,).
    """

    vertices: Floats
    corners: Ints
    counts: Ints

    @classmethod
    def of_triangles(cls, vertices: ArrayLike, triangles: ArrayLike) -> Polygons:
        """Return a surface with vertices (V, 3) and triangles (F, 3)."""
        faces = np.asarray(triangles, np.int64).reshape(-1, 3)
        return cls(np.asarray(vertices, float), faces.ravel(), np.full(len(faces), 3))

    def require_valid(self, path: Path) -> None:
        """Raise ObjectError unless the vertices are finite and each face refers to vertices of the file."""
        if not (self.counts >= 3).any():
            raise ObjectError(f"{path} has no faces; {EXPORT_AGAIN}")
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise ObjectError(f"{path} has vertices without three numbers each; {EXPORT_AGAIN}")
        if not np.isfinite(self.vertices).all():
            raise ObjectError(f"{path} has vertices that are NaN or infinite; {EXPORT_AGAIN}")
        first, last = self.corners.min(), self.corners.max()
        if first < 0 or last >= len(self.vertices):
            raise ObjectError(
                f"{path} has {len(self.vertices)} vertices, but its faces use numbers {first} to {last}; {EXPORT_AGAIN}"
            )

    def triangulate(self, path: Path) -> Ints:
        """Return triangles (T, 3) that cover the faces, with the same vertices and orientation.

        Faces may be concave and slightly bent. Raises ObjectError if the outline of a face crosses itself.
        """
        starts, triangles = np.cumsum(self.counts) - self.counts, [np.empty((0, 3), np.int64)]
        for count in np.unique(self.counts[self.counts >= 3]):
            alike = np.flatnonzero(self.counts == count)
            faces = self.corners[starts[alike][:, None] + np.arange(count)]
            fans = np.stack([np.broadcast_to(faces[:, :1], faces[:, 2:].shape), faces[:, 1:-1], faces[:, 2:]], axis=-1)
            if count == 3:
                triangles.append(fans[:, 0])
                continue
            first, second, third = np.moveaxis(self.vertices[fans], 2, 0)
            areas = np.cross(second - first, third - first)  # (F, count - 2, 3); their sum is that of the polygon
            normals = areas.sum(axis=1)
            sizes = np.linalg.norm(normals, axis=1)
            along = np.einsum("fki,fi->fk", areas, normals / np.maximum(sizes, 1e-300)[:, None])
            fanned = (along > FLAT * sizes[:, None]).all(axis=1)
            triangles.append(fans[fanned].reshape(-1, 3))
            for index in np.flatnonzero(~fanned):
                clipped = list(_clip_ears(_flatten(self.vertices[faces[index]], normals[index])))
                if None in clipped:
                    raise ObjectError(
                        f"{path} has a face whose outline crosses itself: face {alike[index] + 1} with {count} "
                        "corners; correct it, or triangulate the faces when you export"
                    )
                triangles.append(faces[index][np.array(clipped, np.int64).reshape(-1, 3)])
        return np.concatenate(triangles)


def weld(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Merge equal vertices (V, 3) of triangles (F, 3). Drop triangles without area, and vertices without a triangle."""
    used, faces = _renumber(faces)
    rounded = (vertices[used] / MERGED).round()
    _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    kept, faces = _renumber(first[which.ravel()][faces])  # the first of equal vertices stands for them
    used = used[kept]
    a, b, c = np.moveaxis(vertices[used[faces]], 1, 0)
    left, faces = _renumber(faces[np.cross(b - a, c - a).any(axis=1)])
    return vertices[used[left]], faces


def _renumber(faces: Ints) -> tuple[Ints, Ints]:
    """Return the sorted numbers in triangles (F, 3), and the triangles with places in this list instead."""
    used, which = np.unique(faces, return_inverse=True)
    return used, which.reshape(-1, 3)


def check_closed(vertices: Floats, faces: Ints) -> tuple[bool, bool]:
    """Return whether triangles (F, 3) are a closed surface, and whether all of its triangles face inwards.

    A surface is closed if each edge belongs to two triangles.
    """
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    ends = np.array([len(vertices), 1])
    closed = bool((np.unique(np.sort(edges, axis=1) @ ends, return_counts=True)[1] == 2).all())
    if not closed or len(np.unique(edges @ ends)) < len(edges):  # two neighbours face opposite sides
        return closed, False
    a, b, c = np.moveaxis((vertices - vertices[0])[faces], 1, 0)
    return True, bool(np.einsum("fi,fi->", a, np.cross(b, c)) < 0.0)


def _flatten(points: Floats, normal: Floats) -> Floats:
    """Project a polygon (N, 3) along its normal (3,) to (N, 2), counterclockwise, and scale it to a length of 1."""
    centred = points - points.mean(axis=0)
    centred /= max(float(np.abs(centred).max()), 1e-300)
    if np.linalg.norm(normal) == 0.0:  # the polygon is a line, or crosses itself
        normal = np.linalg.svd(centred)[2][2]
    frame = np.linalg.svd(normal[None])[2]
    u, v = frame[1], np.cross(normal / np.linalg.norm(normal), frame[1])
    return np.stack([centred @ u, centred @ v], axis=1)


def _clip_ears(points: Floats) -> Iterator[tuple[int, int, int] | None]:
    """Yield the triangles of a counterclockwise polygon (N, 2); None if there are none, because it crosses itself.

    An ear is a corner whose triangle has a positive area and no other corner inside. Triangles that have positive areas
    cover a polygon exactly once, so the test for other corners only decides the order.
    """
    left = np.arange(len(points))
    while len(left) >= 3:
        a, b, c = (points[np.roll(left, shift)] for shift in (1, 0, -1))
        area = _cross(b - a, c - b)
        length2 = np.square(np.stack([b - a, c - b, a - c])).sum(axis=(0, 2))
        best = np.argsort(-area / np.maximum(length2, 1e-300), kind="stable")
        positive = best[area[best] > FLAT]
        straight = np.flatnonzero(np.abs(area) <= FLAT)
        folded = straight[np.einsum("ni,ni->n", b - a, c - b)[straight] <= 0.0]  # and repeated corners
        ears = (i for i in positive if not _is_entered(points[left], a[i], b[i], c[i]))
        ear = next((int(i) for corners in (folded, ears, straight, positive) for i in corners), None)
        if ear is None:
            yield None
            return
        if area[ear] > FLAT:
            yield int(left[ear - 1]), int(left[ear]), int(left[(ear + 1) % len(left)])
        left = np.delete(left, ear)


def _is_entered(points: Floats, a: Floats, b: Floats, c: Floats) -> bool:
    """Return whether one of points (N, 2) is in the triangle a, b, c or on its side from c to a, beside its corners."""
    inside = (_cross(b - a, points - a) > FLAT) & (_cross(c - b, points - b) > FLAT)
    inside &= _cross(a - c, points - c) >= -FLAT
    for corner in (a, c):
        inside &= (points != corner).any(axis=1)
    return bool(inside.any())


def _cross(u: Floats, v: Floats) -> Floats:
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
