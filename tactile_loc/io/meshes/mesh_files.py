"""Reads mesh files as ObjectModels: formats, units and symmetry. trimesh is imported when a file is read."""

import logging
import os
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args
from xml.etree import ElementTree

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh, check_surface
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.runtime.errors import MissingLibraryError, ObjectError, TactileLocError, did_you_mean
from tactile_loc.core.runtime.formatting import show_name
from tactile_loc.data import DEMO_OBJECTS
from tactile_loc.io.images import summarize
from tactile_loc.io.meshes.gltf_files import read_gltf
from tactile_loc.io.meshes.polygon_files import read_obj, read_off, read_ply, read_stl
from tactile_loc.io.meshes.polygons import EXPORT_AGAIN, Polygons, check_closed, weld
from tactile_loc.io.meshes.step_files import convert_step, is_step
from tactile_loc.store.files import link_plainly

log = logging.getLogger(__name__)

Units = Literal["m", "mm", "cm", "inch", "auto"]
METRES_PER_UNIT: dict[str, float] = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}

AGGRESSIVENESS = 3  # of a decimation, 0 to 10; lower ones stay closer to the surface, but may stop early
ARCHIVES = (".zip", ".gz", ".bz2", ".xz", ".tar")  # refused, because archives could inflate without end

_found: dict[tuple[str, str], SymmetryGroup] = {}  # by digest and declaration; a sweep opens the same file many times


POLYGON_READERS = {".stl": read_stl, ".obj": read_obj, ".off": read_off, ".ply": read_ply}
GLTF_SUFFIXES = (".glb", ".gltf")


class Surface(NamedTuple):
    """The surface in a mesh file: `vertices` (V, 3) and triangles `faces` (F, 3).

    Lengths are in the file's unit. `metres_per_unit` is this unit, if the file or its format states it.
    """

    vertices: Floats
    faces: Ints
    is_watertight: bool
    metres_per_unit: float | None = None


def read_surface(path: Path) -> Surface:
    """Read and merge the faces of a mesh file, as triangles. Raises ObjectError when it is missing, damaged or empty.

    If all triangles of a closed surface face inwards, they are turned outwards. Raises MissingLibraryError when the
    format needs a library that is not installed.
    """
    if not os.path.isfile(path):
        if os.path.isdir(path):
            raise ObjectError(f"{path} is a folder; give one mesh file")
        near = did_you_mean(str(path), DEMO_OBJECTS)
        raise ObjectError(f"there is no file {path}; check the path.{near} Demo objects: {', '.join(DEMO_OBJECTS)}")
    if path.suffix.lower() in ARCHIVES:
        raise ObjectError(f"{path} is an archive; unpack it and give its mesh file")
    try:
        with np.errstate(all="ignore"):  # numbers that are too large or NaN are refused
            polygons, metres_per_unit = _read_polygons(path)
            polygons.require_valid(path)
            vertices, faces = weld(polygons.vertices, polygons.triangulate(path))
    except TactileLocError:
        raise
    except ImportError as error:
        library = error.name or {".dae": "pycollada"}.get(path.suffix.lower(), "lxml")
        raise MissingLibraryError(
            f"{path} is read with {library}, which is not installed: pip install 'tactile-loc[meshes]'; or give an "
            "STL, OBJ, PLY or STEP file"
        ) from error
    except Exception as error:
        reason = summarize(error)[:120]
        raise ObjectError(f"{path} cannot be read as a mesh ({reason}); give an STL, OBJ, PLY or STEP file") from error
    if len(faces) == 0:
        raise ObjectError(f"{path} has zero extent: all its faces are points or lines; {EXPORT_AGAIN}")
    watertight, inverted = check_closed(vertices, faces)
    if inverted:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return Surface(vertices, faces, watertight, metres_per_unit)


def _read_polygons(path: Path) -> tuple[Polygons, float | None]:
    """Read a file with the reader of its format. Also return the file's unit, in metres, if it is stated."""
    suffix = path.suffix.lower()
    if is_step(path):
        with convert_step(path) as file:
            return read_gltf(file), 1.0
    if suffix in GLTF_SUFFIXES:
        return read_gltf(path), 1.0
    if suffix in POLYGON_READERS:
        return POLYGON_READERS[suffix](path), None
    return _read_by_trimesh(path)


def _read_by_trimesh(path: Path) -> tuple[Polygons, float | None]:
    """Read a file of another format, such as 3MF. Raises ObjectError if trimesh warns that a part is missing."""
    import trimesh

    if path.suffix.lower() == ".dae":
        _require_triangles(path)
    complaints = _Complaints()
    trimesh.util.log.addHandler(complaints)
    try:
        with warnings.catch_warnings(), link_plainly(path) as file:
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", UserWarning)
            scene: Any = trimesh.load(file, force="scene", process=False)
            raw = scene.to_mesh()
    finally:
        trimesh.util.log.removeHandler(complaints)
    if complaints.texts:
        raise ObjectError(f"{path} is read only in part ({complaints.texts[0]}); {EXPORT_AGAIN}")
    metres = None if scene.units is None else float(trimesh.units.unit_conversion(scene.units, "meters"))
    return Polygons.of_triangles(raw.vertices, raw.faces), metres


