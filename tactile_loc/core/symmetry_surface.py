"""The surface of a mesh as symmetry detection sees it: moments, samples, tolerance, distance to the surface."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tactile_loc.core.errors import ObjectError

_DENSE_COUNT = 40_000
_POINT_COUNT = 3_000
_SMOOTH_RAD = math.radians(25.0)  # a bend below this is a facet of a curve, not an edge: 15 facets and more to a turn
_CURVE_EDGES = 12  # fewer such bends are draft angles and chamfers, not a tessellated curve


class SurfaceProbe:
    """Answers how far points lie from a mesh's surface, and how far a rotated surface lies from itself.

    Everything is about the area centroid `centre_m` (3,) of the surface, in metres. The answers depend on the surface,
    hardly on how it is cut into triangles. Raises ObjectError for a mesh without area or with non-finite vertices.
    """

    def __init__(self, vertices_m: NDArray[np.float64], faces: NDArray[np.int64], seed: int = 0) -> None:
        corners = _triangles(vertices_m, faces)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        doubled_area = np.linalg.norm(normals, axis=1)
        kept = doubled_area > 1e-12 * doubled_area.sum()
        self._area = doubled_area[kept] / 2.0
        self._normals = normals[kept] / doubled_area[kept, None]
        self.centre_m = np.average(corners[kept].mean(axis=1), axis=0, weights=self._area)
        self._corners = corners[kept] - self.centre_m
        self.radius_m = float(np.linalg.norm(self._corners, axis=2).max())
        rng = np.random.default_rng(seed)
        dense, self._dense_face = self._sample(_DENSE_COUNT, rng, at_least=1)
        self._tree = cKDTree(dense)
        points, _ = self._sample(_POINT_COUNT, rng, at_least=0)
        self.points_m = points[rng.permutation(len(points))]  # any first few cover the surface evenly

    def covariance_m2(self) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of the surface about its centroid, integrated exactly, in square metres."""
        means = self._corners.mean(axis=1)
        corner_part = np.einsum("f,fci,fcj->ij", self._area, self._corners, self._corners)
        mean_part = np.einsum("f,fi,fj->ij", self._area, means, means)
        return (corner_part + 9.0 * mean_part) / (12.0 * self._area.sum())

    def default_tolerance_m(self) -> float:
        """Return how far a surface may differ from itself: 0.5 % of its length, or less on a slender or flat object.

        Length is twice the largest distance from the centroid; a slender object's tolerance is 1 % of its smallest
        width (twice the standard deviation). It is never below one and a half times the chordal error of the
        tessellation, so that a cylinder of 16 facets or more is round, which may raise it to 1 % of the length.
        """
        length_m = 2.0 * self.radius_m
        width_m = 2.0 * math.sqrt(max(float(np.linalg.eigvalsh(self.covariance_m2())[0]), 0.0))
        chordal_m = min(1.5 * self._chordal_error_m(), 0.01 * length_m)
        return max(min(0.005 * length_m, 0.01 * width_m), chordal_m, 1e-4 * length_m)

    def plane_residuals(
        self, points_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return for points (N, 3) how far above the nearest face (N,), its normal (N, 3), and if straight above (N,).

        A point that is not straight above its nearest face is nearest to one of its edges.
        """
        squared_m2, face = self._nearest_face(points_m, 4)
        normals = self._normals[face]
        height_m = np.einsum("ni,ni->n", points_m - self._corners[face, 0], normals)
        return height_m, normals, height_m**2 >= 0.99 * squared_m2

    def distance_m(
        self, points_m: NDArray[np.float64], exact_above_m: float, candidates: int = 4
    ) -> NDArray[np.float64]:
        """Return the distances (N,) of points (N, 3) to the faces of the nearest samples, `candidates` for each.

        They may be too large, where triangles are slivers. Those above `exact_above_m` are looked at again among more
        and, if they are few, so that the surfaces may agree, among very many candidates.
        """
        distance_m = np.sqrt(self._nearest_face(points_m, candidates)[0])
        for more, share in ((24, 1.0), (256, 0.1)):
            far = np.flatnonzero(distance_m > exact_above_m)
            if 0 < len(far) <= share * len(points_m):
                distance_m[far] = np.sqrt(self._nearest_face(points_m[far], more)[0])
        return distance_m

    def _nearest_face(self, points_m: NDArray[np.float64], count: int) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return the squared distances (N,) to and indices (N,) of the nearest of the faces of the nearest samples."""
        faces = self._dense_face[self._tree.query(points_m, k=count)[1]].reshape(-1)
        repeated_m = np.repeat(points_m, count, axis=0)
        squared_m2 = _squared_distance(repeated_m, self._corners[faces], self._normals[faces]).reshape(-1, count)
        nearest = squared_m2.argmin(axis=1)
        row = np.arange(len(nearest))
        return squared_m2[row, nearest], faces.reshape(-1, count)[row, nearest]

    def _sample(
        self, count: int, rng: np.random.Generator, at_least: int
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return points (N, 3) spread over the area and their faces (N,), with `at_least` so many on every face."""
        steps = (np.arange(count) + rng.random(count)) / count
        cumulated = np.cumsum(self._area)
        face = np.searchsorted(cumulated, steps * cumulated[-1]).clip(max=len(cumulated) - 1)
        if at_least:
            face = np.concatenate([face, np.flatnonzero(np.bincount(face, minlength=len(cumulated)) == 0)])
        u, v = rng.random((2, len(face)))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        weights = np.stack([1 - u - v, u, v], axis=1)
        return np.einsum("nc,nci->ni", weights, self._corners[face]), face

    def _chordal_error_m(self) -> float:
        """Estimate the sagitta of the facets that stand for a curve: (width / 2) tan(bend / 4) at its larger ones."""
        first, second, length_m = _shared_edges(self._corners, 1e-7 * self.radius_m)
        cosine = np.abs(np.einsum("ei,ei->e", self._normals[first], self._normals[second]))
        bend_rad = np.arccos(np.clip(cosine, 0.0, 1.0))
        width_m = 2.0 * np.minimum(self._area[first], self._area[second]) / length_m
        sagitta_m = np.where(bend_rad < _SMOOTH_RAD, 0.5 * width_m * np.tan(bend_rad / 4.0), 0.0)
        return float(np.sort(sagitta_m)[-_CURVE_EDGES]) if len(sagitta_m) >= _CURVE_EDGES else 0.0


def _triangles(vertices_m: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the corners (F, 3, 3) of the triangles, or raise ObjectError for a mesh without a surface."""
    vertices_m, faces = np.asarray(vertices_m, dtype=np.float64), np.asarray(faces)
    if vertices_m.ndim != 2 or vertices_m.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise ObjectError(f"A mesh needs vertices (V, 3) and faces (F, 3), not {vertices_m.shape} and {faces.shape}.")
    if faces.min() < 0 or faces.max() >= len(vertices_m):
        raise ObjectError(f"The mesh has {len(vertices_m)} vertices, but its faces name others.")
    corners = vertices_m[faces]
    if not np.isfinite(corners).all():
        raise ObjectError("The mesh has vertices that are not finite numbers: repair it.")
    if not np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any():
        raise ObjectError("The mesh has no area: all of its triangles are degenerate.")
    return corners


def _shared_edges(
    corners: NDArray[np.float64], merge_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Return the two faces (E,), (E,) on either side of each edge between just two, and the edges' lengths (E,)."""
    cells = np.round(corners.reshape(-1, 3) / merge_m).astype(np.int64)
    hashed = (cells * np.array([1, 1_000_003, 998_244_353_000_003], dtype=np.int64)).sum(axis=1)
    vertex = np.unique(hashed, return_inverse=True)[1].reshape(-1, 3)
    edges = np.sort(np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, edge, count = np.unique(edges[:, 0] * (vertex.max() + 1) + edges[:, 1], return_inverse=True, return_counts=True)
    sides = np.argsort(edge, kind="stable")
    pairs = sides[(count == 2)[edge[sides]]].reshape(-1, 2)
    ends = (np.roll(corners, -1, axis=1) - corners).reshape(-1, 3)[pairs[:, 0]]
    length_m = np.maximum(np.linalg.norm(ends, axis=1), merge_m)
    return pairs[:, 0] // 3, pairs[:, 1] // 3, length_m


def _squared_distance(
    points: NDArray[np.float64], corners: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the squared distances (N,) of points (N, 3) to triangles (N, 3, 3) with unit normals (N, 3)."""
    offsets = points[:, None] - corners
    edges = np.roll(corners, -1, axis=1) - corners
    outward = np.cross(edges, normals[:, None])
    outside = np.flatnonzero((np.einsum("nci,nci->nc", outward, offsets) > 0.0).any(axis=1))
    squared = np.asarray(np.einsum("ni,ni->n", offsets[:, 0], normals) ** 2)
    offsets, edges = offsets[outside], edges[outside]
    lengths2 = np.maximum(np.einsum("nci,nci->nc", edges, edges), 1e-300)
    fraction = np.clip(np.einsum("nci,nci->nc", offsets, edges) / lengths2, 0.0, 1.0)
    to_edges = offsets - fraction[..., None] * edges
    squared[outside] = np.einsum("nci,nci->nc", to_edges, to_edges).min(axis=1)
    return squared
