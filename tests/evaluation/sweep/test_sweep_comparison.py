"""Comparison of two sweeps."""

import copy
import csv
import json

import pytest
from message_helpers import missing, naming

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.evaluation.sweep.comparison import compare, format_texts, summarise, write_comparison
from tactile_loc.evaluation.sweep.tables import read_sweep, record_sweep

MM = {"none": 4.0, "icp": 1.0, "filterreg": 0.5}


@pytest.fixture
def recorded(made_up):
    """Make the content of sweep.json for a sweep over refiners with the errors MM, or other errors."""

    def make(**mm: float | str):
        values = {"object": ["pin"], "refiner": list(mm), "option": ["grid.spacing_mm=3,4"]}
        return record_sweep(made_up(values, lambda one: _measured(mm[one.config.refiner.name])), "chosen")

    return make


def _measured(value: float | str):
    return value if isinstance(value, str) else {"chosen_median_mm": value}


def test_the_table_marks_better_and_worse_rows_with_their_ratios(recorded):
    found = compare(recorded(**MM), recorded(none=4.3, icp=1.2, filterreg=0.25), "chosen")
    assert list(found.rows[0]) == ["object", "refiner", "grid.spacing_mm", "old_mm", "new_mm", "ratio", "change"]
    told = [[value for name, value in row.items() if name not in ("old_mm", "new_mm")] for row in found.rows]
    assert told[:3] == [
        ["pin", "none", "3.0", pytest.approx(1.075), ""],
        ["pin", "icp", "3.0", pytest.approx(1.2), "worse"],
        ["pin", "filterreg", "3.0", pytest.approx(0.5), "better"],
    ]
    assert not missing(summarise(found), 6, "2 worse", "2 better", "10 %")
    assert found.versions == {}


def test_missing_and_failed_rows_are_marked(recorded):
    found = compare(recorded(none=4.0, icp="bad"), recorded(icp=1.0, filterreg=0.5), "chosen")
    marks = {row["refiner"]: row["change"] for row in found.rows}
    assert marks == {"none": "only in old", "icp": "failed", "filterreg": "only in new"}
    assert {row["ratio"] for row in found.rows} == {None}


def test_an_option_of_only_one_version_does_not_separate_rows(recorded):
    old, new = recorded(**MM), recorded(**MM)
    for row in new["rows"]:
        row["configuration"]["refiner"]["options"]["brand_new"] = 7
    new["versions"]["tactile-loc"] = "99.0"
    found = compare(old, new, "chosen")
    assert {row["change"] for row in found.rows} == {""}
    assert found.versions == {"tactile-loc": (old["versions"]["tactile-loc"], "99.0")}


def test_rows_that_differ_only_by_a_new_option_have_no_counterpart(recorded):
    old, new = recorded(icp=1.0), recorded(icp=1.0)
    for row in new["rows"]:
        row["configuration"]["refiner"]["options"]["brand_new"] = 7
    new["rows"] += copy.deepcopy(new["rows"])
    for row in new["rows"][2:]:
        row["configuration"]["refiner"]["options"]["brand_new"] = 8
    found = compare(old, new, "chosen")
    assert (found.count("only in old"), found.count("only in new")) == (2, 4)
    assert {row["refiner.brand_new"] for row in format_texts(found)} == {"7", "8", ""}


def test_the_comparison_is_written_as_markdown_and_csv(recorded, tmp_path):
    old, new = recorded(**MM), recorded(**{**MM, "icp": 2.0})
    for name, what in (("old", old), ("new", new)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "sweep.json").write_text(json.dumps(what))
    found = compare(read_sweep(tmp_path / "old"), read_sweep(tmp_path / "new"), "chosen")
    markdown, table = write_comparison(tmp_path / "new", found)
    assert "| pin | icp | 3.0 | 1.00 | 2.00 | 2.000 | worse |" in markdown.read_text()
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["change"] for row in rows] == ["", "worse", ""] * 2
    assert (rows[0]["old_mm"], rows[0]["ratio"]) == ("4.00", "1.000")


def test_a_folder_without_a_sweep_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=naming(tmp_path / "sweep.json", "`out`")):
        read_sweep(tmp_path)
    (tmp_path / "sweep.json").write_text("[]")
    with pytest.raises(ConfigError, match=naming(tmp_path / "sweep.json", "TypeError")):
        read_sweep(tmp_path)
