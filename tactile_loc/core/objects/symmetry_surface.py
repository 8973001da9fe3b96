"""The surface of a mesh for symmetry detection: its moments, samples, errors of its facets, and distances to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tactile_loc.core.runtime.errors import ObjectError

_DENSE_COUNT = 40_000
_POINT_COUNT = 3_000
_PITCH_M, _MOST_CHECKED = 4e-4, 40_000  # distance and largest number of the points that find local features
_PATCH = 1.5  # pitches; a sensor sees two deviating points that are nearer than this, but not a single point
_FACETS = 1.5  # error of facets, as a multiple of the sagitta; it is larger on doubly curved surfaces than on cylinders
_EVENLY = (0.7548776662466927, 0.5698402909980532)  # its multiples fill a square: 1 / p, 1 / p^2, p^3 = p + 1
_FEW = 500  # most points for which the closest search is fast enough
_NEAR = 24  # number of samples around a point whose facets count; they are within about a millimetre
_SMOOTH_RAD = math.radians(25.0)  # a smaller bend belongs to a curve with at least 15 facets per turn, not to an edge
_CURVE_EDGES = 12  # fewer such bends are draft angles and chamfers, not a tessellated curve


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """Points (N, 3), metres, of a surface, relative to its centroid, and the facets' errors there (N,), metres."""

    points_m: NDArray[np.float64]
    open_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.points_m)

    def first(self, count: int) -> SurfaceSample:
        """Return the first `count` points."""
        return SurfaceSample(self.points_m[:count], self.open_m[:count])


