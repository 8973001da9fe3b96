import dataclasses

import numpy as np
import pytest
import trimesh

from tactile_loc import PoseMetric, SensorGeometry
from tactile_loc.plugin import Candidate, Scene
from tactile_loc.plugin.helpers import bring_to_contact, make_transform, make_translation, rotation_about
from tactile_loc.plugins.refiners.render.pictures import Pictures, keep_within_reach
from tactile_loc.plugins.refiners.render.refiner import RenderRefiner
from tactile_loc.testing.problems import (
    CAMERAS,
    ReferenceRenderer,
    make_planar_pose,
    make_touch,
    press_block,
    replace_depth,
)

TILT = make_transform(rotation_about([1.0, 0.4, 0.0], np.radians(2.0)), np.zeros(3))


@pytest.fixture(scope="module", params=list(CAMERAS))
def problem(request):
    return press_block(request.param)


@pytest.fixture(scope="module")
def refiner() -> RenderRefiner:
    return RenderRefiner()


def tilted(problem) -> Candidate:
    """The true pose with errors along the surface, in yaw, and with a tilt of two degrees."""
    T = problem.make_candidate((0.0009, -0.0007, np.radians(4.0))).T_sensor_object @ TILT
    return Candidate(problem.scene.bring_to_contact(T[None])[0][0], 0, 0.0)


def test_an_offset_in_all_directions_is_undone_to_a_fraction_of_a_pixel(refiner, problem):
    candidate = tilted(problem)
    refined = refiner.refine(problem.touch, candidate, problem.scene)
    assert problem.measure_error_m(candidate) > 1e-3
    assert problem.measure_error_m(refined) < 0.05 * problem.touch.geometry.pixel_pitch_m
    assert refined.converged
    assert refined.contact_iou > 0.99
    assert refined.iterations > 3


def test_a_contact_at_the_border_does_not_shift_the_pose(refiner, problem):
    """The sensor's edge cuts the contact; this must not pull the pose inwards."""
    x0, x1, _, _ = problem.scene.geometry.rectangle
    truth = problem.scene.bring_to_contact(make_planar_pose(0.42 * (x1 - x0), 0.001, 0.4)[None])[0][0]
    cut = dataclasses.replace(problem, truth=truth, touch=make_touch(problem.scene, truth, 0.002))
    assert cut.touch.contact_shape.contact[:, -1].any()
    candidate = cut.make_candidate((-0.0008, 0.0006, np.radians(3.0)))
    refined = refiner.refine(cut.touch, candidate, cut.scene)
    assert cut.measure_error_m(refined) < 0.1 * cut.touch.geometry.pixel_pitch_m


def test_undetermined_directions_keep_the_candidate(refiner):
    """A bar crosses the whole sensor: the candidate moves across the bar, and stays along it."""
    bar = trimesh.creation.box([0.3, 0.006, 0.01])
    g = SensorGeometry("orthographic", 80, 80, 4000.0, 4000.0, 40.0, 40.0, 0.02, 0.001)
    block = press_block("orthographic")
    mesh = dataclasses.replace(block.scene.object.mesh, vertices_m=np.array(bar.vertices), faces=np.array(bar.faces))
    scene = Scene(dataclasses.replace(block.scene.object, mesh=mesh), g, ReferenceRenderer())
    truth = scene.bring_to_contact(np.eye(4)[None])[0][0]
    touch = make_touch(scene, truth, 0.001)
    candidate = Candidate(make_translation([0.004, 0.001, 0.0]) @ truth, 0, 0.0)
    moved = refiner.refine(touch, candidate, scene).T_sensor_object[:3, 3] - candidate.T_sensor_object[:3, 3]
    assert abs(moved[0]) < 2e-5
    assert moved[1] == pytest.approx(-0.001, abs=0.5 * g.pixel_pitch_m)  # edges along the rows give no better accuracy


def test_spurious_and_missing_contact_hardly_shift_the_pose(refiner, problem):
    depth = problem.touch.contact_shape.depth_m.copy()
    depth[4:10, 48:56] = 0.3 * problem.touch.press_depth_m
    middle = np.argwhere(problem.touch.contact_shape.contact).mean(axis=0).astype(int)
    depth[middle[0] : middle[0] + 4, middle[1] : middle[1] + 4] = problem.touch.press_depth_m
    refined = refiner.refine(replace_depth(problem.touch, depth), tilted(problem), problem.scene)
    assert problem.measure_error_m(refined) < 0.15 * problem.touch.geometry.pixel_pitch_m


