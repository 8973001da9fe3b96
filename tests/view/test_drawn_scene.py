"""The scene that all viewers draw is the same in the sensor's and in the base's frame."""

import dataclasses

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import invert, make_transform, rotation_about, transform_points
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.view.drawn_scene import DEVIATIONS, GEL_M, DrawnScene, DrawnSensor, Ellipsoid, move_triangles

T_BASE_OBJECT = make_transform(rotation_about([1, 2, 3], 0.8), [0.4, -0.1, 0.2])


@pytest.fixture(scope="module")
def found(localizer):
    """Two touches of an object at a known pose."""
    touches = [
        dataclasses.replace(touch, T_base_sensor=T_BASE_OBJECT @ invert(touch.T_sensor_object))
        for touch in localizer.simulate(2, seed=4)
    ]
    return localize_together([(localizer, touch) for touch in touches])


def test_sensors_and_the_true_pose_move_with_the_frame(found):
    scene, in_base = DrawnScene.of(found), DrawnScene.of(found, in_base=True)
    T = found.touch.T_base_sensor
    np.testing.assert_allclose(in_base.T_true, T_BASE_OBJECT, atol=1e-9)
    np.testing.assert_allclose(in_base.truth_m, move_triangles(scene.truth_m, T), atol=1e-9)
    np.testing.assert_allclose(in_base.likely_poses, T @ scene.likely_poses, atol=1e-9)
    np.testing.assert_array_equal(in_base.poses[0], found.best.T_base_object)
    for one, other in zip(scene.sensors, in_base.sensors, strict=True):
        np.testing.assert_allclose(other.T_scene_sensor, other.touch.T_base_sensor, atol=1e-9)
        np.testing.assert_allclose(other.gel_m, move_triangles(one.gel_m, T), atol=1e-9)
        for line, moved in zip(one.outlines_m, other.outlines_m, strict=True):
            np.testing.assert_allclose(moved, transform_points(T, line), atol=1e-9)


def test_outlines_lie_on_the_gel_and_surround_the_contact(localization):
    sensor = DrawnSensor.of(localization.touch)
    (line,) = sensor.outlines_m
    assert np.ptp(line[:, 2]) == 0
    assert line[0, 2] == sensor.gel_m[..., 2].max() == pytest.approx(sensor.gel_m[..., 2].min() + GEL_M)
    assert (line[0] == line[-1]).all()
    assert DrawnSensor(sensor.geometry).outlines_m == []


def test_an_ellipsoid_has_the_covariance_of_the_position():
    R = rotation_about([1, 1, 0], 0.5)
    variances = np.square([1e-4, 3e-4, 2e-4])
    covariance = np.eye(6)
    covariance[:3, :3] = R @ np.diag(variances) @ R.T
    found = Ellipsoid.of(np.zeros(3), covariance)
    assert np.linalg.det(found.axes) == pytest.approx(1)
    again = found.axes @ np.diag((found.half_axes_m / DEVIATIONS) ** 2) @ found.axes.T
    np.testing.assert_allclose(again, covariance[:3, :3], atol=1e-15)
