"""Priors: log-weights of poses from vision, a list, a region, an earlier posterior, or several of these.

Any callable that maps poses (N, 4, 4), metres, to log-weights (N,) is a prior. Only differences between log-weights
count. The priors of this module have options, and can be converted from the base frame to the sensor frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tactile_loc.core.geometry.rigid import Floats, Ints, Poses, align_to_z, invert, make_transform, require_rigid
from tactile_loc.core.objects.symmetry import SymmetryGroup
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.runtime.errors import ConfigError

ELSEWHERE = 1e-2  # weight of a pose far from all hypotheses; one with the probability 1 has the weight 1
FAR = 1e-6  # weight below which a pose belongs to no hypothesis
FORGOTTEN = 1e-6  # the least probable poses of a posterior, which together have this probability, are ignored
KERNEL_RADII = 6.0  # standard deviations beyond which a kernel counts as zero (e^-18)
LEAST_SPREAD = 0.5  # grid spacings; the median distance of the true pose from the nearest grid pose
NOTHING = -100.0  # least log of a kernel; its exponential is negligible, and exponentials of smaller numbers are slow
PAIRS = 500_000  # largest number of pairs of poses and kernels computed at once

Prior = Callable[[Poses], Floats]


class PosePrior(ABC):
    """Base class for priors over poses in the sensor frame. `view_from` converts a prior over base-frame poses."""

    @abstractmethod
    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return log-weights (N,), unitless, of poses (N, 4, 4) in metres; -inf excludes."""

    @property
    def touches(self) -> int:
        """Number of touches behind the prior: 0 unless it is an earlier posterior."""
        return 0

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return the prior with its weights from N earlier touches raised to `power(N)`: see `temperature`."""
        return self

    def list_peaks(self) -> Poses:
        """Return poses (K, 4, 4), metres, that a search must try even if the touch does not suggest them."""
        return np.empty((0, 4, 4))

    def view_from(self, T_base_sensor: Poses) -> SeenFrom:
        """Convert this prior over T_base_object to a prior over T_sensor_object, for a sensor at (4, 4), metres."""
        return SeenFrom(self, T_base_sensor)

    def __mul__(self, other: Prior) -> ProductPrior:
        """Return the product of both priors."""
        return ProductPrior((self, other))


@dataclass(frozen=True, eq=False)
class SeenFrom(PosePrior):
    """A prior over base-frame poses, converted for a sensor at `T_base_sensor` (4, 4), metres.

    The log-weight of a pose is log w(T_base_sensor @ T_sensor_object). Raises ConfigError if `T_base_sensor` is not a
    rigid transform.
    """

    prior: Prior
    T_base_sensor: Poses

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_base_sensor", require_rigid(self.T_base_sensor, "T_base_sensor of a prior"))

    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return the log-weights (N,) of poses (N, 4, 4), metres, in the sensor frame."""
        return self.prior(self.T_base_sensor @ T_sensor_object)

    @property
    def touches(self) -> int:
        """Number of touches behind the prior over base-frame poses."""
        return count_touches(self.prior)

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return this prior with its prior over base-frame poses tempered."""
        return replace(self, prior=temper(self.prior, power))

    def list_peaks(self) -> Poses:
        """Return the peaks (K, 4, 4), metres, of the prior over base-frame poses, in the sensor frame."""
        return invert(self.T_base_sensor) @ list_peaks(self.prior)


@dataclass(frozen=True, eq=False)
class ProductPrior(PosePrior):
    """The product of several priors. A pose's log-weight is the sum of its log-weights in all priors."""

    priors: tuple[Prior, ...]

    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return the sums (N,) of the log-weights of all priors."""
        return np.sum([prior(T_sensor_object) for prior in self.priors], axis=0) + np.zeros(len(T_sensor_object))

    @property
    def touches(self) -> int:
        """Number of touches behind all priors together."""
        return sum(map(count_touches, self.priors))

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return the product of the tempered priors."""
        return ProductPrior(tuple(temper(prior, power) for prior in self.priors))

    def list_peaks(self) -> Poses:
        """Return the peaks (K, 4, 4), metres, of all priors."""
        return np.concatenate([list_peaks(prior) for prior in self.priors])


