"""How far an estimated pose is from the true one, in metres of object surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry import transform_points
from tactile_loc.core.objects import ObjectModel
from tactile_loc.core.poses import Poses

SYMMETRY_STEP_M = 2e-4


def add(points_m: NDArray[np.float64], T1: Poses, T2: Poses) -> NDArray[np.float64]:
    """Mean distance (...,) in metres between object points (P, 3) at poses T1 and T2 (..., 4, 4): ADD.

    Hinterstoisser et al., ACCV 2012; symmetry is not regarded.
    """
    return np.linalg.norm(transform_points(T1, points_m) - transform_points(T2, points_m), axis=-1).mean(axis=-1)


def symmetric_add(obj: ObjectModel, points_m: NDArray[np.float64], T_estimate: Poses, T_true: Poses) -> float:
    """ADD in metres of one estimate (4, 4), the least over the true poses (4, 4) that look the same by symmetry."""
    lever = max(float(np.sqrt(np.trace(obj.mesh.covariance_m2))), 1e-9)
    same = T_true @ obj.symmetry.elements(max_step_rad=SYMMETRY_STEP_M / lever)
    if len(same) > 8:  # rank by the squared metric first: exact ADD only for the nearest few
        few = points_m[:: max(1, len(points_m) // 200)]
        same = same[np.argsort(add(few, T_estimate[None], same))[:4]]
    return float(min(add(points_m, T_estimate, T) for T in same))
