"""The table of a library's parts, one row a part: where its record is, and what it was made from."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any

from tactile_loc_library.record import LibraryError, hash_bytes, read_header, require_bytes, require_pyarrow


@dataclass(frozen=True)
class PartRow:
    """A part of a library.

    The body of the part's packed record is in the records of the shard `shard`: `length` bytes, from `offset` on. The
    part's `places` placements and vectors are rows of the shard's arrays, from row `first` on. `sha256` is the checksum
    of the whole packed record. `key` is a hash of everything that the record was made from; empty if that is unknown.
    The other columns describe the part, the centre of its symmetry, m, and the box around it, mm, in the object frame.
    """

    name: str
    shard: str
    offset: int
    length: int
    first: int
    places: int
    sha256: str
    key: str
    source: str
    source_sha256: str
    units: str
    symmetry: str
    centre_x_m: float
    centre_y_m: float
    centre_z_m: float
    x_mm: float
    y_mm: float
    z_mm: float

    @classmethod
    def of(cls, packed: bytes, key: str) -> PartRow:
        """Return the row of a packed record that is in no shard yet. Raises LibraryError if it is no record."""
        header = read_header(packed)
        values = header.values
        if len(packed) != header.body + header.placements + header.vectors:
            raise LibraryError(f"the record of {values['name']} is incomplete; build it again")
        same = ("name", "places", "source", "source_sha256", "units", "symmetry")
        centre = {f"centre_{axis}_m": value for axis, value in zip("xyz", values["centre_m"], strict=True)}
        size = {f"{axis}_mm": 1e3 * size_m for axis, size_m in zip("xyz", values["size_m"], strict=True)}
        placed = {"shard": "", "offset": 0, "length": header.body, "first": 0}
        described = {**{name: values[name] for name in same}, **placed, **centre, **size}
        return cls(**described, sha256=hash_bytes(packed), key=key)


def write_table(rows: Sequence[PartRow]) -> bytes:
    """Return rows as a Parquet file. Raises MissingLibraryError without pyarrow."""
    require_pyarrow()
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {"str": pa.string(), "int": pa.int64(), "float": pa.float64()}
    columns = list(zip(*map(astuple, rows), strict=True)) or [()] * len(fields(PartRow))
    arrays = {
        field.name: pa.array(column, kinds[str(field.type)])
        for field, column in zip(fields(PartRow), columns, strict=True)
    }
    file = io.BytesIO()
    parquet.write_table(pa.table(arrays), file)
    return file.getvalue()


def read_table(content: bytes) -> list[PartRow]:
    """Return the rows of a Parquet file. Raises ValueError if it holds none, or MissingLibraryError."""
    require_pyarrow()
    import pyarrow as pa
    from pyarrow import parquet

    try:
        about = parquet.read_metadata(pa.BufferReader(content))
        packed = sum(about.row_group(n).total_byte_size for n in range(about.num_row_groups))
        require_bytes(max(packed, 8 * about.num_rows * about.num_columns))
        columns = map(about.schema.column, range(about.num_columns))
        texts = [column.path for column in columns if column.physical_type == "BYTE_ARRAY"]
        # unlike `parquet.read_table`, this does not import pandas
        file = parquet.ParquetFile(pa.BufferReader(content), read_dictionary=texts)
        found = file.read(columns=[field.name for field in fields(PartRow)], use_threads=False)
        values = [_list_values(found.column(field.name)) for field in fields(PartRow)]
    except (pa.ArrowException, KeyError) as error:
        raise ValueError(str(error)) from error
    return [PartRow(*one) for one in zip(*values, strict=True)]


def _list_values(column: Any) -> list[Any]:
    """Return the values of a column (pyarrow). Equal texts are one object, and take memory once."""
    if not hasattr(column.type, "value_type"):
        return list(column.to_pylist())
    whole = column.unify_dictionaries().combine_chunks()
    texts = whole.dictionary.to_pylist()
    return [None if k is None else texts[k] for k in whole.indices.to_pylist()]
