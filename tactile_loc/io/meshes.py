"""Reading a mesh file into an ObjectModel: formats, units and symmetry. trimesh is imported when a file is read."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ObjectError, did_you_mean
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh, check_surface
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.data import DEMO_OBJECTS

log = logging.getLogger(__name__)

Units = Literal["m", "mm", "cm", "inch", "auto"]
METRES_PER_UNIT: dict[str, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "inch": 0.0254}

ARCHIVES = (".zip", ".gz", ".bz2", ".xz", ".tar")  # which could inflate without end

_detected: dict[str, SymmetryGroup] = {}  # by the surface's digest: a sweep opens the same file again and again


class Surface(NamedTuple):
    """What a mesh file holds, in the file's unit: `vertices` (V, 3) and triangles `faces` (F, 3); do they close?"""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    is_watertight: bool


def read_surface(path: Path) -> Surface:
    """Read and merge the triangles of a mesh file. Raises ObjectError when there is none, or nothing in it."""
    if not os.path.isfile(path):
        if os.path.isdir(path):
            raise ObjectError(f"{path} is a folder; give one mesh file")
        near = did_you_mean(str(path), DEMO_OBJECTS)
        raise ObjectError(
            f"there is no mesh file at {path}; check the path.{near} Demo objects: {', '.join(DEMO_OBJECTS)}"
        )
    if path.suffix.lower() in ARCHIVES:
        raise ObjectError(f"{path} is an archive; unpack it, and give the mesh that is in it")
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            raw = trimesh.load(path, force="mesh", process=False)
    except Exception as error:
        raise ObjectError(f"{path} cannot be read as a mesh ({_summarize(error)}); give an STL, OBJ or PLY") from error
    if not isinstance(raw, trimesh.Trimesh):
        raise ObjectError(f"{path} is no surface mesh; export it as one")
    _require_surface(np.asarray(raw.vertices), np.asarray(raw.faces), path)
    plain = trimesh.Trimesh(raw.vertices, raw.faces, process=False)  # textures and normals would part vertices
    plain.merge_vertices()
    plain.update_faces(plain.nondegenerate_faces(height=0))
    plain.remove_unreferenced_vertices()  # strays would enlarge the box that bounds where the object can touch
    if len(plain.faces) == 0:
        raise ObjectError(f"{path} has zero extent: all its faces are points or lines; export the mesh again")
    return Surface(np.asarray(plain.vertices, float), np.asarray(plain.faces, np.int64), bool(plain.is_watertight))


def _require_surface(vertices: NDArray[Any], faces: NDArray[Any], path: Path) -> None:
    """Raise ObjectError unless these are finite vertices (V, 3), and triangles (F, 3), one at least, of them."""
    if len(faces) == 0:
        raise ObjectError(f"{path} is an empty mesh or no surface mesh: it has no faces; export it as a surface mesh")
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        raise ObjectError(f"{path} has vertices or faces that are not of three numbers; export the mesh again")
    if not np.isfinite(vertices).all():
        raise ObjectError(f"{path} has vertices that are NaN or infinite; repair or export the mesh again")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ObjectError(
            f"{path} has faces of vertices that it does not have: it holds {len(vertices)}, and they name number "
            f"{faces.min()} to {faces.max()}; export the mesh again"
        )


def find_symmetry(declared: str, mesh: TriangleMesh) -> SymmetryGroup:
    """Return the symmetry of a surface, found if declared "auto", else read and checked. Raises SymmetryError."""
    from tactile_loc.core.objects.symmetry_detection import detect_symmetry, require_symmetry

    if declared == "auto":
        if mesh.digest not in _detected:
            _detected[mesh.digest] = detect_symmetry(mesh.vertices_m, mesh.faces)
        return _detected[mesh.digest]
    group = SymmetryGroup.parse(declared, mesh.centroid_m)
    if not group.is_trivial:
        require_symmetry(group, mesh.vertices_m, mesh.faces)
    return group


def load_object(
    path: str | Path, units: Units = "auto", symmetry: str = "auto", name: str | None = None,
    read: Callable[[Path], Surface] = read_surface,
    judge: Callable[[str, TriangleMesh], SymmetryGroup] = find_symmetry,
) -> ObjectModel:  # fmt: skip
    """Read any mesh format that trimesh reads, or a demo object by its name, and return the object in metres.

    `units` is the file's unit; "auto" guesses it from the size and notes what it guessed. `symmetry` is declared
    ("none", "z2", "z6*x2", "zinf", ...) and checked against the surface, or "auto" to detect it. What was guessed or
    looks doubtful is in the result's `notes` and logged as a warning. `read` is what reads the file, `judge` what finds
    or checks the symmetry. Raises ObjectError or SymmetryError.
    """
    demo = DEMO_OBJECTS.get(str(path))
    if demo is not None and not os.path.isfile(path):
        path, units = demo.path, "m"
        symmetry = demo.symmetry if symmetry == "auto" else symmetry
    path = Path(path)
    name = name or path.stem
    surface = read(path)
    scale, notes = _find_scale(surface, units, path.name)
    mesh = TriangleMesh(surface.vertices * scale, surface.faces)
    check_surface(mesh, path.name)
    if not surface.is_watertight:
        notes.append(f"{path.name} is not watertight; touches are rendered from the faces it has")
    group = judge(symmetry, mesh)
    if symmetry == "auto" and not group.is_trivial:
        notes.append(f"symmetry found: {group} (say --symmetry to be sure)")
    for note in notes:
        log.warning(note)
    return ObjectModel(name, mesh, group, tuple(notes), str(path))


def _find_scale(surface: Surface, units: str, name: str) -> tuple[float, list[str]]:
    """Return metres per file unit, and what was guessed.

    Parts that a hand-sized sensor touches are 4 mm to 1 m long: a number below 1 is read as metres, others as mm.
    """
    if units not in get_args(Units):
        raise ObjectError(f"unknown unit {units!r} for {name}; give one of {', '.join(get_args(Units))}")
    if units != "auto":
        return METRES_PER_UNIT[units], []
    size = float(np.ptp(surface.vertices, axis=0).max())
    guess = "m" if size < 1.0 else "mm"
    scale = METRES_PER_UNIT[guess]
    return scale, [
        f"{name} is {size:.4g} units long; guessed {guess}, so {size * scale * 1e3:.4g} mm "
        "(say --units to be sure)"
    ]  # fmt: skip


def _summarize(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]


def simplify_mesh(mesh: TriangleMesh, faces: int) -> TriangleMesh:
    """Return the surface with about so many faces, by quadric error metrics; open3d's."""
    import open3d as o3d

    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices_m), o3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    )
    fewer: Any = whole.simplify_quadric_decimation(faces)
    return TriangleMesh(np.asarray(fewer.vertices, float), np.asarray(fewer.triangles, np.int64))
