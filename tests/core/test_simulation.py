from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_loc.core import simulation
from tactile_loc.core.errors import TouchError
from tactile_loc.core.geometry import is_rigid
from tactile_loc.core.simulation import simulate_touches
from tactile_loc.plugins.grids.face import FaceGrid


@pytest.fixture
def sampler() -> FaceGrid:
    return FaceGrid(FaceGrid.Options(face="+z"))


def test_touches_are_what_their_true_poses_look_like(make_scene, pinhole, box, sampler):
    scene = make_scene(box, pinhole)
    touches = simulate_touches(sampler, scene, 5, np.random.default_rng(0), 0.001)
    assert len(touches) == 5
    assert len({t.name for t in touches}) == 5
    for touch in touches:
        assert touch.press_depth_m == 0.001
        assert touch.geometry is pinhole
        assert is_rigid(touch.T_sensor_object)
        again = scene.contact_shape(touch.T_sensor_object, 0.001).depth_m
        np.testing.assert_allclose(touch.contact_shape.depth_m, again, atol=1e-6)
        in_contact, touching = scene.in_contact(touch.T_sensor_object[None])
        assert touching.all()
        np.testing.assert_allclose(in_contact[0], touch.T_sensor_object, atol=1e-12)


def test_the_deepest_press_is_the_default(make_scene, pinhole, box, sampler):
    (touch,) = simulate_touches(sampler, make_scene(box, pinhole), 1, np.random.default_rng(1))
    assert touch.press_depth_m == pinhole.max_depth_m


def test_the_same_seed_makes_the_same_touches(make_scene, pinhole, box, sampler):
    a, b, c = (
        simulate_touches(sampler, make_scene(box, pinhole), 3, np.random.default_rng(seed)) for seed in (2, 2, 3)
    )
    for x, y, z in zip(a, b, c, strict=True):
        assert np.array_equal(x.contact_shape.depth_m, y.contact_shape.depth_m)
        assert not np.allclose(x.T_sensor_object, z.T_sensor_object)


@pytest.mark.parametrize("press_m", [0.0, -0.001, 0.0021, float("nan")])
def test_a_press_beyond_the_sensors_range_is_refused(make_scene, pinhole, box, sampler, press_m):
    with pytest.raises(TouchError, match="outside the sensor's range of 0 to 2 mm"):
        simulate_touches(sampler, make_scene(box, pinhole), 1, np.random.default_rng(0), press_m)


def test_imprints_of_a_face_that_covers_the_sensor_are_no_touches(make_scene, flat_camera, make_box, sampler):
    """They fit any flat face; what comes has an edge in view."""
    scene = make_scene(make_box(0.08, 0.06, 0.01), flat_camera)
    for touch in simulate_touches(sampler, scene, 10, np.random.default_rng(4)):
        contact = touch.contact_shape.contact
        assert 0 < contact.mean() < 1


def test_a_press_that_leaves_no_imprint_is_refused(make_scene, flat_camera, make_object, sampler, monkeypatch):
    """A press of a millionth of a millimetre touches no pixel's centre; this must end."""
    monkeypatch.setattr(simulation, "MOST_ROUNDS", 5)
    scene = make_scene(make_object(trimesh.creation.icosphere(4, 0.008)), flat_camera)
    with pytest.raises(TouchError, match="hardly any press of part"):
        simulate_touches(sampler, scene, 1, np.random.default_rng(5), 1e-9)


def test_no_touches_are_no_work(make_scene, flat_camera, box, sampler):
    assert simulate_touches(sampler, make_scene(box, flat_camera), 0, np.random.default_rng(6)) == []
