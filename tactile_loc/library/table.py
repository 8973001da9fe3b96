"""The table of a library's parts, one row a part: where its record is, and what it was made from."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

from tactile_loc.core.runtime.errors import LibraryError
from tactile_loc.core.runtime.limits import list_values, require_table
from tactile_loc.library.record import hash_record, read_header, require_pyarrow


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
        x_m, y_m, z_m = values["centre_m"]
        x_mm, y_mm, z_mm = (1e3 * size_m for size_m in values["size_m"])
        return cls(
            values["name"], "", 0, header.body, 0, values["places"], hash_record(packed), key, values["source"],
            values["source_sha256"], values["units"], values["symmetry"], x_m, y_m, z_m,
            x_mm, y_mm, z_mm,
        )  # fmt: skip


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

    names = [field.name for field in fields(PartRow)]
    try:
        # unlike `read_table`, this does not import pandas
        texts = require_table(parquet.read_metadata(pa.BufferReader(content)))
        file = parquet.ParquetFile(pa.BufferReader(content), read_dictionary=texts)
        found = file.read(columns=names, use_threads=False)
        columns = [list_values(found.column(name)) for name in names]
    except (pa.ArrowException, KeyError) as error:
        raise ValueError(str(error)) from error
    return [PartRow(*values) for values in zip(*columns, strict=True)]
