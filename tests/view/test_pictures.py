import dataclasses
import itertools

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from message_helpers import missing
from PIL import Image

from tactile_loc import ContactShape, DrawnScene, SensorGeometry, Touch
from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.locate.result.localization import Agreement
from tactile_loc.view.pictures import (
    MOST_TOGETHER,
    MOST_TOUCHES,
    draw_contact_shape,
    draw_outline,
    draw_result,
    draw_touches,
    make_figure,
    save_figure,
)
from tactile_loc.view.pose_panel import draw_pose

pytestmark = pytest.mark.usefixtures("arranged_pictures")

# 2 px a mm; the optical axis is 2 mm from the left border and 1.5 mm from the top one
FLAT = SensorGeometry("orthographic", 20, 12, 2000.0, 2000.0, 4.0, 3.0, 0.01, 0.001, (-0.001, 0.007, -0.001, 0.004))


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(plt.Text) if text.get_text()]


@pytest.fixture(scope="module")
def figure(localizer, localization):
    errors_m = np.arange(len(localization.hypotheses)) * 1e-3 + 2.5e-3
    return draw_result(localization, localizer.scene, "pin on gelslim", errors_m)


def test_labels_name_the_object_the_units_and_each_candidate_with_its_error(figure, localization):
    shown = texts(figure)
    for label in ("pin on gelslim", "x (mm)", "y (mm)", "z (mm)"):
        assert label in shown
    for word in ("true", "best"):
        assert any(word in text for text in shown)
    assert any("(mm)" in text and "contact" in text for text in shown)
    captions = [text for text in shown if " %,  IoU " in text]
    assert len(captions) == min(4, len(localization.hypotheses))
    assert captions[0].startswith(f"1:  {format_percent(localization.best.probability)}")
    assert not missing(captions[0], "2.5 mm")


def test_a_result_without_a_true_pose_shows_neither_true_pose_nor_error(localizer, localization):
    unknown = dataclasses.replace(localization, touch=dataclasses.replace(localization.touch, T_sensor_object=None))
    shown = texts(draw_result(unknown, localizer.scene, "pin"))
    assert not any("true" in text for text in shown)
    assert not any(" mm" in text for text in shown if " %,  IoU " in text)


def test_a_photo_shows_the_outline_of_the_best_pose(localizer, localization):
    photo = np.full((*localization.touch.geometry.shape, 3), (10, 90, 160), np.uint8)
    seen = dataclasses.replace(localization, touch=dataclasses.replace(localization.touch, image=photo))
    figure = draw_result(seen, localizer.scene, "pin")
    assert "image" in texts(figure)
    assert any("observed" in text for text in texts(figure))
    axes = next(a for a in figure.findobj(Axes) if a.images and a.images[0].get_array().shape == photo.shape)
    contours = [c for c in axes.collections if len(c.get_paths())]
    made = localizer.scene.contact_shape(seen.best.T_sensor_object, seen.touch.press_depth_m)
    x_mm = np.concatenate([path.vertices for c in contours for path in c.get_paths()])[:, 0]
    columns = np.flatnonzero(made.contact.any(axis=0)) + 0.5
    geometry = seen.touch.geometry
    wanted_mm = 1e3 * (columns[[0, -1]] - geometry.cx) / geometry.scale_at_surface[0]
    np.testing.assert_allclose([x_mm.min(), x_mm.max()], wanted_mm, atol=1.5e3 * geometry.pixel_pitch_m)


def draw_several(localizer, localization, names: list[str], left_out: tuple[Touch, ...] = ()) -> Figure:
    others = tuple(dataclasses.replace(localization.touch, name=name) for name in names)
    ious = tuple(0.9 - 0.01 * k for k in range(len(names)))
    best = dataclasses.replace(localization.best, imprint_ious=ious)
    several = dataclasses.replace(
        localization,
        touch=others[0],
        others=others[1:],
        hypotheses=(best,) * 3,
        left_out=left_out,
        agreement=Agreement(outliers=(1,)),
    )
    return draw_result(several, localizer.scene, "pin")


def test_all_touches_that_were_located_together_are_shown(localizer, localization):
    away = dataclasses.replace(localization.touch, name="gone")
    figure = draw_several(localizer, localization, [f"t{k}" for k in range(MOST_TOGETHER + 2)], (away,))
    titles = [a.get_title() for a in figure.findobj(Axes) if a.get_title().startswith("t")]
    assert [title.partition("\n")[0] for title in titles] == [f"t{k}" for k in range(MOST_TOGETHER)]
    assert not missing(titles[0], "90 %")
    assert "contradicts" in titles[1]
    assert any(not missing(text, f"t{MOST_TOGETHER}", f"t{MOST_TOGETHER + 1}", "gone") for text in texts(figure))


