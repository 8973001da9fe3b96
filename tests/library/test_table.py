"""The table of a library's parts, as Parquet."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

pytest.importorskip("pyarrow")

from tactile_loc.library.table import PartRow, read_table, write_table

ROW = PartRow(*("pin" if field.type == "str" else 1 if field.type == "int" else 0.5 for field in fields(PartRow)))


@pytest.mark.parametrize("rows", [[], [ROW], [ROW, replace(ROW, name="head"), ROW]])
def test_a_table_is_read_back(rows):
    assert read_table(write_table(rows)) == rows


def test_equal_texts_take_memory_once():
    first, *others = read_table(write_table([replace(ROW, name="x" * 1000)] * 9))
    assert all(other.name is first.name for other in others)
