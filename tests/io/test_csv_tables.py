"""Tables from CSV files: the rows, the columns, and the errors of the caller's class."""

from __future__ import annotations

import pytest
from message_helpers import naming

from tactile_loc.core.errors import FrameError, TouchError
from tactile_loc.io.csv_tables import read_number, read_table


def test_cells_and_names_lose_their_spaces_and_missing_cells_are_empty(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("\ufeffa, b ,c\n 1 , x\n2,y,3,extra\n", encoding="utf-8")
    rows, columns = read_table(path, "row", TouchError)
    assert columns == ["a", "b", "c"]
    assert rows == [{"a": "1", "b": "x", "c": ""}, {"a": "2", "b": "y", "c": "3"}]
    assert read_number(rows[1], "c", TouchError) == 3.0


@pytest.mark.parametrize("cell", ["", "east", "nan", "inf"])
def test_only_finite_numbers_are_read(cell):
    with pytest.raises(FrameError, match=naming("x_m", cell)):
        read_number({"x_m": cell}, "x_m", FrameError)


def test_errors_have_the_class_and_the_noun_of_the_caller(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("a,b\n")
    with pytest.raises(FrameError, match=naming("table.csv", "sensor pose")):
        read_table(path, "sensor pose", FrameError)
    with pytest.raises(TouchError, match=naming("none.csv")):
        read_table(tmp_path / "none.csv", "touch", TouchError)
