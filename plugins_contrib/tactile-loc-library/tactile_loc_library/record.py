"""The record of a part: its surface, its places and the vectors of its places. It does not depend on a sensor.

A packed record is a body, the placements and the vectors, one after another. The body is a header and a zstd stream of
the surface and the patches. Equal records give equal bytes. The placements and vectors are not compressed, so a shard
can hold them as arrays that a search maps into memory: see `shards.py`.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tactile_loc import ObjectModel, TactileLocError, TriangleMesh
from tactile_loc.plugin import ConfigError, GridSampler, MissingLibraryError, Places, Progress, registry
from tactile_loc.plugin.helpers import PATCH_PX, SymmetryGroup, show_name, use_one_blas_thread

from tactile_loc_library.descriptor import load_descriptor

VERSION, PLACES_VERSION = 2, 1  # increase if the same part gives another record, or the same places mean something else
MAGIC = b"tactile-loc part"
LEVEL = 9  # of zstd, which is read four times as fast as zlib; level 15 takes eight times as long for two percent
PLACED = 6  # numbers of a placement
DIRECTIONS = 800  # of the places of a part
AXIS_TOLERANCE = 1e-3  # radians; a grid whose places have other axes cannot be stored
MOST_BYTES = 2**28  # of an unpacked record or table, which a damaged file could exceed
SHORT_DIGITS = 16  # of a hash that names a file

_HEAD = struct.Struct("<16sI")  # MAGIC, and the length of the header in bytes


class LibraryError(TactileLocError):
    """A library of parts cannot be read, written or changed: it is missing, damaged, or lacks a part."""


class Header(NamedTuple):
    """The header of a packed record, and the lengths (bytes) of the record's parts."""

    values: Mapping[str, Any]
    start: int
    body: int
    placements: int
    vectors: int


@dataclass(frozen=True, eq=False)
class PartRecord:
    """A part of a library.

    `vertices_m` (V, 3), float32, metres, in the object frame, and `faces` (F, 3), int32, are the surface. `symmetry`
    and its `centre_m` (3,), metres, are as in `SymmetryGroup.parse`. `source` is the name of the mesh file, and
    `source_sha256` is its checksum. `units` is the unit that was given for the file.

    The N places are those of `grid`: the name of a grid, and what identifies its places. `placements` (N, 6), float32,
    are the position of each place, metres, and the unit direction that points from the sensor into the part, both in
    the object frame. `patches` (N, PATCH_PX, PATCH_PX) are as in `Places`. `vectors` (N, D), int8, are the places' unit
    vectors, times STEPS, computed by the descriptor with the digest `descriptor`.
    """

    name: str
    vertices_m: NDArray[np.float32]
    faces: NDArray[np.int32]
    units: str
    symmetry: str
    centre_m: tuple[float, float, float]
    source: str
    source_sha256: str
    grid: Mapping[str, Any]
    placements: NDArray[np.float32]
    patches: NDArray[np.uint8]
    vectors: NDArray[np.int8]
    descriptor: str
    places_version: int = PLACES_VERSION

    @cached_property
    def object(self) -> ObjectModel:
        """The part as an object to locate."""
        mesh = TriangleMesh(self.vertices_m.astype(float), self.faces.astype(np.int64))
        return ObjectModel(self.name, mesh, SymmetryGroup.parse(self.symmetry, self.centre_m), (), self.source)

    @cached_property
    def places(self) -> Places:
        """The places of the part. Their poses differ by a few nanometres from those that the grid computed."""
        return Places.at(self.placements, self.patches)

    def pack(self) -> bytes:
        """Return the record as bytes. Raises MissingLibraryError without pyarrow."""
        zero = np.uint8(0)
        differences = np.diff(np.diff(self.patches, axis=1, prepend=zero), axis=2, prepend=zero)  # modulo 256
        faces = np.diff(self.faces.ravel(), prepend=np.int32(0))
        streams = (self.vertices_m.astype("<f4"), faces.astype("<i4"), differences)
        stream = _make_codec().compress(b"".join(one.tobytes() for one in streams), asbytes=True)
        values = {
            "version": VERSION,
            "name": self.name,
            "units": self.units,
            "symmetry": self.symmetry,
            "centre_m": list(self.centre_m),
            "source": self.source,
            "source_sha256": self.source_sha256,
            "grid": self.grid,
            "places_version": self.places_version,
            "descriptor": self.descriptor,
            "size_m": np.ptp(self.vertices_m, axis=0).astype(float).tolist(),
            "vertices": len(self.vertices_m),
            "faces": len(self.faces),
            "places": len(self.patches),
            "dimensions": self.vectors.shape[1],
            "stream": len(stream),
        }
        header = write_canonical_json(values)
        tail = self.placements.astype("<f4").tobytes() + self.vectors.tobytes()
        return b"".join([_HEAD.pack(MAGIC, len(header)), header, stream, tail])

    @classmethod
    def unpack(cls, packed: bytes) -> PartRecord:
        """Return the record that `pack` wrote. Raises LibraryError if the bytes are no record of this version."""
        from tactile_loc_library.similarity import integrate  # numba takes a while to import

        values, start, body, *_ = read_header(packed)
        places = values["places"]
        length = 12 * (values["vertices"] + values["faces"]) + PATCH_PX**2 * places
        try:
            require_bytes(length)
            stream = _make_codec().decompress(packed[start:body], length, asbytes=True)
            surface = (("<f4", (values["vertices"], 3)), ("<i4", (values["faces"], 3)))
            vertices_m, faces, differences = _split(stream, *surface, ("u1", (places, PATCH_PX, PATCH_PX)))
            placed = (("<f4", (places, PLACED)), ("i1", (places, values["dimensions"])))
            placements, vectors = _split(packed[body:], *placed)
        except (OSError, MemoryError, ValueError) as error:
            raise LibraryError(f"the record of {values['name']} is damaged ({error}); build it again") from error
        same = ("name", "units", "symmetry", "source", "source_sha256", "grid", "descriptor", "places_version")
        return cls(
            **{key: values[key] for key in same},
            vertices_m=vertices_m,
            faces=np.cumsum(faces, dtype=np.int32).reshape(-1, 3),
            centre_m=tuple(values["centre_m"]),
            placements=placements,
            patches=integrate(differences),
            vectors=vectors,
        )


