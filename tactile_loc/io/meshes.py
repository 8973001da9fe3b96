"""Reads mesh files as ObjectModels: formats, units and symmetry. trimesh is imported when a file is read."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ObjectError, TactileLocError, did_you_mean, note_source
from tactile_loc.core.limits import MOST_BYTES, require_size
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh, check_surface
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.io.images import summarize
from tactile_loc.io.step_files import convert_step, is_step
from tactile_loc.store.files import parse_json

log = logging.getLogger(__name__)
GLTF, ELEMENT_BYTES = (".gltf", ".glb"), 24  # three coordinates or indices in memory
AGAIN = "export it again as a surface mesh"

Units = Literal["m", "mm", "cm", "inch", "auto"]
METRES_PER_UNIT: dict[str, float] = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}

ARCHIVES = (".zip", ".gz", ".bz2", ".xz", ".tar")  # refused, because archives could inflate without end

_found: dict[tuple[str, str], SymmetryGroup] = {}  # by digest and declaration; a sweep opens the same file many times


class Surface(NamedTuple):
    """The surface in a mesh file: `vertices` (V, 3) and triangles `faces` (F, 3).

    Lengths are in the file's unit; those of a STEP file are in metres.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    is_watertight: bool


def read_surface(path: Path) -> Surface:
    """Read and merge the triangles of a mesh file. Raises ObjectError when it is missing, damaged or empty."""
    if not os.path.isfile(path):
        if os.path.isdir(path):
            raise ObjectError(f"{path} is a folder; give one mesh file")
        near = did_you_mean(str(path), DEMO_OBJECTS)
        raise ObjectError(f"there is no file {path}; check the path.{near} Demo objects: {', '.join(DEMO_OBJECTS)}")
    if path.suffix.lower() in ARCHIVES:
        raise ObjectError(f"{path} is an archive; unpack it and give its mesh file")
    import trimesh

    try:
        raw = _load_raw(path)
    except TactileLocError:
        raise
    except Exception as error:
        reason = summarize(error)[:120]
        raise ObjectError(f"{path} cannot be read as a mesh ({reason}); give an STL, OBJ, PLY or STEP file") from error
    if not isinstance(raw, trimesh.Trimesh):
        raise ObjectError(f"{path} is not a surface mesh; {AGAIN}")
    _require_surface(np.asarray(raw.vertices), np.asarray(raw.faces), path)
    plain = trimesh.Trimesh(raw.vertices, raw.faces, process=False)  # textures and normals would separate vertices
    plain.merge_vertices()
    plain.update_faces(plain.nondegenerate_faces(height=0))
    plain.remove_unreferenced_vertices()  # stray vertices would enlarge the bounding box
    if len(plain.faces) == 0:
        raise ObjectError(f"{path} has zero extent: all its faces are points or lines; {AGAIN}")
    return Surface(np.asarray(plain.vertices, float), np.asarray(plain.faces, np.int64), bool(plain.is_watertight))


def _load_raw(path: Path) -> Any:
    """Load a file as trimesh reads it, in the file's unit; a STEP file in metres."""
    import trimesh

    if path.suffix.lower() in GLTF:
        _require_elements(path)
    with warnings.catch_warnings(), convert_step(path) if is_step(path) else nullcontext(path) as file:
        warnings.simplefilter("ignore")
        return trimesh.load(file, force="mesh", process=False)


def _require_elements(path: Path) -> None:
    """Raise an error if a glTF file states more elements than memory should hold; its buffers need not hold them."""
    content = path.read_bytes()
    length = int.from_bytes(content[12:16], "little")  # of the JSON in a binary file, after 20 bytes
    tree = parse_json(content[20 : 20 + length] if content[:4] == b"glTF" else content)
    counts = [one["count"] for one in tree.get("accessors", ())]
    meshes = [
        sum(counts[n] for one in mesh["primitives"] for n in (*one["attributes"].values(), one.get("indices", 0)))
        for mesh in tree.get("meshes", ())
    ]
    placed = sum(meshes[node["mesh"]] for node in tree.get("nodes", ()) if "mesh" in node)
    require_size(ELEMENT_BYTES * (sum(counts) + placed), MOST_BYTES)


