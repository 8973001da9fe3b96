"""The fuser slot: combines the posteriors of several touches and a prior."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.slots.component import Component


class Fuser(Component):
    """Combines the posteriors of several touches and a prior."""

    slot = "fuser"

    @abstractmethod
    def fuse(
        self, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
    ) -> PosePosterior:
        """Return the posterior over the first touch's grid. `prior` maps its poses (N, 4, 4) to log-weights (N,).

        `T_base_sensor` has each sensor's pose (4, 4), metres; None if unknown. Raises ConfigError for touches that it
        cannot combine, such as several without sensor poses, and GridError when no pose is left.
        """
