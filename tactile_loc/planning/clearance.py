"""The clearance of approaches: what the finger that carries the sensor would hit on its way to a touch.

The finger moves along the sensor's z axis. It is compared every STEP_M with the object in each of its possible poses,
and with a fixture, by the triangles of both surfaces (FCL, through python-fcl). The finger's front is soft: as far
behind the gel's surface as the sensor is pressed, it may enter the object.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses, invert, transform_points
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.errors import MissingLibraryError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.io.approach_files import Approach
from tactile_loc.tracking.pose_modes import PoseModes

STEP_M = 1e-3  # a finger that hits something thicker than this is always found
MARGIN_M = 1e-5  # between the pressed gel and the rest of the finger
PIERCED_M = 1e-6  # surfaces that only touch do not count as a hit
LEAST_PROBABLE = 0.01  # less probable poses of the object are not checked

_models: WeakKeyDictionary[TriangleMesh, Any] = WeakKeyDictionary()  # trees of triangles, which are slow to build


@dataclass(frozen=True, eq=False)
class Clearance:
    """The surfaces that must not meet on the way to a touch.

    `finger` is the rigid body that carries the sensor, in the sensor frame. `fixture` is at rest in the frame of the
    modes, and None if there is none. Nothing of the finger may go below z = `floor_m`, metres, of that frame.
    """

    finger: TriangleMesh
    fixture: TriangleMesh | None = None
    floor_m: float | None = None

    def explain(self, modes: PoseModes, approaches: Sequence[Approach], moved_m: Floats) -> list[str]:
        """Return for each of A approaches what the finger would hit, and "" if it hits nothing.

        `moved_m` (A, K), metres, is the sensor's way along its z axis, with the press, if the object is in each of K
        modes. Raises MissingLibraryError without python-fcl.
        """
        checked = np.flatnonzero(modes.probabilities > LEAST_PROBABLE)
        return [
            next(self._list_hits(modes, approach, moved, checked), "")
            for approach, moved in zip(approaches, moved_m, strict=True)
        ]

    def _list_hits(self, modes: PoseModes, approach: Approach, moved_m: Floats, checked: Ints) -> Iterator[str]:
        longest_m, T_sensor_base = float(moved_m[checked].max()), invert(approach.T_base_sensor)
        if self._goes_below_floor(approach.T_base_sensor, longest_m):
            yield f"would bring the finger below the floor at z = {1e3 * (self.floor_m or 0.0):.4g} mm"
        press_m = modes.press_m if approach.press_m is None else approach.press_m
        rigid = cut_gel(self.finger, modes.geometry, press_m)
        if self.fixture is not None:
            hit_m = find_first_hit_m(self.finger, self.fixture, T_sensor_base, longest_m)
            if hit_m <= longest_m:
                yield f"would hit the fixture with the finger after {1e3 * hit_m:.0f} mm"
        for k in checked:
            mesh = modes.objects[k].mesh
            hit_m = find_first_hit_m(rigid, mesh, T_sensor_base @ modes.T_base_object[k], moved_m[k])
            if hit_m <= moved_m[k]:
                share = format_percent(float(modes.probabilities[k]))
                yield (
                    f"would hit the object with the finger after {1e3 * hit_m:.0f} mm in pose {k + 1}, which has a "
                    f"probability of {share}"
                )

    def _goes_below_floor(self, T_base_sensor: Poses, moved_m: float) -> bool:
        """Return whether the finger is below the floor at the start or at the end of its straight way."""
        if self.floor_m is None:
            return False
        lowest_m = transform_points(T_base_sensor, self.finger.corners_m)[:, 2].min()
        return bool(lowest_m + min(0.0, moved_m * T_base_sensor[2, 2]) < self.floor_m)


def make_box_finger(size_m: Sequence[float], geometry: SensorGeometry) -> TriangleMesh:
    """Return a box of a size (3,), metres, along x, y and z, behind the gel: its front is centred on the gel."""
    import trimesh

    size, front = np.asarray(size_m, float), geometry.gel_middle_m
    made = trimesh.creation.box(bounds=[front - size * [0.5, 0.5, 1.0], front + size * [0.5, 0.5, 0.0]])
    return TriangleMesh(np.asarray(made.vertices, float), np.asarray(made.faces, np.int64))


def cut_gel(finger: TriangleMesh, geometry: SensorGeometry, press_m: float) -> TriangleMesh:
    """Return the finger without the layer that is soft: up to `press_m`, metres, behind the gel's surface.

    Parts in front of the gel remain. The layer is pressed flat, so that the rest of the finger stays closed.
    """
    from trimesh import intersections

    cut: Any = intersections.slice_faces_plane
    low = high = geometry.surface_m
    if geometry.relief_m is not None:
        low, high = low + float(geometry.relief_m.min()), high + float(geometry.relief_m.max())
    back, front = low - press_m - MARGIN_M, high + MARGIN_M
    behind, before, ahead = (
        cut(finger.vertices_m, finger.faces, [0.0, 0.0, sign], [0.0, 0.0, z])[:2]
        for sign, z in ((-1.0, back), (1.0, back), (1.0, front))
    )
    layer = cut(*before, [0.0, 0.0, -1.0], [0.0, 0.0, front])[:2]
    flat = layer[0] * [1.0, 1.0, 0.0] + [0.0, 0.0, back], layer[1]
    ends = np.cumsum([0, *(len(part[0]) for part in (behind, flat))])
    parts = zip((behind, flat, ahead), ends, strict=True)
    faces = np.concatenate([part[1] + end for part, end in parts])
    vertices = np.concatenate([part[0] for part in (behind, flat, ahead)])
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return TriangleMesh(vertices, faces[areas > 0])


def find_first_hit_m(finger: TriangleMesh, obstacle: TriangleMesh, T_sensor_obstacle: Poses, moved_m: float) -> float:
    """Return how far, metres, the sensor moves along its z axis until the finger meets an obstacle, in steps of STEP_M.

    `T_sensor_obstacle` (4, 4), metres, is the obstacle's pose before the motion. The result is infinite if the finger
    meets nothing within `moved_m`.
    """
    fcl = _import_fcl()
    if not len(finger.faces):
        return np.inf
    low, high = (getattr(finger.corners_m, name)(axis=0) for name in ("min", "max"))
    placed = transform_points(T_sensor_obstacle, obstacle.hull_corners_m)
    least, most = placed.min(axis=0), placed.max(axis=0)
    if (least[:2] > high[:2]).any() or (most[:2] < low[:2]).any():
        return np.inf
    start, end = max(0.0, least[2] - high[2] + PIERCED_M), min(moved_m, most[2] - low[2])
    if end < start:
        return np.inf
    body, other = _make_model(fcl, finger), _make_model(fcl, obstacle)
    still = fcl.CollisionObject(body)
    R, t = np.ascontiguousarray(T_sensor_obstacle[:3, :3]), T_sensor_obstacle[:3, 3]
    for s in (*np.arange(start, end, STEP_M), end):
        moved = fcl.CollisionObject(other, fcl.Transform(R, t - [0.0, 0.0, s]))
        if fcl.collide(still, moved, fcl.CollisionRequest(), fcl.CollisionResult()):
            return float(s)
    return np.inf


def _make_model(fcl: Any, mesh: TriangleMesh) -> Any:
    """Return the tree of boxes around a mesh's triangles. It is built once for each mesh."""
    model = _models.get(mesh)
    if model is None:
        model = fcl.BVHModel()
        model.beginModel(len(mesh.vertices_m), len(mesh.faces))
        model.addSubModel(np.ascontiguousarray(mesh.vertices_m), np.ascontiguousarray(mesh.faces))
        model.endModel()
        _models[mesh] = model
    return model


def _import_fcl() -> Any:
    try:
        import fcl
    except ImportError as error:
        raise MissingLibraryError(
            "collisions of a finger are found with python-fcl, which is not installed: pip install "
            "'tactile-loc[clearance]'"
        ) from error
    return fcl
