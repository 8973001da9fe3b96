"""Figures of evaluations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from test_fusion_tables import CONTACTS, make_contact_run
from test_tables import make_run

from tactile_loc.evaluation.figures import DRAWN, FLOOR, draw_fusion, draw_gallery, draw_reliability, draw_violins
from tactile_loc.evaluation.metrics import POSTERIOR_METRICS
from tactile_loc.evaluation.protocol import Evaluation, evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.tables import Run
from tactile_loc.view.pictures import save_figure

pytestmark = pytest.mark.usefixtures("arranged_pictures")


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return [make_run(name, encoder, i) for i, name in enumerate(("pin", "hook")) for encoder in ("pixel", "other")]


def shown(axes) -> bool:
    return bool(axes.axison)


def test_violins_have_a_panel_for_each_object_and_a_colour_for_each_encoder(runs, tmp_path):
    figure = draw_violins(runs, "the title")
    panels = [axes for axes in figure.axes if shown(axes)]
    assert [axes.get_title().split()[0] for axes in panels] == ["pin", "hook"]
    assert all("mm" in axes.get_title() for axes in panels)
    assert figure._suptitle.get_text() == "the title"
    assert "ADD" in panels[0].get_ylabel()
    for axes in panels:
        labels = [label.get_text() for label in axes.get_xticklabels()]
        assert labels == [line.capitalize() for line in DRAWN]
        assert len(axes.collections) == 2 * 2 * len(DRAWN)  # a violin and a bar for each line and encoder
    (legend,) = figure.legends
    words = " ".join(text.get_text() for text in legend.get_texts())
    for word in ("pixel", "other", "random", "closest"):
        assert word in words
    assert save_figure(tmp_path / "violins.png", figure, dpi=40).stat().st_size > 1000


def is_legend_inside(figure) -> bool:
    figure.canvas.draw()
    (legend,) = figure.legends
    box, page = legend.get_window_extent(), figure.bbox
    return page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1


@pytest.mark.parametrize("encoder", ["pixel", "an-encoder-with-a-long-name"])
def test_the_legend_of_a_single_panel_is_not_cut_off(encoder):
    assert is_legend_inside(draw_fusion([make_contact_run("pin", encoder, 0)], "title"))
    assert is_legend_inside(draw_violins([make_run("pin", encoder, 0)], "title"))


def test_violins_mark_the_medians(runs):
    axes = draw_violins(runs[:1], "t").axes[0]
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    medians = [np.median(runs[0].evaluation.normalise_errors(line)) for line in DRAWN]
    assert [10 ** dot.get_ydata()[0] for dot in dots] == pytest.approx(medians)
    levels = [10 ** line.get_ydata()[0] for line in axes.lines if line.get_marker() != "o"]
    expected = [np.median(runs[0].evaluation.normalise_errors(line)) for line in ("random", "closest")]
    assert levels == pytest.approx(expected)
    low, high = axes.get_ylim()
    assert all(low <= np.log10(m) <= high for m in medians)


def test_a_violin_can_show_a_single_exact_touch(tmp_path):
    run = make_run("pin", "pixel", 0)
    errors = run.evaluation.errors_m[:1].copy()
    errors[:, :2] = 0.0  # an error of zero has no logarithm
    one = Run("pin", "none", "pixel", 10, dataclasses.replace(run.evaluation, errors_m=errors))
    figure = draw_violins([one], "t")
    dots = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert dots[0].get_ydata()[0] == np.log10(FLOOR)
    assert save_figure(tmp_path / "one.png", figure, dpi=40).exists()


@pytest.mark.slow
@pytest.mark.parametrize(("count", "columns"), [(6, 6), (3, 3), (1, 1)])
def test_a_gallery_shows_the_best_the_median_and_the_worst_touch(localizer, tmp_path, count, columns):
    six = evaluate(localizer, 6, SimulatedTouches("strong", 3))
    evaluation = Evaluation(**{field.name: getattr(six, field.name)[:count] for field in dataclasses.fields(six)})
    figure = draw_gallery(localizer, evaluation, SimulatedTouches("strong", 3), "pin")
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == columns
    assert titles[0].startswith("best: ")
    assert all("mm" in title and "touch-" in title for title in titles)
    errors = evaluation.select_errors("reg-1")
    assert f"touch-{int(errors.argmin()):04d}" in titles[0]
    assert f"touch-{int(errors.argmax()):04d}" in titles[-1]
    labels = " ".join(axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes)
    for word in ("x (mm)", "y (mm)", "observed", "estimated", "depth from full penetration (mm)"):
        assert word in labels
    assert save_figure(tmp_path / "gallery.png", figure, dpi=40).exists()


def test_the_coverage_curve_shows_the_share_of_true_poses_in_each_set(tmp_path):
    run = make_run("pin", "pixel", 0)
    figure = draw_reliability([run], "title")
    trusted, entropy = figure.axes
    curve = next(line for line in trusted.lines if line.get_label() == "pin, pixel")
    held = (run.evaluation.posterior_metrics[:, POSTERIOR_METRICS.index("credible_level")] <= 0.5).mean()
    assert np.interp(50, *curve.get_data()) == 100 * held
    (dots,) = entropy.lines
    np.testing.assert_allclose(
        dots.get_xdata(), run.evaluation.posterior_metrics[:, POSTERIOR_METRICS.index("entropy")]
    )
    assert dots.get_ydata().max() == 1e3 * run.evaluation.select_errors("reg-1").max()
    assert all("(" in text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()))  # units
    assert save_figure(tmp_path / "a.png", figure, dpi=40).exists()


def test_many_runs_have_different_lines(tmp_path):
    runs = [make_run(f"part {i}", "pixel", i) for i in range(8)]
    figure = draw_reliability(runs, "title")
    styles = {(line.get_color(), line.get_marker()) for line in figure.axes[1].lines}
    assert len(styles) == 8


def panels(figure):
    return [axes for axes in figure.axes if axes.axison]


def test_each_object_has_a_panel_with_medians_and_quartiles(tmp_path):
    runs = [make_contact_run(name, "pixel", i) for i, name in enumerate(("pin", "hook"))]
    figure = draw_fusion(runs, "the title")
    assert [axes.get_title().split()[0] for axes in panels(figure)] == ["pin", "hook"]
    for axes, run in zip(panels(figure), runs, strict=True):
        for label, line in (("best-1", "best-1"), ("kinematic", "kinematic")):
            curve = next(c for c in axes.lines if c.get_label().startswith(label))
            assert tuple(curve.get_xdata()) == CONTACTS
            np.testing.assert_allclose(
                curve.get_ydata(), [np.median(run.evaluation.normalise_errors(line, n)) for n in CONTACTS]
            )
        assert len(axes.collections) == 2
        assert axes.get_yscale() == "log"
        assert axes.get_xlabel() == "number of contacts"
        assert "mm" in axes.get_title()
    assert "ADD" in panels(figure)[0].get_ylabel()
    assert figure._suptitle.get_text() == "the title"
    assert save_figure(tmp_path / "a.png", figure, dpi=40).stat().st_size > 1000


def test_encoders_have_different_lines_and_kinematic_is_drawn_once():
    runs = [make_contact_run("pin", encoder, i) for i, encoder in enumerate(("pixel", "other"))]
    figure = draw_fusion(runs, "t")
    (axes,) = panels(figure)
    curves = [c for c in axes.lines if tuple(c.get_xdata()) == CONTACTS]
    assert len(curves) == 3
    assert len({c.get_color() for c in curves}) == 3
    words = " ".join(text.get_text() for text in figure.legends[0].get_texts())
    for word in ("pixel", "other", "kinematic", "random"):
        assert word in words


def test_errors_of_zero_are_drawn_on_the_floor():
    run = make_contact_run("pin", "pixel", 0)
    run.evaluation.errors_m[:, :, 0] = 0.0
    (axes,) = panels(draw_fusion([run], "t"))
    best = next(c for c in axes.lines if c.get_label().startswith("best-1"))
    assert np.isfinite(np.log(best.get_ydata())).all()
