"""The picture of how far probabilities can be trusted."""

from __future__ import annotations

import numpy as np
from test_tables import make_run

from tactile_loc.drawing.pictures import save_figure
from tactile_loc.evaluation.belief import BELIEF
from tactile_loc.evaluation.reliability import draw_reliability


def test_the_curve_says_how_many_true_poses_a_set_holds(tmp_path):
    run = make_run("pin", "pixel", 0)
    figure = draw_reliability([run], "title")
    trusted, entropy = figure.axes
    curve = next(line for line in trusted.lines if line.get_label() == "pin, pixel")
    held = (run.evaluation.beliefs[:, BELIEF.index("level")] <= 0.5).mean()
    assert np.interp(50, *curve.get_data()) == 100 * held
    (dots,) = entropy.lines
    np.testing.assert_allclose(dots.get_xdata(), run.evaluation.beliefs[:, BELIEF.index("entropy")])
    assert dots.get_ydata().max() == 1e3 * run.evaluation.errors("reg-1").max()
    assert all("(" in text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()))  # units
    assert save_figure(tmp_path / "a.png", figure, dpi=40).exists()


def test_many_runs_are_told_apart(tmp_path):
    runs = [make_run(f"part {i}", "pixel", i) for i in range(8)]
    figure = draw_reliability(runs, "title")
    styles = {(line.get_color(), line.get_marker()) for line in figure.axes[1].lines}
    assert len(styles) == 8
