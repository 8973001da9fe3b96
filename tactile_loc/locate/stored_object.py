"""An object's surface, its symmetry and the field of its surface, stored because making them takes long."""

import logging
import math
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.objects.mesh import ObjectModel, TriangleMesh
from tactile_loc.core.objects.surface_field import CELL_M, REACH_M, Cells, build_surface_field
from tactile_loc.core.objects.symmetry import SymmetryGroup, SymmetryTerm
from tactile_loc.core.runtime.errors import ObjectError, StoreError
from tactile_loc.io.meshes.mesh_files import GLTF_SUFFIXES, Surface, Units, find_symmetry, load_object, read_surface
from tactile_loc.io.meshes.step_files import STEP_SUFFIXES, describe_step_reader, is_step
from tactile_loc.store.artifact import Artifact
from tactile_loc.store.files import list_files
from tactile_loc.store.keys import StageKey, hash_file
from tactile_loc.store.store import StageStore
from tactile_loc.store.workspace import Workspace

logger = logging.getLogger(__name__)

SELF_CONTAINED = (".stl", ".obj", ".ply", ".off", *STEP_SUFFIXES)  # files that contain the whole surface
PART_SUFFIXES = (*SELF_CONTAINED, *GLTF_SUFFIXES)  # of files in folders of parts
# increase if the same file gives another surface or symmetry, or the same surface another field
SURFACE_VERSION, SYMMETRY_VERSION, FIELD_VERSION = 2, 2, 1

Kept = TypeVar("Kept")


def list_mesh_files(folder: Path) -> list[Path]:
    """Return the visible mesh files in a folder, in order. Raises ObjectError if there are none."""
    files = list_files(folder, PART_SUFFIXES)
    if not files:
        raise ObjectError(f"{folder} holds no mesh; give a folder with files of type {', '.join(PART_SUFFIXES)}")
    return files


def load_stored_object(path: str | Path, units: Units, symmetry: str, store: StageStore) -> ObjectModel:
    """Load an object as `load_object` does, with its surface and symmetry from the store if possible."""
    return load_object(
        path,
        units,
        symmetry,
        read=lambda file: _load_surface(file, store),
        judge=lambda declared, mesh: _load_symmetry(declared, mesh, Path(path).stem, store),
    )


def _load_surface(path: Path, store: StageStore) -> Surface:
    if path.suffix.lower() not in SELF_CONTAINED:
        return read_surface(path)
    try:
        digest = hash_file(path)
    except StoreError:
        return read_surface(path)  # raises the error that states why the file cannot be read
    reader = describe_step_reader() if is_step(path) else {}
    described = {"file": digest, "suffix": path.suffix.lower(), "trimesh": metadata.version("trimesh"), **reader}
    key = StageKey("surface", SURFACE_VERSION, described, path.stem)

    def save(surface: Surface, work: Workspace) -> None:
        work.save_array("vertices", surface.vertices, packed=True)
        work.save_array("faces", surface.faces, packed=True)
        work.save_json("about", [surface.is_watertight, surface.metres_per_unit])

    def load(kept: Artifact) -> Surface:
        vertices, faces = (kept.load_array(name, mmap=False) for name in ("vertices", "faces"))
        return Surface(vertices, faces, *kept.load_json("about"))

    return _load_or_keep(store, key, lambda: read_surface(path), save, load)


def _load_symmetry(declared: str, mesh: TriangleMesh, name: str, store: StageStore) -> SymmetryGroup:
    key = StageKey("symmetry", SYMMETRY_VERSION, {"mesh": mesh.digest, "declared": declared}, name)

    def save(group: SymmetryGroup, work: Workspace) -> None:
        terms = [[*term.axis, "inf" if math.isinf(term.order) else int(term.order)] for term in group.terms]
        work.save_json("group", {"centre_m": group.centre_m.tolist(), "terms": terms})

    def load(kept: Artifact) -> SymmetryGroup:
        group = kept.load_json("group")
        terms = [SymmetryTerm((x, y, z), float(order)) for x, y, z, order in group["terms"]]
        return SymmetryGroup(np.array(group["centre_m"]), tuple(terms))

    return _load_or_keep(store, key, lambda: find_symmetry(declared, mesh), save, load)


def load_surface_field(obj: ObjectModel, store: StageStore) -> None:
    """Load the field of an object's surface and its convex hull into memory, from the store if possible.

    They are then found by `build_surface_field` and `TriangleMesh.hull_corners_m`.
    """
    mesh, names = obj.mesh, ("nearest", "distances", "hull")

    def make(find: Callable[[], Cells]) -> list[NDArray[Any]]:
        return [*find(), mesh.hull_corners_m]

    def save(arrays: list[NDArray[Any]], work: Workspace) -> None:
        for name, array in zip(names, arrays, strict=True):
            work.save_array(name, array, packed=True)

    def load(kept: Artifact) -> list[NDArray[Any]]:
        return [kept.load_array(name) for name in names]

    def keep(find: Callable[[], Cells]) -> Cells:
        described: dict[str, Any] = {"mesh": mesh.digest, "reach_m": REACH_M, "cell_m": CELL_M}
        key = StageKey("field", FIELD_VERSION, described, obj.name)
        nearest, distances, hull_corners_m = _load_or_keep(store, key, lambda: make(find), save, load)
        mesh.remember_hull(hull_corners_m)
        return nearest, distances

    build_surface_field(mesh, keep=keep)


def _load_or_keep(
    store: StageStore,
    key: StageKey,
    make: Callable[[], Kept],
    save: Callable[[Kept, Workspace], None],
    load: Callable[[Artifact], Kept],
) -> Kept:
    """Load the artifact from the store, or make it and store it if possible."""
    found = store.get(key)
    if found is not None:
        return load(found)
    made = make()
    try:
        store.build(key, lambda work: save(made, work))
    except StoreError as error:  # if nothing can be stored, the next stage raises an error
        logger.info("cannot store the %s, so it is made again next time: %s", key.stage, error)
    return made
