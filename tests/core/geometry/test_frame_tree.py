"""Frames over time: chains, both directions, interpolation, and errors for missing transforms."""

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.geometry.frame_tree import FrameTree, interpolate
from tactile_loc.core.geometry.rigid import draw_rotations, invert, make_transform, rotation_about
from tactile_loc.core.runtime.errors import FrameError

S = 1_000_000_000
A = make_transform(rotation_about([1, 2, 3], 0.5), [0.1, 0.2, 0.3])
B = make_transform(rotation_about([0, 1, 0], -1.2), [0.0, 0.5, -0.2])


@pytest.fixture
def tree() -> FrameTree:
    """base -> arm (fixed) -> tool, which rotates about z at 1 rad/s and moves along x at 1 m/s; base -> camera."""
    tree = FrameTree()
    tree.add("base", "arm", 0, A, fixed=True)
    for k in (0, 2, 1, 3):  # times are not in order
        tree.add("arm", "tool", k * S, make_transform(rotation_about([0, 0, 1], float(k)), [float(k), 0, 0]))
    tree.add("base", "camera", 0, B, fixed=True)
    return tree


def test_chained_transforms_are_multiplied_and_interpolated(tree):
    at = make_transform(rotation_about([0, 0, 1], 1.25), [1.25, 0, 0])
    np.testing.assert_allclose(tree.look_up("base", "tool", 1_250_000_000), A @ at, atol=1e-12)
    np.testing.assert_allclose(tree.look_up("camera", "tool", 1_250_000_000), invert(B) @ A @ at, atol=1e-12)
    np.testing.assert_allclose(
        tree.look_up("tool", "camera", 3 * S), invert(tree.look_up("camera", "tool", 3 * S)), atol=1e-12
    )
    np.testing.assert_allclose(tree.look_up("tool", "tool", 99 * S), np.eye(4))


def test_interpolation_follows_a_screw_of_constant_rate():
    rng = np.random.default_rng(0)
    first, second = (make_transform(R, rng.normal(size=3)) for R in draw_rotations(2, rng))
    np.testing.assert_allclose(interpolate(first, second, 0.0), first, atol=1e-12)
    np.testing.assert_allclose(interpolate(first, second, 1.0), second, atol=1e-12)
    half = interpolate(first, second, 0.5)
    np.testing.assert_allclose(interpolate(half, second, 0.5), interpolate(first, second, 0.75), atol=1e-9)
    np.testing.assert_allclose(half[:3, 3], (first[:3, 3] + second[:3, 3]) / 2)


def test_only_frames_on_the_path_must_be_known(tree):
    tree.add("arm", "finger", 0, A)
    np.testing.assert_allclose(
        tree.look_up("arm", "tool", 2 * S)[:3, 3], [2, 0, 0]
    )  # the finger has no transform at that time


def test_a_missing_transform_is_named(tree):
    for lookup, mentioned in (
        (("base", "tol", S), ("'tol'", "arm", "base", "camera", "'tool'")),
        (("base", "tool", 4 * S), ("tool", "arm", "0.000 s", "3.000 s", "4.000 s")),
        (("base", "tool", -1), ("tool", "-0.000 s")),
    ):
        with pytest.raises(FrameError, match=naming(*mentioned)):
            tree.look_up(*lookup)
    tree.add("moon", "rover", 0, A)
    with pytest.raises(FrameError, match=naming("base", "rover")):
        tree.look_up("base", "rover", 0)
    with pytest.raises(FrameError, match=naming("tool", "arm", "camera")):
        tree.add("camera", "tool", 0, A)


def test_circular_frames_and_decreasing_times_are_refused(tree):
    tree.add("tool", "base", 0, A)
    tree.add("moon", "rover", 0, A)
    with pytest.raises(FrameError, match=naming("base", "tool", "arm")):
        tree.look_up("base", "rover", 0)
    tree.add("moon", "flag", 100 * S, A)
    tree.add("moon", "flag", 3 * S, B)
    with pytest.raises(FrameError, match=naming("flag", "3.000 s")):
        tree.look_up("moon", "flag", 50 * S)


def test_a_removed_frame_may_get_another_parent(tree):
    tree.remove("tool")
    with pytest.raises(FrameError, match="tool"):
        tree.look_up("base", "tool", S)
    tree.add("camera", "tool", 0, A)
    np.testing.assert_allclose(tree.look_up("base", "tool", 0), B @ A)
    tree.remove("unknown")


def test_forgotten_transforms_are_those_that_later_lookups_do_not_need(tree):
    at = tree.look_up("base", "tool", 3 * S // 2)
    tree.forget(3 * S // 2)
    np.testing.assert_allclose(tree.look_up("base", "tool", 3 * S // 2), at)
    with pytest.raises(FrameError, match=r"from 1\.000 s"):
        tree.look_up("base", "tool", S // 2)
    tree.forget(99 * S)
    tree.look_up("base", "tool", 3 * S)
    tree.look_up("base", "camera", 0)