@pytest.mark.parametrize("count", [2, 5])
def test_the_panels_of_several_touches_do_not_overlap(localizer, localization, count):
    figure = draw_several(localizer, localization, ["a-very-long-name-of-a-touch"] * count)
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    boxes = [axes.get_tightbbox(renderer) for axes in figure.findobj(Axes) if axes.get_title().startswith("a-very")]
    assert len(boxes) == count
    assert not [(a, b) for a, b in itertools.combinations(boxes, 2) if a.overlaps(b)]


def test_drawing_changes_neither_pyplots_figures_nor_its_settings(localizer, localization, tmp_path):
    before, figures = dict(plt.rcParams), plt.get_fignums()
    save_figure(tmp_path / "a.png", draw_result(localization, localizer.scene, "pin"), dpi=40)
    assert plt.get_fignums() == figures
    assert dict(plt.rcParams) == before


def test_contact_shapes_are_drawn_at_their_position_in_mm(tmp_path):
    depth = np.full(FLAT.shape, 0.001, np.float32)
    depth[3, 4] = 0.0004  # its centre is 0.25 mm right of and below the axis
    axes = Figure().add_subplot()
    image = draw_contact_shape(axes, ContactShape(depth, 0.001), FLAT)
    assert image.get_extent() == pytest.approx([-2.0, 8.0, 4.5, -1.5])
    values = image.get_array()
    assert values.mask.sum() == values.size - 1
    assert values[3, 4] == pytest.approx(0.4)  # mm
    assert image.get_clim() == pytest.approx((0.0, 1.0))
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # y runs down, as in the image
    (rectangle,) = axes.patches
    assert rectangle.get_bbox().extents == pytest.approx([-1, -1, 7, 4])


def test_the_outline_runs_around_the_contact(localizer, localization):
    depth = np.full((200, 200), 0.002, np.float32)
    depth[50:100, 20:60] = 0.0
    touch = Touch(ContactShape(depth, 0.002), localization.touch.geometry)
    figure = draw_result(dataclasses.replace(localization, touch=touch), localizer.scene, "pin")
    outline = next(c for a in figure.findobj(plt.Axes) for c in a.collections if type(c).__name__ == "QuadContourSet")
    x, y = outline.get_paths()[0].vertices.T
    sx, sy = (1e-3 * s for s in touch.geometry.scale_at_surface)
    cx, cy = touch.geometry.cx, touch.geometry.cy
    assert [x.min(), x.max()] == pytest.approx([(20 - cx) / sx, (60 - cx) / sx], abs=0.11)
    assert [y.min(), y.max()] == pytest.approx([(50 - cy) / sy, (100 - cy) / sy], abs=0.11)


def test_the_pose_panel_draws_estimate_and_truth_at_the_same_scale(localizer, localization):
    T = localization.touch.T_sensor_object
    pictures = []
    for estimate, truth in ((T, None), (T, T)):
        axes = Figure().add_subplot()
        draw_pose(axes, dataclasses.replace(DrawnScene.of(localization), poses=estimate[None], T_true=truth))
        pictures.append(np.asarray(axes.get_images()[0].get_array()))
    blue, with_lines = pictures
    assert blue.shape == with_lines.shape  # the same pose: the same bounds
    changed = np.abs(blue - with_lines).max(axis=-1) > 0.05
    assert 0.001 < changed.mean() < 0.1  # lines rather than areas
    assert (with_lines[changed][:, 0] > with_lines[changed][:, 2]).mean() > 0.9  # orange


def test_a_sheet_shows_at_most_the_stated_number_of_touches(localizer):
    touches = localizer.simulate(7, seed=1)
    figure = draw_touches(touches, "pin, simulated")
    shown = texts(figure)
    assert [touch.name for touch in touches if touch.name not in shown] == []
    assert len(draw_touches(touches[:1] * 100, "many").findobj(lambda a: a in figure.axes)) <= MOST_TOUCHES


def test_a_figure_is_saved_in_a_new_folder_but_not_below_a_file(tmp_path, figure):
    with Image.open(save_figure(tmp_path / "deep" / "a.png", figure, dpi=50)) as picture:
        picture.load()
        assert picture.size == tuple(int(50 * side) for side in figure.get_size_inches())
    starts = [save_figure(tmp_path / name, figure).read_bytes()[:4] for name in ("a.pdf", "a.other", "a")]
    assert starts == [b"%PDF", b"\x89PNG", b"\x89PNG"]
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError):
        save_figure(tmp_path / "file" / "a.png", figure)
    named = make_figure(4, 2)
    named.suptitle(r"$x^{a$")  # no valid formula, so it is drawn as it is
    assert save_figure(tmp_path / "a.png", named).stat().st_size > 0


def test_the_outline_on_an_elastic_gel_encloses_the_contact_alone(press_block_elastically):
    touch = press_block_elastically(0.008, 0.006)
    axes = make_figure(3, 3).add_subplot()
    draw_outline(axes, touch)
    (contour,) = axes.collections
    x, y = np.concatenate([path.vertices for path in contour.get_paths()]).T
    assert [np.ptp(x), np.ptp(y)] == pytest.approx([8, 6], abs=1.0)
