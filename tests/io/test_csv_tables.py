"""Tables from CSV files: the rows, the columns, and the errors of the caller's class."""

from pathlib import Path

import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import FrameError, TouchError
from tactile_loc.io.csv_tables import read_number, read_table, require_columns


def read(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return read_table(path, "row", TouchError)


def test_cells_and_names_lose_their_spaces_and_missing_cells_are_empty(tmp_path):
    table = read(tmp_path / "table.csv", "a, b ,c\n\n 1 , x\n2,y,3,\n")
    assert table.columns == ["a", "b", "c"]
    assert table.rows == [{"a": "1", "b": "x", "c": ""}, {"a": "2", "b": "y", "c": "3"}]
    assert table.lines == [3, 4]
    assert read_number(table.rows[1], "c", TouchError) == 3.0
    assert read(tmp_path / "noted.csv", "# note\n\na,b\n\n#1.png,x\n").lines == [5]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(
    "lines",
    [
        ("n,x,y", "ü,1.5,-2e-3"),
        ("n;x;y", "ü;1,5;-2,0e-3"),
        ("n\tx\ty", "ü\t1.5\t-2e-3"),
        ("sep=;", "n;x;y", "ü;1,5;-2e-3"),
        ("", "# poses, in mm", "n;x;y", "# first part", "ü;1,5;-2e-3", ";;"),
    ],
)
def test_tables_of_spreadsheets_are_read(tmp_path, lines, end, encoding):
    (row,) = read(tmp_path / "table.csv", end.join([*lines, ""]), encoding).rows
    assert row["n"] == "ü"
    assert [read_number(row, name, TouchError) for name in "xy"] == [1.5, -2e-3]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,5,2\n", ("row 1", "3 cells")),
        ("a;b\n1,5;2.5\n", ("decimal comma",)),
        ("a;b\n1.234,5;2\n", ("1.234,5",)),
        ("a,b,a\n1,2,3\n", ("'a'",)),
    ],
)
def test_ambiguous_numbers_are_refused(tmp_path, text, words):
    with pytest.raises(TouchError, match=naming(*words)):
        read_number(read(tmp_path / "table.csv", text).rows[0], "a", TouchError)


def test_only_finite_numbers_are_read_and_missing_columns_are_named_with_the_others():
    for cell in ("", "east", "nan", "inf"):
        with pytest.raises(FrameError, match=naming("x_m", cell)):
            read_number({"x_m": cell}, "x_m", FrameError)
    with pytest.raises(TouchError, match=naming("t.csv", "'x_mm'", "x_m, y")):
        require_columns(Path("t.csv"), ["x_m", "y"], ["y", "x_mm"], TouchError)


def test_errors_have_the_class_and_the_noun_of_the_caller(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("a,b\n")
    with pytest.raises(FrameError, match=naming("table.csv", "sensor pose")):
        read_table(path, "sensor pose", FrameError)
    (tmp_path / "bytes.csv").write_bytes(b"\xff\x81")
    for name, reason in (("none.csv", "none.csv"), ("bytes.csv", "UTF-8")):
        with pytest.raises(TouchError, match=naming(name, reason)):
            read_table(tmp_path / name, "touch", TouchError)
