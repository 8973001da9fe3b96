"""The trials: which part, which clearance and which seed. They were fixed before the first comparison."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shapes import PARTS

from tactile_loc.plugin.helpers import make_transform

Pose = NDArray[np.float64]

FIRST_SEED = 1  # of the comparison; other seeds from 10 000 served for development
CLEARANCES_MM = (0.1, 0.2, 0.3, 0.5)
MOST_OFF_M, MOST_OFF_RAD = 10e-3, np.radians(20)


@dataclass(frozen=True)
class Trial:
    """One part, one clearance, one seed."""

    number: int
    part: str
    clearance_mm: float
    seed: int

    def draw_error(self, rng: np.random.Generator) -> Pose:
        """Draw the part's pose (4, 4), metres, in the gripper frame just before the grasp. The nominal pose is 1."""
        axis, direction = rng.normal(size=(2, 3))
        turn = axis / np.linalg.norm(axis) * rng.uniform(0, MOST_OFF_RAD)
        shift_m = direction / np.linalg.norm(direction) * rng.uniform(0, MOST_OFF_M)
        return make_transform(Rotation.from_rotvec(turn).as_matrix(), shift_m)


def list_trials(count: int, first_seed: int = FIRST_SEED) -> list[Trial]:
    """Return the first trials: the parts in turn, each with all clearances in turn."""
    names = list(PARTS)
    return [
        Trial(k, names[k % len(names)], CLEARANCES_MM[k // len(names) % len(CLEARANCES_MM)], first_seed + k)
        for k in range(count)
    ]
