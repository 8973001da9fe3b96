"""A slide's true poses and presses agree: at its true pose, the object presses the gel by the stated press."""

import numpy as np
import pytest

from tactile_loc import Recording, decode_image
from tactile_loc.core.sensing.contact import find_lowest_points
from tactile_loc.core.sensing.noise import NOISE
from tactile_loc.evaluation.slides import FLANGE, GEL, Photos, Slide, draw_slide, write_slide
from tactile_loc.plugin import TouchError
from tactile_loc.plugin.helpers import contact_shape_from_array, make_transform, rotation_about
from tactile_loc.sensors.optics.lamps import OPTICS

START = make_transform(rotation_about([1, 2, 0], 0.6), [0.001, 0.0, 0.02])
IMAGES = 25


@pytest.fixture(scope="module")
def over_a_box(make_scene, box, flat_camera) -> Slide:
    return draw_slide(make_scene(box, flat_camera), START, IMAGES)


def test_the_object_is_pressed_to_the_stated_depth(over_a_box, box, flat_camera):
    lowest = find_lowest_points(box.mesh, over_a_box.T_sensor_object, flat_camera.rectangle)
    np.testing.assert_allclose(lowest, flat_camera.standoff_m - over_a_box.press_m, atol=1e-12)
    assert over_a_box.press_m.max() <= 0.9 * flat_camera.max_depth_m


def test_all_images_but_the_first_and_the_last_show_contact(over_a_box, flat_camera):
    for k, number in enumerate(over_a_box.frames):
        depth, press_m = over_a_box.draw_depths_m(number), over_a_box.press_m[number]
        shape = contact_shape_from_array(depth, flat_camera.max_depth_m)
        assert shape.contact.any() == (0 < k < IMAGES - 1)
        if press_m > 0:
            assert shape.press_depth_m == pytest.approx(press_m, abs=2e-6)


def test_noise_depends_on_the_seed_and_the_image(make_scene, box, flat_camera, over_a_box):
    noisy, same, other = (
        draw_slide(make_scene(box, flat_camera), START, IMAGES, NOISE["mild"], seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(noisy.draw_depths_m(20), same.draw_depths_m(20))
    assert (noisy.draw_depths_m(20) != other.draw_depths_m(20)).any()
    assert (noisy.draw_depths_m(20) != over_a_box.draw_depths_m(20)).any()
    np.testing.assert_array_equal(noisy.T_sensor_object, over_a_box.T_sensor_object)


def test_photos_are_colour_images_of_the_sensors_size(over_a_box, flat_camera, tmp_path):
    path = write_slide(tmp_path / "slide.mcap", over_a_box, Photos(flat_camera, OPTICS["digit"], 0))
    recording = Recording(path)
    photos = [decode_image(message.decode()) for message in recording.read_messages("/gel/image")]
    assert {photo.shape for photo in photos} == {(*flat_camera.shape, 3)}
    moved = np.abs(photos[12].astype(int) - photos[0]).max()
    assert moved > 20  # counts: a press, no noise
    assert recording.read_frame_tree().look_up(FLANGE, GEL, 0).shape == (4, 4)


def test_an_object_that_slides_off_is_refused(make_scene, box, flat_camera):
    beside = START.copy()
    beside[0, 3] = 0.03
    with pytest.raises(TouchError, match="box"):
        draw_slide(make_scene(box, flat_camera), beside, IMAGES)
