"""Several touches of one object, by sensors at known poses."""

import dataclasses
from collections import Counter
from typing import ClassVar

import numpy as np
import pytest
from locate_helpers import locate_together, measure_errors_mm
from message_helpers import naming

from tactile_loc import HypothesisOptions, Localizer
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.io.config import SlotConfig
from tactile_loc.locate.outliers import require_within_reach
from tactile_loc.locate.result.hypothesis import RefinedBy
from tactile_loc.locate.several_touches import compute_posterior_together, localize_together
from tactile_loc.plugin import ConfigError, GridError, RefinedPose, Refiner, TouchError, registry
from tactile_loc.plugin.helpers import invert, make_transform, make_translation, rotation_about
from tactile_loc.plugins.refiners.icp import IcpRefiner

T_BASE_OBJECT = make_transform(rotation_about([1, 2, 3], 0.7), [0.4, -0.2, 0.3])


def placed(touch, T_base_object=T_BASE_OBJECT):
    """Return the touch with the sensor pose that puts the object at the given pose in the base frame."""
    return dataclasses.replace(touch, T_base_sensor=T_base_object @ invert(touch.T_sensor_object))


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    return Localizer.create("pin", store=store, grid={"name": "face", "spacing_mm": 6})


@pytest.fixture(scope="module")
def touches(localizer):
    return [placed(touch) for touch in localizer.simulate(3, seed=7, noise="mild")]


def error_m(localizer, found) -> float:
    return 1e-3 * measure_errors_mm(localizer, found.best.T_sensor_object[None], found.touch)[0]


def test_more_touches_lower_the_entropy(localizer, touches):
    one, three = (compute_posterior_together([(localizer, t) for t in some]) for some in (touches[:1], touches))
    assert three.entropy < one.entropy
    three = locate_together(localizer, touches)
    assert three.others == tuple(touches[1:])
    assert error_m(localizer, three) < 2e-3
    truth = three.posterior.grid.nearest(touches[0].T_sensor_object[None])[1][0]
    assert three.posterior.probabilities[truth] > 0.05


def test_without_a_search_only_the_given_poses_are_compared(localizer, touches):
    truth = touches[0].T_sensor_object
    starts = np.stack([truth, truth @ make_transform(rotation_about([0, 0, 1], 0.3), [5e-3, 0.0, 0.0])])
    found = localizer.localize(touches, starts=starts, searches=False)
    every = (*found.hypotheses, *found.unlisted)
    assert all(np.isclose(starts, one.T_sensor_object_grid).all(axis=(1, 2)).any() for one in every)
    assert error_m(localizer, found) < 1e-3


def test_the_position_of_the_base_does_not_matter(localizer, touches):
    elsewhere = make_transform(rotation_about([0, 1, 0], 2.0), [1.0, 2.0, -3.0])
    moved = [dataclasses.replace(t, T_base_sensor=elsewhere @ t.T_base_sensor) for t in touches]
    a, b = locate_together(localizer, touches), locate_together(localizer, moved)
    np.testing.assert_allclose(a.posterior.probabilities, b.posterior.probabilities, atol=1e-9)
    poses = (found.best.T_sensor_object[None] for found in (a, b))
    assert (
        localizer.model.grid.metric.symmetric_distance(*poses)[0] < 5e-5
    )  # among equal end poses, any candidate may be chosen


def test_the_refined_pose_fits_all_touches_best(localizer, touches):
    found = locate_together(localizer, touches, top=1).best

    def average_iou(T: np.ndarray) -> float:
        poses = [invert(touch.T_base_sensor) @ touches[0].T_base_sensor @ T for touch in touches]
        seen = zip(poses, touches, strict=True)
        return float(np.mean([localizer.scene.imprint_ious(pose[None], touch)[0] for pose, touch in seen]))

    grid, refined = average_iou(found.T_sensor_object_grid), average_iou(found.T_sensor_object)
    assert refined >= grid
    assert refined - 1e-6 <= found.imprint_iou <= refined + 0.05  # sensor poses may have small errors


def test_sensors_of_different_kinds_can_be_combined(localizer, touches, store):
    other = Localizer.create("pin", store=store, sensor="gelsight-mini", grid={"name": "face", "spacing_mm": 6})
    small = placed(other.simulate(1, seed=6)[0])
    found = localize_together([(localizer, touches[0]), (other, small)])
    np.testing.assert_array_equal(
        found.posterior.grid.T_sensor_object, localizer.listed.press_grid(touches[0]).T_sensor_object
    )
    assert np.isfinite(found.posterior.log_p).any()


