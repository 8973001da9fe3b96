"""The two figures of a sweep."""

import numpy as np
import pytest
from message_helpers import naming
from report_helpers import make_sweep

from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.evaluation.sweep.tables import require_line
from tactile_loc.evaluation.sweep.uncertainty import Estimate
from tactile_loc.reports.sweep_figures import (
    Point,
    compute_effects,
    draw_effects,
    draw_error_time,
    find_pareto_front,
    list_points,
    write_ranges,
)

pytestmark = pytest.mark.usefixtures("arranged_pictures")

VALUES = {
    "object": ["pin", "head"],
    "refiner": ["none", "icp", "filterreg"],
    "option": ["encoder.cells=12,20"],
    "noise": ["none", "mild"],
}


def measure(one):
    i, j = one.place[6], one.place[4]
    return {"chosen_median_mm": 3.0 / (1 + i) + j, "chosen_ms": 2.0 + 5 * i + j}


def texts(axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_every_combination_has_a_numbered_point_and_a_name():
    figure = draw_error_time(make_sweep(VALUES, measure), "chosen")
    left, right, *others = figure.axes
    assert len(others) == 2  # the other noise
    assert sorted(texts(left)) == ["1", "2", "3", "4", "5", "6"]
    assert len(texts(right)) == 6
    assert texts(right)[0].startswith("  1  pixel cells=12 + filterreg  (1 mm, 12 ms)")
    dots = np.array([line.get_xydata()[0] for line in left.lines if line.get_linestyle() == "None"])
    truth = np.array([(2, 3), (3, 4), (7, 1.5), (8, 2.5), (12, 1), (13, 2)])
    assert dots[np.argsort(dots[:, 0])] == pytest.approx(truth)
    assert left.get_title() == "noise: none"


def test_each_varying_slot_has_a_panel():
    figure = draw_effects(make_sweep(VALUES, measure), "chosen")
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "encoder, all else equal",
        "refiner, all else equal",
    ]
    assert [t.get_text() for t in figure.axes[1].get_yticklabels()] == ["none", "icp", "filterreg"]
    refiner = [float(t.removeprefix("x ")) for t in texts(figure.axes[1])]
    assert refiner == sorted(refiner, reverse=True)
    assert np.prod(refiner) == pytest.approx(1, abs=0.03)


def test_a_sweep_without_varying_results_has_no_figures():
    single = make_sweep({"object": "pin"}, lambda one: {"chosen_median_mm": 1.0, "chosen_ms": 1.0})
    assert draw_effects(single, "chosen") is None
    failed = make_sweep({"object": "pin", "refiner": ["none", "icp"]}, lambda one: "bad")
    assert draw_effects(failed, "chosen") is None
    assert draw_error_time(failed, "chosen") is None


@pytest.mark.parametrize(
    ("numbers", "text"), [([3], "3"), ([2, 1], "1, 2"), ([5, 3, 4, 9], "3-5, 9"), ([1, 3], "1, 3")]
)
def test_numbers_are_written_in_ranges(numbers, text):
    assert write_ranges(numbers) == text


BASE_MM = {"none": 4.0, "icp": 1.0, "filterreg": 0.5}


def product(one) -> dict[str, float]:
    """A product of factors: pin x 1, head x 9; 12 cells x 2; mild x 3."""
    config = one.config
    factor = {"pin": 1, "head": 9}[one.object] * {12: 2, 20: 1}[config.encoder.options["cells"]]
    return {
        "chosen_median_mm": BASE_MM[config.refiner.name] * factor * {"none": 1, "mild": 3}[config.touch.noise],
        "chosen_ms": {"pin": 10.0, "head": 40.0}[one.object] * (1 + config.seed),
    }


def test_effects_equal_the_factors_of_a_product():
    found = compute_effects(make_sweep(VALUES, product), "chosen")
    assert set(found) == {"encoder", "refiner"}
    refiners = {name: np.exp(logs) for name, logs in found["refiner"].items()}
    mean = 2.0 ** (1 / 3)  # geometric mean of 4, 1 and 0.5
    for name, ratios in refiners.items():
        assert ratios == pytest.approx(np.full(8, BASE_MM[name] / mean))
    assert np.exp(found["encoder"]["pixel cells=12"]) == pytest.approx(np.full(12, np.sqrt(2)))


def test_a_failure_removes_its_group_from_the_effect():
    def failing(one):
        return "bad" if one.object == "head" and one.config.refiner.name == "icp" else product(one)

    found = compute_effects(make_sweep(VALUES, failing), "chosen")
    assert {len(logs) for logs in found["refiner"].values()} == {4}
    assert {len(logs) for logs in found["encoder"].values()} == {10}


def test_points_are_geometric_means_over_objects():
    sweep = make_sweep(VALUES, product)
    first = list_points(sweep, "chosen", "mild")[0]
    assert first.label == "pixel cells=12 + none"
    assert first.error_mm == pytest.approx(4 * 2 * 3 * 3)
    assert first.time_ms == pytest.approx(20)
    assert len(list_points(sweep, "chosen", "none")) == 6


def test_the_pareto_front_holds_the_points_that_no_point_beats():
    placed = [(1, 9), (2, 5), (2, 6), (3, 5), (4, 2), (9, 3), (9, 1)]
    found = [Point((i,), str(i), Estimate(error), Estimate(time)) for i, (time, error) in enumerate(placed)]
    assert [p.label for p in find_pareto_front(found)] == ["0", "1", "4", "6"]
    for p in found:
        beaten = any(q.error_mm <= p.error_mm and q.time_ms <= p.time_ms and q != p for q in found)
        assert (p in find_pareto_front(found)) != beaten


def test_only_lines_of_the_protocol_are_accepted():
    assert require_line("reg-1") == "reg-1"
    with pytest.raises(ConfigError, match=naming("'best1'", "'best-1'")):
        require_line("best1")
