"""The product of the touches' probabilities and the prior: equation 1 of the paper."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import PosePosterior
from tactile_loc.plugin.helpers import CommonPosesFuser


class ProductFuser(CommonPosesFuser):
    """P(x | CS_1 ... CS_N) ~ prod_i P(x | CS_i) P_task(x) / prod_i P_train,i(x), over the first touch's grid.

    This is the full form in the paper's appendix, computed in log space. P_task is the prior. P_train,i is the
    distribution from which the probabilities of touch i were learned. Both are uniform unless given. The factor of
    touch i is taken at the pose of touch i's grid that is nearest to x. Poses that do not touch a sensor are dropped.
    """

    if_contradictory = "allow fuser.doubt, or let the matcher score all poses"

    class Options(CommonPosesFuser.Options):
        """`doubt` keeps one misleading touch from excluding the true pose. Poses without contact stay excluded."""

        doubt: float = Field(
            default=0.0, ge=0, lt=1, description="probability that a touch shows only that there is contact (0 to 1)"
        )

    def evidence(self, posterior: PosePosterior, index: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Return log(P(x | CS) / P_train(x)) (K,) of grid poses `index`, in nats; 0 for an uninformative touch."""
        log_train: NDArray[np.float64] | float = -np.log(len(posterior.grid))
        if posterior.log_train is not None:
            log_train = PosePosterior(posterior.grid, posterior.log_train).log_p[index]
        ratio: NDArray[np.float64] = posterior.log_p[index] - log_train
        if not self.options.doubt:
            return ratio
        return np.logaddexp(np.log1p(-self.options.doubt) + ratio, np.log(self.options.doubt))
