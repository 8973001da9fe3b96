"""Priors: log-weights of poses from vision, a region, an earlier posterior, or several of these.

Any callable that maps poses (N, 4, 4) to log-weights (N,) is a prior. The priors here have options, and can be given in
another frame than the sensor's. Only differences between log-weights count.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile_loc.core.deprecation import keep_old_names, make_getattr
from tactile_loc.core.errors import ConfigError
from tactile_loc.core.geometry.rigid import Poses, align_to_z, make_transform, require_rigid
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import PosePosterior

Array = NDArray[np.float64]

FORGOTTEN = 1e-6  # share of a posterior's probability, on its least probable poses, that is ignored
KERNEL_RADII = 6.0  # standard deviations beyond which a kernel counts as zero (e^-18)
LEAST_SPREAD = 0.5  # grid spacings: the median distance of the true pose from the nearest grid pose
NOTHING = -100.0  # a negligible log term of nearby kernels; exponentials of smaller numbers are slow
PAIRS = 500_000  # pairs of poses and kernels computed at once

Prior = Callable[[Poses], NDArray[np.float64]]


@keep_old_names(tempered="temper", seen_from="view_from")
class PosePrior(ABC):
    """A prior over poses in one frame: the sensor's, unless `view_from` moves it to another."""

    @abstractmethod
    def __call__(self, T_sensor_object: Poses) -> Array:
        """Return log-weights (N,), unitless, of poses (N, 4, 4) in metres; -inf excludes."""

    @property
    def touches(self) -> int:
        """Number of touches behind the prior: 0 unless it is an earlier posterior."""
        return 0

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return the prior, with what it learned from N touches raised to `power(N)`: see `FusedScaling`."""
        return self

    def view_from(self, T_base_sensor: Poses) -> SeenFrom:
        """Convert this prior over T_base_object to one over T_sensor_object, for a sensor at (4, 4)."""
        return SeenFrom(self, T_base_sensor)

    def __mul__(self, other: Prior) -> ProductPrior:
        """Return the product of both priors."""
        return ProductPrior((self, other))


@dataclass(frozen=True, eq=False)
class SeenFrom(PosePrior):
    """log w(T_base_sensor @ T_sensor_object): a prior in the base frame, for a sensor at `T_base_sensor` (4, 4).

    Metres. Raises ConfigError if that is not a rigid transform.
    """

    prior: Prior
    T_base_sensor: Poses

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_base_sensor", require_rigid(self.T_base_sensor, "T_base_sensor of a prior"))

    def __call__(self, T_sensor_object: Poses) -> Array:
        """Return the log-weights (N,) of T_base_object."""
        return self.prior(self.T_base_sensor @ T_sensor_object)

    @property
    def touches(self) -> int:
        """Number of touches that the prior in the base frame was learned from."""
        return count_touches(self.prior)

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return this prior, with the one in the base frame tempered."""
        return replace(self, prior=temper(self.prior, power))


