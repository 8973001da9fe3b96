"""STL, OBJ, OFF and PLY files with polygons give the surface that they describe, in every notation of these formats."""

import struct

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.io.meshes.mesh_files import read_surface

OUTLINE = np.array([(0, 0), (6, 0), (6, 4), (4, 4), (4, 1), (2, 1), (2, 4), (0, 4)], float)
VERTICES = np.concatenate([np.c_[OUTLINE, np.full(8, z)] for z in (0.0, 5.0)])
FACES = [[*range(7, -1, -1)], [*range(8, 16)], *([i, (i + 1) % 8, 8 + (i + 1) % 8, 8 + i] for i in range(8))]
VOLUME = 18.0 * 5.0


def write_obj(style: str) -> bytes:
    points = [f"v {x} {y} {z} 0.5 0.5 0.5" for x, y, z in VERTICES]
    lines = ["# C:\\", *points, "# a channel", "vt 0 0", "vn 0 0 1", "l 1 2"]
    name = {"plain": "{}", "texture": "{}/1", "normal": "{}//1", "both": "{}/1/1", "relative": "{}"}[style]
    shift = -16 if style == "relative" else 1
    corners = [[name.format(i + shift) for i in face] for face in FACES]
    lines += ["o left", "usemtl red", *("f " + " ".join(face[:3]) + " \\\n" + " ".join(face[3:]) for face in corners)]
    return "\n".join([*lines, "v 90 90 90"] if style != "relative" else lines).encode()


def write_stl(faces: list[list[int]] = FACES) -> bytes:
    loops = ["".join("vertex {} {} {}\n".format(*VERTICES[i]) for i in face) for face in faces]
    facets = [f"facet normal -nan(ind) 0 0\nouter loop\n{loop}endloop\nendfacet\n" for loop in loops]
    half = len(faces) // 2
    solids = [
        f"solid vertex {name}\n{''.join(some)}endsolid {name}\n"
        for name, some in (("one", facets[:half]), ("two", facets[half:]))
    ]
    return "".join(solids).encode("utf-8-sig")


def write_binary_stl() -> bytes:
    faces = [[face[0], *face[k : k + 2]] for face in FACES[2:] for k in (1, 2)]
    facets = [struct.pack("<12fH", 0, 0, 0, *VERTICES[face].ravel(), 0) for face in faces]
    return b"solid".ljust(80) + struct.pack("<I", len(facets)) + b"".join(facets)


def write_off(header: str) -> bytes:
    extra = " 0.1 0.2 0.3" if header != "OFF" else ""
    faces = [f"{len(face)} " + " ".join(map(str, face)) + " 255 0 0" for face in FACES]
    lines = [header, "", "# a comment", "16 10 0", *(f"{x} {y} {z}{extra}" for x, y, z in VERTICES), *faces]
    return "\n".join(lines).encode()


def write_ply(form: str, faces: list[list[int]] = FACES) -> bytes:
    head = ["ply", f"format {form} 1.0", "comment no end_header", "element vertex 16", "property double x"]
    head += ["property double y", "property uchar red", "property double z", f"element face {len(faces)}"]
    head += ["property uchar flags", "property list uchar int vertex_indices", "end_header", ""]
    rows = [(x, y, 7, z) for x, y, z in VERTICES], [(1, len(face), *face) for face in faces]
    if form == "ascii":
        lines = [" ".join(f"{value:g}" for value in row) for part in rows for row in part]
        return "\n".join(head + lines).replace("end_header\n\n", "end_header\n").encode()
    order = "<" if form == "binary_little_endian" else ">"
    body = [struct.pack(f"{order}ddBd", *row) for row in rows[0]]
    body += [struct.pack(f"{order}BB{len(row) - 2}i", *row) for row in rows[1]]
    return "\n".join(head).encode() + b"".join(body)


FILES = {
    **{f"{style}.obj": write_obj(style) for style in ("plain", "texture", "normal", "both", "relative")},
    "text.stl": write_stl(),
    "capital.stl": write_stl().upper().replace(b"\n", b"\r\n"),
    "mark.obj": "\ufeff".encode() + write_obj("plain"),
    **{f"{header}.off": write_off(header) for header in ("OFF", "COFF", "NOFF")},
    **{f"{form}.ply": write_ply(form) for form in ("ascii", "binary_little_endian", "binary_big_endian")},
}


@pytest.mark.parametrize("name", FILES)
def test_a_channel_with_eight_corners_keeps_its_groove(tmp_path, name):
    (tmp_path / name).write_bytes(FILES[name])
    surface = read_surface(tmp_path / name)
    assert surface.is_watertight
    assert len(surface.faces) == 2 * 6 + 8 * 2
    assert trimesh.Trimesh(surface.vertices, surface.faces).volume == pytest.approx(VOLUME)
    assert surface.vertices.max() == 6.0  # vertices that no face uses are ignored


def test_negative_numbers_count_back_from_their_own_line(tmp_path):
    """A file with several objects states the vertices of each object before its faces."""
    corners = "v {0} 0 0\nv {0} 1 0\nv {0} 0 1\nf -3 -2 -1\n"
    (tmp_path / "two.obj").write_text(corners.format(0) + corners.format(5))
    surface = read_surface(tmp_path / "two.obj")
    np.testing.assert_array_equal(np.sort(surface.vertices[surface.faces][:, :, 0].mean(axis=1)), [0, 5])


def test_an_off_header_of_one_line_and_a_few_more_bytes_of_a_binary_stl_file_are_read(tmp_path):
    (tmp_path / "one.off").write_text("OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    assert len(read_surface(tmp_path / "one.off").faces) == 1
    (tmp_path / "tube.stl").write_bytes(write_binary_stl() + b"\n")
    surface = read_surface(tmp_path / "tube.stl")
    assert len(surface.faces) == 16
    np.testing.assert_array_equal(np.ptp(surface.vertices, axis=0), [6, 4, 5])


BAD = {
    "letter.stl": b"Dear all, solid parts are attached.",
    "second.stl": write_stl()[:-300],
    "short.stl": write_binary_stl()[:-20],
    "more.stl": write_binary_stl() * 2,
    "zero.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n",
    "far.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 -2 -1\n",
    "curved.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\ncstype bspline\nsurf 0 1 0 1 1 2 3\n",
    "short.off": write_off("OFF")[:-40],
    "four.off": b"4OFF\n1 0 0\n1 2 3 4\n",
    "short.ply": write_ply("binary_little_endian")[:-1],
    "ascii.ply": write_ply("ascii")[:-4],
    "missing.ply": write_ply("binary_big_endian", [[0, 1, 2, 3], [5, 6, 77]]),
}


@pytest.mark.parametrize("name", BAD)
def test_a_damaged_file_is_refused_by_name(tmp_path, name):
    (tmp_path / name).write_bytes(BAD[name])
    with pytest.raises(ObjectError, match=naming(name)):
        read_surface(tmp_path / name)
