"""The rows of a sweep have the right columns, Parquet holds the same values, and Markdown tables show the best."""

from __future__ import annotations

import json
import sys

import pytest
from message_helpers import missing, naming

from tactile_loc.core.runtime.errors import ConfigError, MissingLibraryError
from tactile_loc.evaluation.protocol import LINES
from tactile_loc.evaluation.sweep.sweep import MOMENTARY, format_summary, list_columns, read_sweep
from tactile_loc.evaluation.text_tables import require_parquet, write_parquet
from tactile_loc.slots.registry import SLOTS

VALUES = {
    "object": ["pin", "head"],
    "encoder": [{"name": "pixel", "cells": 12}, {"name": "pixel", "signal": "depth"}],
    "refiner": ["none", {"name": "icp", "walls": False}, "icp"],
    "option": ["grid.spacing_mm=3,4.5"],
}
VARIED = ["grid.spacing_mm", "encoder.cells", "encoder.signal", "refiner.walls"]


@pytest.fixture(scope="module")
def rows(made_up):
    def measure(one):
        if one.object == "head" and one.config.refiner.name == "none":
            return 'ValueError: "odd", and\nlong'
        return {"chosen_median_mm": 0.1 + 1 / 3, "nll_nats": 1e-17, "chosen_ms": 3.0}

    sweep = made_up(VALUES, measure)
    assert list(sweep.rows[0]) == list_columns(sweep.plan)
    return sweep.rows


def test_columns_begin_with_the_inputs_and_end_with_times_and_builds(rows):
    columns = list(rows[0])
    assert columns[:11] == ["object", *SLOTS, "noise", "seed", "count"]
    assert columns[11:18] == [*VARIED, "grid_poses", "grid_id", "touches_id"]
    assert columns[18 : 18 + 3 * len(LINES)] == [
        f"{line}_{what}" for line in LINES for what in ("median_mm", "mean_mm", "median_share")
    ]
    times = ("encode_ms", "match_ms", "fuse_ms", "refine_ms", "choose_ms", "best-1_ms", "reg-1_ms", "chosen_ms")
    assert (*times, "model_s", "built") == MOMENTARY
    assert tuple(columns[-10:]) == MOMENTARY
    assert columns[-16:-10] == ["coverage_50", "coverage_80", "coverage_95", "nll_nats", "error", "key"]


def test_rows_follow_the_order_of_the_plan_and_omit_inapplicable_values(rows):
    assert len(rows) == 2 * 2 * 2 * 3
    assert [row["object"] for row in rows] == ["pin"] * 12 + ["head"] * 12
    assert [(row["refiner"], row["refiner.walls"]) for row in rows[:3]] == [
        ("none", None),
        ("icp", False),
        ("icp", True),
    ]
    failed = [row for row in rows if row["error"]]
    assert {(row["object"], row["refiner"]) for row in failed} == {("head", "none")}
    assert all(row["chosen_median_mm"] is None and row["key"] for row in failed)


def test_parquet_is_read_back_with_its_types(rows, tmp_path):
    from pyarrow import parquet

    path = write_parquet(tmp_path / "sweep.parquet", rows)
    table = parquet.read_table(path)
    assert table.to_pylist() == rows
    types = {field.name: str(field.type) for field in table.schema}
    assert (types["seed"], types["grid_poses"], types["chosen_ms"]) == ("int64", "int64", "double")
    assert [types[name] for name in VARIED] == ["double", "int64", "string", "bool"]
    assert json.loads(table.to_pylist()[0]["built"])[0].startswith("grid ")


def test_a_missing_library_gives_an_error_with_the_package_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingLibraryError, match=naming("pyarrow", "pip install 'tactile-loc[sweep]'")):
        require_parquet("a sweep")


MM = {("pin", "none"): 4.0, ("pin", "icp"): 0.5, ("head", "none"): 2.0, ("head", "icp"): 2.0001}


def measure_by_noise(one):
    base = MM[one.object, one.config.refiner.name]
    return {"chosen_median_mm": base * (1 if one.config.touch.noise == "none" else 2)}


def test_each_noise_has_a_table_with_the_best_values_in_bold(made_up):
    values = {"object": ["pin", "head"], "refiner": ["none", "icp"], "noise": ["none", "mild"]}
    text = format_summary(made_up(values, measure_by_noise), "chosen")
    first, second = text.split("## Noise: ")[1:]
    rows = ["| components | pin | head |", "| --- | --- | --- |", "| none | 4.00 | **2.00** |"]
    assert first.strip().splitlines() == ["none", "", *rows, "| icp | **0.500** | **2.00** |"]
    assert "| icp | **1.00** | **4.00** |" in second
    assert not missing(text, "gelslim", "heightmap", "face", "pixel", "dense", "product")


def test_failed_rows_show_their_errors(made_up):
    sweep = made_up(
        {"object": ["pin", "head"], "refiner": ["none", "icp"]},
        lambda one: (
            "TypeError: no" if one.object == "head" and one.config.refiner.name == "icp" else {"reg-1_median_mm": 1.0}
        ),
    )
    text = format_summary(sweep, "reg-1")
    assert "| icp | **1.00** | failed |" in text
    assert "1 of 4" in text
    assert text.endswith(
        "- head, gelslim, heightmap, face, pixel, dense, icp, product, noise strong, seed 0: TypeError: no\n"
    )


def test_a_sweep_without_variation_names_its_components(made_up):
    assert "| pixel + joint | **1.00** |" in format_summary(
        made_up({"object": "pin"}, lambda one: {"chosen_median_mm": 1.0}), "chosen"
    )


@pytest.mark.parametrize("rows", [[], [{}], [{"configuration": {}}], 3, [[]], ["\ud800"]])
def test_an_invalid_sweep_file_is_refused(tmp_path, rows):
    (tmp_path / "sweep.json").write_text(json.dumps({"rows": rows, "versions": {}}))
    with pytest.raises(ConfigError, match=naming(tmp_path / "sweep.json")):
        read_sweep(tmp_path)
