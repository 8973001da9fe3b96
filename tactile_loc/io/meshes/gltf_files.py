"""Reads glTF 2.0 files (.gltf and .glb) as triangles in metres: registry.khronos.org/glTF/specs/2.0/glTF-2.0.html."""

import base64
import json
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Ints, quaternion_to_rotation
from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.core.runtime.limits import MOST_BYTES, require_size
from tactile_loc.io.meshes.polygons import EXPORT_AGAIN, Polygons

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives; lower ones are points and lines
READABLE = re.compile(  # required extensions that do not hide triangles: quantized vertices, and the looks of a surface
    "KHR_mesh_quantization$|KHR_(materials|texture|lights)_|(EXT|MSFT)_texture_|EXT_lights_|KHR_xmp"
)
INSTANCES = "EXT_mesh_gpu_instancing"


def read_gltf(path: Path) -> Polygons:
    """Read the triangles of a glTF file's scene, in metres. Points, lines and materials are ignored.

    Raises ObjectError if the file needs an extension that cannot be decoded, or a file that is missing.
    """
    file = _File(path)
    vertices: list[Floats] = [np.empty((0, 3))]
    triangles: list[Ints] = [np.empty((0, 3), np.int64)]
    held = 0
    for mesh, T in file.list_instances():
        for primitive in file.tree["meshes"][mesh]["primitives"]:
            if primitive.get("mode", TRIANGLES) < TRIANGLES:
                continue
            points, faces = file.read_primitive(primitive)
            held += points.nbytes + faces.nbytes
            require_size(held, MOST_BYTES)
            triangles.append((faces[:, ::-1] if np.linalg.det(T[:3, :3]) < 0 else faces) + sum(map(len, vertices)))
            vertices.append(points @ T[:3, :3].T + T[:3, 3])
    return Polygons.of_triangles(np.concatenate(vertices), np.concatenate(triangles))


