import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc.core.geometry.rigid import is_rigid
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.noise import NOISE, TouchNoise
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.simulate import touch_simulation as simulation
from tactile_loc.simulate.touch_simulation import draw_touches, simulate_touches


@pytest.fixture
def sampler() -> FaceGrid:
    return FaceGrid(FaceGrid.Options(face="+z"))


def test_touches_match_the_contact_shapes_of_their_true_poses(make_scene, pinhole, box, sampler):
    scene = make_scene(box, pinhole)
    touches = simulate_touches(sampler, scene, 5, np.random.default_rng(0), 0.001)
    assert len(touches) == 5
    assert len({t.name for t in touches}) == 5
    for touch in touches:
        assert touch.press_depth_m == touch.indentation_m == 0.001
        assert touch.geometry.surface_m == pinhole.standoff_m
        assert is_rigid(touch.T_sensor_object)
        again = scene.contact_shape(touch.T_sensor_object, 0.001).depth_m
        np.testing.assert_allclose(touch.contact_shape.depth_m, again, atol=1e-6)
        in_contact, touching = scene.press(0.001).bring_to_contact(touch.T_sensor_object[None])
        assert touching.all()
        np.testing.assert_allclose(in_contact[0], touch.T_sensor_object, atol=1e-12)


def test_the_same_seed_makes_the_same_touches_at_the_deepest_press(make_scene, pinhole, box, sampler):
    def draw(count: int, seed: int):
        return simulate_touches(sampler, make_scene(box, pinhole), count, np.random.default_rng(seed))

    for x, y, z in zip(draw(3, 2), draw(3, 2), draw(3, 3), strict=True):
        assert x.press_depth_m == pinhole.max_depth_m
        assert np.array_equal(x.contact_shape.depth_m, y.contact_shape.depth_m)
        assert not np.allclose(x.T_sensor_object, z.T_sensor_object)
    assert draw(0, 6) == []


@pytest.mark.parametrize("press_m", [0.0, -0.001, 0.0021, float("nan")])
def test_a_press_beyond_the_sensors_range_is_refused(make_scene, pinhole, box, sampler, press_m):
    with pytest.raises(TouchError, match=naming(f"{1e3 * press_m:.3g} mm", "2 mm")):
        simulate_touches(sampler, make_scene(box, pinhole), 1, np.random.default_rng(0), press_m)


def test_rejected_presses_are_counted(make_scene, flat_camera, make_box, sampler):
    """The large face covers the sensor at most places; the small face gives a touch at any place."""
    large, small = (make_scene(make_box(side, side, 0.01), flat_camera) for side in (0.06, 0.01))
    touches, refused = draw_touches(sampler, large, 10, np.random.default_rng(4))
    assert refused > 0
    again = simulate_touches(sampler, large, 10, np.random.default_rng(4))
    assert all((a.T_sensor_object == b.T_sensor_object).all() for a, b in zip(touches, again, strict=True))
    assert draw_touches(sampler, small, 10, np.random.default_rng(4))[1] == 0
    shy = TouchNoise(missing=4.0, patch_m=0.008)
    assert draw_touches(sampler, small, 10, np.random.default_rng(4), None, shy)[1] > 0


def test_a_press_that_leaves_no_imprint_is_refused(make_scene, flat_camera, make_object, sampler, monkeypatch):
    """A press of a millionth of a millimetre touches no pixel centre; the search must end."""
    monkeypatch.setattr(simulation, "MOST_ROUNDS", 5)
    scene = make_scene(make_object(trimesh.creation.icosphere(4, 0.008)), flat_camera)
    with pytest.raises(TouchError, match=naming("part", "1e-06 mm")):
        simulate_touches(sampler, scene, 1, np.random.default_rng(5), 1e-9)


@pytest.mark.parametrize("press_m", [None, 0.00013, 0.0015])
def test_the_noise_level_none_gives_clean_touches(make_scene, pinhole, box, sampler, press_m):
    scene = make_scene(box, pinhole)
    a, b = (
        simulate_touches(sampler, scene, 6, np.random.default_rng(7), press_m, noise) for noise in (None, NOISE["none"])
    )
    for x, y in zip(a, b, strict=True):
        pressed = scene.press(press_m or pinhole.max_depth_m)
        clean = pressed.render_contact_depths(x.T_sensor_object[None])[0]
        assert x.contact_shape.depth_m.tobytes() == y.contact_shape.depth_m.tobytes() == clean.tobytes()
        assert x.press_depth_m == y.press_depth_m == (press_m or pinhole.max_depth_m)
        assert np.array_equal(x.T_sensor_object, y.T_sensor_object)


