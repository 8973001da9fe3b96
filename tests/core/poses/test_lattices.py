import numpy as np
import pytest

from tactile_loc.core.poses.lattices import (
    compute_lattice_shape,
    find_reachable_translations,
    make_plane_lattice,
    make_shifted_lattice,
)
from tactile_loc.core.runtime.errors import GridError

LOW, HIGH = np.array([-0.010, 0.004]), np.array([0.013, 0.009])


def test_a_lattice_has_square_cells_and_is_centred():
    points = make_plane_lattice(LOW, HIGH, 0.002)
    assert len(points) == 12 * 3
    for axis, n in ((0, 12), (1, 3)):
        values = np.unique(points[:, axis].round(9))
        assert len(values) == n
        np.testing.assert_allclose(np.diff(values), 0.002)
    np.testing.assert_allclose(points.mean(axis=0), (LOW + HIGH) / 2)


@pytest.mark.parametrize("pitch_m", [0.0007, 0.001, 0.0023, 0.0049])
def test_every_place_has_a_lattice_point_within_half_a_pitch(pitch_m):
    points = make_plane_lattice(LOW, HIGH, pitch_m)
    places = np.random.default_rng(0).uniform(LOW, HIGH, (2000, 2))
    off = np.abs(places[:, None] - points[None]).max(axis=-1).min(axis=1)
    assert off.max() <= pitch_m / 2 * (1 + 1e-9)
    assert (points >= LOW - 1e-12).all()
    assert (points <= HIGH + 1e-12).all()
    assert len(points) == compute_lattice_shape(LOW, HIGH, pitch_m).prod()


def test_shifted_lattices_have_square_cells_and_lie_inside():
    for number in range(8):
        points = make_shifted_lattice(LOW, HIGH, 0.002, number)
        for axis in range(2):
            np.testing.assert_allclose(np.diff(np.unique(points[:, axis].round(9))), 0.002)
        assert (points >= LOW - 1e-12).all()
        assert (points <= HIGH + 1e-12).all()
        reached = np.abs(np.stack([points.min(axis=0) - LOW, HIGH - points.max(axis=0)]))
        assert reached.max() < 0.002, "the lattice has as many points as fit"


def test_successive_shifts_fill_each_others_gaps():
    middle = (LOW + HIGH) / 2
    offs = np.stack([(make_shifted_lattice(LOW, HIGH, 0.002, number)[0] - middle) % 0.002 for number in range(16)])
    places = np.random.default_rng(0).uniform(0, 0.002, (500, 2))
    apart = np.abs(places[:, None] - offs)
    off = np.minimum(apart, 0.002 - apart).max(axis=-1).min(axis=1)  # the square is a torus
    assert off.max() < 0.5 * 0.002 * 0.5, "16 points of a square lattice would leave 1/8, one lattice leaves 1/2"
    assert np.allclose(offs[0] % 0.002, 0.0, atol=1e-12) or np.allclose(offs[0], 0.002)


def test_a_short_or_empty_range_gives_its_middle():
    np.testing.assert_allclose(make_plane_lattice(np.zeros(2), np.array([0.001, -0.001]), 0.01), [[0.0005, -0.0005]])
    np.testing.assert_allclose(
        make_shifted_lattice(np.zeros(2), np.array([0.001, -0.001]), 0.01, 3), [[0.0005, -0.0005]]
    )


@pytest.mark.parametrize("pitch_m", [0.0, -0.001, np.nan, np.inf])
def test_an_impossible_pitch_is_refused(pitch_m):
    with pytest.raises(GridError, match=f"{1e3 * pitch_m:g} mm"):
        make_plane_lattice(LOW, HIGH, pitch_m)
    with pytest.raises(GridError, match=f"{1e3 * pitch_m:g} mm"):
        make_shifted_lattice(LOW, HIGH, pitch_m, 1)


def test_boxes_overlap_only_between_low_and_high():
    points = np.random.default_rng(1).normal(size=(40, 3)) * 0.01
    x0, x1, y0, y1 = rectangle = (-0.004, 0.006, -0.02, -0.01)
    low, high = find_reachable_translations(points, rectangle)
    for t in np.random.default_rng(2).uniform(low - 0.01, high + 0.01, (500, 2)):
        moved = points[:, :2] + t
        overlaps = (moved.max(axis=0) >= [x0, y0]).all() and (moved.min(axis=0) <= [x1, y1]).all()
        assert overlaps == ((t >= low).all() and (t <= high).all())


def test_batches_of_points_are_computed_separately():
    points = np.random.default_rng(3).normal(size=(5, 8, 3))
    low, high = find_reachable_translations(points, (-1.0, 1.0, -2.0, 2.0))
    one_low, one_high = find_reachable_translations(points[3], (-1.0, 1.0, -2.0, 2.0))
    np.testing.assert_array_equal(low[3], one_low)
    np.testing.assert_array_equal(high[3], one_high)