class SurfaceProbe:
    """Measures distances of points from a mesh's surface, and of a rotated surface from itself.

    All coordinates are in metres, relative to the surface's centroid `centre_m` (3,). Results depend on the surface,
    and hardly on its triangulation. Raises ObjectError if the mesh has no area or vertices that are not finite.
    """

    def __init__(self, vertices_m: NDArray[np.float64], faces: NDArray[np.int64], seed: int = 0) -> None:
        corners = _require_triangles(vertices_m, faces)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        doubled_area = np.linalg.norm(normals, axis=1)
        kept = doubled_area > 1e-12 * doubled_area.sum()
        self._area = doubled_area[kept] / 2.0
        self._normals = normals[kept] / doubled_area[kept, None]
        self.centre_m = np.average(corners[kept].mean(axis=1), axis=0, weights=self._area)
        self._corners = corners[kept] - self.centre_m
        self.radius_m = float(np.linalg.norm(self._corners, axis=2).max())
        self._open_m = self._estimate_open_m()
        rng = np.random.default_rng(seed)
        dense, self._dense_face = self._sample(_DENSE_COUNT, rng, at_least=1)
        self._tree = cKDTree(dense)
        points, face = self._sample(_POINT_COUNT, rng, at_least=0)
        order = rng.permutation(len(points))
        self.few = SurfaceSample(points[order], self._open_m[face[order]])  # the first few cover the surface evenly
        count = int(np.clip(self._area.sum() / _PITCH_M**2, 1, _MOST_CHECKED))
        self._pitch_m = math.sqrt(self._area.sum() / count)
        points, face = self._sample(count, rng, at_least=0)
        self.many = SurfaceSample(points, self._open_m[face])  # dense enough for every feature

    def covariance_m2(self) -> NDArray[np.float64]:
        """Return the exact covariance (3, 3) of the surface about its centroid, square metres."""
        means = self._corners.mean(axis=1)
        corner_part = np.einsum("f,fci,fcj->ij", self._area, self._corners, self._corners)
        mean_part = np.einsum("f,fi,fj->ij", self._area, means, means)
        return (corner_part + 9.0 * mean_part) / (12.0 * self._area.sum())

    def declared_tolerance_m(self) -> float:
        """Return by how much, metres, the surface may differ from itself under a declared symmetry.

        This is 0.5 % of the object's length, which is twice the largest distance from the centroid. For a slender or
        flat object, it is 1 % of the smallest width, if that is less. The width is twice the standard deviation.
        """
        length_m = 2.0 * self.radius_m
        width_m = 2.0 * math.sqrt(max(float(np.linalg.eigvalsh(self.covariance_m2())[0]), 0.0))
        return max(min(0.005 * length_m, 0.01 * width_m), 1e-4 * length_m)

    def plane_residuals(
        self, points_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return heights (N,) of points (N, 3) above their nearest faces, and the normals (N, 3) of these faces.

        Also return which points (N,) are directly above their faces. All other points are nearest to an edge of a face.
        """
        squared_m2, face, _ = self._find_nearest_face(points_m, 4)
        normals = self._normals[face]
        height_m = np.einsum("ni,ni->n", points_m - self._corners[face, 0], normals)
        return height_m, normals, height_m**2 >= 0.99 * squared_m2

    def distance_m(self, points_m: NDArray[np.float64], candidates: int = 4) -> NDArray[np.float64]:
        """Return the distances (N,) of points (N, 3) to the faces of the `candidates` samples nearest to each point.

        Distances can be too large if triangles are long and thin.
        """
        return np.sqrt(self._find_nearest_face(points_m, candidates)[0])

    def deviation_m(
        self, points_m: NDArray[np.float64], open_m: NDArray[np.float64], exact_above_m: float, candidates: int = 256
    ) -> NDArray[np.float64]:
        """Return the distances (N,) of points (N, 3) from the surface, minus the facets' errors there.

        `open_m` (N,) are the facets' errors where the points were sampled. Deviations above `exact_above_m` are
        measured again with the faces of more samples, up to `candidates`. For many points, fewer samples are used.
        """
        deviation_m = self._measure_beyond_facets(points_m, open_m, 1)
        for more, most in ((4, len(points_m)), (_NEAR, len(points_m)), (256, _FEW)):
            far = np.flatnonzero(deviation_m > exact_above_m)
            if more <= candidates and 0 < len(far) <= most:
                deviation_m[far] = self._measure_beyond_facets(points_m[far], open_m[far], more)
        return deviation_m

    def patch_deviation_m(
        self, points_m: NDArray[np.float64], open_m: NDArray[np.float64], above_m: float
    ) -> tuple[float, int]:
        """Return the largest deviation that two neighbouring points share, and the index of one of these points.

        The points (N, 3) are those of the sample `many`, moved. A sensor does not see a single deviating point, because
        it is too small. Only deviations above `above_m` count. If no two neighbours deviate, the result is (0.0, 0).
        `open_m` is as for `deviation_m`.
        """
        deviation_m = self.deviation_m(points_m, open_m, above_m)
        far = np.flatnonzero(deviation_m > above_m)
        pairs = cKDTree(points_m[far]).query_pairs(_PATCH * self._pitch_m, output_type="ndarray")
        if len(pairs) == 0:
            return 0.0, 0
        both_m = deviation_m[far[pairs]].min(axis=1)
        return float(both_m.max()), int(far[pairs[both_m.argmax(), 0]])

    def _measure_beyond_facets(
        self, points_m: NDArray[np.float64], open_m: NDArray[np.float64], count: int
    ) -> NDArray[np.float64]:
        squared_m2, _, faces = self._find_nearest_face(points_m, count)
        here_m = self._open_m[faces[:, :_NEAR]].max(axis=1)
        return np.maximum(np.sqrt(squared_m2) - np.maximum(here_m, open_m), 0.0)

    def _find_nearest_face(
        self, points_m: NDArray[np.float64], count: int
    ) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.intp]]:
        """Return the squared distance (N,) of each point (N, 3) to its nearest face, and the index (N,) of this face.

        Also return the compared faces (N, C), which are those of the C samples nearest to each point.
        """
        faces = self._dense_face[self._tree.query(points_m, k=count)[1]].reshape(-1)
        repeated_m = np.repeat(points_m, count, axis=0)
        squared_m2 = _measure_squared_distance(repeated_m, self._corners[faces], self._normals[faces])
        squared_m2, faces = squared_m2.reshape(-1, count), faces.reshape(-1, count)
        nearest = squared_m2.argmin(axis=1)
        row = np.arange(len(nearest))
        return squared_m2[row, nearest], faces[row, nearest], faces

    def _sample(
        self, count: int, rng: np.random.Generator, at_least: int
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return points (N, 3), spread evenly over the surface, and their faces (N,).

        Each face has at least `at_least` points, 0 or 1.
        """
        steps = (np.arange(count) + rng.random(count)) / count
        cumulated = np.cumsum(self._area)
        face = np.searchsorted(cumulated, steps * cumulated[-1]).clip(max=len(cumulated) - 1)
        if at_least:
            face = np.concatenate([face, np.flatnonzero(np.bincount(face, minlength=len(cumulated)) == 0)])
        u, v = (rng.random((2, 1)) + np.outer(_EVENLY, np.arange(len(face)))) % 1.0
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        weights = np.stack([1 - u - v, u, v], axis=1)
        return np.einsum("nc,nci->ni", weights, self._corners[face]), face

    def _estimate_open_m(self) -> NDArray[np.float64]:
        """Return an estimate (F,) of the distance between each face and the curved surface that it approximates.

        The distance is a multiple of the facets' sagitta, (width / 2) tan(bend / 4), at bends between faces. It is at
        most 1 % of the object's length. The few bends with the largest sagitta are taken for edges of the object.
        """
        first, second, length_m = _find_shared_edges(self._corners, 1e-7 * self.radius_m)
        cosine = np.abs(np.einsum("ei,ei->e", self._normals[first], self._normals[second]))
        bend_rad = np.arccos(np.clip(cosine, 0.0, 1.0))
        width_m = 2.0 * np.minimum(self._area[first], self._area[second]) / length_m
        sagitta_m = np.where(bend_rad < _SMOOTH_RAD, 0.5 * width_m * np.tan(bend_rad / 4.0), 0.0)
        of_face_m = np.zeros(len(self._area))
        if len(sagitta_m) >= _CURVE_EDGES:
            most_m = min(float(np.sort(sagitta_m)[-_CURVE_EDGES]), 0.01 * 2.0 * self.radius_m / _FACETS)
            for face in (first, second):
                np.maximum.at(of_face_m, face, np.minimum(sagitta_m, most_m))
        return _FACETS * of_face_m


def _require_triangles(vertices_m: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the corners (F, 3, 3) of the triangles. Raises ObjectError if the mesh has no surface."""
    vertices_m, faces = np.asarray(vertices_m, dtype=np.float64), np.asarray(faces)
    if vertices_m.ndim != 2 or vertices_m.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise ObjectError(f"a mesh has vertices {vertices_m.shape} and faces {faces.shape}; give (V, 3) and (F, 3)")
    if faces.min() < 0 or faces.max() >= len(vertices_m):
        raise ObjectError(f"the mesh has {len(vertices_m)} vertices, but its faces name others; export it again")
    corners = vertices_m[faces]
    if not np.isfinite(corners).all():
        raise ObjectError("the mesh has vertices that are not finite numbers; repair or export it again")
    if not np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any():
        raise ObjectError("the mesh has no area: all of its triangles are degenerate; export it again")
    return corners


def _find_shared_edges(
    corners: NDArray[np.float64], merge_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Return the first and second face, (E,) each, and the length (E,) of each edge that exactly two faces share."""
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


def _measure_squared_distance(
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
