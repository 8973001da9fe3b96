"""The surface of a mesh for symmetry detection: its moments, samples, errors of its facets, and distances to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tactile_loc.core.geometry.rigid import Bools, Floats
from tactile_loc.core.objects.mesh import TriangleMesh, find_shared_sides

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

    points_m: Floats
    open_m: Floats

    def __len__(self) -> int:
        return len(self.points_m)

    def __getitem__(self, some: slice | NDArray[np.intp]) -> SurfaceSample:
        return SurfaceSample(self.points_m[some], self.open_m[some])

    def rotate(self, R: Floats, centre_m: Floats | float = 0.0) -> SurfaceSample:
        """Return the points rotated by R (3, 3) about a centre (3,), metres, by default the centroid."""
        return SurfaceSample((self.points_m - centre_m) @ R.T + centre_m, self.open_m)


class SurfaceProbe:
    """Measures distances of points from a mesh's surface, and of a rotated surface from itself.

    All coordinates are in metres, relative to the surface's centroid `centre_m` (3,). Results depend on the surface,
    and hardly on its triangulation.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        kept = mesh.face_areas > 1e-12 * mesh.face_areas.sum()
        self._area, self.centre_m, self.covariance_m2 = mesh.face_areas[kept], mesh.centroid_m, mesh.covariance_m2
        self._corners = mesh.triangles_m[kept] - self.centre_m
        normals = np.cross(self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0])
        self._normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self.radius_m = float(np.linalg.norm(self._corners, axis=2).max())
        self._open_m = self._estimate_open_m()
        rng = np.random.default_rng(0)
        dense, self._dense_face = self._sample(_DENSE_COUNT, rng, at_least=1)
        self._tree = cKDTree(dense)
        points, face = self._sample(_POINT_COUNT, rng, at_least=0)
        order = rng.permutation(len(points))
        self.few = SurfaceSample(points[order], self._open_m[face[order]])  # the first few cover the surface evenly
        count = int(np.clip(self._area.sum() / _PITCH_M**2, 1, _MOST_CHECKED))
        self._pitch_m = math.sqrt(self._area.sum() / count)
        points, face = self._sample(count, rng, at_least=0)
        self.many = SurfaceSample(points, self._open_m[face])  # dense enough for every feature

    def declared_tolerance_m(self) -> float:
        """Return by how much, metres, the surface may differ from itself under a declared symmetry.

        This is 0.5 % of the object's length, which is twice the largest distance from the centroid. For a slender or
        flat object, it is 1 % of the smallest width, if that is less. The width is twice the standard deviation.
        """
        length_m = 2.0 * self.radius_m
        width_m = 2.0 * math.sqrt(max(float(np.linalg.eigvalsh(self.covariance_m2)[0]), 0.0))
        return max(min(0.005 * length_m, 0.01 * width_m), 1e-4 * length_m)

    def plane_residuals(self, points_m: Floats) -> tuple[Floats, Floats, Bools]:
        """Return heights (N,) of points (N, 3) above their nearest faces, and the normals (N, 3) of these faces.

        Also return which points (N,) are directly above their faces. All other points are nearest to an edge of a face.
        """
        squared_m2, face, _ = self._find_nearest_face(points_m, 4)
        normals = self._normals[face]
        height_m = np.einsum("ni,ni->n", points_m - self._corners[face, 0], normals)
        return height_m, normals, height_m**2 >= 0.99 * squared_m2

    def distance_m(self, points_m: Floats, candidates: int = 4) -> Floats:
        """Return the distances (N,) of points (N, 3) to the faces of the `candidates` samples nearest to each point.

        Distances can be too large if triangles are long and thin.
        """
        return np.sqrt(self._find_nearest_face(points_m, candidates)[0])

    def deviation_m(self, moved: SurfaceSample, exact_above_m: float, candidates: int = 256) -> Floats:
        """Return the distances (N,) of a moved sample from the surface, minus the facets' errors there.

        Deviations above `exact_above_m` are measured again with the faces of more samples, up to `candidates`. For many
        points, fewer samples are used.
        """
        deviation_m = self._measure_beyond_facets(moved, 1)
        for more, most in ((4, len(moved)), (_NEAR, len(moved)), (256, _FEW)):
            far = np.flatnonzero(deviation_m > exact_above_m)
            if more <= candidates and 0 < len(far) <= most:
                deviation_m[far] = self._measure_beyond_facets(moved[far], more)
        return deviation_m

    def patch_deviation_m(self, moved: SurfaceSample, above_m: float) -> tuple[float, int]:
        """Return the largest deviation that two neighbouring points share, and the index of one of these points.

        The points are those of the sample `many`, moved. A sensor does not see a single deviating point, because it is
        too small. Only deviations above `above_m` count. If no two neighbours deviate, the result is (0.0, 0).
        """
        deviation_m = self.deviation_m(moved, above_m)
        far = np.flatnonzero(deviation_m > above_m)
        pairs = cKDTree(moved.points_m[far]).query_pairs(_PATCH * self._pitch_m, output_type="ndarray")
        if len(pairs) == 0:
            return 0.0, 0
        both_m = deviation_m[far[pairs]].min(axis=1)
        return float(both_m.max()), int(far[pairs[both_m.argmax(), 0]])

    def _measure_beyond_facets(self, moved: SurfaceSample, count: int) -> Floats:
        squared_m2, _, faces = self._find_nearest_face(moved.points_m, count)
        here_m = self._open_m[faces[:, :_NEAR]].max(axis=1)
        return np.maximum(np.sqrt(squared_m2) - np.maximum(here_m, moved.open_m), 0.0)

    def _find_nearest_face(self, points_m: Floats, count: int) -> tuple[Floats, NDArray[np.intp], NDArray[np.intp]]:
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

    def _sample(self, count: int, rng: np.random.Generator, at_least: int) -> tuple[Floats, NDArray[np.intp]]:
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

    def _estimate_open_m(self) -> Floats:
        """Return an estimate (F,) of the distance between each face and the curved surface that it approximates.

        The distance is a multiple of the facets' sagitta, (width / 2) tan(bend / 4), at bends between faces. It is at
        most 1 % of the object's length. The few bends with the largest sagitta are taken for edges of the object.
        """
        sides = find_shared_sides(self._corners)
        (first, second), ends = sides.T // 3, (np.roll(self._corners, -1, axis=1) - self._corners).reshape(-1, 3)
        length_m = np.maximum(np.linalg.norm(ends[sides[:, 0]], axis=1), 1e-7 * self.radius_m)
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


def _measure_squared_distance(points: Floats, corners: Floats, normals: Floats) -> Floats:
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
