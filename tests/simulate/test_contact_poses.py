import dataclasses

import numpy as np
import pytest
import trimesh
from message_helpers import naming

from tactile_loc import PoseGrid, load_object
from tactile_loc.core.sensing.contact import find_lowest_points
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.plugin import GridError
from tactile_loc.plugin.helpers import is_rigid, make_transform, make_translation, rotation_about
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.simulate.contact_poses import (
    draw_contact_poses,
    draw_contacts,
    make_contact_grid,
    mark_contact,
    mark_touches,
)


def face(spacing_mm: float, side: str = "+z", **options) -> FaceGrid:
    return FaceGrid(FaceGrid.Options(spacing_mm=spacing_mm, face=side, **options))


class Fixed(FaceGrid):
    """Return the same poses for any spacing."""

    def __init__(self, poses: np.ndarray) -> None:
        super().__init__(FaceGrid.Options(spacing_mm=3.0))
        self.poses = poses

    def sample(self, obj, geometry, spacing_m):
        return self.poses

    def random(self, obj, geometry, count, rng):
        return self.poses[rng.integers(len(self.poses), size=count)]


@pytest.mark.parametrize("name", ["pin", "head", "hook"])
@pytest.mark.parametrize("spacing_mm", [4.0, 6.0])
def test_the_grid_has_the_requested_spacing(make_scene, pinhole, name, spacing_mm):
    """Contact moves poses along z, mostly on a tilted or curved face; the spacing is still right."""
    grid = make_contact_grid(face(spacing_mm, "auto"), make_scene(load_object(name), pinhole))
    assert grid.neighbour_spacing().mean() == pytest.approx(spacing_mm * 1e-3, rel=0.05)


class Wider(FaceGrid):
    """Sample with a larger spacing than requested, as contact causes on a steep surface."""

    def sample(self, obj, geometry, spacing_m):
        return super().sample(obj, geometry, 1.3 * spacing_m)


def test_a_sampler_with_too_wide_spacing_is_called_again(make_scene, pinhole, box):
    grid = make_contact_grid(Wider(FaceGrid.Options(spacing_mm=4.0, face="+z")), make_scene(box, pinhole))
    assert grid.neighbour_spacing().mean() == pytest.approx(0.004, rel=0.05)


def test_fixed_tilt_steps_do_not_affect_the_spacing(make_scene, pinhole, box):
    """Tilts closer than the spacing must not cause a coarser lattice of x and y."""
    scene = make_scene(box, pinhole)
    tilted = make_contact_grid(face(4.0, tilt_deg=6.0), scene)
    R, x_m = tilted.T_sensor_object[:, :3, :3], tilted.T_sensor_object[:, 0, 3]
    of_one_rotation = np.unique(x_m[(R[0] == R).all(axis=(1, 2))].round(9))
    assert np.diff(of_one_rotation).min() == pytest.approx(0.004, rel=1e-6)
    assert len(tilted) > 7 * len(make_contact_grid(face(4.0), scene))


def test_poses_without_contact_are_dropped(make_scene, flat_camera, box):
    beside = make_translation([0.05, 0.0, 0.0])
    poses = np.stack([np.eye(4), beside, make_translation([0.005, 0, 0])])
    grid = make_contact_grid(Fixed(poses), make_scene(box, flat_camera))
    assert len(grid) == 2
    assert grid.T_sensor_object[:, 0, 3].tolist() == [0.0, 0.005]
    assert len(make_contact_grid(Fixed(np.eye(4)[None]), make_scene(box, flat_camera))) == 1


def test_a_grid_without_contact_is_refused(make_scene, flat_camera, box):
    scene = make_scene(box, flat_camera)
    nowhere = Fixed(make_translation([[0.05, 0.0, 0.0], [0.06, 0.0, 0.0]]))
    with pytest.raises(GridError, match="box"):
        make_contact_grid(nowhere, scene)
    with pytest.raises(GridError, match=naming("box", "0.25 %", "grid.min_contact_percent")):
        draw_contact_poses(nowhere, scene, 1, np.random.default_rng(0))


def test_symmetric_duplicates_are_removed(make_scene, flat_camera, make_box):
    half_turn = make_transform(rotation_about([0, 0, 1], np.pi), np.zeros(3))
    poses = np.stack([np.eye(4), half_turn, make_translation([0.005, 0, 0])])
    kept = {
        symmetry: len(
            make_contact_grid(Fixed(poses), make_scene(make_box(0.02, 0.01, 0.01, symmetry=symmetry), flat_camera))
        )
        for symmetry in ("none", "z2", "x2")
    }
    assert kept == {"none": 3, "z2": 2, "x2": 3}


