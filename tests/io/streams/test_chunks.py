"""Chunks of recordings: unpacked as they are, or refused above the limit."""

from __future__ import annotations

import bz2

import lz4.frame
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2.reader import zstd

from tactile_loc.core.runtime.limits import TooLargeError
from tactile_loc.io.streams.chunks import limit_unpacking, read_records, require_chunks

DATA = np.random.default_rng(0).bytes(5000)


@pytest.mark.parametrize(
    ("pack", "unpack"),
    [(bz2.compress, bz2.decompress), (lz4.frame.compress, lz4.frame.decompress), (zstd.compress, zstd.decompress)],
)
def test_a_chunk_or_message_of_a_bag_is_unpacked_up_to_the_limit(pack, unpack):
    assert limit_unpacking(unpack)(pack(DATA)) == DATA
    assert limit_unpacking(unpack, len(DATA))(pack(DATA)) == DATA
    with pytest.raises(TooLargeError):
        limit_unpacking(unpack, len(DATA) - 1)(pack(DATA))


@pytest.mark.parametrize("compression", CompressionType)
def test_the_records_of_chunks_are_read_with_every_compression(tmp_path, compression):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        channel = writer.register_channel("/a", "none", writer.register_schema("a", "none", b""))
        writer.add_message(channel, 1, DATA, 1)
        writer.finish()
    require_chunks(path)
    with path.open("rb") as file:
        records = list(read_records(file, path.stat().st_size))
    assert DATA in [getattr(record, "data", None) for record in records]
