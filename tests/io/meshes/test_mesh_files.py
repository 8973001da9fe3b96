import logging
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from message_helpers import missing, naming

from tactile_loc import DEMO_OBJECTS, TriangleMesh, load_object, simplify_mesh
from tactile_loc.core.runtime.errors import MissingLibraryError, ObjectError, SymmetryError

SIDES_M = np.array([0.030, 0.020, 0.012])


@pytest.fixture
def write_box(tmp_path: Path):
    """Write a box of 30 x 20 x 12 mm, with `scale` file units per metre."""

    def write(name: str = "part.stl", scale: float = 1.0) -> Path:
        trimesh.creation.box(SIDES_M * scale).export(tmp_path / name)
        return tmp_path / name

    return write


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "off"])
def test_every_mesh_format_gives_the_same_box(write_box, suffix):
    obj = load_object(write_box(f"part.{suffix}"), units="m", symmetry="none")
    assert obj.name == "part"
    assert load_object(write_box(), "m", "none", name="bracket").name == "bracket"
    assert obj.source.endswith(f"part.{suffix}")
    np.testing.assert_allclose(obj.mesh.extents_m, SIDES_M, rtol=1e-6)
    assert (len(obj.mesh.vertices_m), len(obj.mesh.faces)) == (8, 12), "the corners are not merged"
    assert obj.notes == ()


@pytest.mark.parametrize(("units", "per_metre"), [("m", 1.0), ("mm", 1e3), ("cm", 1e2), ("inch", 1 / 0.0254)])
def test_all_declared_units_give_the_same_object(write_box, units, per_metre):
    obj = load_object(write_box(scale=per_metre), units=units, symmetry="none")
    np.testing.assert_allclose(obj.mesh.extents_m, SIDES_M, rtol=1e-6)
    assert obj.notes == ()


@pytest.mark.parametrize(("per_metre", "guess"), [(1.0, "m"), (1e3, "mm")])
def test_guessed_units_are_right_and_logged(write_box, caplog, per_metre, guess):
    with caplog.at_level(logging.WARNING):
        obj = load_object(write_box(scale=per_metre), symmetry="none")
    np.testing.assert_allclose(obj.mesh.extents_m, SIDES_M, rtol=1e-6)
    (note,) = obj.notes
    assert re.search(rf"\b{guess}\b", note)
    assert not missing(note, "30 mm")
    assert "`units`" in note
    assert note in caplog.text


def write_3mf(path: Path, unit: str, items: tuple[int, ...] = (1,)) -> Path:
    """Write a box of 3 x 2 x 1 units, and refer to the objects `items`."""
    box = trimesh.creation.box((3, 2, 1))
    vertices = "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*vertex) for vertex in box.vertices)
    faces = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in box.faces)
    mesh = f"<mesh><vertices>{vertices}</vertices><triangles>{faces}</triangles></mesh>"
    namespace = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    build = "".join(f'<item objectid="{number}"/>' for number in items)
    model = f'<model unit="{unit}" xmlns="{namespace}"><resources><object id="1">{mesh}</object></resources>'
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("3D/3dmodel.model", f"{model}<build>{build}</build></model>")
    return path


def test_the_unit_that_a_3mf_file_states_is_used(tmp_path):
    obj = load_object(write_3mf(tmp_path / "part.3mf", "inch"), symmetry="none")
    np.testing.assert_allclose(obj.mesh.extents_m, [0.0762, 0.0508, 0.0254])
    assert obj.notes == ()
    with pytest.raises(ObjectError, match=naming("part.3mf", 7)):  # trimesh reads only a part of it
        load_object(write_3mf(tmp_path / "part.3mf", "inch", (1, 7)), "m")


