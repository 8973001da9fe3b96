"""The fuser slot: combines the posteriors of several touches and a prior."""

from abc import abstractmethod
from collections.abc import Sequence

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.poses.posterior import NoPoseLeft, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.slots.component import Component


class Fuser(Component):
    """Combines the posteriors of several touches and a prior."""

    slot = "fuser"

    @abstractmethod
    def fuse(
        self, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
    ) -> PosePosterior | NoPoseLeft:
        """Return the posterior over the first touch's grid, or `NoPoseLeft` if touches and prior exclude all poses.

        `T_base_sensor` has each sensor's pose (4, 4), metres, or None if it is unknown. `prior` maps the poses of the
        grid (N, 4, 4), metres, to log-weights (N,). Raises ConfigError for touches that the fuser cannot combine, such
        as several touches without sensor poses.
        """
