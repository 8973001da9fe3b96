"""Unpacks the chunks and messages of recordings, up to `MOST_PART_BYTES`."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from tactile_loc.core.runtime.limits import MOST_PART_BYTES, read_unpacked, require_size


def read_records(file: IO[bytes], size: int) -> Iterator[Any]:
    """Yield the records of an MCAP file of `size` bytes, also those in chunks. Raises the errors of damaged bytes."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    for record in StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=size).records:
        if isinstance(record, Chunk):
            yield from breakup_chunk(_unpack(record), validate_crc=True)
        else:
            yield record


def _unpack(chunk: Any) -> Any:
    """Return a chunk of MCAP without compression. Raises ValueError if it is too large or of another size."""
    from lz4.frame import LZ4FrameFile
    from zstandard import ZstdDecompressor

    open_stream: Any = {"zstd": ZstdDecompressor().stream_reader, "lz4": LZ4FrameFile}.get(chunk.compression)
    if open_stream is None:
        return chunk
    with open_stream(BytesIO(chunk.data)) as stream:
        return replace(chunk, compression="", data=read_unpacked(stream, chunk.uncompressed_size))


def require_chunks(path: Path) -> None:
    """Raise TooLargeError if a chunk of an MCAP file states a size above the limit, without unpacking it."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader
    from zstandard import frame_content_size

    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=path.stat().st_size).records:
            if isinstance(record, Chunk):
                stated = frame_content_size(record.data) if record.compression == "zstd" else record.uncompressed_size
                require_size(max(stated, record.uncompressed_size))


def limit_unpacking(unpack: Callable[[bytes], bytes], most: int = MOST_PART_BYTES) -> Callable[[bytes], bytes]:
    """Return a function that unpacks like `unpack`, which is that of bz2, lz4 or zstd in rosbags, up to `most` bytes.

    It raises TooLargeError for more.
    """
    from lz4.frame import LZ4FrameFile, decompress
    from rosbags.rosbag2.reader import zstd

    streams = {bz2.decompress: bz2.BZ2File, decompress: LZ4FrameFile, zstd.decompress: zstd.ZstdFile}
    open_stream: Any = streams.get(unpack)
    if open_stream is None:
        return unpack

    def unpack_within(data: bytes) -> bytes:
        with open_stream(BytesIO(data)) as stream:
            content: bytes = stream.read(most + 1)
        require_size(len(content), most)
        return content

    return unpack_within
