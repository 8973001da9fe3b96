"""Distributions over rotations, for pictures."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.geometry import align_to_z, random_rotations, rotation_about
from tactile_loc.reports.rotations import SideMap, side_map, yaw_histogram, yaw_rad

Z = [0, 0, 1]


@pytest.mark.parametrize("normal", [[0, 0, -1], [0, 0, 1], [1, 0, 0], [0.3, -0.5, 0.2]])
def test_yaw_is_the_turn_of_a_face_that_lies_on_the_sensor(normal):
    yaw = np.linspace(-3, 3, 25)
    R = rotation_about(Z, yaw) @ align_to_z(-np.array(normal, float))
    assert yaw_rad(R) == pytest.approx(yaw)


def test_yaw_and_side_make_the_rotation():
    R = random_rotations(40, np.random.default_rng(0))
    again = np.stack([rotation_about(Z, yaw) @ align_to_z(r[2]) for yaw, r in zip(yaw_rad(R), R, strict=True)])
    assert again == pytest.approx(R)


def test_a_lattice_has_a_bar_for_each_yaw():
    yaw_deg = np.repeat(np.arange(0, 360, 15.0), 3)
    weights = np.random.default_rng(0).dirichlet(np.ones(len(yaw_deg)))
    found = yaw_histogram(rotation_about(Z, np.radians(yaw_deg)) @ align_to_z([0, 1, 0]), weights)
    assert found.yaw_deg == pytest.approx(np.arange(0, 360, 15.0), abs=0.01)
    assert found.mass == pytest.approx(weights.reshape(-1, 3).sum(axis=1))
    assert found.width_deg == pytest.approx(15.0)


def test_scattered_yaws_are_counted_in_bins():
    weights = np.full(500, 1 / 500)
    found = yaw_histogram(random_rotations(500, np.random.default_rng(0)), weights)
    assert len(found.mass) == 36
    assert found.mass.sum() == pytest.approx(1.0)


def test_one_face_is_one_side():
    R = rotation_about(Z, np.linspace(0, 6, 20)) @ align_to_z([0, -1, 0])
    found = side_map(R, np.full(20, 0.05))
    assert found.kind == "one"
    assert found.normal == pytest.approx([0, 1, 0])


def test_small_tilts_are_leans_in_the_sensor_s_frame():
    tilt = np.radians([-10.0, 0.0, 10.0])
    R = rotation_about([1, 0, 0], tilt) @ rotation_about(Z, np.array(0.7)) @ align_to_z([1, 0, 0])
    found = side_map(R, np.array([0.2, 0.3, 0.5]))
    assert found.kind == "lean"
    assert found.mass.sum() == pytest.approx(1.0)
    y = 0.5 * (found.y[1:] + found.y[:-1])
    rows = found.mass.sum(axis=1)
    # turned about +x by 10 degrees, the side that faced -z leans towards +y
    assert sorted(zip(y[rows > 0].round(1), rows[rows > 0].round(6), strict=True)) == [
        (pytest.approx(-10, abs=1), 0.2), (pytest.approx(0, abs=1), 0.3), (pytest.approx(10, abs=1), 0.5),
    ]  # fmt: skip
    assert found.mass[:, len(rows) // 2].sum() == pytest.approx(1.0)


def peak(found: SideMap) -> tuple[float, float]:
    row, column = np.unravel_index(found.mass.argmax(), found.mass.shape)
    return (found.x[column] + found.x[column + 1]) / 2, (found.y[row] + found.y[row + 1]) / 2


def test_all_sides_are_a_globe_of_equal_areas():
    R = random_rotations(20_000, np.random.default_rng(0))
    weights = np.full(len(R), 0.5 / len(R))
    side = np.array([np.cos(np.radians(40)), np.sin(np.radians(40)), 0.0])
    R = np.concatenate([R, align_to_z(-side)[None]])
    found = side_map(R, np.append(weights, 0.5))
    assert found.kind == "globe"
    assert found.mass.sum() == pytest.approx(1.0)
    azimuth, elevation = peak(found)
    assert azimuth == pytest.approx(40, abs=10)
    assert elevation == pytest.approx(0, abs=7)
    rest = np.sort(found.mass.ravel())[:-1]
    assert rest.max() < 2.5 * rest.mean()
    assert found.normal == pytest.approx(side)
