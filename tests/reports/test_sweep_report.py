"""The page of a sweep agrees with its rows, for any columns."""

import json

import pytest
from message_helpers import missing, naming
from report_helpers import Elements, html_of, page_in, sweep_rows, write_sweep

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.reports.sweep import find_components, find_measured_lines, find_varying, is_factor, read_rows


def test_varying_columns_are_found():
    rows = read_rows({"rows": sweep_rows()})
    assert find_varying(rows) == ["object", "refiner", "grid.spacing_mm"]
    assert find_components(rows) == ["refiner", "grid.spacing_mm"]
    assert find_measured_lines(rows) == ["chosen", "best-1"]


@pytest.mark.parametrize(
    ("column", "is_one"),
    [("object", True), ("grid.spacing_mm", True), ("grid_poses", False), ("chosen_median_mm", False), ("a.b", False)],
)
def test_factors_are_distinguished_from_measures(column, is_one):
    assert is_factor(column) is is_one


def test_the_page_shows_the_rows_of_the_file(sweep_folder):
    data, rows = page_in(sweep_folder).data, sweep_rows()
    assert len(data["rows"]) == len(rows)
    for drawn, row in zip(data["rows"], rows, strict=True):
        assert drawn["chosen_median_mm"] == row["chosen_median_mm"]
        assert drawn["chosen_ms"] == pytest.approx(row["chosen_ms"])
        assert (drawn["object"], drawn["refiner"]) == (row["object"], row["refiner"])
    assert data["line_times"] == {"chosen": "chosen_ms"}, "errors are drawn against the time of their line"
    page = Elements(html_of(sweep_folder))
    assert not missing(page.text, "pin", "6 mm", "filterreg, 4.0"), "the best of each object is named"
    table = page.rows
    measured = ["best-1 (mm)", "chosen (mm)", "coverage 80", "chosen (ms)", "model (s)", "grid poses"]
    assert table[0] == ["object", "refiner", "grid.spacing_mm", *measured]
    assert [float(cell) for cell in table[1][3:5]] == [rows[0]["best-1_median_mm"], rows[0]["chosen_median_mm"]]


def test_the_page_states_the_sentence_and_the_differences(tmp_path):
    write_sweep(tmp_path)
    document = json.loads((tmp_path / "sweep.json").read_text())
    row = {"object": "pin", "refiner": "icp", "grid.spacing_mm": 4.0, "error_difference_mm": -1.5}
    row |= {"error_difference_low_mm": -2.0, "error_difference_high_mm": -1.0, "error_verdict": "better"}
    added = {"line": "chosen", "differences": [row]}
    (tmp_path / "sweep.json").write_text(json.dumps({**document, **added}))
    page = Elements(html_of(tmp_path))
    assert ["pin", "icp", "4.0", "-1.5 (-2 to -1)", "better", "", ""] in page.rows


def test_failed_rows_are_listed_with_their_errors_and_not_drawn(tmp_path):
    rows = sweep_rows()
    rows[1] |= {"error": "the grid is empty", "chosen_median_mm": None, "best-1_median_mm": None, "chosen_ms": None}
    folder = write_sweep(tmp_path, rows)
    assert len(page_in(folder).data["rows"]) == len(rows) - 1
    found = Elements(html_of(folder))
    assert ["pin", "icp", "4.0", "the grid is empty"] in found.rows


def test_a_sweep_with_only_failures_has_a_page(tmp_path):
    rows = [{"object": "pin", "refiner": name, "chosen_median_mm": None, "error": "no"} for name in ("a", "b")]
    page = page_in(write_sweep(tmp_path, rows))
    assert page.data["rows"] == []
    assert [section.name for section in page.sections] == ["summary", "rows", "failed", "made"]


@pytest.mark.parametrize(("rows", "says"), [([], "combination"), (None, "NoneType"), ([1], "'int'")])
def test_missing_or_damaged_rows_give_a_one_sentence_error(tmp_path, rows, says):
    write_sweep(tmp_path)
    document = json.loads((tmp_path / "sweep.json").read_text())
    (tmp_path / "sweep.json").write_text(json.dumps({**document, "rows": rows}))
    with pytest.raises(ResultError, match=rf"sweep\.json.*{says}"):
        page_in(tmp_path)


def test_a_sweep_without_rows_or_readable_text_gives_a_one_sentence_error(tmp_path):
    (tmp_path / "sweep.json").write_text("{}")
    with pytest.raises(ResultError, match=naming("sweep.json", "'rows'")):
        page_in(tmp_path)
    (tmp_path / "sweep.json").write_bytes(b"object\n\xff\xfe\n")
    with pytest.raises(ResultError, match=naming("sweep.json", "JSON", "0xff")):
        page_in(tmp_path)
