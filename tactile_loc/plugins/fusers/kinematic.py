"""Contact or no contact only: the paper's baseline for several touches, which looks at no contact shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tactile_loc.core.common_poses import ContactOptions, check_contacts, common_poses, prior_weights
from tactile_loc.core.interfaces import Capabilities, Fuser, Prior
from tactile_loc.core.poses import Poses
from tactile_loc.core.posterior import PosePosterior


class KinematicFuser(Fuser):
    """Uniform over the first grid's poses that touch all sensors, times the prior."""

    capabilities = Capabilities(contact_only=True)

    class Options(ContactOptions):
        """When a pose counts as one that touches a sensor."""

    def fuse(
        self, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
    ) -> PosePosterior:
        """Return the posterior over the first touch's grid; of the posteriors, only the grids count. Poses in metres.

        Raises ConfigError for several touches without the pose of each sensor, touches of different objects, or a
        prior that does not return one log-weight a pose, none of them NaN or +inf; GridError when no pose is left.
        """
        check_contacts(posteriors, T_base_sensor)
        grids = [posterior.grid for posterior in posteriors]
        weights = prior_weights(prior, grids[0])
        common = common_poses(grids, T_base_sensor, self.options.reach, np.isfinite(weights))
        log_p = np.full(len(grids[0]), -np.inf)
        log_p[common.first] = weights[common.first]
        return PosePosterior(grids[0], log_p)
