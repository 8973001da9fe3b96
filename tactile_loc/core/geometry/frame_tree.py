"""A tree of frames with the transforms between them over time, as in ROS's TF."""

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from tactile_loc.core.geometry.lie import compute_pose_errors, move
from tactile_loc.core.geometry.rigid import Floats, invert
from tactile_loc.core.runtime.errors import FrameError, advise_choice

Transform = Floats

JUMP_NS = 1_000_000_000  # a clock that goes back farther was reset; smaller steps back are messages out of order


@dataclass(eq=False)
class Edge:
    """The transforms `T_parent_child` (4, 4), metres, of a child frame in its parent frame, at increasing stamps, ns.

    A `fixed` edge has one transform for all times. If the clock was set back, `jump_ns` is the stamp after that.
    """

    parent: str
    child: str
    fixed: bool = False
    stamps_ns: list[int] = field(default_factory=list)
    T_parent_child: list[Transform] = field(default_factory=list)
    jump_ns: int | None = None

    def add(self, stamp_ns: int, T: Transform) -> None:
        """Add a transform (4, 4), metres; a fixed edge keeps only the last one."""
        if self.fixed:
            self.stamps_ns, self.T_parent_child = [stamp_ns], [T]
            return
        if self.stamps_ns and stamp_ns < self.stamps_ns[-1] - JUMP_NS:
            self.jump_ns = stamp_ns
        place = bisect_right(self.stamps_ns, stamp_ns)
        self.stamps_ns.insert(place, stamp_ns)
        self.T_parent_child.insert(place, T)

    def look_up(self, stamp_ns: int) -> Transform:
        """Return T_parent_child (4, 4), metres, interpolated at a time. Raises FrameError if it is unknown then."""
        if self.fixed:
            return self.T_parent_child[0]
        if self.jump_ns is not None:
            raise FrameError(
                f"the clock of {self._name} jumps back to {format_seconds(self.jump_ns)}, so its pose at a time is "
                "ambiguous; cut the recording there"
            )
        first_ns, last_ns = self.stamps_ns[0], self.stamps_ns[-1]
        if not first_ns <= stamp_ns <= last_ns:
            raise FrameError(
                f"{self._name} is known from {format_seconds(first_ns)} to {format_seconds(last_ns)}, "
                f"not at {format_seconds(stamp_ns)}"
            )
        after = min(bisect_right(self.stamps_ns, stamp_ns), len(self.stamps_ns) - 1)
        before = max(after - 1, 0)
        passed_ns = stamp_ns - self.stamps_ns[before]
        share = passed_ns / max(1, self.stamps_ns[after] - self.stamps_ns[before])
        return interpolate(self.T_parent_child[before], self.T_parent_child[after], share)

    def forget(self, before_ns: int) -> None:
        """Drop the transforms that no lookup at `before_ns` or later needs; a fixed edge keeps its transform."""
        unused = 0 if self.fixed else max(0, bisect_right(self.stamps_ns, before_ns) - 1)
        del self.stamps_ns[:unused], self.T_parent_child[:unused]

    @property
    def _name(self) -> str:
        return f"{self.child!r} in {self.parent!r}"


class FrameTree:
    """A tree of named frames. Each frame has one parent, except a frame at the top."""

    def __init__(self) -> None:
        self._edges: dict[str, Edge] = {}  # the edge to its parent, by child

    @property
    def names(self) -> tuple[str, ...]:
        """The frames' names, sorted."""
        return tuple(sorted({name for edge in self._edges.values() for name in (edge.parent, edge.child)}))

    def add(self, parent: str, child: str, stamp_ns: int, T_parent_child: Transform, fixed: bool = False) -> None:
        """Add the transform (4, 4), metres, of `child` in `parent` at a time, or for all times if `fixed` is True.

        Raises FrameError if the child already has another parent.
        """
        edge = self._edges.setdefault(child, Edge(parent, child, fixed))
        if edge.parent != parent:
            raise FrameError(f"the frame {child!r} has two parents, {edge.parent!r} and {parent!r}; give it only one")
        edge.add(stamp_ns, T_parent_child)

    def remove(self, child: str) -> None:
        """Remove all transforms of a frame in its parent, for instance before it gets another parent."""
        self._edges.pop(child, None)

    def forget(self, before_ns: int) -> None:
        """Drop the transforms that no lookup at `before_ns`, ns, or later needs."""
        for edge in self._edges.values():
            edge.forget(before_ns)

    def require(self, *names: str) -> None:
        """Raise FrameError, which lists the known frames, unless there are frames with all these names."""
        for name in names:
            if name not in self.names:
                raise FrameError(f"there is no frame {name!r}; {advise_choice(name, self.names)}")

    def look_up(self, target: str, source: str, stamp_ns: int) -> Transform:
        """Return T_target_source (4, 4), metres, at a time in ns, interpolated between stamps.

        Raises FrameError if a frame is unknown, the frames are not connected, or a transform is unknown at that time.
        """
        self.require(target, source)
        up_target, up_source = self._list_ancestors(target), self._list_ancestors(source)
        common = next((name for name in up_source if name in up_target), None)
        if common is None:
            raise FrameError(f"the frames {target!r} and {source!r} are not connected; record a transform between them")
        return invert(self._chain_up(common, target, stamp_ns)) @ self._chain_up(common, source, stamp_ns)

    def _list_ancestors(self, name: str) -> list[str]:
        """List the frame and all frames above it."""
        found = [name]
        while (edge := self._edges.get(found[-1])) is not None:
            if edge.parent in found:
                raise FrameError(
                    f"the frames {', '.join(found)} are each other's parents; correct the transforms of the recording"
                )
            found.append(edge.parent)
        return found

    def _chain_up(self, ancestor: str, name: str, stamp_ns: int) -> Transform:
        T = np.eye(4)
        while name != ancestor:
            edge = self._edges[name]
            T = edge.look_up(stamp_ns) @ T
            name = edge.parent
        return T


def interpolate(T_first: Transform, T_second: Transform, share: float) -> Transform:
    """Interpolate between two transforms (4, 4), metres. A `share` of 0 returns the first, 1 the second."""
    return move(T_first, share * compute_pose_errors(T_second, T_first))


def format_seconds(stamp_ns: int) -> str:
    """Return a time, ns, as text in seconds, with the unit."""
    return f"{stamp_ns / 1e9:.3f} s"
