"""The paper's baseline for several touches: it uses only whether each sensor is in contact, not the contact shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import Capabilities, CommonPosesFuser, PosePosterior


class KinematicFuser(CommonPosesFuser):
    """Gives the first grid's poses that touch all sensors equal probability, times the prior. Only the grids matter."""

    capabilities = Capabilities(contact_only=True)

    def evidence(self, posterior: PosePosterior, index: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Return log-weights (K,) of grid poses `index`, in nats: all zero."""
        return np.zeros(len(posterior.grid))[index]
