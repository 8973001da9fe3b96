"""The gel, the poses and the objects of which tests choose the next touch."""

from collections.abc import Sequence

import numpy as np
import trimesh

from tactile_loc import ObjectModel, SensorGeometry
from tactile_loc.tracking.pose_modes import PoseModes, find_distinct_modes

GEL = SensorGeometry("orthographic", 80, 60, 4000.0, 4000.0, 40.0, 30.0, 0.01, 1e-3)  # 20 x 15 mm
PRESS_M = 8e-4


def join_boxes(*boxes: tuple[Sequence[float], Sequence[float]]) -> trimesh.Trimesh:
    """Return boxes with these sides and middles, in metres, as one surface."""
    return trimesh.util.concatenate([trimesh.creation.box(sides).apply_translation(at) for sides, at in boxes])


def modes_of(obj: ObjectModel, *poses: np.ndarray, p: Sequence[float] | None = None) -> PoseModes:
    """Return the distinct poses of an object with these probabilities, or with equal ones."""
    share = np.full(len(poses), 1 / len(poses)) if p is None else np.array(p)
    return find_distinct_modes(obj, np.stack(poses), share, GEL, PRESS_M)