def test_touches_that_cannot_be_fused_are_refused(localizer, touches, store):
    with pytest.raises(TouchError):
        localize_together([])
    nowhere = dataclasses.replace(touches[1], T_base_sensor=None)
    with pytest.raises(ConfigError, match=naming("touch 2", "T_base_sensor")):
        locate_together(localizer, [touches[0], nowhere])
    hook = Localizer.create("head", store=store, grid={"name": "face", "spacing_mm": 8})
    with pytest.raises(TouchError, match=naming("pin", "head")):
        localize_together([(localizer, touches[0]), (hook, touches[1])])
    far = dataclasses.replace(touches[1], T_base_sensor=make_transform(np.eye(3), [5.0, 0, 0]))
    with pytest.raises(GridError, match=naming("pin", "37 mm", "T_base_sensor") + r".*[45],\d{3} mm"):
        locate_together(localizer, [touches[0], far])


def test_touches_are_within_reach_if_two_of_them_are(localizer, touches):
    size_m = float(np.linalg.norm(localizer.object.mesh.extents_m))
    x0, x1, y0, y1 = touches[0].geometry.rectangle
    reach_m = size_m + float(np.hypot(x1 - x0, y1 - y0))

    def placed_at(*x_m):
        return [dataclasses.replace(touches[0], T_base_sensor=make_translation([x, 0, 0])) for x in x_m]

    require_within_reach(placed_at(0, 0.99 * reach_m), localizer.object)
    require_within_reach(placed_at(0, 5, 0.01), localizer.object)
    require_within_reach(placed_at(0), localizer.object)
    for x_m in ((0, 1.01 * reach_m), (0, 5, 10)):
        with pytest.raises(GridError, match=naming("pin", "37 mm", "T_base_sensor", "T_sensor_base")):
            require_within_reach(placed_at(*x_m), localizer.object)


class CountingIcp(IcpRefiner):
    """ICP that counts how often it refines poses to each touch."""

    seen: ClassVar[Counter[str]] = Counter()

    def refine_many(self, touch, candidates, scene):
        self.seen[touch.name] += 1
        return super().refine_many(touch, candidates, scene)


class Idle(Refiner):
    """Returns the candidates."""

    def refine(self, touch, candidate, scene):
        T = candidate.T_sensor_object
        return RefinedPose(T.copy(), scene.contact_iou(T, touch), True, 0)


def choose(localizer, refiner: str) -> Localizer:
    """The localizer with another refiner, which refines few poses, for speed."""
    few = HypothesisOptions(refined_together=8)
    chosen = localizer.config.model_copy(update={"refiner": SlotConfig(name=refiner), "hypotheses": few})
    return Localizer(chosen, localizer.object, localizer.store)


@pytest.fixture
def added(monkeypatch):
    """Offer a component under a name during one test."""
    monkeypatch.setattr(registry(), "offers", list(registry().offers))
    return registry().add


@pytest.fixture
def exact(localizer):
    """Three clean touches."""
    named = localizer.simulate(3, seed=7)
    return [dataclasses.replace(placed(touch), name=f"touch {number}") for number, touch in enumerate(named)]


def test_the_chosen_refiner_refines_to_each_of_several_touches(localizer, exact, added):
    added(CountingIcp, "counting-icp")
    CountingIcp.seen.clear()
    found = locate_together(choose(localizer, "counting-icp"), exact)
    assert set(CountingIcp.seen) == {touch.name for touch in exact}
    assert found.refined_by == RefinedBy(None, "counting-icp", "alone", "joint registration")
    assert error_m(localizer, found) < 3e-4


def test_refiners_give_poses_of_their_own(localizer, exact):
    """Both are near the true pose, and not the same."""
    joint, icp = (locate_together(choose(localizer, name), exact) for name in ("joint", "icp"))
    assert max(error_m(localizer, one) for one in (joint, icp)) < 3e-4
    assert not np.allclose(joint.best.T_sensor_object, icp.best.T_sensor_object, rtol=0, atol=1e-7)
    assert icp.best.covariance is not None


def test_an_idle_refiner_leaves_the_poses_of_the_grid(localizer, exact, added):
    added(Idle, "idle")
    found = locate_together(choose(localizer, "idle"), exact)
    for one in found.hypotheses:
        np.testing.assert_array_equal(one.T_sensor_object, one.T_sensor_object_grid)
    assert error_m(localizer, found) > 5e-4


@pytest.mark.parametrize("refiner", ["joint", "icp"])
def test_the_order_of_touches_does_not_matter(localizer, exact, refiner):
    """The grids of different touches propose other poses, but the best of them end at the same pose."""
    chosen = choose(localizer, refiner)
    one, other = (locate_together(chosen, [exact[k] for k in order]) for order in ((0, 1, 2), (2, 0, 1)))
    here, there = (found.best.T_base_object for found in (one, other))
    assert measure_pose_errors(localizer.object, here[None], there)[0] < 5e-5
