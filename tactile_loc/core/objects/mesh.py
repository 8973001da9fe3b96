"""The known object: its surface, its symmetry, and points on its surface."""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.core.runtime.formatting import show_name

SMALLEST_M, LARGEST_M = 1e-3, 1.0


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A surface of triangles: `vertices_m` (V, 3), metres, in the object frame, and `faces` (F, 3) of indices."""

    vertices_m: Floats
    faces: Ints

    @cached_property
    def triangles_m(self) -> Floats:
        """The corners (F, 3, 3) of every face, metres."""
        return self.vertices_m[self.faces]

    @cached_property
    def face_areas(self) -> Floats:
        """Area (F,) of every face in square metres."""
        a, b, c = np.moveaxis(self.triangles_m, 1, 0)
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @cached_property
    def face_normals(self) -> Floats:
        """The unit normal (F, 3) of every face, or zero without area."""
        a, b, c = np.moveaxis(self.triangles_m, 1, 0)
        return np.asarray(np.cross(b - a, c - a) / np.maximum(2 * self.face_areas[:, None], 1e-30))

    @cached_property
    def vertex_normals(self) -> Floats:
        """The unit normal (V, 3) at each vertex: the area-weighted mean over its faces, or zero without faces."""
        a, b, c = np.moveaxis(self.triangles_m, 1, 0)
        normals = np.zeros_like(self.vertices_m)
        for corner in range(3):
            np.add.at(normals, self.faces[:, corner], np.cross(b - a, c - a))
        return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))

    @property
    def extents_m(self) -> Floats:
        """Size (3,) of the axis-aligned box around the surface, metres."""
        return np.ptp(self.vertices_m, axis=0)

    @cached_property
    def corners_m(self) -> Floats:
        """The vertices (V, 3) that belong to faces, metres."""
        return self.vertices_m[np.unique(self.faces)]

    @cached_property
    def hull_corners_m(self) -> Floats:
        """The corners (V, 3) of the surface's convex hull, metres; all vertices if the surface is flat."""
        from scipy.spatial import ConvexHull, QhullError  # scipy takes a while to import

        try:
            return np.asarray(self.corners_m[ConvexHull(self.corners_m).vertices])
        except QhullError:
            return self.corners_m

    def remember_hull(self, corners_m: Floats) -> None:
        """Take `hull_corners_m` (V, 3), metres, from an earlier computation with an equal mesh."""
        vars(self)["hull_corners_m"] = corners_m

    @cached_property
    def centroid_m(self) -> Floats:
        """Centroid (3,) of the surface, metres: exact, not sampled."""
        return np.average(self.triangles_m.mean(axis=1), axis=0, weights=self.face_areas)

    @cached_property
    def covariance_m2(self) -> Floats:
        """Covariance (3, 3) of the surface's points in square metres, exact.

        Over a triangle with corners v, the mean of p p^T is (sum v v^T + (sum v)(sum v)^T) / 12.
        """
        v = self.triangles_m - self.centroid_m
        s = v.sum(axis=1)
        moments = np.einsum("fki,fkj->fij", v, v) + np.einsum("fi,fj->fij", s, s)
        return np.einsum("f,fij->ij", self.face_areas, moments) / (12.0 * self.face_areas.sum())

    def sample(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw points (count, 3), metres, uniformly over the surface."""
        return self.sample_faces(count, rng)[0]

    def sample_faces(self, count: int, rng: np.random.Generator) -> tuple[Floats, Ints]:
        """Draw points (count, 3), metres, uniformly over the surface, each with the number (count,) of its face."""
        faces = rng.choice(len(self.faces), size=count, p=self.face_areas / self.face_areas.sum())
        a, b, c = np.moveaxis(self.triangles_m[faces], 1, 0)
        r, s = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
        return (1 - r) * a + r * (1 - s) * b + r * s * c, faces

    @cached_property
    def digest(self) -> str:
        """Hash of the surface, which identifies it in the store."""
        parts = (np.ascontiguousarray(self.vertices_m, "<f8"), np.ascontiguousarray(self.faces, "<i8"))
        return hashlib.sha256(b"".join(p.tobytes() for p in parts)).hexdigest()


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A known object: its surface, metres, the rotations that map the surface onto itself, and notes from loading.

    Raises ObjectError if the surface is empty, not finite, without extent or of an impossible size.
    """

    name: str
    mesh: TriangleMesh
    symmetry: SymmetryGroup
    notes: tuple[str, ...] = ()
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", show_name(self.name))
        check_surface(self.mesh, self.name)

    def describe(self) -> dict[str, object]:
        """Return what identifies the object, as JSON values: the digest of its surface, and its symmetry."""
        return {"mesh": self.mesh.digest, "symmetry": str(self.symmetry), "centre_m": self.symmetry.centre_m.tolist()}


def check_surface(mesh: TriangleMesh, name: str) -> None:
    """Raise ObjectError unless the surface, in metres, is valid and from 1 mm to 1 m long."""
    if len(mesh.faces) == 0 or len(mesh.vertices_m) == 0:
        raise ObjectError(f"{name} is an empty mesh: it has no faces; export it again as a surface mesh")
    if not np.isfinite(mesh.vertices_m).all():
        bad = int((~np.isfinite(mesh.vertices_m).all(axis=1)).sum())
        raise ObjectError(f"{name} has {bad} vertices that are NaN or infinite; repair or export the mesh again")
    if mesh.face_areas.sum() <= 0 or mesh.extents_m.max() <= 0:
        raise ObjectError(f"{name} has zero extent: all its faces are points or lines; export the mesh again")
    size = float(mesh.extents_m.max())
    if not SMALLEST_M <= size <= LARGEST_M:
        raise ObjectError(
            f"{name} is {size * 1e3:.4g} mm long, but objects from 1 mm to 1 m can be located, so its unit is probably "
            "wrong; give `units` m, mm, cm or inch"
        )


def find_shared_sides(corners: Floats) -> Ints:
    """Return the pairs (E, 2) of sides of triangles (F, 3, 3) that are the same edge, from different triangles.

    Side 3 f + k of triangle f leads from its corner k to the next one. Corners are the same if they are exactly equal.
    An edge of more than two triangles gives several pairs.
    """
    points = corners.reshape(-1, 3)
    order = np.lexsort(points.T)
    starts = np.r_[False, (np.diff(points[order], axis=0) != 0).any(axis=1)]
    which = np.empty(len(points), np.int64)
    which[order] = np.cumsum(starts)  # equal numbers for equal corners
    ends = np.sort(np.stack([which, np.roll(which.reshape(-1, 3), -1, axis=1).ravel()]), axis=0)
    edge = ends[0] * len(points) + ends[1]
    side = np.argsort(edge, kind="stable")
    edge, apart, pairs = edge[side], 0, [np.empty((0, 2), np.int64)]
    while (apart := apart + 1) < len(side) and (same := edge[apart:] == edge[:-apart]).any():
        pairs.append(np.column_stack([side[:-apart][same], side[apart:][same]]))
    return np.concatenate(pairs)