def test_rotational_symmetry_reduces_the_yaws_of_a_face(make_scene, pinhole, make_object):
    def grid(symmetry: str) -> PoseGrid:
        return make_contact_grid(
            face(4.0), make_scene(make_object(trimesh.creation.cylinder(0.012, 0.01, sections=36), symmetry), pinhole)
        )

    alone, six, any_turn = grid("none"), grid("z6"), grid("zinf")
    assert len(six) == pytest.approx(len(alone) / 6, rel=0.25)
    across = np.unique(any_turn.T_sensor_object[:, :2, 3].round(6), axis=0)
    assert len(any_turn) == len(across), "each place has one yaw"


@pytest.mark.parametrize("symmetry", ["z2", "zinf"])
def test_no_pose_is_far_from_a_symmetric_grid(make_scene, pinhole, make_object, symmetry):
    solid = (
        trimesh.creation.box([0.02, 0.01, 0.01])
        if symmetry == "z2"
        else trimesh.creation.cylinder(0.01, 0.01, sections=64)
    )
    obj = make_object(solid, symmetry)
    scene = make_scene(obj, pinhole)
    grid = make_contact_grid(face(4.0), scene)
    distance, _ = grid.nearest(draw_contact_poses(face(4.0), scene, 200, np.random.default_rng(0)))
    # In a cubic cell of side s, the corners are 0.87 s from the centre, random places 0.48 s on average.
    assert distance.max() < 1.1 * 0.004
    assert distance.mean() < 0.55 * 0.004


def test_the_least_contact_is_a_share_of_the_observed_pixels(make_scene, flat_camera, box):
    scene = make_scene(box, flat_camera)
    depths = np.full((4, *flat_camera.shape), flat_camera.max_depth_m, np.float32)
    pixels = 60 * 44
    for i, count in enumerate([0, 1, pixels // 10, pixels // 10 - 1]):
        depths[i].ravel()[:count] = 0.0
    assert mark_contact(depths, scene, 0.0).tolist() == [False, True, True, True]
    assert mark_contact(depths, scene, 10.0).tolist() == [False, False, True, False]
    assert not mark_contact(depths, scene, 100.0).any()


def test_the_least_contact_is_what_an_elastic_gel_touches(make_scene, flat_camera):
    """A ball touches half as much of a half-space as a rigid gel would show, and less of an elastic layer."""
    soft = dataclasses.replace(flat_camera, gel=Gel(1.0))
    y, x = np.mgrid[: soft.height_px, : soft.width_px]
    r2_m2 = ((x - soft.cx) / soft.fx) ** 2 + ((y - soft.cy) / soft.fy) ** 2
    depths = np.minimum(r2_m2 / (2 * 3e-3), soft.max_depth_m)[None].astype(np.float32)
    percent = 100 * np.count_nonzero(depths < np.float32(soft.max_depth_m)) / soft.observed_mask.sum()
    rigid, elastic = (make_scene(load_object("pin"), geometry) for geometry in (flat_camera, soft))
    for share, touches in ((0.9, False), (0.6, False), (0.4, True)):
        assert mark_touches(depths, rigid, share * percent).all()
        assert mark_touches(depths, elastic, share * percent).all() == touches
    assert mark_touches(np.full_like(depths, soft.max_depth_m), elastic, 1.0).tolist() == [False]


def test_random_poses_of_an_elastic_gel_touch_enough(make_scene, flat_camera):
    soft = dataclasses.replace(flat_camera, gel=Gel(4e-3))
    hook, sampler = load_object("hook"), face(4.0, "auto", min_contact_percent=10.0)
    drawn = {}
    for name, geometry in (("rigid", flat_camera), ("elastic", soft)):
        scene = make_scene(hook, geometry)
        batches = list(draw_contacts(sampler, scene, 20, np.random.default_rng(3)))
        drawn[name] = np.concatenate([poses for poses, _ in batches])
        depths = np.concatenate([depths for _, depths in batches])
        assert mark_touches(depths, make_scene(hook, soft), 10.0).all() == (name == "elastic")
    assert len(drawn["elastic"]) == len(drawn["rigid"]) == 20


@pytest.mark.parametrize("count", [1, 40, 300])
def test_random_poses_touch_and_have_the_requested_count(make_scene, pinhole, box, count):
    scene = make_scene(box, pinhole)
    poses = draw_contact_poses(face(5.0, min_contact_percent=3.0), scene, count, np.random.default_rng(1))
    assert poses.shape == (count, 4, 4)
    assert is_rigid(poses)
    np.testing.assert_allclose(find_lowest_points(box.mesh, poses, pinhole.rectangle), pinhole.standoff_m, atol=1e-12)
    assert mark_contact(scene.render_contact_depths(poses), scene, 3.0).all()


@pytest.mark.parametrize("spacing_mm", [0.0, -1.0, float("nan")])
def test_an_impossible_spacing_is_refused(make_scene, pinhole, box, spacing_mm):
    sampler = FaceGrid(FaceGrid.Options.model_construct(spacing_mm=spacing_mm, face="+z", tilt_deg=0.0, tilt_steps=3))
    with pytest.raises(GridError, match=naming(f"{spacing_mm:g} mm", "spacing_mm")):
        make_contact_grid(sampler, make_scene(box, pinhole))
