"""The two pictures."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.sweeps.figures import draw_effects, draw_error_time

VALUES = {
    "object": ["pin", "head"],
    "refiner": ["none", "icp", "filterreg"],
    "option": ["encoder.cells=12,20"],
    "noise": ["none", "mild"],
}


def measure(one):
    i, j = one.place[6], one.place[4]
    return {"chosen_median_mm": 3.0 / (1 + i) + j, "total_ms": 2.0 + 5 * i + j}


def texts(axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_every_combination_is_a_numbered_point_with_a_name(made_up):
    figure = draw_error_time(made_up(VALUES, measure), "chosen")
    left, right, *others = figure.axes
    assert len(others) == 2  # the other noise
    assert sorted(texts(left)) == ["1", "2", "3", "4", "5", "6"]
    assert len(texts(right)) == 6
    assert texts(right)[0].startswith("  1  pixel cells=12 + filterreg  (1 mm, 12 ms)")
    dots = np.array([line.get_xydata()[0] for line in left.lines if line.get_linestyle() == "None"])
    truth = np.array([(2, 3), (3, 4), (7, 1.5), (8, 2.5), (12, 1), (13, 2)])
    assert dots[np.argsort(dots[:, 0])] == pytest.approx(truth)
    assert left.get_title() == "noise: none"


def test_a_panel_for_each_slot_that_varies(made_up):
    figure = draw_effects(made_up(VALUES, measure), "chosen")
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["encoder", "refiner"]
    assert [t.get_text() for t in figure.axes[1].get_yticklabels()] == ["none", "icp", "filterreg"]
    refiner = [float(t.removeprefix("x ")) for t in texts(figure.axes[1])]
    assert refiner == sorted(refiner, reverse=True)
    assert np.prod(refiner) == pytest.approx(1, abs=0.03)


def test_nothing_is_drawn_of_nothing(made_up):
    assert (
        draw_effects(made_up({"object": "pin"}, lambda one: {"chosen_median_mm": 1.0, "total_ms": 1.0}), "chosen")
        is None
    )
    failed = made_up({"object": "pin", "refiner": ["none", "icp"]}, lambda one: "bad")
    assert draw_effects(failed, "chosen") is None
    assert draw_error_time(failed, "chosen") is None
