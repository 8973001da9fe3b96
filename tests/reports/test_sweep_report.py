"""The page of a sweep agrees with its rows."""

import json
from typing import Any

import pytest
from message_helpers import missing, naming
from report_helpers import Elements, describe_sweep, html_of, page_in, write_sweep

from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.reports.sweep import DRAWN, find_varying, is_factor, read_rows


def list_rows() -> list[dict[str, Any]]:
    return read_rows(json.loads(describe_sweep()))


def test_varying_columns_are_found(sweep_folder):
    assert find_varying(list_rows()) == ["object", "refiner", "grid.spacing_mm"]
    assert page_in(sweep_folder).data["components"] == ["refiner", "grid.spacing_mm"]


@pytest.mark.parametrize(
    ("column", "is_one"),
    [("object", True), ("grid.spacing_mm", True), ("grid_poses", False), ("chosen_median_mm", False), ("a.b", False)],
)
def test_factors_are_distinguished_from_measures(column, is_one):
    assert is_factor(column) is is_one


def test_the_page_shows_the_rows_of_the_file(sweep_folder):
    data, rows = page_in(sweep_folder).data, list_rows()
    assert len(data["rows"]) == len(rows)
    for drawn, row in zip(data["rows"], rows, strict=True):
        assert drawn.items() <= row.items()
    times = {"chosen": "chosen_ms", "reg-1": "reg-1_ms", "best-50": "best-1_ms"}
    assert times.items() <= data["line_times"].items(), "errors are drawn against the time of their line"
    page = Elements(html_of(sweep_folder))
    assert not missing(page.text, "pin", "6 mm", "filterreg, 4.0"), "the best of each object is named"
    header = next(row for row in page.rows if "best-1 (mm)" in row)
    assert header[:3] == ["object", "refiner", "grid.spacing_mm"]
    assert header[3:7] == ["best-1 (mm)", "reg-1 (mm)", "chosen (mm)", "closest (mm)"]
    first = page.rows[page.rows.index(header) + 1]
    assert [float(first[k]) for k in (3, 5)] == [rows[0]["best-1_median_mm"], rows[0]["chosen_median_mm"]]


def test_the_page_states_the_differences(sweep_folder):
    page = Elements(html_of(sweep_folder))
    assert ["pin", "icp", "4.0", "-36 (-36 to -36)", "better", "+0.625 (+0.625 to +0.625)", "slower"] in page.rows


def fail(*rows: dict[str, Any]) -> None:
    for row in rows:
        row |= {**dict.fromkeys(DRAWN), "error": "the grid is empty"}


def test_failed_rows_are_listed_with_their_errors_and_not_drawn(tmp_path):
    folder = write_sweep(tmp_path, lambda rows: fail(rows[1]))
    assert len(page_in(folder).data["rows"]) == len(list_rows()) - 1
    found = Elements(html_of(folder))
    assert ["pin", "icp", "4.0", "the grid is empty"] in found.rows


def test_a_sweep_with_only_failures_has_a_page(tmp_path):
    page = page_in(write_sweep(tmp_path, lambda rows: fail(*rows)))
    assert page.data["rows"] == []
    assert [section.name for section in page.sections] == ["summary", "differences", "rows", "failed", "made"]


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