def test_a_note_names_a_unit_that_differs_from_the_stated_one(tmp_path, caplog):
    write_3mf(tmp_path / "part.3mf", "inch")
    obj = load_object(tmp_path / "part.3mf", units="cm", symmetry="none")
    np.testing.assert_allclose(obj.mesh.extents_m, [0.03, 0.02, 0.01])  # the given unit wins
    (note,) = obj.notes
    assert note == caplog.messages[0]
    assert re.search(naming("part.3mf", "cm", 0.394, "`units`"), note)  # 10 mm / 25.4 mm
    assert load_object(tmp_path / "part.3mf", units="inch", symmetry="none").notes == ()


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    def lack(*_, **__):
        raise ModuleNotFoundError("No module named 'lxml'", name="lxml")

    monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, "3mf", lack)
    with pytest.raises(MissingLibraryError, match=naming("part.3mf", "pip install 'tactile-loc[meshes]'")):
        load_object(write_3mf(tmp_path / "part.3mf", "inch"))


@pytest.mark.parametrize("name", DEMO_OBJECTS)
def test_demo_objects_load_by_name_with_their_symmetry_and_without_notes(name):
    obj = load_object(name)
    assert obj.name == name
    assert str(obj.symmetry) == DEMO_OBJECTS[name].symmetry
    assert obj.notes == ()
    assert 0.02 < obj.mesh.extents_m.max() < 0.09


def test_a_declared_symmetry_replaces_that_of_a_demo_object():
    assert str(load_object("pin", symmetry="none").symmetry) == "none"
    with pytest.raises(SymmetryError):
        load_object("pin", symmetry="z6")


def test_a_file_takes_precedence_over_a_demo_object_of_the_same_name(tmp_path, monkeypatch):
    trimesh.creation.box(SIDES_M).export(tmp_path / "pin", file_type="stl")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ObjectError, match=naming("pin", "STL", "OBJ", "PLY")):
        load_object("pin")


def test_symmetry_is_about_the_surfaces_centroid_and_found_or_checked(tmp_path):
    trimesh.creation.box(SIDES_M).apply_translation([0.1, 0.2, 0]).export(tmp_path / "part.ply")
    found = load_object(tmp_path / "part.ply", units="m")
    declared = load_object(tmp_path / "part.ply", units="m", symmetry="z2")
    assert str(found.symmetry) == "x2*y2"
    assert any("x2*y2" in note for note in found.notes)
    for obj in (found, declared):
        np.testing.assert_allclose(obj.symmetry.centre_m, [0.1, 0.2, 0], atol=1e-8)
    with pytest.raises(SymmetryError, match="'z4'"):
        load_object(tmp_path / "part.ply", units="m", symmetry="z4")


def test_a_missing_file_is_refused_with_similar_names(tmp_path):
    with pytest.raises(ObjectError, match=naming("none.stl", "damping_pin")):
        load_object(tmp_path / "none.stl")
    with pytest.raises(ObjectError, match=naming("'elbow_pipe'", "damping_pin") + r".*elbow_pip\b"):
        load_object("elbow_pip")
    with pytest.raises(ObjectError, match=naming(tmp_path, "folder")):
        load_object(tmp_path)


POINTS = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {axis}\n" for axis in "xyz")
BAD_FILES = {  # the content of each file, and what its refusal mentions
    "prose.stl": ("This is a letter, not a part.", ""),
    "prose.obj": ("Dear all,\nregards", ""),
    "prose.ply": ("ply? no.", ""),
    "prose.glb": ("glb? no.", ""),
    "prose.xyzzy": ("unknown format", ""),
    "nothing.stl": ("", ""),
    "part.zip": ("PK", "archive"),
    "nothing.ply": ("", ""),
    "binary.stl": ("\x00" * 84, ""),
    "points.ply": (f"{POINTS}end_header\n0 0 0\n10 0 0\n0 10 0\n", "faces"),
    "nan.obj": ("v 0 0 0\nv nan 0 0\nv 0 10 0\nf 1 2 3\n", "NaN"),
    "inf.obj": ("v 0 0 0\nv 10 inf 0\nv 0 10 0\nf 1 2 3\n", ""),
    "line.obj": ("v 0 0 0\nv 10 0 0\nv 20 0 0\nf 1 2 3\n", "extent"),
    "point.obj": ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "extent"),
    "huge.obj": ("v 0 0 0\nv 5000 0 0\nv 0 5000 0\nf 1 2 3\n", "5000 mm"),
    "tiny.obj": ("v 0 0 0\nv 5e-4 0 0\nv 0 5e-4 0\nf 1 2 3\n", "0.5 mm"),
    "beyond.obj": ("v 0 0 0\nv 10 0 0\nv 0 10 0\nf 1 2 9\n", ""),
    "flat.obj": ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", ""),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_refused_by_name_and_reason(tmp_path, name):
    content, reason = BAD_FILES[name]
    (tmp_path / name).write_text(content)
    with pytest.raises(ObjectError) as refused:
        load_object(tmp_path / name, symmetry="none")
    message = str(refused.value)
    assert not missing(message, name, reason)
    assert "\n" not in message
    assert re.search(r"[.,:;] \w", message), "the message names no next step"


