"""The scene of a run's page."""

import numpy as np
import pytest
from report_helpers import floats

from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.reports import scene
from tactile_loc.view.raytracing import Viewpoint


def test_meshes_and_poses_are_in_mm(box):
    packed = scene.pack_mesh(box.mesh)
    assert floats(packed["vertices_mm"]).reshape(-1, 3) == pytest.approx(1e3 * box.mesh.vertices_m)
    T = make_transform(np.eye(3), [0.001, -0.002, 0.025])
    assert scene.list_rows_mm(T) == [1, 0, 0, 1.0, 0, 1, 0, -2.0, 0, 0, 1, 25.0]


def test_the_camera_sees_every_point():
    """In plotly, the unit is the geometric mean of the ranges, the origin their centre, the view 45 degrees wide."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-60, -10, 20], [30, 40, 60], (200, 3))
    bounds = [[-80.0, 50.0], [-30.0, 60.0], [0.0, 70.0]]
    view = Viewpoint(35.0, 28.0)
    camera = scene.place_camera(points, bounds, view)
    unit, middle = np.prod(np.ptp(bounds, axis=1)) ** (1 / 3), np.mean(bounds, axis=1)
    eye, centre = ([camera[name][k] for k in "xyz"] for name in ("eye", "center"))
    seen = ((points - middle) / unit - eye) @ view.axes.T
    towards = (np.array(centre) - eye) / np.linalg.norm(np.array(centre) - eye)
    assert towards == pytest.approx(-view.axes[2], abs=1e-3)
    angles = np.degrees(np.arctan2(np.abs(seen[:, :2]), -seen[:, 2:]))
    assert angles.max() < 22.5
    assert angles.max() > 15  # and the camera is not too far away