@dataclass(frozen=True, eq=False)
class ProductPrior(PosePrior):
    """The product of priors, sum_i log w_i."""

    priors: tuple[Prior, ...]

    def __call__(self, T_sensor_object: Poses) -> Array:
        """Return the sums (N,) of the log-weights."""
        return np.sum([prior(T_sensor_object) for prior in self.priors], axis=0) + np.zeros(len(T_sensor_object))

    @property
    def touches(self) -> int:
        """Number of touches that all priors together were learned from."""
        return sum(map(count_touches, self.priors))

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return the product of the tempered priors."""
        return ProductPrior(tuple(temper(prior, power) for prior in self.priors))


@dataclass(frozen=True, eq=False)
class GaussianPrior(PosePrior):
    """A Gaussian about the pose `T` (4, 4), metres, as from vision: log w = -|dt|^2 / (2 s_t^2) - a^2 / (2 s_r^2).

    dt is the distance between the origins of the object's frame, and a the angle of the rotation between the poses.
    Both are isotropic, with standard deviations `translation_std_m` and `rotation_std_rad`; inf means unknown. With the
    object's `symmetry`, a is the least over equivalent poses, and dt is measured at the symmetry's centre, which they
    share. Raises ConfigError when T is not rigid or a standard deviation is not positive.
    """

    T: Poses
    translation_std_m: float
    rotation_std_rad: float
    symmetry: SymmetryGroup | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "T", require_rigid(self.T, "the pose of a Gaussian prior"))
        for name in ("translation_std_m", "rotation_std_rad"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of a Gaussian prior is {getattr(self, name)}; give a number above 0")

    def __call__(self, T_sensor_object: Poses) -> Array:
        """Return the log-weights (N,), 0 at the pose T."""
        symmetry = self.symmetry or SymmetryGroup(np.zeros(3))
        R, t = T_sensor_object[:, :3, :3], T_sensor_object[:, :3, 3]
        centre_m = self.T[:3, :3] @ symmetry.centre_m + self.T[:3, 3]
        distance_m = np.linalg.norm(R @ symmetry.centre_m + t - centre_m, axis=1)
        angle_rad = symmetry.measure_least_angle(self.T[:3, :3], R)
        with np.errstate(over="ignore"):  # far beyond a tiny deviation, the log-weight is -inf
            return -0.5 * ((distance_m / self.translation_std_m) ** 2 + (angle_rad / self.rotation_std_rad) ** 2)


@dataclass(frozen=True, eq=False)
class RegionPrior(PosePrior):
    """A point of the object lies in a box: log w = 0 there, -inf elsewhere.

    `low_m`, `high_m` (3,) bound the box along the axes of the poses' frame, or of the frame into which `T_box` (4, 4)
    transforms its coordinates; +-inf leaves a side open. `point_m` (3,) is the point, in the object frame. Metres.
    Raises ConfigError when the box is empty or a value is NaN.
    """

    low_m: Array
    high_m: Array
    point_m: Array
    T_box: Poses | None = None

    def __post_init__(self) -> None:
        for name in ("low_m", "high_m", "point_m"):
            object.__setattr__(self, name, _require_numbers(getattr(self, name), f"{name} of a region prior"))
        if not (self.low_m < self.high_m).all():
            raise ConfigError(f"the region {self.low_m} to {self.high_m} (metres) is empty; give low below high")
        if self.T_box is not None:
            object.__setattr__(self, "T_box", require_rigid(self.T_box, "T_box of a region prior"))

    @classmethod
    def half_space(cls, normal: ArrayLike, border_m: ArrayLike, point_m: ArrayLike) -> RegionPrior:
        """Return the half-space on the side of a plane to which its `normal` (3,), unitless, points.

        The plane goes through `border_m` (3,); `point_m` (3,) is the object's point, in its frame. Metres.
        Raises ConfigError for a normal of length 0.
        """
        direction = _require_numbers(normal, "the normal of a half-space")
        if not 0 < np.linalg.norm(direction) < np.inf:
            raise ConfigError(f"the normal {direction} of a half-space has no direction; give one that is not zero")
        R = align_to_z(direction)
        T_box = make_transform(R, -R @ _require_numbers(border_m, "the border of a half-space"))
        open_ = np.full(3, np.inf)
        return cls(
            np.array([-np.inf, -np.inf, 0.0]), open_, _require_numbers(point_m, "point_m of a half-space"), T_box
        )

    def __call__(self, T_sensor_object: Poses) -> Array:
        """Return 0 for poses whose point is in the region or on its border, and -inf for others (N,)."""
        T = T_sensor_object if self.T_box is None else self.T_box @ T_sensor_object
        p = T[:, :3, :3] @ self.point_m + T[:, :3, 3]
        return np.where(((p >= self.low_m) & (p <= self.high_m)).all(axis=1), 0.0, -np.inf)


@dataclass(frozen=True, eq=False)
class PosteriorPrior(PosePrior):
    """An earlier posterior, moved: w(x) = (1 - f) sum_j p_j exp(-d(x, T_new_old x_j)^2 / (2 s^2)) + f / N.

    `T_new_old` (4, 4) is the known motion: T_sensor_object_new = T_new_old @ T_sensor_object_old. For an object at rest
    it is inv(T_base_sensor_new) @ T_base_sensor_old. The distance d is the pose metric, up to symmetry. s is `std_m`,
    the uncertainty of the motion, and at least half the earlier grid's spacing, so that the two grids do not miss each
    other. `floor`, f, leaves a share of 1 / N everywhere, with N earlier poses; the earlier posterior's `elsewhere` is
    added to it. The sum is raised to `power`. Metres. Raises ConfigError when the motion is not rigid, std_m is
    negative or f is not in [0, 1).
    """

    posterior: PosePosterior
    T_new_old: Poses
    std_m: float = 0.0
    floor: float = 1e-3
    power: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_new_old", require_rigid(self.T_new_old, "T_new_old of a posterior prior"))
        if not 0 <= self.std_m < np.inf:
            raise ConfigError(f"std_m of a posterior prior is {self.std_m}; give a length of at least 0")
        if not 0 <= self.floor < 1:
            raise ConfigError(f"the floor of a posterior prior is {self.floor}; give at least 0 and less than 1")

    def __call__(self, T_sensor_object: Poses) -> Array:
        """Return the log-weights (N,)."""
        log_w = np.full(len(T_sensor_object), -np.inf)
        near = np.flatnonzero(self._moved.nearest(T_sensor_object, KERNEL_RADII * self.spread_m)[1] >= 0)
        for some, density in self._sum_kernels(T_sensor_object[near]):
            log_w[near[some]] = np.log1p(-self.floor) + density
        anywhere = self.floor + (1 - self.floor) * self.posterior.elsewhere
        if anywhere > 0:
            log_w = np.logaddexp(log_w, np.log(anywhere / len(self.posterior.grid)))
        return self.power * log_w

    @property
    def touches(self) -> int:
        """Number of touches that the earlier posterior was learned from."""
        return self.posterior.touches

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return this prior, with the earlier posterior raised to `power(N)` for its N touches."""
        return replace(self, power=power(self.touches))

    @cached_property
    def spread_m(self) -> float:
        """The kernels' standard deviation, metres."""
        spacing_m = self.posterior.grid.spacing_m
        return max(self.std_m, LEAST_SPREAD * spacing_m if np.isfinite(spacing_m) else 0.0, 1e-6)

    @cached_property
    def _kept(self) -> NDArray[np.int64]:
        """Indices (M,) of the earlier poses that count: the most probable, without FORGOTTEN of the probability."""
        order = np.argsort(-self.posterior.log_p, kind="stable")
        mass = np.cumsum(np.exp(self.posterior.log_p[order]))
        return order[: int(np.searchsorted(mass, 1.0 - FORGOTTEN)) + 1]

    @cached_property
    def _moved(self) -> PoseGrid:
        earlier = self.posterior.grid
        return PoseGrid(self.T_new_old @ earlier.T_sensor_object[self._kept], earlier.metric)

    def _sum_kernels(self, T_sensor_object: Poses) -> Iterator[tuple[slice, Array]]:
        """Yield slices of poses (N, 4, 4), each near some kernel, with the log of the sum of kernels.

        log p_j - |x - y_j|^2 / (2 s^2) is one matrix product: [x, 1, -|x|^2 / 2] times [y_j, log p_j - |y_j|^2 / 2, 1].
        """
        metric = self.posterior.grid.metric
        y = metric.embed_orbits(self._moved.T_sensor_object)[0]
        centre_m = y.mean(axis=0)
        y = (y - centre_m) / self.spread_m
        half = self.posterior.log_p[self._kept] - 0.5 * (y**2).sum(axis=1)
        kernels = np.column_stack([y, half, np.ones(len(y))]).T
        step = max(1, PAIRS // len(y))
        for start in range(0, len(T_sensor_object), step):
            some = slice(start, start + step)
            x = (metric.embed_orbits(T_sensor_object[some]) - centre_m) / self.spread_m
            ones, less = np.ones((*x.shape[:2], 1)), -0.5 * (x**2).sum(axis=2, keepdims=True)
            log_terms = (np.concatenate([x, ones, less], axis=2) @ kernels).max(axis=0)  # the nearest equivalent's
            yield some, np.log(np.exp(np.maximum(log_terms, NOTHING)).sum(axis=1))


def count_touches(prior: Prior | None) -> int:
    """Return the number of touches that a prior was learned from; 0 if it does not tell."""
    return prior.touches if isinstance(prior, PosePrior) else 0


def temper(prior: Prior, power: Callable[[int], float]) -> Prior:
    """Return a prior, with what it learned from N touches raised to `power(N)`; unchanged if it does not tell N."""
    return prior.temper(power) if isinstance(prior, PosePrior) else prior


def _require_numbers(values: ArrayLike, what: str) -> Array:
    found = np.array(values, dtype=np.float64)
    if found.shape != (3,) or np.isnan(found).any():
        raise ConfigError(f"{what} is {values!r}; give three numbers")
    return found


__getattr__ = make_getattr(__name__)