def _require_surface(vertices: NDArray[Any], faces: NDArray[Any], path: Path) -> None:
    """Raise ObjectError unless the vertices (V, 3) are finite and there is at least one valid triangle (F, 3)."""
    if len(faces) == 0:
        raise ObjectError(f"{path} has no faces; {AGAIN}")
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        raise ObjectError(f"{path} has vertices or faces without three numbers each; {AGAIN}")
    if not np.isfinite(vertices).all():
        raise ObjectError(f"{path} has vertices that are NaN or infinite; {AGAIN}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ObjectError(
            f"{path} has {len(vertices)} vertices, but its faces use numbers {faces.min()} to {faces.max()}; {AGAIN}"
        )


def find_symmetry(declared: str, mesh: TriangleMesh) -> SymmetryGroup:
    """Return the symmetry of a surface: detected if `declared` is "auto", otherwise as declared.

    Raises SymmetryError when `declared` cannot be parsed, or when the surface does not have the declared symmetry.
    """
    from tactile_loc.core.objects.symmetry_detection import detect_symmetry, require_symmetry

    key = mesh.digest, declared
    if key not in _found:
        if declared == "auto":
            group = detect_symmetry(mesh.vertices_m, mesh.faces)
        else:
            group = SymmetryGroup.parse(declared, mesh.centroid_m)
            if not group.is_trivial:
                require_symmetry(group, mesh.vertices_m, mesh.faces)
        _found[key] = group
    return _found[key]


def load_object(
    path: str | Path, units: Units = "auto", symmetry: str = "auto", name: str | None = None,
    read: Callable[[Path], Surface] = read_surface,
    judge: Callable[[str, TriangleMesh], SymmetryGroup] = find_symmetry,
) -> ObjectModel:  # fmt: skip
    """Read a STEP file, any mesh that trimesh reads, or a demo object by its name; return the object in metres.

    `units` is the file's unit; "auto" guesses the unit from the size. A STEP file states its unit, so `units` is not
    used. A declared `symmetry` ("none", "z2", "z6*x2",
    "zinf", ...) is checked against the surface; "auto" detects the symmetry. Guesses and doubts are logged as warnings
    and kept in the result's `notes`. `read` reads the file, and `judge` finds or checks the symmetry. Raises
    ObjectError when the mesh cannot be used, and SymmetryError when the declared symmetry is wrong.
    """
    demo = DEMO_OBJECTS.get(str(path))
    if demo is not None and not os.path.isfile(path):
        path, units = demo.path, "m"
        symmetry = demo.symmetry if symmetry == "auto" else symmetry
    path = Path(path)
    name = name or path.stem
    surface = read(path)
    scale, notes = _find_scale(surface, "m" if is_step(path) else units, path.name)
    if is_step(path) and units != "auto":
        notes.append(f"{path.name} states its own unit, so the unit {units} is not used")
    mesh = TriangleMesh(surface.vertices * scale, surface.faces)
    check_surface(mesh, path.name)
    if not surface.is_watertight:
        notes.append(f"{path.name} is not watertight; touches are drawn from its existing faces")
    with note_source(path.name):
        group = judge(symmetry, mesh)
    if symmetry == "auto" and not group.is_trivial:
        notes.append(
            f"detected the symmetry {group} of {path.name}; give `symmetry` '{group}' to confirm it, or `symmetry` none"
        )
    for note in notes:
        log.warning(note)
    return ObjectModel(name, mesh, group, tuple(notes), str(path))


def _find_scale(surface: Surface, units: str, name: str) -> tuple[float, list[str]]:
    """Return metres per file unit, and a list with a note if the unit was guessed.

    A length below 1 is taken as metres, any other length as mm, because touched objects are 1 mm to 1 m long.
    """
    if units not in get_args(Units):
        raise ObjectError(f"the unit {units!r} of {name} is unknown; give one of {', '.join(get_args(Units))}")
    if units != "auto":
        return METRES_PER_UNIT[units], []
    size = float(np.ptp(surface.vertices, axis=0).max())
    guess = "m" if size < 1.0 else "mm"
    scale = METRES_PER_UNIT[guess]
    lengths = f"{name} is {size:.4g} units long, which is read as {size * scale * 1e3:.4g} mm"
    return scale, [f"{lengths}; give `units` {guess} to confirm the unit, or another `units`"]


def simplify_mesh(mesh: TriangleMesh, faces: int) -> TriangleMesh:
    """Return the surface with about `faces` triangles, by open3d's quadric error metrics."""
    import open3d as o3d

    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices_m), o3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    )
    fewer: Any = whole.simplify_quadric_decimation(faces)
    return TriangleMesh(np.asarray(fewer.vertices, float), np.asarray(fewer.triangles, np.int64))