@dataclass(frozen=True, eq=False)
class GaussianPrior(PosePrior):
    """A Gaussian prior about the pose `T` (4, 4), metres, which may come from vision.

    The log-weight of a pose is -|dt|^2 / (2 s_t^2) - a^2 / (2 s_r^2). The translation dt leads from the origin of the
    object frame at T to the origin at the pose. The angle a is that of the rotation between T and the pose. The
    standard deviations are s_t, `translation_std_m`, and s_r, `rotation_std_rad`; inf means unknown. If the object's
    `symmetry` is given, a is the least angle over all equivalent poses. Then dt is measured at the centre of symmetry,
    which all equivalent poses share. Raises ConfigError if T is not rigid or a standard deviation is not positive.
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

    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return the log-weights (N,), 0 at the pose T."""
        symmetry = self.symmetry or SymmetryGroup(np.zeros(3))
        R, t = T_sensor_object[:, :3, :3], T_sensor_object[:, :3, 3]
        centre_m = self.T[:3, :3] @ symmetry.centre_m + self.T[:3, 3]
        distance_m = np.linalg.norm(R @ symmetry.centre_m + t - centre_m, axis=1)
        angle_rad = symmetry.measure_least_angle(self.T[:3, :3], R)
        with np.errstate(over="ignore"):  # many tiny standard deviations away, the log-weight is -inf
            return -0.5 * ((distance_m / self.translation_std_m) ** 2 + (angle_rad / self.rotation_std_rad) ** 2)


