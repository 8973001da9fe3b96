"""The table of examples, and rows written as text."""

import json

import numpy as np
import pytest
from report_helpers import make_recall_runs

from tactile_loc.evaluation import text_tables
from tactile_loc.evaluation.summary import summarise_errors
from tactile_loc.evaluation.table import ExampleTable


def test_a_table_is_read_back_from_json():
    table = make_recall_runs()[0].table
    read = ExampleTable.read(json.loads(json.dumps(table.describe(), allow_nan=False)))
    assert "T_sensor_object" not in read.columns
    for name, values in read.columns.items():
        assert np.array_equal(values, table[name], equal_nan=values.dtype.kind == "f"), name


def test_rows_may_lack_values():
    table = ExampleTable.of_rows([{"first add_m": 0.1, "p": 0.5, "word": "a", "yes": True}, {"yes": False}])
    assert table.errors_m("first", "add").tolist() == [0.1, np.inf]
    assert np.isnan(table["p"][1])
    assert table["word"].tolist() == ["a", ""]
    assert table["yes"].dtype == bool


def test_groups_keep_the_order_and_refused_presses_count_once():
    runs = make_recall_runs(examples=4)
    joined = ExampleTable.join(run.table for run in runs)
    assert list(joined.group("object", "touches")) == [("pin", 1), ("pin", 3), ("hook", 1), ("hook", 3)]
    assert sum(map(len, joined.group("touches").values())) == len(joined) == 4 * 8
    assert joined.count_refused() == 4 * 4  # of each example, whatever its numbers of touches


def test_statistics_of_known_values():
    found = summarise_errors(np.arange(1.0, 12.0), 2.0)
    assert list(found)[:6] == ["mean_m", "median_m", "std_m", "q25_m", "q75_m", "p90_m"]
    assert list(found.values())[:6] == [6, 6, pytest.approx(np.sqrt(10)), 3.5, 8.5, 10]
    assert found["p90_normalised"] == 5


def test_rows_are_written_as_markdown_and_csv():
    rows = [{"n": "a", "m": "x", "v": 1.5, "yes": True}, {"n": "b", "m": "y", "v": None, "yes": [1]}]
    pivoted = text_tables.pivot(rows, ("n",), "m", lambda row: str(row["v"]))
    assert pivoted == [["n", "x", "y"], ["a", "1.5", ""], ["b", "", "None"]]
    table = text_tables.tabulate({"p|q": row["n"]} for row in rows)
    assert text_tables.format_document("T", ["one", table]) == "# T\n\none\n\n| p\\|q |\n| --- |\n| a |\n| b |\n"
    assert text_tables.format_csv(rows) == "n,m,v,yes\na,x,1.5,true\nb,y,,[1]\n"
    shown = text_tables.show_in_mm({"a_m": 0.00123456789, "b": 1 / 3, "c": 2, "d_m": None, "e": (1,)})
    assert shown == {"a_mm": "1.23457", "b": "0.333333", "c": 2, "d_mm": None}