def test_unknown_and_wrong_units_are_refused(write_box):
    with pytest.raises(ObjectError, match=naming("'furlong'", "part.stl", "mm", "cm", "inch", "auto")):
        load_object(write_box(), units="furlong")
    with pytest.raises(ObjectError, match=r"(30000|3e\+04) mm"):
        load_object(write_box(scale=1e3), units="m")
    with pytest.raises(ObjectError, match=naming("0.03 mm", "`units`")):
        load_object(write_box(), units="mm")


def test_an_open_surface_is_used_with_a_note(tmp_path):
    corners = "v 0 0 {0}\nv 10 0 {0}\nv 0 10 {0}\nf -3 -2 -1\n"
    (tmp_path / "open.obj").write_text(corners.format(0) + corners.format(5))
    obj = load_object(tmp_path / "open.obj", units="mm", symmetry="none")
    assert len(obj.mesh.faces) == 2
    assert any(not missing(note, "open.obj", "watertight") for note in obj.notes)


def test_degenerate_faces_and_stray_vertices_are_ignored(tmp_path):
    """Stray vertices would enlarge the object's bounding box."""
    box = trimesh.creation.box(SIDES_M)
    lines = [f"v {x} {y} {z}" for x, y, z in box.vertices] + ["v 0.5 0 0", "v 0.6 0 0", "v 0.7 0 0"]
    lines += [f"f {a} {b} {c}" for a, b, c in box.faces + 1]
    (tmp_path / "stray.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "needle.obj").write_text("\n".join([*lines, "f 9 10 11"]) + "\n")
    for name in ("stray.obj", "needle.obj"):
        obj = load_object(tmp_path / name, units="m", symmetry="none")
        np.testing.assert_allclose(obj.mesh.extents_m, SIDES_M, rtol=1e-6)
        assert len(obj.mesh.faces) == 12


def test_reading_does_not_move_rotate_or_reorder_the_surface(tmp_path):
    """Poses refer to the file's own frame: nothing is centred, and no axes are swapped."""
    hook = load_object("hook").mesh
    trimesh.Trimesh(hook.vertices_m * 1e3, hook.faces, process=False).export(tmp_path / "hook.stl")
    again = load_object(tmp_path / "hook.stl", "mm", "none").mesh
    np.testing.assert_allclose(again.centroid_m, hook.centroid_m, atol=1e-8)
    np.testing.assert_allclose(again.covariance_m2, hook.covariance_m2, atol=1e-10)
    assert isinstance(again, TriangleMesh)


def test_a_closed_surface_that_faces_inwards_is_turned(tmp_path):
    box = trimesh.creation.box(SIDES_M)
    box.invert()
    box.export(tmp_path / "inverted.stl")
    corners_m = load_object(tmp_path / "inverted.stl", units="m", symmetry="none").mesh.triangles_m
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    assert (np.einsum("fi,fi->f", normals, corners_m.mean(axis=1)) > 0).all()


def test_a_simplified_surface_has_fewer_faces_and_the_same_shape():
    ball = trimesh.creation.icosphere(4, 0.02)
    mesh = TriangleMesh(np.array(ball.vertices), np.array(ball.faces, np.int64))
    fewer = simplify_mesh(mesh, 1000)
    assert 500 < len(fewer.faces) <= 1000
    assert np.linalg.norm(fewer.vertices_m, axis=1) == pytest.approx(0.02, rel=0.02)
    assert fewer.face_areas.sum() == pytest.approx(mesh.face_areas.sum(), rel=0.02)
