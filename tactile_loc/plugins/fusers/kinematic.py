"""The paper's baseline for several touches. It uses the fact that each sensor is in contact, but no contact shape."""

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import Capabilities, PosePosterior
from tactile_loc.plugin.helpers import CommonPosesFuser


class KinematicFuser(CommonPosesFuser):
    """Gives equal probability, times the prior, to the poses of the first grid that touch all sensors."""

    capabilities = Capabilities(contact_only=True)

    def evidence(self, posterior: PosePosterior, index: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Return log-weights (K,) of grid poses `index`, in nats: all zero."""
        return np.zeros(len(posterior.grid))[index]