class _File:
    """A glTF file: its JSON `tree`, and the buffers that it refers to."""

    def __init__(self, path: Path) -> None:
        self._path = path
        content: bytes = path.read_bytes()
        self._chunk: bytes | None = None
        if content[:4] == b"glTF":
            chunks = dict(reversed(list(_list_chunks(content))))
            content, self._chunk = chunks[b"JSON"], chunks.get(b"BIN\0")
        self.tree: dict[str, Any] = json.loads(content.decode("utf-8-sig", "replace"))
        version = str(self.tree["asset"]["version"])
        if not version.startswith("2."):
            raise ObjectError(f"{path} is glTF {version}; export it again as glTF 2.0")
        for extension in self.tree.get("extensionsRequired", []):
            if not READABLE.match(extension):
                self._refuse(extension)
        self._buffers: dict[int, bytes] = {}

    def _refuse(self, *extensions: str) -> NoReturn:
        """Raise ObjectError: the file needs these extensions, or without any, it lacks data that it refers to."""
        if not extensions:
            raise ObjectError(f"{self._path} lacks data of a mesh that it refers to; {EXPORT_AGAIN}")
        names = " and ".join(extensions)
        raise ObjectError(f"{self._path} needs {names}, which cannot be read; export it again without extensions")

    def list_instances(self) -> Iterator[tuple[int, Floats]]:
        """Yield the number of each mesh of the scene, with its transform (4, 4) to the scene."""
        nodes = self.tree.get("nodes", [])
        if "scenes" in self.tree:
            roots = self.tree["scenes"][self.tree.get("scene", 0)].get("nodes", [])
        else:
            roots = set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])}
        waiting, seen = [(root, np.eye(4)) for root in roots], set()
        while waiting:
            index, T = waiting.pop()
            node = nodes[index]
            if index in seen:
                raise ObjectError(f"{self._path} has a node with several parents; {EXPORT_AGAIN}")
            seen.add(index)
            T = T @ _read_transform(node)
            waiting += [(child, T) for child in node.get("children", [])]
            if "mesh" not in node:
                continue
            weights = node.get("weights", self.tree["meshes"][node["mesh"]].get("weights", []))
            if "skin" in node or any(weights):
                raise ObjectError(f"{self._path} bends a mesh by a skin or by morph targets; export its shape at rest")
            if INSTANCES in node.get("extensions", {}):
                self._refuse(INSTANCES)
            yield node["mesh"], T

    def read_primitive(self, primitive: dict[str, Any]) -> tuple[Floats, Ints]:
        """Return the vertices (V, 3) and triangles (F, 3) of a primitive."""
        position, indices = primitive["attributes"].get("POSITION"), primitive.get("indices")
        for number in (position, indices):
            stored = number is None or not {"bufferView", "sparse"}.isdisjoint(self.tree["accessors"][number])
            if position is None or not stored:
                self._refuse(*primitive.get("extensions", ()))
        vertices = self._read_accessor(position).astype(float)
        order = np.arange(len(vertices)) if indices is None else self._read_accessor(indices).ravel().astype(np.int64)
        mode = primitive.get("mode", TRIANGLES)
        if mode == TRIANGLES:
            return vertices, order.reshape(-1, 3)
        i = np.arange(len(order) - 2)
        if mode == STRIP:
            return vertices, order[np.stack([i, i + 1 + i % 2, i + 2 - i % 2], axis=1)]
        return vertices, order[np.stack([i + 1, i + 2, 0 * i], axis=1)]

    def _read_accessor(self, number: int) -> NDArray[Any]:
        accessor = self.tree["accessors"][number]
        kind, shape = np.dtype(COMPONENTS[accessor["componentType"]]), (accessor["count"], WIDTHS[accessor["type"]])
        require_size(24 * accessor["count"], MOST_BYTES)  # three coordinates in memory; buffers need not hold them
        values = self._read_view(accessor, kind, shape) if "bufferView" in accessor else np.zeros(shape, kind)
        if sparse := accessor.get("sparse"):
            places = self._read_view(
                sparse["indices"], np.dtype(COMPONENTS[sparse["indices"]["componentType"]]), (sparse["count"],)
            )
            values = values.copy()
            values[places] = self._read_view(sparse["values"], kind, (sparse["count"], shape[1]))
        if accessor.get("normalized") and kind.kind in "iu":
            return np.maximum(values / float(np.iinfo(kind).max), -1.0)
        return values

    def _read_view(self, place: dict[str, Any], kind: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
        """Read numbers of a shape from the buffer view and the byte offset that `place` states."""
        values = None
        with suppress(LookupError, TypeError, ValueError):  # a buffer is missing or too short
            view = self.tree["bufferViews"][place["bufferView"]]
            row = kind.itemsize * (shape[1] if len(shape) > 1 else 1)
            strides = (view.get("byteStride", row), kind.itemsize)[: len(shape)]
            start = view.get("byteOffset", 0)
            part = memoryview(self._load_buffer(view))[start : start + view["byteLength"]]
            if part:  # numpy returns any memory for an empty buffer
                values = np.ndarray(shape, kind, part, place.get("byteOffset", 0), strides)
        if values is None:
            self._refuse()
        return values

    def _load_buffer(self, view: dict[str, Any]) -> bytes:
        number = view["buffer"]
        if number not in self._buffers:
            uri = self.tree["buffers"][number].get("uri")
            if uri is None:
                if number or self._chunk is None:
                    self._refuse(*view.get("extensions", ()))
                self._buffers[number] = self._chunk
            elif uri.startswith("data:"):
                self._buffers[number] = base64.b64decode(uri.split(",", 1)[1])
            else:
                file = self._path.parent / unquote(uri)
                if not file.is_file():
                    raise ObjectError(f"{self._path} needs the file {file}, which is missing; put it there")
                self._buffers[number] = file.read_bytes()
        return self._buffers[number]


def _list_chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the type and the content of each chunk of a GLB file."""
    start, end = 12, int.from_bytes(content[8:12], "little")
    while start < end:
        length = int.from_bytes(content[start : start + 4], "little")
        if start + 8 + length > min(end, len(content)):
            raise ValueError("the file ends too early")
        yield content[start + 4 : start + 8], content[start + 8 : start + 8 + length]
        start += 8 + length


def _read_transform(node: dict[str, Any]) -> Floats:
    """Return the transform (4, 4) from a node to its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    T = np.eye(4)
    quaternion = np.array([w, x, y, z]) / max(float(np.linalg.norm([w, x, y, z])), 1e-300)
    T[:3, :3] = quaternion_to_rotation(quaternion) * node.get("scale", (1.0, 1.0, 1.0))
    T[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return T
