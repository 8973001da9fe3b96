"""The robot's frames from TF, as they arrive. This module does not import ROS."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import FrameTree, RosPose, TactileLocError

NS = 1_000_000_000
JUMP_NS = NS  # a clock that goes back farther was reset, as when a recording starts again


def read_stamp_ns(header: Any) -> int:
    """Return the time of a std_msgs Header, ns."""
    return int(header.stamp.sec) * NS + int(header.stamp.nanosec)


class LiveFrames:
    """The frames of the last `keep_s` seconds. Transforms of the frame `ignored` are left out.

    As in tf2, a frame may get another parent, and the clock may be reset. Older transforms of this frame are then
    forgotten.
    """

    def __init__(self, keep_s: float = 10.0, ignored: str = "") -> None:
        self._tree, self._keep_ns, self._ignored = FrameTree(), round(keep_s * NS), ignored
        self._latest: dict[str, tuple[str, bool, int]] = {}  # by child: its parent, whether it is fixed, and its stamp

    def add(self, message: Any, fixed: bool) -> tuple[str, ...]:
        """Add the transforms of a tf2_msgs TFMessage; return the reasons why transforms were left out."""
        problems, stamp_ns = [], None
        for one in message.transforms:
            parent, child = (name.removeprefix("/") for name in (one.header.frame_id, one.child_frame_id))
            if child == self._ignored:
                continue
            try:
                T = _read(one.transform)
            except TactileLocError as error:
                problems.append(f"{child!r} in {parent!r}: {error}")
                continue
            stamp_ns = read_stamp_ns(one.header)
            before = self._latest.get(child, (parent, fixed, stamp_ns))
            if before[:2] != (parent, fixed) or (not fixed and stamp_ns < before[2] - JUMP_NS):
                self._tree.remove(child)
            self._tree.add(parent, child, stamp_ns, T, fixed)
            self._latest[child] = (parent, fixed, stamp_ns)
        if stamp_ns is not None and not fixed:
            self._tree.forget(stamp_ns - self._keep_ns)
        return tuple(problems)

    def look_up(self, target: str, source: str, stamp_ns: int) -> NDArray[np.float64]:
        """Return T_target_source (4, 4), metres, at a time in ns. Raises FrameError if it is unknown."""
        return self._tree.look_up(target.removeprefix("/"), source.removeprefix("/"), stamp_ns)


def _read(transform: Any) -> NDArray[np.float64]:
    """Return the transform (4, 4), metres, of a geometry_msgs Transform. Raises FrameError if it is not rigid."""
    t, q = transform.translation, transform.rotation
    return RosPose((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), ()).T
