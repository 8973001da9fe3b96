"""Surfaces of the parts: the union of their pieces, which the localizer and the tactile images use."""

from pathlib import Path

import trimesh
from shapes import Part

from tactile_loc.store.files import write_atomically


def build_surface(part: Part) -> trimesh.Trimesh:
    """Return the closed surface of a part, metres: the union of its convex pieces."""
    hulls = [trimesh.convex.convex_hull(piece) for piece in part.pieces]
    return trimesh.boolean.union(hulls, engine="manifold")


def write_mesh(part: Part, folder: Path) -> Path:
    """Write a part's surface as a PLY file in metres, and return the file's path."""
    path = folder / f"{part.name}.ply"
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda temporary: temporary.write_bytes(build_surface(part).export(file_type="ply")))
    return path
