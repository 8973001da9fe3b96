"""Scores of simulated presses with known errors."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tactile_loc import Localizer, StageStore, Touch
from tactile_loc.plugin import ContactShape
from tactile_loc.plugin.helpers import make_translation

from tactile_loc_test_object import scoring
from tactile_loc_test_object.score import Score
from tactile_loc_test_object.scoring import (
    Photo,
    ScoredPress,
    Surfaces,
    TestObjectError,
    compare_surfaces,
    find_nominal_pose,
    list_photos,
    locate_press,
    subtract_plane,
)
from tactile_loc_test_object.shape import PLACES, make_object, write_stl

PRESS_M = 5e-4
MIDDLE_M = np.array([4e-4, -3e-4])
FEW = (PLACES[0], PLACES[5], PLACES[9])


@pytest.fixture(scope="module")
def localizer(tmp_path_factory) -> Localizer:
    folder = tmp_path_factory.mktemp("object")
    write_stl(folder / "object.stl")
    return Localizer.create(
        folder / "object.stl", units="mm", symmetry="none", sensor="gelsight-mini", store=StageStore(folder / "store")
    )


def press(localizer: Localizer, place, shift_m=(0.0, 0.0), scale: float = 1.0) -> ScoredPress:
    """Locate a press with an error of the hand, whose heights are read too large by the factor `scale`."""
    geometry = localizer.sensor.geometry
    T = make_translation([*shift_m, 0]) @ find_nominal_pose(place, geometry)
    shape = localizer.scene.contact_shape(T, PRESS_M)
    read = ContactShape((scale * shape.depth_m).astype(np.float32), scale * shape.press_depth_m)
    return locate_press(localizer, Touch(read, geometry), Photo(Path(f"{place.number}.png"), place))


@pytest.fixture(scope="module")
def right(localizer) -> list[ScoredPress]:
    return [press(localizer, place, MIDDLE_M) for place in FEW]


def test_a_right_sensor_loses_no_points_by_its_middle(right):
    score = Score(tuple(right))
    assert len(score.located) == len(FEW)
    assert min(map(score.rate, right)) > 85
    assert score.shape_points == pytest.approx(sum(map(score.rate, right)) / len(PLACES))
    assert score.height_points == pytest.approx(100 * len(FEW) / len(PLACES), abs=2)
    assert score.height_scale == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(score.middle_m, MIDDLE_M, atol=1e-4)
    assert score.between_places_m < 1e-4
    assert score.repeatability_m is None


@pytest.mark.parametrize("scale", [0.75, 1.25])
def test_wrong_heights_cost_points_and_are_stated(localizer, right, scale):
    wrong = [press(localizer, place, MIDDLE_M, scale) for place in FEW]
    score = Score(tuple(wrong))
    assert score.height_scale == pytest.approx(scale, rel=0.1)
    assert score.points < Score(tuple(right)).points - 2
    assert score.calibration_m > Score(tuple(right)).calibration_m


def test_refused_and_missing_photos_never_add_points(right):
    all_of_them = Score(tuple(right)).points
    for number in range(len(right)):
        without = right[:number] + right[number + 1 :]
        assert Score(tuple(without)).points < all_of_them
        refused = ScoredPress(right[number].photo, "no contact")
        assert Score((*without, refused)).points < all_of_them
    assert Score((ScoredPress(right[0].photo, "no contact"),)).points == 0
    assert Score((ScoredPress(right[0].photo, "no contact"),)).calibration_m is None


@pytest.mark.parametrize("scales", [(1.9, 1.0, 0.9), (0.2, 1.1, 1.1), (5.0, 1.2, 1.3), (-1.0, 0.8, 0.9)])
def test_no_refusal_adds_points_whatever_the_heights(right, scales):
    pairs = zip(right, scales, strict=True)
    presses = [replace(one, surfaces=replace(one.surfaces, scale=scale)) for one, scale in pairs]
    points = Score(tuple(presses)).height_points
    for number, one in enumerate(presses):
        refused = [*presses[:number], ScoredPress(one.photo, "no contact"), *presses[number + 1 :]]
        assert Score(tuple(refused)).height_points <= points + 1e-9


def test_a_press_far_from_the_others_is_astray(right):
    moved = replace(right[0], shift_m=right[0].shift_m + np.array([3e-3, 0]))
    score = Score((moved, *right[1:], replace(right[1], shift_m=MIDDLE_M)))
    assert score.describe_state(moved) == "astray"
    assert score.rate(moved) == 0


@pytest.mark.parametrize("verdict", ["poor fit", "not found"])
def test_a_press_whose_pose_does_not_fit_is_not_located(right, verdict):
    lost = replace(right[0], verdict=verdict, surfaces=replace(right[0].surfaces, scale=-1.0))
    score = Score((lost, *right[1:]))
    assert score.describe_state(lost) == verdict
    assert score.located == tuple(right[1:])
    assert score.rate(lost) == 0
    assert score.height_scale == Score(tuple(right[1:])).height_scale


def test_repeatability_is_the_spread_at_a_place(right):
    again = [replace(right[0], shift_m=MIDDLE_M + np.array([d, 0])) for d in (-1e-4, 1e-4)]
    assert Score(tuple(again)).repeatability_m == pytest.approx(np.sqrt(2) * 1e-4)


def test_the_places_errors_are_measured_about_their_mean(right):
    moved = [replace(one, shift_m=np.array([d, 0])) for one, d in zip(right[:2], (-2e-4, 2e-4), strict=True)]
    assert Score(tuple(moved)).between_places_m == pytest.approx(2e-4)


def test_a_plane_is_no_error():
    y, x = np.indices((20, 30), float)
    bowl, inside = 1e-5 * (x - 15) ** 2, np.hypot(x - 15, y - 10) < 8
    tilted = Surfaces.compare(bowl + 1e-5 * x - 2e-5 * y + 1e-4, bowl, inside)
    assert tilted.error_m < 1e-12
    assert tilted.scale == pytest.approx(1)
    assert tilted.share == pytest.approx(1)
    assert Surfaces.compare(0.8 * bowl, bowl, inside).share == pytest.approx(0.8)
    assert np.abs(subtract_plane(1e-5 * x + 3, inside)).max() < 1e-12


@pytest.mark.parametrize(("lifted_m", "refused"), [(0.0, False), (4.9e-4, True), (1e-3, True)])
def test_a_pose_without_contact_has_no_surfaces(localizer, lifted_m, refused):
    geometry = localizer.sensor.geometry
    T = localizer.scene.press(PRESS_M).bring_to_contact(find_nominal_pose(PLACES[0], geometry)[None])[0][0]
    touch = Touch(localizer.scene.contact_shape(T, PRESS_M), geometry)
    scene, lifted = localizer.scene.match_touch(touch), make_translation([0, 0, lifted_m]) @ T
    assert (compare_surfaces(scene, touch, lifted) is None) == refused


def test_a_photo_without_a_pose_is_refused(localizer, monkeypatch):
    monkeypatch.setattr(scoring, "compare_surfaces", lambda *_: None)
    with pytest.raises(TestObjectError, match=r"^1\.png: "):
        press(localizer, PLACES[0])


def test_a_start_that_was_not_refined_is_passed_over(localizer, monkeypatch):
    start = find_nominal_pose(PLACES[0], localizer.sensor.geometry)
    poses = (start, make_translation([*MIDDLE_M, -PRESS_M]) @ start)
    found = SimpleNamespace(hypotheses=[SimpleNamespace(T_sensor_object=T) for T in poses], verdict="ambiguous")
    monkeypatch.setattr(Localizer, "localize", lambda *_, **__: found)
    one = press(localizer, PLACES[0], MIDDLE_M)
    np.testing.assert_allclose(one.shift_m, MIDDLE_M, atol=1e-9)
    assert one.surfaces.error_m < 2e-5


def test_photos_are_found_by_their_numbers(tmp_path):
    for name in ("10.png", "2.jpg", "02b.PNG", "notes.txt", "plate.png"):
        (tmp_path / name).touch()
    found = list_photos(tmp_path)
    assert [(one.place.number, one.repetition) for one in found] == [(2, ""), (2, "b"), (10, "")]


@pytest.mark.parametrize("names", [(), ("11.png",), ("0.png",)])
def test_folders_without_photos_of_places_are_refused(tmp_path, names):
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(TestObjectError):
        list_photos(tmp_path)
    with pytest.raises(TestObjectError):
        list_photos(tmp_path / "missing")


def test_the_row_has_no_path(right):
    row = Score(tuple(right)).to_row("mine")
    assert (row["sensor"], row["photos"], row["located"]) == ("mine", 3, 3)
    assert "png" not in str(row)
    assert make_object().name == "test-object"
