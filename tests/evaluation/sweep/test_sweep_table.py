"""The rows of a sweep have the right columns, and Markdown tables show the best."""

import csv
from typing import Any

import numpy as np
import pytest
from message_helpers import missing

from tactile_loc.evaluation.protocol import LINES
from tactile_loc.evaluation.sweep.sweep import MOMENTARY, Sweep, list_columns
from tactile_loc.evaluation.sweep.tables import format_summary, list_differences, write_touches
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
    assert columns[18 : 18 + 5 * len(LINES)] == [
        f"{line}_{what}" for line in LINES for what in ("median_mm", "low_mm", "high_mm", "mean_mm", "median_share")
    ]
    stages = ("encode_ms", "match_ms", "fuse_ms", "refine_ms", "choose_ms")
    times = (f"{line}_{what}" for line in ("best-1", "reg-1", "chosen") for what in ("ms", "low_ms", "high_ms"))
    assert (*stages, *times, "model_s", "built") == MOMENTARY
    assert tuple(columns[-16:]) == MOMENTARY
    assert columns[-22:-16] == ["coverage_50", "coverage_80", "coverage_95", "nll_nats", "error", "key"]


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


MM = {("pin", "none"): 4.0, ("pin", "icp"): 0.5, ("head", "none"): 2.0, ("head", "icp"): 2.0001}


def measure_by_noise(one):
    base = MM[one.object, one.config.refiner.name]
    return {"chosen_median_mm": base * (1 if one.config.touch.noise == "none" else 2)}


def test_each_noise_has_a_table_with_the_best_values_in_bold(made_up):
    values = {"object": ["pin", "head"], "refiner": ["none", "icp"], "noise": ["none", "mild"], "count": 5}
    text = format_summary(made_up(values, measure_by_noise), "chosen")
    first, second = text.split("## Noise: ")[1:]
    rows = ["| components | pin | head |", "| --- | --- | --- |", "| none | 4.00 | **2.00** |"]
    assert first.strip().splitlines()[:6] == ["none", "", *rows, "| icp | **0.500** | **2.00** |"]
    assert "| icp | **1.00** | **4.00** |" in second
    assert not missing(text, "gelslim", "heightmap", "face", "pixel", "dense", "product")


def test_failed_rows_show_their_errors(made_up):
    sweep = made_up(
        {"object": ["pin", "head"], "refiner": ["none", "icp"], "count": 5},
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


TOUCHES = 12


def measure_touches(one) -> dict[str, Any] | str:
    """With icp, each touch has a third of the error; the encoder changes nothing. The head fails with icp."""
    rng = np.random.default_rng(one.config.seed)
    hard = rng.lognormal(size=one.count) * {"none": 3.0, "icp": 1.0}[one.config.refiner.name]
    if one.object == "head" and one.config.refiner.name == "icp":
        return "TouchError: refused"
    columns = {"chosen_mm": hard.tolist(), "chosen_ms": (5 + hard).tolist(), "refused": list(range(one.count))}
    return {"chosen_median_mm": float(np.median(hard)), "touches_id": "same", "touches": columns}


@pytest.fixture(scope="module")
def planted(made_up) -> Sweep:
    values = {"object": ["pin", "head"], "refiner": ["none", "icp"], "option": ["encoder.cells=12,20"]}
    return made_up({**values, "seed": [0, 1], "count": TOUCHES}, measure_touches)


def test_differences_from_the_base_are_paired_and_judged(planted):
    found = {(one["object"], one["encoder.cells"], one["refiner"]): one for one in list_differences(planted, "chosen")}
    base, better, equal = found["pin", 12, "none"], found["pin", 12, "icp"], found["pin", 20, "none"]
    assert (base["error_verdict"], base["error_difference_mm"]) == ("base", None)
    assert (better["error_verdict"], better["time_verdict"]) == ("better", "faster")
    hard = np.concatenate([np.random.default_rng(seed).lognormal(size=TOUCHES) for seed in (0, 1)])
    assert better["error_difference_mm"] == pytest.approx(np.median(-2 * hard), rel=1e-4)
    assert better["error_difference_high_mm"] < 0
    assert (equal["error_verdict"], equal["error_difference_mm"]) == ("equal", 0)
    assert found["head", 12, "icp"]["error_verdict"] == "failed"
    assert found["head", 12, "icp"]["error_mm"] is None
    text = format_summary(planted, "chosen")
    assert "| pixel cells=20 + none | +0 (+0 to +0), equal | " in text


def test_other_touches_are_not_compared(made_up):
    sweep = made_up(
        {"object": "pin", "option": ["grid.spacing_mm=4,6"]},
        lambda one: {"chosen_median_mm": 1.0, "touches_id": str(one.config.grid.options["spacing_mm"])},
    )
    assert [one["error_verdict"] for one in list_differences(sweep, "chosen")] == ["base", "other touches"]


def test_the_long_table_has_a_row_for_each_touch_and_line(planted, tmp_path):
    with write_touches(tmp_path, planted).open(newline="") as file:
        rows = list(csv.DictReader(file))
    done = len(planted.combinations) - planted.failed
    assert len(rows) == done * TOUCHES * len(LINES)
    assert list(rows[0]) == [
        "object", *SLOTS, "noise", "seed", "encoder.cells", "touch", "refused", "line", "error_mm", "time_ms",
    ]  # fmt: skip
    own = [row for row in rows if (row["object"], row["seed"], row["line"]) == ("pin", "1", "chosen")]
    hard = np.random.default_rng(1).lognormal(size=TOUCHES)
    errors = [float(row["error_mm"]) for row in own if (row["refiner"], row["encoder.cells"]) == ("icp", "20")]
    assert errors == pytest.approx(hard.tolist())
    assert [int(row["refused"]) for row in own[:TOUCHES]] == [int(row["touch"]) for row in own[:TOUCHES]]