@dataclass(frozen=True, eq=False)
class HypothesesPrior(PosePrior):
    """A list of poses, one of which is probably right, as vision systems return it.

    A pose x has the weight w(x) = sum_k p_k g_k(x) + f. The Gaussian prior g_k of the hypothesis k is 1 at its peak.
    The probabilities p_k, `probabilities` (K,), have the sum 1. The weight f, `floor`, is that of a pose far from all
    hypotheses. It allows that none of them is right. Raises ConfigError if there is no hypothesis, or for numbers that
    are not probabilities.
    """

    hypotheses: tuple[GaussianPrior, ...]
    probabilities: Floats
    floor: float = ELSEWHERE

    def __post_init__(self) -> None:
        found = np.array(self.probabilities, float)
        object.__setattr__(self, "probabilities", found)
        if not self.hypotheses or found.shape != (len(self.hypotheses),):
            raise ConfigError(f"a prior has {len(self.hypotheses)} hypotheses and {found.size} probabilities")
        if not ((found >= 0).all() and np.isclose(found.sum(), 1.0)):
            raise ConfigError(f"the probabilities of hypotheses are {found.tolist()}; give numbers with the sum 1")
        _require_floor(self.floor, "a prior")

    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return the log-weights (N,) of poses (N, 4, 4), metres."""
        return np.logaddexp.reduce(self._list_parts(T_sensor_object, self.floor), axis=0)

    def rank(self, T_sensor_object: Poses, probabilities: Floats) -> Floats:
        """Return the probabilities (K,) that the hypotheses are right, given that one of the located poses is.

        The located poses (N, 4, 4) are in metres, and their `probabilities` (N,) include this prior. Each belongs to a
        hypothesis by the hypothesis' part of its weight, or to none of them if it is far from all. The rest to 1 is the
        probability that no hypothesis is right.
        """
        parts = self._list_parts(T_sensor_object, FAR)
        shares = np.exp(parts - np.logaddexp.reduce(parts, axis=0))
        return np.asarray(shares[:-1] @ (probabilities / np.sum(probabilities)))

    def list_peaks(self) -> Poses:
        """Return the poses (K, 4, 4), metres, of the hypotheses."""
        return np.array([one.T for one in self.hypotheses])

    def _list_parts(self, T_sensor_object: Poses, floor: float) -> Floats:
        """Return the logs (K + 1, N) of the parts of the weights: of each hypothesis, and of the `floor`."""
        with np.errstate(divide="ignore"):
            log_p, log_f = np.log(self.probabilities), np.log(floor)
        kernels = np.array([one(T_sensor_object) for one in self.hypotheses]) + log_p[:, None]
        return np.concatenate([kernels, np.full((1, len(T_sensor_object)), log_f)])


@dataclass(frozen=True, eq=False)
class RegionPrior(PosePrior):
    """The prior that a point of the object lies in a box: log w is 0 if it does, else -inf.

    All lengths are in metres. `point_m` (3,) is the point in the object frame. `low_m` and `high_m` (3,) bound the box
    along the axes of its own frame; -inf or inf leaves a side open. `T_box` (4, 4) maps points from the poses' frame to
    the box's frame. None means that both frames are the same. Raises ConfigError if the box is empty or a value is NaN.
    """

    low_m: Floats
    high_m: Floats
    point_m: Floats
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
        """Return the prior that a point lies on the side of a plane to which the `normal` (3,), unitless, points.

        The plane goes through `border_m` (3,), metres, in the poses' frame. `point_m` (3,), metres, is the point in the
        object frame. Raises ConfigError if the normal has no finite length above 0.
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

    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return log-weights (N,): 0 for poses whose point is in the region or on its border, else -inf."""
        T = T_sensor_object if self.T_box is None else self.T_box @ T_sensor_object
        p = T[:, :3, :3] @ self.point_m + T[:, :3, 3]
        return np.where(((p >= self.low_m) & (p <= self.high_m)).all(axis=1), 0.0, -np.inf)


@dataclass(frozen=True, eq=False)
class PosteriorPrior(PosePrior):
    """An earlier posterior as a prior, after a known motion of the object in the sensor frame.

    A pose x has the weight w(x) = (1 - f) sum_j p_j exp(-d(x, T_new_old x_j)^2 / (2 s^2)) + f / N, raised to `power`.
    The sum is over the N earlier poses x_j with probabilities p_j. The distance d is that of the pose metric, up to
    symmetry.

    `T_new_old` (4, 4), metres, is the motion: T_sensor_object_new = T_new_old @ T_sensor_object_old. For an object at
    rest, the motion is inv(T_base_sensor_new) @ T_base_sensor_old. The kernel's standard deviation s is `std_m`,
    metres, the uncertainty of the motion. It is at least half the spacing of the earlier grid, so that new poses
    between the earlier poses get weight. The share f is `floor`, plus the earlier posterior's `elsewhere`. Raises
    ConfigError if the motion is not rigid, `std_m` is negative or `floor` is not in [0, 1).
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
        _require_floor(self.floor, "a posterior prior")

    def __call__(self, T_sensor_object: Poses) -> Floats:
        """Return the log-weights (N,) of poses (N, 4, 4), metres."""
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
        """Number of touches behind the earlier posterior."""
        return self.posterior.touches

    def temper(self, power: Callable[[int], float]) -> PosePrior:
        """Return this prior with its weights raised to `power(N)`, for the N touches of the earlier posterior."""
        return replace(self, power=power(self.touches))

    @cached_property
    def spread_m(self) -> float:
        """The kernels' standard deviation, metres."""
        spacing_m = self.posterior.grid.spacing_m
        return max(self.std_m, LEAST_SPREAD * spacing_m if np.isfinite(spacing_m) else 0.0, 1e-6)

    @cached_property
    def _kept(self) -> Ints:
        """Indices (M,) of the earlier poses that count: the most probable poses, with all but FORGOTTEN of the mass."""
        order = np.argsort(-self.posterior.log_p, kind="stable")
        mass = np.cumsum(np.exp(self.posterior.log_p[order]))
        return order[: int(np.searchsorted(mass, 1.0 - FORGOTTEN)) + 1]

    @cached_property
    def _moved(self) -> PoseGrid:
        earlier = self.posterior.grid
        return PoseGrid(self.T_new_old @ earlier.T_sensor_object[self._kept], earlier.metric)

    def _sum_kernels(self, T_sensor_object: Poses) -> Iterator[tuple[slice, Floats]]:
        """Yield slices of poses (N, 4, 4), each with the log of the sum of kernels. Every pose must be near a kernel.

        In units of s, the log of a kernel is log p_j - |x - y_j|^2 / 2. All of these logs are one matrix product:
        [x, 1, -|x|^2 / 2] times [y_j, log p_j - |y_j|^2 / 2, 1].
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
            log_terms = (np.concatenate([x, ones, less], axis=2) @ kernels).max(axis=0)  # of the nearest equivalent
            yield some, np.log(np.exp(np.maximum(log_terms, NOTHING)).sum(axis=1))


def count_touches(prior: Prior | None) -> int:
    """Return the number of touches behind a prior. It is 0 if the prior is not a PosePrior."""
    return prior.touches if isinstance(prior, PosePrior) else 0


def list_peaks(prior: Prior) -> Poses:
    """Return the peaks (K, 4, 4), metres, of a prior. There are none if the prior is not a PosePrior."""
    return prior.list_peaks() if isinstance(prior, PosePrior) else np.empty((0, 4, 4))


def temper(prior: Prior, power: Callable[[int], float]) -> Prior:
    """Return a prior with its weights from N earlier touches raised to `power(N)`.

    A prior that is not a PosePrior is returned unchanged.
    """
    return prior.temper(power) if isinstance(prior, PosePrior) else prior


def _require_floor(floor: float, what: str) -> None:
    if not 0 <= floor < 1:
        raise ConfigError(f"the floor of {what} is {floor}; give at least 0 and less than 1")


def _require_numbers(values: ArrayLike, what: str) -> Floats:
    found = np.array(values, dtype=np.float64)
    if found.shape != (3,) or np.isnan(found).any():
        raise ConfigError(f"{what} is {values!r}; give three numbers")
    return found
