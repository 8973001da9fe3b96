"""Reads STL, OBJ, OFF and PLY files, whose faces may be polygons."""

import codecs
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.io.meshes.polygons import EXPORT_AGAIN, Polygons

COMMENT = re.compile(rb"^[ \t]*#[^\r\n]*", re.MULTILINE)  # it may end in a backslash, but does not continue
CONTINUED = re.compile(rb"\\[ \t]*(\r\n?|\n)")
FREE_FORM = ("surf", "curv", "curv2", "scrv")
PLY_TYPES = {"char": "i1", "uchar": "u1", "int": "i4", "uint": "u4", "float": "f4"}  # other names are those of numpy


def read_obj(path: Path) -> Polygons:
    """Read the polygons of a Wavefront OBJ file. Raises ObjectError if it has free-form surfaces."""
    vertices: list[list[str]] = []
    faces: list[list[int]] = []
    content = COMMENT.sub(b"", path.read_bytes().removeprefix(codecs.BOM_UTF8))
    for line in _list_lines(CONTINUED.sub(b" ", content)):
        kind, *words = line.split()
        if kind == "v":
            vertices.append(words[:3])
        elif kind == "f":
            numbers = [int(word.split("/", 1)[0]) for word in words]
            faces.append([n - 1 if n >= 0 else len(vertices) + n for n in numbers])  # negative numbers count backwards
        elif kind in FREE_FORM:
            raise ObjectError(f"{path} has free-form surfaces ({kind}), which are not read; {EXPORT_AGAIN}")
    return _gather(vertices, faces)


def read_off(path: Path) -> Polygons:
    """Read the polygons of an OFF file. Colours and normals are ignored."""
    lines = _list_lines(path.read_bytes())
    header = re.match(r"(ST)?C?N?OFF\b\s*", lines[0]) if lines else None
    if header is None:
        raise ObjectError(f"{path} does not begin with OFF, COFF or NOFF; {EXPORT_AGAIN}")
    lines[:1] = [lines[0][header.end() :]] if header.end() < len(lines[0]) else []
    vertices, faces = (int(word) for word in lines[0].split()[:2])
    if len(lines) < 1 + vertices + faces:
        raise ObjectError(f"{path} ends before its {vertices} vertices and {faces} faces; {EXPORT_AGAIN}")
    rows = [[int(word) for word in _cut_list(line.split())] for line in lines[1 + vertices : 1 + vertices + faces]]
    return _gather([line.split()[:3] for line in lines[1 : 1 + vertices]], rows)


def read_stl(path: Path) -> Polygons:
    """Read the facets of an STL file, text or binary. Raises ObjectError if it ends too early, or has more content."""
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little")
    more = len(content) - 84 - 50 * count
    if more == 0 or b"\0" in content:
        if not 0 <= more < 50:
            raise ObjectError(f"{path} does not hold the {count} triangles that it states; {EXPORT_AGAIN}")
        facets = np.frombuffer(content, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("use", "<u2")], count, 84)
        return Polygons.of_triangles(facets["corners"].reshape(-1, 3), np.arange(3 * count))
    text = content.removeprefix(codecs.BOM_UTF8).lower().replace(b"\r", b"\n")
    solids = re.findall(rb"^\s*(end)?solid\b.*$", text, re.MULTILINE)
    if not solids:
        raise ObjectError(f"{path} is not an STL file; {EXPORT_AGAIN}")
    if len(solids) != 2 * solids.count(b"end"):
        raise ObjectError(f"{path} begins or ends within a solid; {EXPORT_AGAIN}")
    text = re.sub(rb"^\s*(end)?solid\b.*$", b"", text, flags=re.MULTILINE)  # a name may be any word
    vertices = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", text)
    counts = np.array([loop.count(b"vertex") for loop in text.split(b"endloop")], np.int64)
    return Polygons(np.array(vertices, "S").reshape(-1, 3).astype(float), np.arange(counts.sum()), counts)


