"""The paper's baseline for several touches: it uses contact or no contact, and ignores contact shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import Capabilities, CommonPosesFuser, PosePosterior


class KinematicFuser(CommonPosesFuser):
    """Uniform over the first grid's poses that touch all sensors, times the prior. Only the touches' grids matter."""

    capabilities = Capabilities(contact_only=True)

    def evidence(self, posterior: PosePosterior, index: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Return log-weights (K,) of grid poses `index`, in nats: all zero."""
        return np.zeros(len(posterior.grid))[index]
