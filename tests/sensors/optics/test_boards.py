"""The calibration boards: solids of the right size, and poses that press their raised side."""

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc.core.geometry.rigid import invert, is_rigid, transform_points
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.optics.boards import (
    COLUMNS,
    MIDDLE,
    MOST_TILT_RAD,
    PITCH_M,
    PLATE_M,
    ROWS,
    draw_board_poses,
    make_board,
)


@pytest.fixture(scope="module", params=[1, 2])
def numbered(request):
    return make_board(request.param)


def test_every_shape_of_a_board_is_a_closed_solid(numbered):
    whole = trimesh.Trimesh(numbered.mesh.vertices_m, numbered.mesh.faces, process=False)
    assert whole.is_watertight
    solids = whole.split(only_watertight=False)
    assert len(solids) >= 36
    assert all(s.is_watertight and s.is_winding_consistent and s.volume > 0 for s in solids)


def test_a_board_has_the_outline_of_its_plate_and_shapes_of_several_heights(numbered):
    x, y, thickness = PLATE_M
    assert numbered.mesh.vertices_m.min(axis=0) == pytest.approx([-x / 2, -y / 2, -thickness])
    assert numbered.mesh.vertices_m.max(axis=0) == pytest.approx([x / 2, y / 2, 4e-3], abs=1e-4)
    whole = trimesh.Trimesh(numbered.mesh.vertices_m, numbered.mesh.faces, process=False)
    raised = [s.bounds for s in whole.split(only_watertight=False) if s.bounds[1, 2] > 0]
    low, high = (np.array([bounds[i] for bounds in raised]) for i in (0, 1))
    assert len(raised) >= 35
    assert high[:, 2].min() >= 1.0e-3  # the lower of two parts, tilted
    assert len(np.unique(high[:, 2].round(5))) >= 5
    assert (np.maximum(high, -low)[:, :2] <= [x / 2, y / 2]).all()
    assert (low[:, 2] < 0).all()  # every shape begins inside the plate
    assert (low[:, 2] > -thickness).all()  # and does not pass through it


def test_there_are_two_reproducible_boards():
    first, again, second = (make_board(number).mesh.digest for number in (1, 1, 2))
    assert first == again != second
    for number in (0, 3):
        with pytest.raises(ConfigError, match=naming(number, 1, 2)):
            make_board(number)


def test_poses_lie_above_the_sensor_with_the_raised_side_down(numbered, pinhole):
    T = draw_board_poses(numbered, pinhole, 300, np.random.default_rng(0))
    assert is_rigid(T)
    lowest = [transform_points(t, numbered.mesh.vertices_m)[:, 2].min() for t in T]
    assert (np.array(lowest) > pinhole.standoff_m).all()
    tilt = np.arccos(-T[:, 2, 2])
    assert 0.9 * MOST_TILT_RAD < tilt.max() <= MOST_TILT_RAD
    yaw = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    assert np.abs(np.exp(1j * yaw).mean()) < 0.15
    x0, x1, y0, y1 = pinhole.rectangle
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    over = np.einsum("nji,nj->ni", T[:, :3, :3], middle - T[:, :3, 3])  # close to the height of the plate
    assert np.ptp(over[:, :2], axis=0) == pytest.approx(MIDDLE * PITCH_M * np.array([COLUMNS, ROWS]), abs=0.012)
    assert draw_board_poses(numbered, pinhole, 0, np.random.default_rng(0)).shape == (0, 4, 4)


@pytest.mark.parametrize("size_m", [0.015, 0.04])
def test_poses_touch_the_raised_side(numbered, make_scene, size_m):
    k = 64 / size_m
    geometry = SensorGeometry("orthographic", 64, 64, k, k, 32.0, 32.0, 0.01, 2e-3)
    scene = make_scene(numbered, geometry)
    T, touching = scene.bring_to_contact(draw_board_poses(numbered, geometry, 40, np.random.default_rng(1)))
    assert touching.all()
    depth = scene.render_contact_depths(T)
    in_sensor = geometry.backproject(depth + np.float32(geometry.standoff_m))
    for t, points, contact in zip(T, in_sensor, depth < np.float32(geometry.max_depth_m), strict=True):
        assert contact.any()
        on_board = transform_points(invert(t), points[contact])
        assert on_board[:, 2].min() > -4e-4  # the contact is on the raised side, at the plate or above
        assert on_board[:, 2].max() <= 4.1e-3
