"""Parts with a planted difference: a burr, a dent, a closed hole, a shifted boss or a worn edge."""

from dataclasses import dataclass

import numpy as np
import trimesh
from manifold3d import Manifold, Mesh

from tactile_loc import ObjectModel, TriangleMesh

KINDS = ("burr", "dent", "closed hole", "shifted boss", "worn edge")
CAP_MM, HOLE_MM, BOSS_MM, WEAR_MM = 0.8, 1.0, (1.2, 0.5), 4.0


@dataclass(frozen=True, eq=False)
class Spot:
    """A point (3,), metres, of a part's surface, the outward normal there, and a direction along the surface."""

    point_m: np.ndarray
    normal: np.ndarray
    along: np.ndarray

    @classmethod
    def draw(cls, obj: ObjectModel, rng: np.random.Generator, edge: bool) -> "Spot":
        """Return a random point of the surface, or the middle of a random sharp, convex and long `edge`."""
        mesh = trimesh.Trimesh(obj.mesh.vertices_m, obj.mesh.faces)
        mesh.merge_vertices()
        ends = mesh.vertices[mesh.face_adjacency_edges]
        long_m = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        sharp = mesh.face_adjacency_convex & (mesh.face_adjacency_angles > 0.7) & (long_m > 1e-3 * WEAR_MM)
        if edge and sharp.any():
            number = rng.choice(np.flatnonzero(sharp))
            (a, b), normal = ends[number], mesh.face_normals[mesh.face_adjacency[number]].sum(axis=0)
            point = (a + b) / 2
        else:
            number = rng.choice(len(mesh.faces), p=mesh.area_faces / mesh.area_faces.sum())
            (a, b, c), normal = mesh.triangles[number], mesh.face_normals[number]
            point = rng.dirichlet([1, 1, 1]) @ [a, b, c]
        return cls(point, normal / np.linalg.norm(normal), (b - a) / np.linalg.norm(b - a))

    def place(self, solid: Manifold) -> Manifold:
        """Return a solid, mm, whose z is turned to the normal, its x along the surface, and its origin to the point."""
        axes = [self.along, np.cross(self.normal, self.along), self.normal, 1e3 * self.point_m]
        return solid.transform(np.column_stack(axes))


def alter(obj: ObjectModel, kind: str, size: float, spot: Spot) -> tuple[ObjectModel, ObjectModel]:
    """Return the part and its model, which differ by a size, mm, at a spot."""
    mesh = trimesh.Trimesh(1e3 * obj.mesh.vertices_m, obj.mesh.faces)
    mesh.merge_vertices()
    solid = Manifold(Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)))

    def model(made: Manifold) -> ObjectModel:
        found = made.to_mesh()
        vertices_m = 1e-3 * np.asarray(found.vert_properties[:, :3], float)
        return ObjectModel(obj.name, TriangleMesh(vertices_m, np.asarray(found.tri_verts, np.int64)), obj.symmetry)

    if kind in ("burr", "dent"):
        radius = (CAP_MM**2 + size**2) / (2 * size)
        ball = Manifold.sphere(radius, 96).translate([0, 0, (size - radius) * (1 if kind == "burr" else -1)])
        cap = spot.place(ball ^ Manifold.cylinder(max(1.2, 2.4 * size), CAP_MM, CAP_MM, 48, True))
        return model(solid + cap if kind == "burr" else solid - cap), obj
    if kind == "closed hole":
        hole = Manifold.cylinder(size + 2, HOLE_MM, HOLE_MM, 48).translate([0, 0, -size])
        return obj, model(solid - spot.place(hole))
    if kind == "shifted boss":
        boss = Manifold.cylinder(1.5 + BOSS_MM[1], BOSS_MM[0], BOSS_MM[0], 48).translate([0, 0, -1.5])
        return model(solid + spot.place(boss.translate([size, 0, 0]))), model(solid + spot.place(boss))
    return model(solid - spot.place(Manifold.cube([WEAR_MM, 4, 4], True).translate([0, 0, 2 - size]))), obj
