"""Figures of the paper's protocol."""

import numpy as np
import pytest
from report_helpers import CONTACTS, make_contact_table, make_touch_table

from tactile_loc.evaluation.paper.fusion import FUSED_LINES
from tactile_loc.evaluation.protocol import LINES, evaluate
from tactile_loc.evaluation.simulated_touches import SimulatedTouches
from tactile_loc.evaluation.summary import summarise_lines
from tactile_loc.evaluation.table import ExampleTable
from tactile_loc.reports.paper_figures import DRAWN, FLOOR, draw_contacts, draw_gallery, draw_reliability, draw_violins
from tactile_loc.view.pictures import save_figure

pytestmark = pytest.mark.usefixtures("arranged_pictures")


@pytest.fixture(scope="module")
def table() -> ExampleTable:
    names = [(name, encoder, i) for i, name in enumerate(("pin", "hook")) for encoder in ("pixel", "other")]
    return ExampleTable.join(make_touch_table(*about) for about in names)


def panels(figure):
    return [axes for axes in figure.axes if axes.axison]


def test_violins_have_a_panel_for_each_object_and_a_colour_for_each_encoder(table):
    figure = draw_violins(table, "the title")
    assert [axes.get_title().split()[0] for axes in panels(figure)] == ["pin", "hook"]
    assert all("mm" in axes.get_title() for axes in panels(figure))
    for axes in panels(figure):
        labels = [label.get_text() for label in axes.get_xticklabels()]
        assert labels == [line.capitalize() for line in DRAWN]
        assert len(axes.collections) == 2 * 2 * len(DRAWN)  # a violin and a bar for each line and encoder
    (legend,) = figure.legends
    words = " ".join(text.get_text() for text in legend.get_texts())
    for word in ("pixel", "other", "random", "closest"):
        assert word in words


def test_errors_of_zero_are_drawn_on_the_floor_also_of_a_single_touch(tmp_path):
    zero = {f"{line} add_m": np.zeros(1) for line in LINES[:2]}  # an error of zero has no logarithm
    one = make_touch_table("pin", "pixel", 0).select([0])
    figure = draw_violins(ExampleTable.make({**one.columns, **zero}), "t")
    dots = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert dots[0].get_ydata()[0] == np.log10(FLOOR)
    assert save_figure(tmp_path / "one.png", figure, dpi=40).exists()
    run = make_contact_table("pin", "pixel", 0)
    run.errors_m("best-1", "add")[:] = 0.0
    best = next(c for c in draw_contacts(run, "t").axes[0].lines if c.get_label().startswith("best-1"))
    assert np.isfinite(np.log(best.get_ydata())).all()


@pytest.mark.slow
@pytest.mark.parametrize(("count", "columns"), [(6, 6), (3, 3), (1, 1)])
def test_a_gallery_shows_the_best_the_median_and_the_worst_touch(localizer, tmp_path, count, columns):
    some = evaluate(localizer, 6, SimulatedTouches("strong", 3)).select(range(count))
    figure = draw_gallery(localizer, some, SimulatedTouches("strong", 3), "pin")
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == columns
    assert titles[0].startswith("best: ")
    assert all("mm" in title and "touch-" in title for title in titles)
    errors = some.errors_m("reg-1", "add")
    assert f"touch-{int(errors.argmin()):04d}" in titles[0]
    assert f"touch-{int(errors.argmax()):04d}" in titles[-1]
    labels = " ".join(axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes)
    for word in ("x (mm)", "y (mm)", "observed", "estimated", "depth from full penetration (mm)"):
        assert word in labels
    assert save_figure(tmp_path / "gallery.png", figure, dpi=40).exists()


def test_the_coverage_curve_shows_the_share_of_true_poses_in_each_set():
    run = make_touch_table("pin", "pixel", 0)
    figure = draw_reliability(run, "title")
    trusted, entropy = figure.axes
    curve = next(line for line in trusted.lines if line.get_label() == "pin, pixel")
    held = (run["credible_level"] <= 0.5).mean()
    assert np.interp(50, *curve.get_data()) == 100 * held
    (dots,) = entropy.lines
    np.testing.assert_allclose(dots.get_xdata(), run["entropy_nats"])
    assert dots.get_ydata().max() == 1e3 * run.errors_m("reg-1", "add").max()
    assert all("(" in text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()))  # units


def test_each_object_has_a_panel_with_medians_and_quartiles():
    runs = [make_contact_table(name, "pixel", i) for i, name in enumerate(("pin", "hook"))]
    figure = draw_contacts(ExampleTable.join(runs), "the title")
    assert [axes.get_title().split()[0] for axes in panels(figure)] == ["pin", "hook"]
    for axes, run in zip(panels(figure), runs, strict=True):
        for line in FUSED_LINES:
            curve = next(c for c in axes.lines if c.get_label().startswith(line))
            assert tuple(curve.get_xdata()) == CONTACTS
            np.testing.assert_allclose(
                curve.get_ydata(), [row["median_normalised"] for row in summarise_lines(run, [line])]
            )
        assert len(axes.collections) == len(FUSED_LINES)
        assert axes.get_yscale() == "log"
        assert axes.get_xlabel() == "number of contacts"
        assert "mm" in axes.get_title()
    assert "ADD" in panels(figure)[0].get_ylabel()
    assert figure._suptitle.get_text() == "the title"
