"""Effects, points and the Pareto front of sweeps whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.errors import ConfigError
from tactile_loc.sweeps.summary import Point, cells, effects, pareto, points, require_line

BASE_MM = {"none": 4.0, "icp": 1.0, "filterreg": 0.5}
VALUES = {
    "object": ["pin", "head"],
    "refiner": list(BASE_MM),
    "option": ["encoder.cells=12,20"],
    "noise": ["none", "mild"],
}


def measure(one) -> dict[str, float]:
    """A product of factors: pin x 1, head x 9; 12 cells x 2; mild x 3."""
    config = one.config
    factor = {"pin": 1, "head": 9}[one.object] * {12: 2, 20: 1}[config.encoder.options["cells"]]
    return {
        "chosen_median_mm": BASE_MM[config.refiner.name] * factor * {"none": 1, "mild": 3}[config.touch.noise],
        "total_ms": {"pin": 10.0, "head": 40.0}[one.object] * (1 + config.seed),
    }


def test_effects_are_the_factors_wherever_the_model_is_a_product(made_up):
    found = effects(made_up(VALUES, measure), "chosen")
    assert set(found) == {"encoder", "refiner"}
    refiners = {name: np.exp(logs) for name, logs in found["refiner"].items()}
    mean = 2.0 ** (1 / 3)  # of 4, 1 and 0.5
    for name, ratios in refiners.items():
        assert ratios == pytest.approx(np.full(8, BASE_MM[name] / mean))
    assert np.exp(found["encoder"]["pixel cells=12"]) == pytest.approx(np.full(12, np.sqrt(2)))


def test_a_failure_takes_its_group_out_of_the_effect(made_up):
    def failing(one):
        return "bad" if one.object == "head" and one.config.refiner.name == "icp" else measure(one)

    found = effects(made_up(VALUES, failing), "chosen")
    assert {len(logs) for logs in found["refiner"].values()} == {4}
    assert {len(logs) for logs in found["encoder"].values()} == {10}


def test_points_are_geometric_means_over_objects(made_up):
    sweep = made_up(VALUES, measure)
    first = points(sweep, "chosen", "mild")[0]
    assert first.label == "pixel cells=12 + none"
    assert first.error_mm == pytest.approx(4 * 2 * 3 * 3)
    assert first.time_ms == pytest.approx(20)
    assert len(points(sweep, "chosen", "none")) == 6


def test_a_point_needs_all_objects(made_up):
    sweep = made_up(
        VALUES, lambda one: "bad" if one.place[0] == 1 and one.config.refiner.name == "icp" else measure(one)
    )
    assert [p.label.split()[-1] for p in points(sweep, "chosen", "none")] == ["none", "filterreg"] * 2


def test_cells_are_means_over_seeds(made_up):
    sweep = made_up(
        {**VALUES, "seed": [0, 1, 2]}, lambda one: {**measure(one), "chosen_median_mm": float(one.config.seed)}
    )
    assert {(cell.error_mm, cell.time_ms) for cell in cells(sweep, "chosen")} == {(1.0, 20.0), (1.0, 80.0)}


def test_the_front_holds_what_nothing_beats():
    found = [Point(str(i), (i,), error, time) for i, (time, error) in enumerate(
        [(1, 9), (2, 5), (2, 6), (3, 5), (4, 2), (9, 3), (9, 1)]
    )]  # fmt: skip
    assert [p.label for p in pareto(found)] == ["0", "1", "4", "6"]
    for p in found:
        beaten = any(q.error_mm <= p.error_mm and q.time_ms <= p.time_ms and q != p for q in found)
        assert (p in pareto(found)) != beaten


def test_lines_are_the_protocols():
    assert require_line("reg-1") == "reg-1"
    with pytest.raises(ConfigError, match="Did you mean 'best-1'"):
        require_line("best1")
