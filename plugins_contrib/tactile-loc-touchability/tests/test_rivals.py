"""Pairs of poses of a block that touches confuse: their motions, their words, and the places that tell them apart."""

from dataclasses import replace

import numpy as np
import pytest
from tactile_loc.plugin.helpers import SymmetryGroup, invert, make_transform, rotation_about, rotation_angle

from tactile_loc_touchability.features import FeatureError, TriedFeature, change_surface, try_features
from tactile_loc_touchability.rivals import (
    choose_equivalents,
    choose_marks,
    describe_motions,
    find_pairs,
    find_turn,
    merge_motions,
    tell_apart,
)

HALF_TURN = make_transform(rotation_about([0, 0, 1], np.pi), np.zeros(3))


def shift(x_mm: float) -> np.ndarray:
    return make_transform(np.eye(3), np.array([1e-3 * x_mm, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("motion", "words", "reason"),
    [
        (HALF_TURN, "turned by 180 degrees about z", "these places look alike after 1/2 of a turn"),
        (shift(-4), "moved by 4.0 mm along -x", "these places look alike along this direction"),
        (
            make_transform(rotation_about([0, 1, 0], np.radians(20)), np.zeros(3)),
            "turned by 20 degrees about y",
            "these places are nearly round about this axis",
        ),
        (
            make_transform(rotation_about([0, 1, 0], np.radians(100)), np.zeros(3)),
            "turned by 100 degrees about y",
            "places of the part look alike",
        ),
        (
            make_transform(rotation_about([0, 0, 1], np.radians(50)), np.array([0, 0, 5e-3])),
            "turned by 50 degrees about z and moved by 5.0 mm along z",
            "places of the part look alike",
        ),
    ],
)
def test_a_motion_is_described_in_the_frame_of_the_part(plain, motion, words, reason):
    assert describe_motions(motion[None], plain, 0.033) == (words, reason)


def test_a_motion_and_its_inverse_are_one_pair(plain):
    motions = np.stack([shift(4), shift(-4.2), shift(12), HALF_TURN])
    assert merge_motions(plain, motions, 1.5e-3).tolist() == [0, 0, 2, 3]
    assert np.allclose(invert(shift(4)), shift(-4))


def test_the_least_of_equivalent_motions_is_taken(plain):
    """A turn by 170 degrees is one by 10 degrees backwards, if half a turn is a symmetry."""
    obj = replace(plain, symmetry=SymmetryGroup.parse("z2", np.zeros(3)))
    turn = make_transform(rotation_about([0, 0, 1], np.radians(170)), np.zeros(3))
    (least,) = choose_equivalents(obj, turn[None])
    assert rotation_angle(least[:3, :3]) == pytest.approx(np.radians(10))


def test_no_touch_tells_the_halves_of_a_plain_block_apart(study_of):
    assert not tell_apart(study_of["plain"], HALF_TURN[None]).any()


def test_the_touches_at_a_notch_or_opposite_to_it_tell_its_side(study_of):
    study = study_of["notched"]
    told, places_m = tell_apart(study, HALF_TURN[None]), study.presses.places_m
    at_notch = (np.abs(np.abs(places_m[:, 0]) - 0.011) < 3e-3) & (places_m[:, 2] > 2e-3)
    in_middle = np.abs(places_m[:, 0]) < 2e-3
    assert told[at_notch].mean() > 0.5
    assert not told[in_middle].any()


def test_pairs_are_counted_over_touches(study_of):
    study = study_of["notched"]
    rival = {"motion": HALF_TURN.ravel().tolist(), "probability": 0.4}
    rows = [{**row, "rivals": [rival] if k < 15 else []} for k, row in enumerate(study.rows)]
    (pair,) = find_pairs(replace(study, rows=rows))
    assert pair.words == "turned by 180 degrees about z"
    assert pair.confused.sum() == 15
    assert 0 < pair.told.mean() < 0.9
    assert find_pairs(study) == []


@pytest.mark.parametrize("angle_deg", [20, 50, 130])
def test_the_axis_of_a_turn_is_found_beside_the_centre(plain, angle_deg):
    R, point = rotation_about([0, 1, 0], np.radians(angle_deg)), np.array([0.02, 0.0, -0.01])
    turn = find_turn(make_transform(R, point - R @ point), plain, 0.033)
    assert turn.point_m == pytest.approx(point, abs=1e-9)
    assert turn.name_axis(np.zeros(3)) == "an axis along y through (20.0, 0.0, -10.0) mm"


def test_turns_about_one_axis_are_one_family(study_of):
    study = study_of["plain"]
    turns = [make_transform(rotation_about([0, 0, a], np.radians(d)), np.zeros(3)) for d, a in ((40, 1), (75, -1))]
    rivals = [{"motion": T.ravel().tolist(), "probability": 0.3} for T in (*turns, shift(6))]
    rows = [{**row, "rivals": rivals[: 1 + k % 3]} for k, row in enumerate(study.rows)]
    turned, moved = find_pairs(replace(study, rows=rows))
    assert turned.words == "turned by 40 or 75 degrees about z"
    assert turned.confused.all()
    assert (moved.words, moved.confused.sum()) == ("moved by 6.0 mm along x", 20)


def test_a_feature_tells_the_halves_of_a_plain_block_apart(study_of):
    study = study_of["plain"]
    rival = {"motion": HALF_TURN.ravel().tolist(), "probability": 0.5}
    (pair,) = find_pairs(replace(study, rows=[{**row, "rivals": [rival]} for row in study.rows]))
    assert not pair.told.any()
    tried = try_features(study, pair)
    assert {one.kind for one in tried} == {"dimple", "bump"}
    assert tried[0].after > 0
    assert all(one.before == 0 for one in tried)
    assert [one.after for one in tried] == sorted((one.after for one in tried), reverse=True)


def test_a_feature_without_a_gain_is_not_recommended():
    useless, useful = (TriedFeature("bump", (0.0, 0.0, 0.0), 0.9, after) for after in (0.9, 0.95))
    assert useless.describe().startswith("no tried feature")
    assert "from 90 % to 95 %" in useful.describe()


def test_features_need_a_closed_surface(plain):
    mesh = replace(plain.mesh, faces=plain.mesh.faces[:-1])
    with pytest.raises(FeatureError, match="not a closed surface"):
        next(change_surface(replace(plain, mesh=mesh), np.array([0.0, 0.0, 4e-3])))


def test_marks_are_far_apart():
    places = np.array([[0, 0, 0], [1, 0, 0], [10, 0, 0], [5, 0, 0]], float)
    assert choose_marks(places, np.array([True, True, True, False]), 2) == [0, 2]
    assert choose_marks(places, np.zeros(4, bool), 2) == []
