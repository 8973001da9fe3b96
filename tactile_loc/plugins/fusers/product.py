"""The product of probabilities: what one touch says, times what was known before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tactile_loc.core.errors import ConfigError
from tactile_loc.core.interfaces import Fuser, Prior
from tactile_loc.core.poses import Poses
from tactile_loc.core.posterior import PosePosterior


class ProductFuser(Fuser):
    """P(x | touch) times the prior, over the touch's grid, in log space. For one touch."""

    def fuse(
        self, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
    ) -> PosePosterior:
        """Return the posterior of the one touch, weighted by the prior. Raises ConfigError for several touches, or
        a prior that does not return one log-weight a pose, none of them NaN or +inf.
        """
        if len(posteriors) != 1:
            raise ConfigError(f"the product fuser combines one touch with a prior, not {len(posteriors)} touches")
        posterior = posteriors[0]
        if prior is None:
            return posterior
        weights = np.asarray(prior(posterior.grid.T_sensor_object), float)
        if weights.shape != posterior.log_p.shape or not (weights < np.inf).all():
            raise ConfigError(
                f"the prior returned an array of shape {weights.shape} for {len(posterior.log_p)} poses; it must "
                "return one log-weight a pose, (N,), each finite or -inf"
            )
        return PosePosterior(posterior.grid, posterior.log_p + weights)