def _list_lines(content: bytes) -> list[str]:
    """Return the lines of a text without comments and without empty lines."""
    lines = (line.split("#", 1)[0].strip() for line in content.decode("utf-8-sig", "replace").splitlines())
    return [line for line in lines if line]


def _cut_list(words: list[str]) -> list[str]:
    """Return the entries of a list that begins with their number, without what follows them."""
    entries = words[1 : 1 + int(words[0])]
    if len(entries) != int(words[0]):
        raise ValueError(f"a face has {len(entries)} of {words[0]} corners")
    return entries


def _gather(vertices: Any, faces: Any) -> Polygons:
    corners = np.concatenate([np.empty(0, np.int64), *faces]).astype(np.int64) if len(faces) else np.empty(0, np.int64)
    return Polygons(np.array(vertices, float), corners, np.array([len(face) for face in faces], np.int64))


class _Property(NamedTuple):
    """A property of a PLY element: its name, its type, and for a list the type of the list's length."""

    name: str
    kind: str
    length: str | None


def read_ply(path: Path) -> Polygons:
    """Read the polygons of a PLY file: text, or binary in either byte order."""
    head, _, body = re.split(rb"^(end_header[^\S\n]*\n)", path.read_bytes(), maxsplit=1, flags=re.MULTILINE)
    lines = [line.split() for line in head.decode("utf-8", "replace").splitlines()]
    form = next(words[1] for words in lines if words[:1] == ["format"])
    is_text, order = form == "ascii", ">" if form == "binary_big_endian" else "<"
    data = np.array(body.split(), "<f8").tobytes() if is_text else body
    elements: dict[str, tuple[int, list[_Property]]] = {}
    for words in lines:
        if words[:1] == ["element"]:
            elements[words[1]] = int(words[2]), []
        elif words[:1] == ["property"]:
            types = [np.dtype(PLY_TYPES.get(word, word)) for word in words[1:-1] if word != "list"]
            kinds = ["<f8" if is_text else (order + kind.str[1:]) for kind in types]
            elements[list(elements)[-1]][1].append(_Property(words[-1], kinds[-1], kinds[0] if kinds[1:] else None))
    start, columns = 0, {}
    for name, (count, properties) in elements.items():
        columns[name], start = _read_element(data, start, count, properties) if count else ({}, start)
    if "tristrips" in columns:
        raise ObjectError(f"{path} has strips of triangles; {EXPORT_AGAIN}")
    vertices = np.stack([np.asarray(columns["vertex"][axis], float).ravel() for axis in "xyz"], axis=1)
    faces = columns.get("face", {})
    named = [name for name in ("vertex_indices", "vertex_index", *faces) if name in faces]
    return _gather(vertices, faces[named[0]] if named else [])


def _read_element(data: bytes, start: int, count: int, properties: Sequence[_Property]) -> tuple[dict[str, Any], int]:
    """Return the columns of `count` rows that begin at a byte, and the byte after them."""
    fields: list[tuple[Any, ...]] = []
    for p in properties:
        if p.length:
            length = int(np.frombuffer(data, p.length, 1, start + np.dtype(fields).itemsize)[0])
            fields += [(f"length of {p.name}", p.length), (p.name, p.kind, (length,))]
        else:
            fields.append((p.name, p.kind))
    row = np.dtype(fields)  # of the first row; often, all rows are like it
    if start + count * row.itemsize <= len(data):
        table = np.frombuffer(data, row, count, start)
        lengths = [table[f"length of {p.name}"] for p in properties if p.length]
        if all((length == length[0]).all() for length in lengths):
            return {p.name: table[p.name] for p in properties}, start + count * row.itemsize
    columns: dict[str, list[NDArray[Any]]] = {p.name: [] for p in properties}
    for _ in range(count):
        for p in properties:
            length = 1
            if p.length:
                length = int(np.frombuffer(data, p.length, 1, start)[0])
                start += np.dtype(p.length).itemsize
            columns[p.name].append(np.frombuffer(data, p.kind, length, start))
            start += length * np.dtype(p.kind).itemsize
    return columns, start