@pytest.mark.parametrize("level", ["mild", "strong"])
def test_noisy_touches_have_enough_contact_and_mostly_the_same_poses(make_scene, pinhole, box, sampler, level):
    scene = make_scene(box, pinhole)
    clean = simulate_touches(sampler, scene, 12, np.random.default_rng(8))
    noisy, again = (
        simulate_touches(sampler, scene, 12, np.random.default_rng(8), None, NOISE[level]) for _ in range(2)
    )
    least = sampler.options.min_contact_percent / 100 * pinhole.observed_mask.sum()
    same = 0
    for a, b, c in zip(noisy, again, clean, strict=True):
        assert a.contact_shape.depth_m.tobytes() == b.contact_shape.depth_m.tobytes()
        assert a.press_depth_m == b.press_depth_m
        assert (a.contact_shape.contact & pinhole.observed_mask).sum() >= least
        assert a.contact_shape.depth_m.max() <= np.float32(a.press_depth_m)
        assert not np.array_equal(a.contact_shape.depth_m, c.contact_shape.depth_m)
        same += any(
            np.array_equal(a.T_sensor_object[:2], t.T_sensor_object[:2]) for t in clean
        )  # equal up to z, which depends on the press
    assert same > 0
    assert len({touch.press_depth_m for touch in noisy}) > 6
    assert len({touch.name for touch in noisy}) == 12


def test_a_given_press_is_measured_with_an_error(make_scene, pinhole, box, sampler):
    """A press measured as deeper shows no more contact; one measured as lighter is cut at that depth."""
    scene, noise = make_scene(box, pinhole), TouchNoise(press_error=0.2)
    touches = simulate_touches(sampler, scene, 20, np.random.default_rng(9), 0.001, noise)
    measured = np.array([touch.press_depth_m for touch in touches])
    assert measured.min() < 0.00095
    assert measured.max() > 0.00105
    for touch in touches:
        clean = scene.press(0.001, 0.002).render_contact_depths(touch.T_sensor_object[None])[0]
        assert np.array_equal(touch.contact_shape.contact, clean < np.float32(min(0.001, touch.press_depth_m)))
        shown = touch.contact_shape.contact
        assert np.array_equal(touch.contact_shape.depth_m[shown], clean[shown])


def test_a_misplaced_sensor_does_not_see_the_true_pose(make_scene, pinhole, box, sampler):
    scene = make_scene(box, pinhole)
    clean = simulate_touches(sampler, scene, 8, np.random.default_rng(10))
    shifted = simulate_touches(sampler, scene, 8, np.random.default_rng(10), None, TouchNoise(sensor_m=1e-3))
    same = [(a, b) for a in clean for b in shifted if np.array_equal(a.T_sensor_object, b.T_sensor_object)]
    assert len(same) >= 6  # a misplaced sensor may miss an edge, and another touch is drawn
    for _, b in same:
        assert b.contact_shape.depth_m.min() < 2e-5  # brought to contact again
    overlap = [a.contact_shape.contact_iou(b.contact_shape, pinhole.observed_mask) for a, b in same]
    assert 0.3 < np.mean(overlap) < 0.98


def test_noise_that_removes_all_contact_is_refused(make_scene, pinhole, box, sampler, monkeypatch):
    monkeypatch.setattr(simulation, "MOST_ROUNDS", 3)
    with pytest.raises(TouchError, match="box"):
        simulate_touches(
            sampler, make_scene(box, pinhole), 2, np.random.default_rng(11), None, TouchNoise(least_m=0.01)
        )


def test_spurious_contact_alone_gives_no_touch(make_scene, pinhole, box, sampler):
    """Missing patches remove all contact of some touches; spurious patches do not make them touches again."""
    scene, noise = make_scene(box, pinhole), TouchNoise(missing=3.0, spurious=20.0, patch_m=0.008)
    for touch in simulate_touches(sampler, scene, 20, np.random.default_rng(12), None, noise):
        clean = scene.render_contact_depths(touch.T_sensor_object[None])[0] < np.float32(pinhole.max_depth_m)
        least = sampler.options.min_contact_percent / 100 * pinhole.observed_mask.sum()
        assert (touch.contact_shape.contact & clean & pinhole.observed_mask).sum() >= least
