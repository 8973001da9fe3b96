"""glTF files give the triangles of their scene in metres, as the standard defines, or are refused by name."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.io.meshes.mesh_files import load_object, read_surface

CORNERS = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.02, 0], [0, 0, 0.01]], np.float32)
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint16)
VOLUME_M3 = 1e-6
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


def make_tree(*arrays: np.ndarray, mode: int = 4) -> dict[str, Any]:
    """Return a file with one node: positions (V, 3), and the vertex numbers of its triangles if they are given."""
    views, accessors, data = [], [], b""
    for array in arrays:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        kind = {1: "SCALAR", 3: "VEC3"}[array.shape[-1] if array.ndim > 1 else 1]
        stored = {"bufferView": len(accessors), "componentType": COMPONENTS[array.dtype.str[1:]]}
        accessors.append({**stored, "count": len(array), "type": kind})
        data += array.tobytes() + b"\0" * (-array.nbytes % 4)
    primitive = {"attributes": {"POSITION": 0}, "mode": mode, **({"indices": 1} if len(arrays) > 1 else {})}
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    buffers = [{"uri": uri, "byteLength": len(data)}]
    scene = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
    meshes = [{"primitives": [primitive]}]
    return {**scene, "meshes": meshes, "accessors": accessors, "bufferViews": views, "buffers": buffers}


@pytest.fixture
def write(tmp_path: Path):
    def write(tree: dict[str, Any], name: str = "part.gltf") -> Path:
        (tmp_path / name).write_text(json.dumps(tree))
        return tmp_path / name

    return write


def tetrahedron() -> dict[str, Any]:
    return make_tree(CORNERS, TRIANGLES.ravel())


def measure(path: Path) -> tuple[np.ndarray, float]:
    """Return the bounds (2, 3) and the volume of a file's surface."""
    surface = read_surface(path)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces)
    return mesh.bounds, float(mesh.volume)


def test_a_part_is_in_metres_whatever_its_size(write):
    assert read_surface(write(tetrahedron())).is_watertight
    long = tetrahedron()
    long["nodes"][0]["scale"] = [30, 1, 1]
    assert load_object(write(long), symmetry="none").mesh.extents_m.max() == pytest.approx(0.9)
    assert load_object(write(long), "cm", "none").mesh.extents_m.max() == pytest.approx(0.009)  # the user's word


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2"])
def test_normalised_integers_are_fractions_of_their_largest_value(write, kind):
    largest = np.iinfo(kind).max
    stored = np.rint(CORNERS / 0.03 * largest).astype(kind)
    if kind == "i1":
        stored[0, 0] = -128  # which means -1, as -127 does
    tree = make_tree(np.pad(stored, ((0, 0), (0, 1)))[:, :3].copy(), TRIANGLES.ravel())
    tree["accessors"][0]["normalized"] = True
    tree |= {"extensionsRequired": ["KHR_mesh_quantization"], "extensionsUsed": ["KHR_mesh_quantization"]}
    tree["nodes"][0] |= {"scale": [0.03] * 3, "translation": [0, 0, 1]}
    bounds, _ = measure(write(tree))
    np.testing.assert_allclose(bounds[1], [0.03, 0.02, 1.01], atol=0.03 / largest)
    np.testing.assert_allclose(bounds[0], [-0.03 if kind == "i1" else 0, 0, 1], atol=1e-9)


def test_integers_strided_and_sparse_positions_are_read(write):
    tree = make_tree(np.rint(1000 * CORNERS).astype("i2"), TRIANGLES.ravel())  # numbers, as they are not normalised
    tree["nodes"][0]["scale"] = [0.001] * 3
    assert measure(write(tree))[1] == pytest.approx(VOLUME_M3)
    rows = np.concatenate([CORNERS, CORNERS + 9], axis=1)  # normals or colours follow each position
    tree = make_tree(rows.reshape(-1, 3), TRIANGLES.ravel())
    tree["bufferViews"][0]["byteStride"] = 24
    tree["accessors"][0]["count"] = 4
    assert measure(write(tree))[1] == pytest.approx(VOLUME_M3, rel=1e-5)
    tree = make_tree(0 * CORNERS, TRIANGLES.ravel(), np.array([1, 2, 3], np.uint8), CORNERS[1:])
    places, values = {"bufferView": 2, "componentType": 5121}, {"bufferView": 3}
    tree["accessors"][0]["sparse"] = {"count": 3, "indices": places, "values": values}
    assert measure(write(tree))[1] == pytest.approx(VOLUME_M3, rel=1e-5)
    del tree["accessors"][0]["bufferView"]  # then the other values are zero
    assert measure(write(tree))[1] == pytest.approx(VOLUME_M3, rel=1e-5)


