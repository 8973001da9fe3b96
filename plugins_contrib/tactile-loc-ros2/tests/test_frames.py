"""The live frame tree, filled from serialised TFMessages."""

import numpy as np
import pytest
from tactile_loc import TactileLocError

from tactile_loc_ros2.frames import LiveFrames
from tactile_loc_ros2.messages import MessageMaker

NS = 1_000_000_000


def shift(x_m: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = x_m
    return T


@pytest.fixture
def send(types):
    """Return a function that passes transforms, in CDR and back, to live frames."""
    maker = MessageMaker(types.find)

    def send(frames: LiveFrames, stamp_ns: int, fixed: bool = False, **T_by_child) -> tuple[str, ...]:
        edges = {tuple(name.split("__")): T for name, T in T_by_child.items()}
        return frames.add(types.pass_on(maker.make_transforms(edges, stamp_ns)), fixed)

    return send


def test_transforms_are_chained_and_interpolated(send):
    frames = LiveFrames()
    send(frames, 0, fixed=True, flange__gel=shift(0.5))
    send(frames, 0, base__flange=shift(1))
    send(frames, NS, base__flange=shift(2))
    np.testing.assert_allclose(frames.look_up("base", "gel", NS // 4), shift(1.75))
    np.testing.assert_allclose(frames.look_up("/base", "/gel", NS // 4), shift(1.75))
    with pytest.raises(TactileLocError, match=r"not at 1\.500 s"):
        frames.look_up("base", "gel", 3 * NS // 2)


def test_old_transforms_are_forgotten(send):
    frames = LiveFrames(keep_s=2)
    for k in range(10):
        send(frames, k * NS, base__gel=shift(k))
    np.testing.assert_allclose(frames.look_up("base", "gel", 7 * NS), shift(7))
    with pytest.raises(TactileLocError, match=r"from 7\.000 s"):
        frames.look_up("base", "gel", 6 * NS)


def test_a_reset_clock_forgets_the_later_transforms(send):
    frames = LiveFrames()
    send(frames, 100 * NS, base__gel=shift(1))
    send(frames, 3 * NS, base__gel=shift(2))
    np.testing.assert_allclose(frames.look_up("base", "gel", 3 * NS), shift(2))
    with pytest.raises(TactileLocError):
        frames.look_up("base", "gel", 100 * NS)


def test_a_frame_may_get_another_parent(send):
    frames = LiveFrames()
    send(frames, 0, table__part=shift(1))
    send(frames, NS, gripper__part=shift(2))
    np.testing.assert_allclose(frames.look_up("gripper", "part", NS), shift(2))
    with pytest.raises(TactileLocError):
        frames.look_up("table", "part", NS)


def test_the_ignored_frame_is_left_out(send):
    frames = LiveFrames(ignored="object")
    send(frames, 0, base__object=shift(1), base__gel=shift(2))
    np.testing.assert_allclose(frames.look_up("base", "gel", 0), shift(2))
    with pytest.raises(TactileLocError, match="no frame 'object'"):
        frames.look_up("base", "object", 0)


def test_a_transform_that_is_not_rigid_is_reported(send):
    frames = LiveFrames()
    (problem,) = send(frames, 0, base__gel=shift(np.nan), base__flange=shift(1))
    assert "'gel' in 'base'" in problem
    np.testing.assert_allclose(frames.look_up("base", "flange", 0), shift(1))