def test_a_refined_pose_never_explains_the_touch_worse_than_the_candidate(refiner, problem):
    rng = np.random.default_rng(0)
    candidates = [
        problem.make_candidate((*rng.uniform(-0.006, 0.006, 2), rng.uniform(-np.pi, np.pi))) for _ in range(12)
    ]
    refined = refiner.refine_many(problem.touch, candidates, problem.scene)
    before, after = (
        problem.scene.imprint_ious(np.stack([p.T_sensor_object for p in poses]), problem.touch)
        for poses in (candidates, refined)
    )
    assert (after >= before - 1e-9).all()
    assert (after > before + 0.05).any()


def test_the_noise_correlation_limits_the_motion_for_noisy_touches_only(problem):
    """A larger correlation length of the noise reduces the motion for a noisy touch, but not for a clean one."""
    rng = np.random.default_rng(5)
    depth, press = problem.touch.contact_shape.depth_m, problem.touch.press_depth_m
    rough = depth + rng.normal(0, 4e-4, depth.shape)
    noisy = replace_depth(problem.touch, np.where(depth < press, np.clip(rough, 0, 0.999 * press), press).astype("f4"))
    candidate = problem.make_candidate((0.0009, 0.0, 0.0))
    loose, firm = (RenderRefiner(RenderRefiner.Options(patch_mm=mm)) for mm in (0.0, 40.0))
    moved = [
        PoseMetric(problem.scene.object).distance(
            candidate.T_sensor_object, refiner.refine(noisy, candidate, problem.scene).T_sensor_object
        )
        for refiner in (loose, firm)
    ]
    assert moved[1] < 0.8 * moved[0]
    assert problem.measure_error_m(firm.refine(problem.touch, candidate, problem.scene)) < 5e-5


def pictures(problem, width_m: float = 0.0, in_contact: bool = False) -> Pictures:
    touch = problem.touch
    return Pictures.blurred(problem.scene.object.mesh, touch.geometry, touch.contact_shape, width_m, in_contact)


def test_pictures_equal_the_renderings_of_the_scene():
    problem = press_block("pinhole")
    p, press_m = pictures(problem), problem.touch.press_depth_m
    expected = 1 - problem.scene.render_contact_depths(problem.truth[None], press_m) / press_m
    seen = p.draw_poses(problem.truth[None])[0].reshape(expected.shape)
    assert (np.abs(seen - expected) > 1e-4).mean() < 0.002


def test_a_blur_keeps_the_volume_and_position_of_the_imprint(problem):
    sharp, blurred = pictures(problem), pictures(problem, 2e-3)
    assert blurred.pixel_m > 2 * sharp.pixel_m
    h, w = (side // blurred.block for side in blurred.geometry.shape)
    volumes, centres = [], []
    for p, shape in ((sharp, sharp.geometry.shape), (blurred, (h, w))):
        picture = p.draw_touch().reshape(shape).astype(float)
        u = (np.arange(shape[1]) + 0.5) * p.pixel_m
        volumes.append(picture.sum() * p.pixel_m**2)
        centres.append((picture.sum(axis=0) * u).sum() / picture.sum())
    assert volumes[1] == pytest.approx(volumes[0], rel=0.03)
    assert centres[1] == pytest.approx(centres[0], abs=sharp.pixel_m)


def test_z_follows_from_contact_and_is_not_a_free_direction(problem):
    p = pictures(problem, in_contact=True)
    assert p.directions.shape == (5, 6)
    assert (p.directions[:, 2] == 0).all()
    lifted = problem.truth.copy()
    lifted[2, 3] += 0.003
    seen, drawn = p.draw_poses(lifted[None])
    np.testing.assert_allclose(drawn[0], problem.truth, atol=1e-9)
    assert (np.abs(seen[0] - p.draw_touch()) > 1e-4).mean() < 0.002


def test_faces_out_of_reach_do_not_change_the_picture(problem):
    mesh, g = problem.scene.object.mesh, problem.touch.geometry
    part = keep_within_reach(mesh, g, problem.truth[None])
    assert 0 < len(part.faces) < len(mesh.faces)
    p = pictures(problem)
    whole = p.draw_poses(problem.truth[None])[0]
    near = Pictures.blurred(part, g, problem.touch.contact_shape, 0.0, False).draw_poses(problem.truth[None])[0]
    np.testing.assert_array_equal(whole, near)
    np.testing.assert_array_equal(*(bring_to_contact(m, problem.truth[None], g)[0] for m in (mesh, part)))
