"""Records of parts: packing, and what they hold; and the table of parts, as Parquet."""

import dataclasses
import io
import struct

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from tactile_loc.core.places.places import FAR
from tactile_loc.plugin import Progress

from tactile_loc_library.descriptor import load_descriptor
from tactile_loc_library.record import LibraryError, PartRecord, PlaceGrid, make_record, read_header
from tactile_loc_library.table import read_table

GRID = PlaceGrid("whole", {"directions": 100})
ARRAYS = ("vertices_m", "faces", "placements", "patches", "vectors")


@pytest.fixture(scope="module")
def record(cylinder) -> PartRecord:
    return make_record(dataclasses.replace(cylinder, source="some/where/rod.stl"), GRID, "mm", "ab" * 32)


@pytest.fixture(scope="module")
def places(record):
    """The places that the grid finds on the record's surface."""
    return GRID.make_sampler().places(record.object, Progress())


def assert_equal(one: PartRecord, other: PartRecord) -> None:
    for field in dataclasses.fields(PartRecord):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name in ARRAYS:
            assert a.dtype == b.dtype
            assert np.array_equal(a, b), field.name
        else:
            assert a == b, field.name


def test_a_packed_record_is_unpacked_as_it_was(record):
    """Differences are modulo 256, so that also noise is packed without loss."""
    noise = np.random.default_rng(0).integers(0, FAR + 1, record.patches.shape).astype(np.uint8)
    for one in (record, dataclasses.replace(record, patches=noise)):
        assert_equal(PartRecord.unpack(one.pack()), one)


def test_a_record_states_the_part(record, cylinder):
    obj = record.object
    assert (record.name, record.source, record.units) == ("cylinder", "rod.stl", "mm")
    assert np.abs(obj.mesh.vertices_m - cylinder.mesh.vertices_m).max() < 1e-8
    assert np.array_equal(obj.mesh.faces, cylinder.mesh.faces)
    assert str(obj.symmetry) == str(cylinder.symmetry) == "zinf*x2"
    assert np.array_equal(obj.symmetry.centre_m, cylinder.symmetry.centre_m)


def test_the_places_are_those_of_the_grid(record, places):
    found = record.places
    assert np.array_equal(found.patches, places.patches)
    assert np.abs(found.T_place_object[:, :3, :3] - places.T_place_object[:, :3, :3]).max() < 1e-6
    assert np.abs(found.T_place_object[:, :3, 3] - places.T_place_object[:, :3, 3]).max() < 2e-8


def test_placements_are_points_of_the_surface_and_directions_into_it(record):
    """A cylinder with radius 8 mm and half length 15 mm: a place touches first, so its direction points inwards."""
    position_m, direction = np.split(record.placements.astype(float), 2, axis=1)
    beyond_m = np.maximum(np.hypot(*position_m[:, :2].T) - 8e-3, np.abs(position_m[:, 2]) - 15e-3)
    assert np.abs(beyond_m).max() < 3e-4  # a pixel of a patch is 0.5 mm wide
    assert np.linalg.norm(direction, axis=1) == pytest.approx(1, abs=1e-6)
    assert np.einsum("ni,ni->n", position_m, direction).max() < 0


def test_vectors_are_those_of_the_descriptor_in_steps(record, places):
    exact = load_descriptor().describe_places(places.patches)
    assert np.abs(record.vectors / 127 - exact).max() <= 0.5 / 127 + 1e-6
    assert record.descriptor == load_descriptor().digest


@pytest.mark.parametrize("position", [3, 18, 40, -1])
def test_a_shortened_record_is_refused(record, position):
    with pytest.raises(LibraryError, match="build"):
        PartRecord.unpack(record.pack()[:position])


def test_a_damaged_stream_is_refused(record):
    packed = bytearray(record.pack())
    at = packed.index(b"}") + 2000
    packed[at : at + 50] = bytes(50)
    with pytest.raises(LibraryError, match=r"cylinder is damaged .*build it again"):
        PartRecord.unpack(bytes(packed))


def test_records_and_tables_that_would_fill_the_memory_are_refused(record):
    packed, huge = record.pack(), str(2**30 // 12).encode()
    header = read_header(packed)
    stated = packed[20 : header.start].replace(f'"vertices":{len(record.vertices_m)}'.encode(), b'"vertices":' + huge)
    with pytest.raises(LibraryError, match="GiB"):
        PartRecord.unpack(packed[:16] + struct.pack("<I", len(stated)) + stated + packed[header.start :])
    file, rows = io.BytesIO(), pa.table({"name": pa.array(np.zeros(2**20, np.int64))})
    with parquet.ParquetWriter(file, rows.schema) as writer:
        for _ in range(33):
            writer.write_table(rows)
    with pytest.raises(ValueError, match="GiB"):
        read_table(file.getvalue())
