from __future__ import annotations

import numpy as np
import pytest
from message_helpers import missing, naming

from tactile_loc.core.geometry.rigid import invert, make_transform, make_translation, rotation_about
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import NoPoseLeft, PosePosterior
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.plugins.fusers.kinematic import KinematicFuser
from tactile_loc.plugins.fusers.product import ProductFuser

T_BASE = [np.eye(4), make_transform(rotation_about([-1, 0, 2], 2.1), [0.21, -0.12, 0.39])]


def line(box, places: list[int], log_p: list[float], sensor: int = 0) -> PosePosterior:
    """Poses 3 mm apart in the frame of the first sensor, as `sensor` sees them."""
    x = 0.003 * np.array(places, float)
    in_first = make_translation(np.column_stack([x, 0 * x, 0 * x]))
    return PosePosterior(PoseGrid(invert(T_BASE[sensor]) @ in_first, PoseMetric(box)), np.array(log_p, float))


def test_all_poses_that_touch_all_sensors_are_equally_probable(box):
    touches = [line(box, [0, 1, 2, 3], [0, -9, -np.inf, -5]), line(box, [3, 8, 2, 1], [-40, 0, 0, 0], 1)]
    fused = KinematicFuser(KinematicFuser.Options(reach=0.4)).fuse(touches, T_BASE)
    np.testing.assert_allclose(fused.probabilities, [0, 1 / 3, 1 / 3, 1 / 3], atol=1e-12)
    assert fused.grid is touches[0].grid
    assert KinematicFuser.capabilities.contact_only


def test_the_kinematic_fuser_excludes_the_same_poses_as_the_product(box):
    touches = [line(box, [0, 1, 2, 3], [0, -1, -2, -3]), line(box, [2, 5, 3], [-1, -1, -2], 1)]
    supports = [np.isfinite(f.fuse(touches, T_BASE).log_p).tolist() for f in (KinematicFuser(), ProductFuser())]
    assert supports[0] == supports[1]


def test_without_a_common_pose_none_is_left_and_unknown_sensor_poses_are_refused(box):
    touches = [line(box, [0, 1], [0, 0]), line(box, [30, 31], [0, 0], 1)]
    left = KinematicFuser().fuse(touches, T_BASE)
    assert isinstance(left, NoPoseLeft)
    assert not missing(left.reason, "touch 2", "T_base_sensor")
    with pytest.raises(ConfigError, match=naming("touch 2", "T_base_sensor")):
        KinematicFuser().fuse(touches, [np.eye(4), None])
