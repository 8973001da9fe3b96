"""Objects whose surface and symmetry the store keeps."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tactile_loc.core.objects import surface_field
from tactile_loc.core.runtime.caches import ByteCache
from tactile_loc.core.runtime.errors import ObjectError, StoreError, SymmetryError
from tactile_loc.io.meshes import mesh_files as meshes
from tactile_loc.locate import stored_object as module
from tactile_loc.store.store import StageStore


def test_a_surface_is_read_again_only_if_the_file_changes(tmp_path, monkeypatch):
    store, path = StageStore(tmp_path / "store"), tmp_path / "part.stl"
    read: list[Path] = []
    monkeypatch.setattr(module, "read_surface", lambda file: read.append(file) or meshes.read_surface(file))
    for size, times in ((0.02, 1), (0.02, 1), (0.03, 2)):
        trimesh.creation.box((size, 0.01, 0.01)).export(path)
        for _ in range(2):
            found = module.load_stored_object(path, "m", "none", store)
            plain = meshes.load_object(path, "m", "none")
            np.testing.assert_array_equal(found.mesh.vertices_m, plain.mesh.vertices_m)
            np.testing.assert_array_equal(found.mesh.faces, plain.mesh.faces)
            assert (found.name, found.notes, found.source) == (plain.name, plain.notes, plain.source)
        assert len(read) == times


@pytest.mark.parametrize("content", [None, b"", b"no mesh at all"])
def test_an_invalid_mesh_gives_the_usual_error_and_leaves_no_entry(tmp_path, content):
    store, path = StageStore(tmp_path / "store"), tmp_path / "part.stl"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ObjectError) as alone:
        meshes.load_object(path)
    with pytest.raises(ObjectError) as stored:
        module.load_stored_object(path, "auto", "auto", store)
    assert str(stored.value) == str(alone.value)
    assert not store.entries()


def test_a_surface_that_cannot_be_stored_is_still_read(tmp_path, monkeypatch):
    path = tmp_path / "part.stl"
    trimesh.creation.box((0.02, 0.01, 0.01)).export(path)
    store = StageStore(tmp_path / "store")

    def full(*_):
        raise StoreError("the disk is full")

    monkeypatch.setattr(store, "build", full)
    assert len(module.load_stored_object(path, "m", "none", store).mesh.faces) == 12


@pytest.mark.parametrize("declared", ["auto", "none", "z2", "x2*y2", "axis(0,0,1)2"])
def test_a_symmetry_is_found_once_and_read_back_from_the_store(tmp_path, monkeypatch, declared):
    store, path = StageStore(tmp_path / "store"), tmp_path / "part.stl"
    trimesh.creation.box((0.03, 0.02, 0.01)).export(path)
    plain = meshes.load_object(path, "m", declared)
    first = module.load_stored_object(path, "m", declared, store)
    monkeypatch.setattr(module, "find_symmetry", lambda *_: pytest.fail("the symmetry was searched again"))
    again = module.load_stored_object(path, "m", declared, store)
    for found in (first, again):
        assert found.symmetry.terms == plain.symmetry.terms
        np.testing.assert_array_equal(found.symmetry.rotations, plain.symmetry.rotations)
        np.testing.assert_array_equal(found.symmetry.centre_m, plain.symmetry.centre_m)
        assert found.notes == plain.notes
        assert found.describe() == plain.describe()


def test_a_continuous_axis_is_read_back_from_the_store(tmp_path):
    store, path = StageStore(tmp_path / "store"), tmp_path / "part.stl"
    trimesh.creation.cylinder(0.01, 0.03, sections=64).export(path)
    first, again = (module.load_stored_object(path, "m", "zinf", store) for _ in range(2))
    np.testing.assert_array_equal(again.symmetry.continuous_axis, first.symmetry.continuous_axis)
    assert str(again.symmetry) == "zinf"


def test_a_sphere_is_read_back_from_the_store(tmp_path):
    store, path = StageStore(tmp_path / "store"), tmp_path / "ball.stl"
    trimesh.creation.icosphere(4, 0.01).export(path)
    first, again = (module.load_stored_object(path, "m", "auto", store) for _ in range(2))
    assert str(first.symmetry) == str(again.symmetry) == "sphere"
    assert again.describe() == first.describe()


def test_a_wrong_symmetry_is_refused_each_time(tmp_path):
    store, path = StageStore(tmp_path / "store"), tmp_path / "part.stl"
    trimesh.creation.box((0.03, 0.02, 0.01)).export(path)
    for _ in range(2):
        with pytest.raises(SymmetryError):
            module.load_stored_object(path, "m", "z4", store)


def test_each_readable_mesh_of_a_folder_is_a_part(tmp_path):
    for name in ("b.glb", "a.STL", "c.gltf", "._a.stl", "c.bin"):
        (tmp_path / name).touch()
    assert [path.name for path in module.list_mesh_files(tmp_path)] == ["a.STL", "b.glb", "c.gltf"]


def test_the_field_and_the_hull_of_a_surface_are_computed_once(tmp_path, monkeypatch):
    store, path = StageStore(tmp_path / "store"), tmp_path / "part.stl"
    trimesh.creation.icosphere(2, 0.008).export(path)

    def open_field():
        obj = module.load_stored_object(path, "m", "none", store)
        monkeypatch.setattr(surface_field, "_fields", ByteCache(surface_field.KEPT_BYTES, lambda field: field.nbytes))
        module.load_surface_field(obj, store)
        return obj.mesh, surface_field.build_surface_field(obj.mesh)

    made, field = open_field()
    monkeypatch.setattr(surface_field, "_fill_cells", lambda *_: pytest.fail("the field is computed again"))
    read, same = open_field()
    np.testing.assert_array_equal(same.triangles.nearest, field.triangles.nearest)
    np.testing.assert_array_equal(same.distances, field.distances)
    np.testing.assert_array_equal(read.hull_corners_m, made.hull_corners_m)
    assert [entry.stage for entry in store.entries()].count("field") == 1
