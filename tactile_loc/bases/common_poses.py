"""The search for poses that touch every sensor, in each sensor's grid, and the base class for fusers that use it."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar

import numpy as np
from pydantic import Field

from tactile_loc.core.geometry.rigid import Bools, Floats, Ints, Poses, invert, require_rigid
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import NoPoseLeft, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.runtime.errors import ConfigError, quote
from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.slots.fuser import Fuser

Indices = Ints
LookUp = Callable[[Poses], Indices]

SAMPLE = 200  # least number of poses by which sensors are ordered


class CommonPosesFuser(Fuser):
    """Base class for fusers over those poses of the first grid that touch all sensors.

    A subclass defines the `evidence` of a touch. Its own Options derive from `CommonPosesFuser.Options`.
    `if_contradictory` is the advice in the message for contradictory touches, which leave no pose.
    """

    if_contradictory: ClassVar[str] = "let the matcher score all poses"

    class Options(ComponentOptions):
        """Options that decide whether a pose of the first grid touches another sensor."""

        reach: float = Field(
            default=1.5, gt=0, description="poses are equal within this many mean spacings of the coarser grid"
        )

    @abstractmethod
    def evidence(self, posterior: PosePosterior, index: Indices | slice) -> Floats:
        """Return the log-weights (K,), nats, that a touch gives to the poses `index` (K,) of its own grid."""

    def fuse(
        self, posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None], prior: Prior | None = None
    ) -> PosePosterior | NoPoseLeft:
        """Return the posterior over the poses of the first touch's grid, or `NoPoseLeft` if all poses are excluded.

        `T_base_sensor` are sensor poses (4, 4), metres. Only a single touch may have None. Raises ConfigError if one of
        several touches has no sensor pose, or if the touches are of different objects. Raises ConfigError, too, if the
        prior does not return one log-weight per pose, each finite or -inf.
        """
        require_fusable(posteriors, T_base_sensor)
        first = posteriors[0].grid
        known_before = compute_prior_weights(prior, first)
        if len(first) and np.isneginf(known_before).all():
            return NoPoseLeft(
                f"the prior excludes all {len(first):,} poses that the touch may be of; check its unit and its frame, "
                "or widen it"
            )
        weights = known_before + self.evidence(posteriors[0], slice(None))
        known = [np.asarray(T, float) for T in T_base_sensor if T is not None]  # a single touch may have None
        found = find_common_poses([p.grid for p in posteriors], known, self.options.reach, np.isfinite(weights))
        if isinstance(found, NoPoseLeft):
            return found
        total = weights[found[0]]
        for posterior, index in zip(posteriors[1:], found[1:], strict=True):
            total = total + self.evidence(posterior, index)
        if len(total) and not np.isfinite(total).any():
            return NoPoseLeft(
                f"the {len(posteriors)} touches contradict each other: each of the {len(total):,} poses that touch all "
                f"sensors has probability 0 for one of them; {self.if_contradictory}"
            )
        log_p = np.full(len(first), -np.inf)
        log_p[found[0]] = total
        return PosePosterior(first, log_p)


def require_fusable(posteriors: Sequence[PosePosterior], T_base_sensor: Sequence[Poses | None]) -> None:
    """Raise ConfigError if posteriors cannot be fused.

    There must be at least one touch. Several touches must be of one object, each with a rigid sensor pose (4, 4).
    """
    if not posteriors or len(posteriors) != len(T_base_sensor):
        raise ConfigError(
            f"a fuser takes at least one posterior and a sensor pose for each, not {len(posteriors)} posteriors and "
            f"{len(T_base_sensor)} poses"
        )
    if len(posteriors) == 1:
        return
    require_sensor_poses(T_base_sensor)
    ours = posteriors[0].grid.metric.object
    for number, posterior in enumerate(posteriors, start=1):
        other = posterior.grid.metric.object
        if other.mesh.digest != ours.mesh.digest:
            raise ConfigError(f"touch {number} is of {other.name}, touch 1 of {ours.name}; fuse touches of one object")


def require_sensor_poses(T_base_sensor: Sequence[Poses | None]) -> None:
    """Raise ConfigError unless each of several touches has a rigid sensor pose (4, 4)."""
    for number, T in enumerate(T_base_sensor, start=1):
        if T is None:
            raise ConfigError(
                f"touch {number} of {len(T_base_sensor)} has no sensor pose; to fuse several touches, give the "
                "T_base_sensor of each"
            )
        require_rigid(T, f"T_base_sensor of touch {number}")


def compute_prior_weights(prior: Prior | None, grid: PoseGrid) -> Floats:
    """Return the prior's log-weights (N,) of the grid's poses, or zeros without a prior.

    Raises ConfigError unless the prior returns one log-weight per pose, each finite or -inf.
    """
    if prior is None:
        return np.zeros(len(grid))
    if not callable(prior):
        raise ConfigError(
            f"{quote(prior)} is not a prior; give a function of poses (N, 4, 4) to log-weights, such as a GaussianPrior"
        )
    weights = np.asarray(prior(grid.T_sensor_object), float)
    if weights.shape != (len(grid),) or not (weights < np.inf).all():
        raise ConfigError(
            f"the prior returned an array of shape {weights.shape} for {len(grid)} poses; it must "
            "return one log-weight per pose, (N,), each finite or -inf"
        )
    return weights


def find_common_poses(
    grids: Sequence[PoseGrid], T_base_sensor: Sequence[Poses], reach: float, possible: Bools
) -> Indices | NoPoseLeft:
    """Find which of the first grid's `possible` (N,) poses touch all sensors, in the grid's order.

    Returns the indices (S, K) of these K poses in the grid of each of S sensors. In the frame of sensor i, a pose x of
    the first grid is inv(T_base_sensor_i) @ T_base_sensor_1 @ x. The pose touches sensor i if this sensor's grid has a
    pose within `reach` mean spacings, up to symmetry. Sensors that exclude many poses are searched first. Returns
    `NoPoseLeft` if no pose touches all sensors.
    """
    others = _list_others(grids, T_base_sensor, reach)
    poses = grids[0].T_sensor_object
    found = np.tile(np.flatnonzero(possible), (len(grids), 1))  # right for the first's grid at the first's pose
    for number in _order_others(others, poses[found[0]]):
        found[number] = others[number](poses[found[0]])
        touching = found[number] >= 0
        if len(touching) and not touching.any():
            return NoPoseLeft(
                f"no pose touches all {len(grids)} sensors: {len(touching):,} of {len(poses):,} poses are left before "
                f"touch {number + 1}, and none after it. Check each T_base_sensor (metres, from sensor to base), or "
                "search all faces with the grid whole or hopf",
                number,
            )
        found = found[:, touching]
    return found


def _list_others(grids: Sequence[PoseGrid], T_base_sensor: Sequence[Poses], reach: float) -> dict[int, LookUp]:
    """Return the look-ups of the sensors to search, by number: all except sensors with the first's grid and pose."""
    others: dict[int, LookUp] = {}
    for number, (grid, T) in enumerate(zip(grids[1:], T_base_sensor[1:], strict=True), start=1):
        if grid is not grids[0] or not np.array_equal(T, T_base_sensor[0]):
            # a pose is known only to the spacing of the coarser grid; a grid of one pose has no spacing
            spacing_m = max((m for m in (grids[0].spacing_m, grid.spacing_m) if np.isfinite(m)), default=np.inf)
            others[number] = partial(_look_up, grid, invert(T) @ T_base_sensor[0], reach * spacing_m)
    return others


def _look_up(grid: PoseGrid, T_sensor_first: Poses, reach_m: float, T_first_object: Poses) -> Indices:
    """Return the index (M,) of the grid's pose nearest to each of the first sensor's poses (M, 4, 4), or -1 if far."""
    return grid.nearest(T_sensor_first @ T_first_object, reach_m)[1]


def _order_others(others: dict[int, LookUp], T_first_object: Poses) -> list[int]:
    """Return an order of the sensors, judged by a few poses. A sensor that excludes many poses comes early.

    Then fewer poses are left to look up in the grids of the later sensors.
    """
    if len(T_first_object) <= SAMPLE:
        return list(others)
    some = T_first_object[:: len(T_first_object) // SAMPLE]
    touching = {number: look_up(some) >= 0 for number, look_up in others.items()}
    left, order = np.ones(len(some), bool), []
    while touching:
        order.append(min(touching, key=lambda number: int((touching[number] & left).sum())))
        left = left & touching.pop(order[-1])
    return order
