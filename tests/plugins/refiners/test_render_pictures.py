from __future__ import annotations

import numpy as np
import pytest

from tactile_loc.core.contact import bring_to_contact
from tactile_loc.core.geometry import transform_points
from tactile_loc.plugins.refiners.render_pictures import Pictures, within_reach
from tactile_loc.testing.problems import CAMERAS, pressed_block


@pytest.fixture(params=list(CAMERAS))
def problem(request):
    return pressed_block(request.param)


def pictures(problem, width_m: float = 0.0, in_contact: bool = False) -> Pictures:
    touch = problem.touch
    return Pictures.blurred(problem.scene.object.mesh, touch.geometry, touch.contact_shape, width_m, in_contact)


def test_a_sharp_picture_is_the_imprint_as_a_share_of_the_press(problem):
    shape = problem.touch.contact_shape
    expected = 1 - shape.depth_m / shape.press_depth_m
    np.testing.assert_allclose(pictures(problem).of_touch().reshape(shape.depth_m.shape), expected, atol=1e-6)


def test_the_true_pose_makes_the_touchs_picture(problem):
    for width_m in (0.0, 0.5e-3, 1.5e-3):
        p = pictures(problem, width_m)
        seen, drawn = p.of_poses(problem.truth[None])
        assert np.array_equal(drawn[0], problem.truth)
        assert (np.abs(seen[0] - p.of_touch()) > 1e-4).mean() < 0.002  # a pixel's centre may lie on an edge


def test_a_blur_keeps_the_imprints_volume_and_place(problem):
    sharp, blurred = pictures(problem), pictures(problem, 2e-3)
    assert blurred.pixel_m > 2 * sharp.pixel_m
    h, w = (side // blurred.block for side in blurred.geometry.shape)
    volumes, centres = [], []
    for p, shape in ((sharp, sharp.geometry.shape), (blurred, (h, w))):
        picture = p.of_touch().reshape(shape).astype(float)
        u = (np.arange(shape[1]) + 0.5) * p.pixel_m
        volumes.append(picture.sum() * p.pixel_m**2)
        centres.append((picture.sum(axis=0) * u).sum() / picture.sum())
    assert volumes[1] == pytest.approx(volumes[0], rel=0.03)
    assert centres[1] == pytest.approx(centres[0], abs=sharp.pixel_m)


def test_a_rotation_turns_about_the_contacts_centre(problem):
    p = pictures(problem)
    moves = np.zeros((3, 6))
    moves[:, 3:] = 2.0 * np.eye(3)
    inverse = np.linalg.inv(problem.truth)
    for T in p.moved(np.repeat(problem.truth[None], 3, axis=0), moves):
        centre = transform_points(T @ inverse, p.centre_m[None])[0]
        np.testing.assert_allclose(centre, p.centre_m, atol=1e-12)
        assert not np.allclose(T, problem.truth)


def test_in_contact_z_follows_and_is_no_direction_of_its_own(problem):
    p = pictures(problem, in_contact=True)
    assert p.directions.shape == (5, 6)
    assert (p.directions[:, 2] == 0).all()
    lifted = problem.truth.copy()
    lifted[2, 3] += 0.003
    seen, drawn = p.of_poses(lifted[None])
    np.testing.assert_allclose(drawn[0], problem.truth, atol=1e-9)
    assert (np.abs(seen[0] - p.of_touch()) > 1e-4).mean() < 0.002


def test_what_is_out_of_reach_makes_no_difference(problem):
    mesh, g = problem.scene.object.mesh, problem.touch.geometry
    part = within_reach(mesh, g, problem.truth[None])
    assert 0 < len(part.faces) < len(mesh.faces)
    p = pictures(problem)
    whole = p.of_poses(problem.truth[None])[0]
    near = Pictures.blurred(part, g, problem.touch.contact_shape, 0.0, False).of_poses(problem.truth[None])[0]
    np.testing.assert_array_equal(whole, near)
    np.testing.assert_array_equal(*(bring_to_contact(m, problem.truth[None], g)[0] for m in (mesh, part)))
