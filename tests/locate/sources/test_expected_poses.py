"""The search of several touches with a prior, where a smooth handle looks alike in many places."""

import dataclasses

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import invert, make_transform, make_translation, rotation_about
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import GaussianPrior, HypothesesPrior
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.noise import make_noise
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.evaluation.robot_touches import RobotTouches
from tactile_loc.locate.hypotheses import DOUBT
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.pipeline import is_unexpected
from tactile_loc.locate.result.doubts import list_doubts
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.locate.sources.place_search import choose_expected, draw_expected
from tactile_loc.locate.sources.whole_object import EXPECTED_MODES, FIRST, add_expected_modes, search_together
from tactile_loc.plugin.helpers import bring_to_contact
from tactile_loc.slots.registry import registry

SEEDS = (0, 2, 5)
OPENING_M = 6.6e-3
STD_M, STD_RAD = 5e-3, np.radians(10)


@pytest.fixture(scope="module")
def handle(store, tmp_path_factory) -> Localizer:
    path = tmp_path_factory.mktemp("handle") / "handle.ply"
    shank = trimesh.creation.box((0.009, 0.009, 0.028), make_transform(np.eye(3), np.array([0, 0, -0.03])))
    whole = trimesh.boolean.union([trimesh.creation.cylinder(0.007, 0.04, sections=64), shank], engine="manifold")
    groove = trimesh.creation.box((0.003, 0.003, 0.05), make_transform(np.eye(3), np.array([0.007, 0, 0.002])))
    trimesh.boolean.difference([whole, groove], engine="manifold").export(path)
    sensor = {"name": "gelsight-mini", "options": {"gel": "layer"}}
    return Localizer.create(path, units="m", sensor=sensor, tolerance="0.5mm,2deg", store=store)


def grip(localizer: Localizer, seed: int) -> tuple[np.ndarray, list[Touch]]:
    """Return T_world_object, near the identity, and the touches of two gels that face each other."""
    rng, gel = np.random.default_rng(seed), localizer.sensor.geometry
    R = rotation_about([0, 1, 0], rng.uniform(-0.2, 0.2)) @ rotation_about([0, 0, 1], rng.uniform(-0.3, 0.3))
    T_world_object = make_transform(R, np.array([rng.uniform(-5e-3, 5e-3), 0, rng.uniform(-5e-3, 5e-3)]))
    renderer = registry().create("renderer", "zbuffer", {})
    robot, touches = RobotTouches(localizer.object, gel, renderer, noise=make_noise("mild")), []
    for side in (-1, 1):
        x, z = np.array([0.0, 0, 1]), np.array([0.0, -side, 0])
        T_world_sensor = make_transform(np.stack([x, np.cross(z, x), z], axis=1), -z * (OPENING_M + gel.surface_m))
        T = invert(T_world_sensor) @ T_world_object
        contact, _ = bring_to_contact(localizer.object.mesh, T[None], gel)
        touch = robot.draw_touch(T, float(contact[0, 2, 3] - T[2, 3]), f"gel{side}", rng)
        touches.append(dataclasses.replace(touch, T_base_sensor=T_world_sensor))
    return T_world_object, touches


@pytest.fixture(scope="module")
def grips(handle) -> list[tuple[np.ndarray, list[Touch], GaussianPrior]]:
    """Return, for each seed, the true pose in the first sensor's frame, the touches, and the prior about this pose."""
    found = []
    for seed in SEEDS:
        T_world_object, touches = grip(handle, seed)
        T_world_sensor = np.asarray(touches[0].T_base_sensor)
        prior = GaussianPrior(np.eye(4), STD_M, STD_RAD).view_from(T_world_sensor)
        found.append((invert(T_world_sensor) @ T_world_object, touches, prior))
    return found


@pytest.mark.slow
def test_poses_that_a_prior_favours_are_registered(handle, grips):
    for truth, touches, prior in grips:
        views = handle.make_views(touches)
        (alone, ious_alone), (guided, ious) = (
            search_together(views, [handle.source.place_search] * 2, StageTimes(), p) for p in (None, prior)
        )
        explained = guided[ious.mean(axis=1) > ious.mean(axis=1).max() - 0.1]
        assert prior(explained).max() > prior(truth[None])[0] - 0.5
        assert prior(alone).max() < prior(explained).max()
        # the prior takes no pose away from the touches
        assert ious.mean(axis=1).max() > ious_alone.mean(axis=1).max() - 0.01