class _Complaints(logging.Handler):
    """Collects the warnings that a library logs in this thread."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        about_looks = "material" in str(record.funcName)
        if record.thread == threading.get_ident() and not about_looks:
            self.texts.append(" ".join(record.getMessage().split())[:120])


def _require_triangles(path: Path) -> None:
    """Raise ObjectError if a COLLADA file has polygons, because pycollada covers their notches."""
    for element in ElementTree.parse(path).iter():
        kind = element.tag.rpartition("}")[2]
        if kind == "polygons" or (kind == "vcount" and any(int(word) > 3 for word in (element.text or "").split())):
            raise ObjectError(f"{path} has faces with more than three corners; triangulate them when you export")


def find_symmetry(declared: str, mesh: TriangleMesh) -> SymmetryGroup:
    """Return the symmetry of a surface: detected if `declared` is "auto", otherwise as declared.

    Raises SymmetryError when `declared` cannot be parsed, or when the surface does not have the declared symmetry.
    """
    from tactile_loc.core.objects.symmetry_detection import detect_symmetry, require_symmetry

    key = mesh.digest, declared
    if key not in _found:
        if declared == "auto":
            group = detect_symmetry(mesh)
        else:
            group = SymmetryGroup.parse(declared, mesh.centroid_m)
            if not group.is_trivial:
                require_symmetry(group, mesh)
        _found[key] = group
    return _found[key]


def load_object(
    path: str | Path,
    units: Units = "auto",
    symmetry: str = "auto",
    name: str | None = None,
    read: Callable[[Path], Surface] = read_surface,
    judge: Callable[[str, TriangleMesh], SymmetryGroup] = find_symmetry,
) -> ObjectModel:
    """Read a STEP file, any mesh that trimesh reads, or a demo object by its name; return the object in metres.

    `units` is the file's unit. "auto" takes the unit that the file states, or that of its format: metres for glTF. For
    other files, it guesses the unit from the size. A STEP file is always read in its own unit. A declared `symmetry`
    ("none", "z2", "z6*x2", "zinf", ...) is checked against the surface; "auto" detects the symmetry. Guesses and doubts
    are logged as warnings and kept in the result's `notes`. `read` reads the file, and `judge` finds or checks the
    symmetry. Raises
    ObjectError when the mesh cannot be used, and SymmetryError when the declared symmetry is wrong.
    """
    demo = DEMO_OBJECTS.get(str(path))
    if demo is not None and not os.path.isfile(path):
        path, units = demo.path, "m"
        symmetry = demo.symmetry if symmetry == "auto" else symmetry
    path = Path(path)
    name, shown = name or path.stem, show_name(path.name)
    surface = read(path)
    scale, notes = _find_scale(surface, "auto" if is_step(path) else units, shown)
    if is_step(path) and units != "auto":
        notes.append(f"{shown} states its own unit, so the unit {units} is not used")
    mesh = TriangleMesh(surface.vertices * scale, surface.faces)
    check_surface(mesh, shown)
    if not surface.is_watertight:
        notes.append(f"{shown} is not watertight; touches are drawn from its existing faces")
    group = judge(symmetry, mesh)
    if symmetry == "auto" and not group.is_trivial:
        notes.append(
            f"detected the symmetry {group} of {shown}; give `symmetry` '{group}' to confirm it, or `symmetry` none"
        )
    for note in notes:
        log.warning(note)
    return ObjectModel(name, mesh, group, tuple(notes), str(path))


def _find_scale(surface: Surface, units: str, name: str) -> tuple[float, list[str]]:
    """Return metres per file unit, and a list with a note if the unit was guessed, or is not the stated one.

    A length below 1 is taken as metres, any other length as mm, because touched objects are 1 mm to 1 m long.
    """
    if units not in get_args(Units):
        raise ObjectError(f"the unit {units!r} of {name} is unknown; give one of {', '.join(get_args(Units))}")
    stated, asked = surface.metres_per_unit, METRES_PER_UNIT.get(units)
    if asked is not None and stated is not None and not np.isclose(asked, stated, rtol=1e-6):
        return asked, [
            f"{name} is read in {units}, as given, {asked / stated:.3g} times the size that it states; leave out "
            "`units` to read it as it states"
        ]
    if scale := asked or stated:
        return scale, []
    size = float(np.ptp(surface.vertices, axis=0).max())
    guess = "m" if size < 1.0 else "mm"
    scale = METRES_PER_UNIT[guess]
    lengths = f"{name} is {size:.4g} units long, which is read as {size * scale * 1e3:.4g} mm"
    return scale, [f"{lengths}; give `units` {guess} to confirm the unit, or another `units`"]


def simplify_mesh(mesh: TriangleMesh, faces: int) -> TriangleMesh:
    """Return the surface with about `faces` triangles, by quadric error metrics."""
    from fast_simplification import simplify

    size_m = np.ptp(mesh.vertices_m, axis=0).max()  # its thresholds are for surfaces of size 1
    vertices, triangles = simplify(mesh.vertices_m / size_m, mesh.faces, target_count=faces, agg=AGGRESSIVENESS)
    return TriangleMesh(np.asarray(vertices, float) * size_m, np.asarray(triangles, np.int64))