@pytest.mark.parametrize(("mode", "order"), [(5, [0, 2, 1, 3, 0, 2]), (6, [0, 2, 1, 3, 2])])
def test_strips_and_fans_keep_their_orientation(write, mode, order):
    tree = make_tree(CORNERS, np.array(order, np.uint16), mode=mode)
    tree["meshes"][0]["primitives"] += [
        {"attributes": {"POSITION": 0}, "mode": 1, "indices": 1},  # lines have no surface
        *([{"attributes": {"POSITION": 2}}] if mode == 6 else []),
    ]
    if mode == 6:  # a fan lacks the side opposite to its first corner
        side = make_tree(CORNERS, np.array(order, np.uint16), CORNERS[[1, 2, 3]], mode=mode)
        tree |= {key: side[key] for key in ("accessors", "bufferViews", "buffers")}
    _, volume = measure(write(tree))
    assert volume == pytest.approx(VOLUME_M3, rel=1e-5)


def test_instances_nested_and_mirrored_nodes_are_placed(write):
    tree = tetrahedron()
    turn = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # a quarter turn about z
    tree["nodes"] = [
        {"children": [1, 2], "translation": [1, 0, 0]},
        {"mesh": 0, "rotation": turn, "scale": [2, 1, 1]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0, 0, 1], "camera": 0},
        {"mesh": 0, "translation": [9, 9, 9]},  # in no scene
    ]
    bounds, volume = measure(write(tree))
    np.testing.assert_allclose(bounds, [[0.98, 0, 0], [1.5, 0.06, 0.01]], atol=1e-6)
    assert volume == pytest.approx(3 * VOLUME_M3, rel=1e-4)


def test_the_stated_scene_is_read(write):
    tree = tetrahedron()
    tree["nodes"].append({"mesh": 0, "scale": [2, 2, 2]})
    tree |= {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}
    assert measure(write(tree))[1] == pytest.approx(8 * VOLUME_M3, rel=1e-5)
    del tree["scene"], tree["scenes"]
    assert len(read_surface(write(tree)).faces) == 8


def test_a_buffer_in_a_file_of_its_own_is_found_or_named(write, tmp_path):
    tree = tetrahedron()
    content = base64.b64decode(tree["buffers"][0]["uri"].split(",")[1])
    tree["buffers"][0]["uri"] = "my%20part.bin"
    with pytest.raises(ObjectError, match=naming("part.gltf", "my part.bin")):
        read_surface(write(tree))
    (tmp_path / "my part.bin").write_bytes(content)
    assert measure(write(tree))[1] == pytest.approx(VOLUME_M3, rel=1e-5)


EXTENSIONS = ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_unknown"]


@pytest.mark.parametrize(
    ("word", "changes"),
    [
        *((name, {"extensionsRequired": ["KHR_materials_unlit", name]}) for name in EXTENSIONS),
        *((version, {"asset": {"version": version}}) for version in ("1.0", "3.0")),
    ],
)
def test_a_required_extension_and_another_version_are_named(write, word, changes):
    with pytest.raises(ObjectError, match=naming("part.gltf", word)):
        read_surface(write(tetrahedron() | changes))


def test_an_optional_extension_needs_its_fallback(write):
    tree = tetrahedron()
    tree["meshes"][0]["primitives"][0]["extensions"] = {EXTENSIONS[0]: {"bufferView": 0, "attributes": {}}}
    tree["bufferViews"][0]["extensions"] = {EXTENSIONS[1]: {"buffer": 0}}
    assert measure(write(tree))[1] == pytest.approx(VOLUME_M3, rel=1e-5)
    for number in (0, 1):
        lacking = json.loads(json.dumps(tree))
        del lacking["accessors"][number]["bufferView"]
        with pytest.raises(ObjectError, match=naming("part.gltf", EXTENSIONS[0])):
            read_surface(write(lacking))
        del lacking["meshes"][0]["primitives"][0]["extensions"]
        with pytest.raises(ObjectError, match=naming("part.gltf")):
            read_surface(write(lacking))
    del tree["buffers"][0]["uri"]
    with pytest.raises(ObjectError, match=naming("part.gltf", EXTENSIONS[1])):
        read_surface(write(tree))
    for buffers in ([], [{"uri": "data:,", "byteLength": 0}]):
        with pytest.raises(ObjectError, match=naming("part.gltf", "lacks data")):
            read_surface(write(tree | {"buffers": buffers}))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("skin", 0),
        ("weights", [0.0, 0.5]),
        ("children", [0]),
        ("children", [1, 1]),
        ("extensions", {"EXT_mesh_gpu_instancing": {}}),
    ],
)
def test_a_mesh_that_a_node_changes_in_another_way_is_refused(write, key, value):
    tree = tetrahedron()
    tree["nodes"].append({})
    tree["nodes"][0][key] = value
    with pytest.raises(ObjectError, match=naming("part.gltf")):
        read_surface(write(tree))


def test_a_cut_binary_file_is_refused(tmp_path):
    path = tmp_path / "box.glb"
    trimesh.creation.box((0.03, 0.02, 0.01)).export(path)
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"trimesh", b"gr\xf6\xdfe--") + b"more")  # neither changes the mesh
    assert len(read_surface(path).faces) == 12
    for length in (4, 40, len(whole) - 4):
        path.write_bytes(whole[:length])
        with pytest.raises(ObjectError, match=naming("box.glb")):
            read_surface(path)
