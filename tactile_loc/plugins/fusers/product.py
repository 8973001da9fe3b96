"""The product of probabilities: what each touch says, times what was known before. Eq. 1 of the paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.core.common_poses import ContactOptions, check_contacts, common_poses, prior_weights
from tactile_loc.core.errors import GridError
from tactile_loc.core.interfaces import Fuser, Prior
from tactile_loc.core.poses import Poses
from tactile_loc.core.posterior import PosePosterior

ALL = slice(None)


class ProductFuser(Fuser):
    """P(x | CS_1 ... CS_N) ~ prod_i P(x | CS_i) P_task(x) / prod_i P_train,i(x), over the first touch's grid.

    The appendix's full form, in log space; P_task is the prior, P_train,i what touch i's probabilities were learned
    from, both uniform unless given. A factor of touch i is that of the pose of its own grid nearest to x as its sensor
    sees it; poses that do not touch a sensor are dropped. The cost is linear in the number of touches.
    """

    class Options(ContactOptions):
        """`doubt` keeps one misleading touch from excluding the truth; poses without contact stay excluded."""

        doubt: float = Field(
            default=0.0, ge=0, lt=1, description="probability that a touch tells nothing but contact (0 to 1)"
        )

    def fuse(
        self, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
    ) -> PosePosterior:
        """Return the posterior over the first touch's grid; poses in metres.

        Raises ConfigError for several touches without the pose of each sensor, touches of different objects, or a
        prior that does not return one log-weight a pose, none of them NaN or +inf; GridError when no pose is left.
        """
        check_contacts(posteriors, T_base_sensor)
        first = posteriors[0].grid
        log_p = prior_weights(prior, first) + self._log_ratio(posteriors[0])
        if len(posteriors) > 1:
            common = common_poses([p.grid for p in posteriors], T_base_sensor, self.options.reach, np.isfinite(log_p))
            total = log_p[common.first]
            for posterior, index in zip(posteriors[1:], common.found[1:], strict=True):
                total = total + self._log_ratio(posterior, index)
            log_p = np.full(len(first), -np.inf)
            log_p[common.first] = total
            if not np.isfinite(total).any():
                raise GridError(_contradiction(len(posteriors), len(total)))
        return PosePosterior(first, log_p)

    def _log_ratio(self, posterior: PosePosterior, index: NDArray[np.int64] | slice = ALL) -> NDArray[np.float64]:
        """Return log(P(x | CS) / P_train(x)) (K,) of grid poses `index`; a touch that tells nothing has P = P_train."""
        log_train: NDArray[np.float64] | float = -np.log(len(posterior.grid))
        if posterior.log_train is not None:
            log_train = PosePosterior(posterior.grid, posterior.log_train).log_p[index]
        ratio: NDArray[np.float64] = posterior.log_p[index] - log_train
        if self.options.doubt == 0:
            return ratio
        return np.logaddexp(np.log1p(-self.options.doubt) + ratio, np.log(self.options.doubt))


def _contradiction(touches: int, poses: int) -> str:
    return (
        f"the {touches} touches contradict one another: each of the {poses:,} poses that touch all sensors has no "
        "probability for one of them; allow fuser.doubt, or let the matcher score all poses"
    )
