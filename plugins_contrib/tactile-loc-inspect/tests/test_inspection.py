"""Inspections of a plate with a step: clean, with a burr, with a dent, and at a wrong pose."""

from dataclasses import replace

import numpy as np
import pytest
from inspect_helpers import TOP_M, make_burr, make_plate, misplace, press
from tactile_loc.plugin import Gel
from tactile_loc.plugin.helpers import make_translation

from tactile_loc_inspect.comparison import compare_touches, fit_plain_pose
from tactile_loc_inspect.inspection import (
    EXACT,
    NOISY,
    InspectionError,
    inspect_localization,
    inspect_part,
    state_heights,
)
from tactile_loc_inspect.scan import map_differences


def test_a_clean_part_is_as_the_model(clean_views):
    found = inspect_part(clean_views, misplace(clean_views))
    assert found.verdict == "as the model"
    assert found.differences == ()
    assert 0 < found.detectable_m < 5e-4
    assert 0.005 < found.touched < 0.2


def test_places_that_are_pressed_less_than_the_stated_height_do_not_count(clean_views):
    found = inspect_part(clean_views, misplace(clean_views)).map
    heights_m = state_heights(found, EXACT)
    counted = np.isfinite(heights_m)
    assert (found.pressed_m.max(axis=0)[counted] > heights_m[counted]).all()
    shallow = replace(found, pressed_m=np.minimum(found.pressed_m, 0.99 * heights_m[counted].min()))
    assert not np.isfinite(state_heights(shallow, EXACT)).any()


def test_a_noisy_reading_counts_places_that_enough_touches_press(clean_views):
    found = inspect_part(clean_views, misplace(clean_views)).map
    once = np.isfinite(found.pressed_m).sum(axis=0) < 2
    assert not np.isfinite(state_heights(found, NOISY)[once]).any()
    alone = replace(found, pressed_m=found.pressed_m[:1])
    assert not np.isfinite(state_heights(alone, NOISY)).any()


def test_a_burr_as_high_as_stated_is_found(clean_views):
    stated_mm = 1e3 * inspect_part(clean_views, misplace(clean_views)).detectable_m
    views = press(make_plate(make_burr(stated_mm)))
    assert inspect_part(views, misplace(views)).verdict == "differs"


def test_the_verdict_of_a_noisy_reading_has_a_note(clean_views):
    found = inspect_part(clean_views, misplace(clean_views))
    assert len(replace(found, limits=NOISY).list_notes()) == len(found.list_notes()) + 1


def test_the_verdict_of_an_elastic_gel_has_a_note(clean_views):
    found = inspect_part(clean_views, misplace(clean_views))
    first = found.comparisons[0]
    elastic = replace(first, geometry=replace(first.geometry, gel=Gel(4e-3)))
    assert len(replace(found, comparisons=(elastic,)).list_notes()) == len(found.list_notes()) + 1


@pytest.mark.parametrize("height_mm", [0.15, 0.3])
def test_a_burr_is_found_at_its_place_with_its_height(height_mm):
    views = press(make_plate(make_burr(height_mm)))
    found = inspect_part(views, misplace(views))
    assert found.verdict == "differs"
    first = found.differences[0]
    assert np.linalg.norm(first.point_m - TOP_M) < 4e-4
    assert 0.5 * height_mm < 1e3 * first.height_m < 1.2 * height_mm
    assert first.touches == 2
    assert found.describe().startswith("differs here: ")
    assert found.moved_m > 0


def test_differences_of_touches_from_images_have_a_warning():
    views = press(make_plate(make_burr(0.3)))
    image = np.zeros((*views[0].touch.geometry.shape, 3), np.uint8)
    photographed = [replace(one, touch=replace(one.touch, image=image)) for one in views]
    warned, plain = (inspect_part(some, misplace(views)).list_notes() for some in (photographed, views))
    assert len(warned) == len(plain) + 1


def test_a_dent_is_found():
    dented, model = press(make_plate()), make_plate(make_burr(0.25))  # the part lacks what the model has
    views = [type(one)(one.touch, type(one.scene)(model, one.touch.geometry, one.scene.renderer)) for one in dented]
    found = inspect_part(views, misplace(views))
    assert found.differences[0].height_m < -1e-4
    assert np.linalg.norm(found.differences[0].point_m - TOP_M) < 5e-4


def test_the_robust_pose_is_nearer_to_the_truth_than_the_plain_one():
    views = press(make_plate(make_burr(0.3)))
    found = inspect_part(views, misplace(views))
    for view, one in zip(views, found.comparisons, strict=True):
        poses = one.T, fit_plain_pose(view, one.T)
        robust, plain = (abs((T - view.touch.T_sensor_object)[2] @ [*TOP_M, 1]) for T in poses)
        assert robust < plain


def test_opposite_differences_cancel_and_are_counted(clean_views):
    burred = press(make_plate(make_burr(0.3)), seed=4)
    together = map_differences(compare_touches([*burred[:1], *clean_views], misplace([*burred[:1], *clean_views])))
    alone = map_differences(compare_touches(burred[:1], misplace(burred[:1])))
    assert together.heights_m[1].max() < alone.heights_m[1].max()


def test_a_better_pose_is_named_instead_of_a_difference(clean_views):
    wrong = [make_translation([1.5e-3, 0, 0]) @ view.touch.T_sensor_object for view in clean_views]
    right = [view.touch.T_sensor_object for view in clean_views]
    found = inspect_part(clean_views, wrong, {2: right})
    assert (found.verdict, found.better) == ("another pose", 2)


def test_the_map_holds_the_touched_surface_only(clean_views):
    found = map_differences(compare_touches(clean_views, misplace(clean_views)))
    middle_m = np.array([1e-3, 0.5e-3])
    assert (np.abs(found.points_m[:, :2] - middle_m) < [3.3e-3, 2.8e-3]).all()
    assert found.areas_m2.sum() == pytest.approx(30e-6, rel=0.3)


def test_the_limit_counts_no_places_that_are_too_narrow_for_its_blob(clean_views):
    (one,) = compare_touches(clean_views[:1], misplace(clean_views[:1]))
    strip = np.zeros(one.geometry.shape, bool)
    strip[:, 58:62] = True  # 0.5 mm wide
    narrow = replace(one, differences=replace(one.differences, known=one.differences.known & strip))
    found = map_differences([narrow])
    assert np.isfinite(found.std_m[0]).all()
    assert (np.isinf(found.std_m) | (found.std_m < 1e-3)).all()
    assert np.isinf(found.std_m[-1]).any()


def test_an_uncertain_result_is_refused(located_uncertain):
    with pytest.raises(InspectionError):
        inspect_localization(located_uncertain)
    with pytest.raises(InspectionError):
        inspect_localization(located_uncertain, 10_000)
    assert len(inspect_localization(located_uncertain, 1).comparisons) == 1
