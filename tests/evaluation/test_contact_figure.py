"""The picture of error against number of contacts."""

from __future__ import annotations

import numpy as np
from test_contact_tables import CONTACTS, make_contact_run

from tactile_loc.drawing.pictures import save_figure
from tactile_loc.evaluation.contact_figure import draw_contacts


def panels(figure):
    return [axes for axes in figure.axes if axes.axison]


def test_each_object_has_a_panel_with_medians_and_quartiles(tmp_path):
    runs = [make_contact_run(name, "pixel", i) for i, name in enumerate(("pin", "hook"))]
    figure = draw_contacts(runs, "the title")
    assert [axes.get_title().split()[0] for axes in panels(figure)] == ["pin", "hook"]
    for axes, run in zip(panels(figure), runs, strict=True):
        for label, line in (("best-1", "best-1"), ("kinematic", "kinematic")):
            curve = next(c for c in axes.lines if c.get_label().startswith(label))
            assert tuple(curve.get_xdata()) == CONTACTS
            np.testing.assert_allclose(
                curve.get_ydata(), [np.median(run.evaluation.normalised(line, n)) for n in CONTACTS]
            )
        assert len(axes.collections) == 2
        assert axes.get_yscale() == "log"
        assert axes.get_xlabel() == "number of contacts"
        assert "mm" in axes.get_title()
    assert "ADD" in panels(figure)[0].get_ylabel()
    assert figure._suptitle.get_text() == "the title"
    assert save_figure(tmp_path / "a.png", figure, dpi=40).stat().st_size > 1000


def test_encoders_are_told_apart_and_kinematic_is_drawn_once():
    runs = [make_contact_run("pin", encoder, i) for i, encoder in enumerate(("pixel", "other"))]
    figure = draw_contacts(runs, "t")
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
    (axes,) = panels(draw_contacts([run], "t"))
    best = next(c for c in axes.lines if c.get_label().startswith("best-1"))
    assert np.isfinite(np.log(best.get_ydata())).all()