@pytest.mark.slow
def test_a_wrong_pose_far_from_the_prior_is_not_certain(handle, grips):
    for truth, touches, prior in grips:
        found = localize_together([(handle, touch) for touch in touches], prior)
        within = handle.config.tolerance.find_within(handle.object, truth, found.best.T_sensor_object[None])[0]
        assert within or found.verdict is not Verdict.CERTAIN
        assert found.best.prior_nats > prior(truth[None])[0] - 1.0


def test_the_poses_that_a_prior_favours_are_refined_unless_the_touches_exclude_them(handle):
    poses = np.stack([make_translation([k * 1e-2, 0, 0]) for k in range(20)])
    prior = GaussianPrior(poses[19], 5e-2, 0.5)
    evidence = np.zeros(20)
    evidence[19] = -2 * DOUBT  # the touches exclude the prior's peak, but not the poses beside it
    posterior = PosePosterior(PoseGrid(poses, PoseMetric(handle.object)), evidence + prior(poses))
    modes = [Mode(k, 0.1, poses[k], np.array([k])) for k in range(10)]
    added = add_expected_modes(modes, posterior, prior, 1e-3)
    assert [mode.index for mode in added] == [*range(FIRST), *range(18, 18 - EXPECTED_MODES, -1), 8, 9]
    assert add_expected_modes(modes, posterior, None, 1e-3) == modes
    known = add_expected_modes([*modes, Mode(18, 0.1, poses[18], np.array([18]))], posterior, prior, 1e-3)
    assert [mode.index for mode in known].count(18) == 1


def test_a_pose_that_explains_nothing_is_not_chosen_by_the_prior(handle):
    poses = np.stack([make_translation([k * 1e-2, 0, 0]) for k in range(4)])
    grid, prior = PoseGrid(poses, PoseMetric(handle.object)), GaussianPrior(poses[3], 5e-3, 0.1)
    ious = np.array([0.9, 0.85, 0.75, 0.0])
    assert choose_expected(grid, ious, prior, 1e-3, 3).tolist() == [2, 1, 0]


def test_nothing_is_drawn_around_a_flat_prior():
    T = make_translation([0, 0, 1e-2])
    assert len(draw_expected(lambda poses: np.zeros(len(poses)), T, np.zeros(3))) == 0
    drawn = draw_expected(GaussianPrior(make_translation([2e-3, 0, 1e-2]), 1e-3, 0.1), T, np.zeros(3))
    assert drawn[0, :3, 3] == pytest.approx([2e-3, 0, 1e-2], abs=1e-5)
    assert len(np.unique(drawn[:, 0, 3])) == len(drawn)


def test_poses_are_drawn_around_each_listed_pose():
    listed = make_translation([[2e-3, 0, 1e-2], [5e-2, 0, 1e-2], [0, 9e-2, 1e-2]])
    prior = HypothesesPrior(tuple(GaussianPrior(one, 1e-3, 0.1) for one in listed), np.full(3, 1 / 3))
    drawn = draw_expected(prior, make_translation([0, 0, -1.0]), np.zeros(3))[:, :3, 3]
    near = np.linalg.norm(drawn[:, None] - listed[:, :3, 3], axis=2) < 6e-3
    assert (near.sum(axis=0) >= 16).all()
    assert near.any(axis=1).all()


def test_a_pose_contradicts_a_prior_that_makes_it_very_improbable():
    T = make_translation([0, 0, 1e-2])
    for shift_m, expected in ((4e-3, False), (7e-3, True)):  # 4 and 7 standard deviations
        assert is_unexpected(GaussianPrior(make_translation([0, shift_m, 1e-2]), 1e-3, 0.1), T, np.zeros(3)) is expected
    assert not is_unexpected(None, T, np.zeros(3))
    assert not is_unexpected(lambda poses: np.full(len(poses), -50.0), T, np.zeros(3))


@pytest.mark.slow
def test_touches_that_contradict_a_prior_are_not_certain(store, tmp_path):
    localizer = Localizer.create("pin", store=store)
    touches = localizer.simulate_together(3, seed=2)
    observations = [(localizer, touch) for touch in touches]
    truth = np.asarray(touches[0].T_sensor_object)
    right, wrong = (
        localize_together(observations, GaussianPrior(make_translation([shift_m, 0, 0]) @ truth, 1e-3, 0.1))
        for shift_m in (0.0, 0.02)
    )
    assert right.verdict is Verdict.CERTAIN
    assert not right.unexpected
    assert wrong.unexpected
    assert wrong.verdict is not Verdict.CERTAIN
    wrong.save(tmp_path)
    loaded = Localization.load(tmp_path)
    assert loaded.unexpected
    assert loaded.verdict is wrong.verdict
    assert len(list_doubts(wrong)) == len(list_doubts(dataclasses.replace(wrong, unexpected=False))) + 1