@dataclass(frozen=True)
class PlaceGrid:
    """The grid of a library's places: the `name` under which it is registered, and its `options`."""

    name: str = "whole"
    options: Mapping[str, Any] = field(default_factory=lambda: {"directions": DIRECTIONS})

    def make_sampler(self) -> GridSampler:
        """Return the grid. Raises ConfigError if it lists poses, not places."""
        sampler: GridSampler = registry().create("grid", self.name, self.options)
        if not sampler.capabilities.places:
            raise ConfigError(f"the grid {self.name!r} lists poses, but a library needs places; choose the grid whole")
        return sampler

    def describe(self) -> dict[str, Any]:
        """Return the name of the grid, and what identifies its places, as JSON values.

        The version of places stands for the grid's code, so a library outlives changes that leave its places alone.
        """
        described = {k: v for k, v in self.make_sampler().describe().items() if k != "code"}
        return {"name": self.name, "version": PLACES_VERSION, **described}


def make_record(obj: ObjectModel, grid: PlaceGrid, units: str, source_sha256: str) -> PartRecord:
    """Return the record of an object, with the places of a grid.

    The surface is rounded to float32 first, so that the places are those of the record's surface. Raises the errors of
    `GridSampler.places`, and LibraryError if the grid rotates its places in another way than the grid `whole`.
    """
    vertices_m = obj.mesh.vertices_m.astype(np.float32)
    rounded = replace(obj, mesh=TriangleMesh(vertices_m.astype(float), obj.mesh.faces))
    places = grid.make_sampler().places(rounded, Progress())
    descriptor = load_descriptor()
    with use_one_blas_thread():  # the sums of several threads may differ in the last bit
        vectors = descriptor.describe_in_steps(places.patches)
    x, y, z = (float(coordinate) for coordinate in obj.symmetry.centre_m)
    record = PartRecord(
        obj.name,
        vertices_m,
        obj.mesh.faces.astype(np.int32),
        units,
        str(obj.symmetry),
        (x, y, z),
        show_name(obj.source.rpartition("/")[2]),
        source_sha256,
        grid.describe(),
        places.placements.astype(np.float32),
        places.patches,
        vectors,
        descriptor.digest,
    )
    if np.abs((record.places.T_place_object - places.T_place_object)[:, :3, :3]).max(initial=0.0) > AXIS_TOLERANCE:
        raise LibraryError(f"the places of the grid {grid.name!r} cannot be stored; choose the grid whole")
    return record


def read_header(packed: bytes) -> Header:
    """Read the header of a packed record, or of its body. Raises LibraryError if the record has another version."""
    try:
        magic, length = _HEAD.unpack_from(packed)
        if magic != MAGIC:
            raise ValueError("it does not begin as one")
        start = _HEAD.size + length
        values = json.loads(packed[_HEAD.size : start])
        version, places = values["version"], values["places"]
        body = start + values["stream"]
        found = Header(values, start, body, 4 * PLACED * places, values["dimensions"] * places)
    except (struct.error, ValueError, KeyError, TypeError, RecursionError) as error:
        raise LibraryError(f"these bytes are no record of a part ({error}); build the part again") from error
    if version != VERSION:
        raise LibraryError(f"the record of {values['name']} has format {version}, not {VERSION}; build it again")
    return found


def require_pyarrow() -> None:
    """Raise MissingLibraryError if pyarrow is not installed."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise MissingLibraryError(
            "a library of parts needs pyarrow, which is not installed: pip install pyarrow"
        ) from error


def require_bytes(size: int) -> None:
    """Raise ValueError if something takes more than MOST_BYTES in memory."""
    if not 0 <= size <= MOST_BYTES:
        raise ValueError(f"it takes {size / 2**30:.3g} GiB of memory; the limit is {MOST_BYTES / 2**30:.3g} GiB")


def write_canonical_json(value: Any) -> bytes:
    """Return a JSON value as bytes: keys sorted, without spaces, ASCII only."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def hash_bytes(content: bytes) -> str:
    """Return the SHA-256 (hex) of some bytes."""
    return hashlib.sha256(content).hexdigest()


def hash_file(path: Path) -> str:
    """Return the SHA-256 (hex) of a file's content. Raises OSError if the file cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def guard_output(path: Path) -> Iterator[None]:
    """Convert an OSError of the block, which writes `path`, to a LibraryError."""
    try:
        yield
    except OSError as error:
        raise LibraryError(f"{path} cannot be written ({error.strerror or error}); choose another `out`") from error


def _make_codec() -> Any:
    require_pyarrow()
    import pyarrow as pa

    return pa.Codec("zstd", compression_level=LEVEL)


def _split(content: bytes, *arrays: tuple[str, tuple[int, ...]]) -> list[NDArray[Any]]:
    """Return consecutive arrays of these types and shapes. Raises ValueError unless they fill the content."""
    found, at = [], 0
    for kind, shape in arrays:
        count = int(np.prod(shape))
        found.append(np.frombuffer(content, kind, count, at).reshape(shape))
        at += found[-1].nbytes
    if at != len(content):
        raise ValueError(f"{len(content) - at} bytes are left")
    return found
