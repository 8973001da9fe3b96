"""Rotational symmetry groups of objects, which are read from text, and tests for poses that are equal by symmetry."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from tactile_loc.core.geometry.rigid import Bools, Floats, make_transform, rotation_about
from tactile_loc.core.runtime.errors import SymmetryError

MAX_ORDER = 120
"""Largest order of a finite group: that of a 60-sided prism, and twice that of the icosahedron's rotations."""

_TERM = re.compile(r"(?:([xyz])|axis\(([^()]*)\))(\d+|inf)")
_SAME_RAD = 1e-2  # tolerance for rounded axes; different elements of a group are 0.05 rad apart
_TIE = 1e-9
_REFERENCE_ROTVEC = (0.3721, -0.8147, 1.1369)  # not on a symmetry plane of any usual object
_REFERENCE = rotation_about(_REFERENCE_ROTVEC, np.linalg.norm(_REFERENCE_ROTVEC))


@dataclass(frozen=True)
class SymmetryTerm:
    """One generator: the rotations by multiples of 2 pi / `order` about `axis` (3,), in the object frame.

    An order of math.inf means rotations by any angle.
    """

    axis: tuple[float, float, float]
    order: float

    @property
    def unit_axis(self) -> Floats:
        """The axis (3,) as a unit vector."""
        axis = np.array(self.axis, dtype=np.float64)
        return axis / np.linalg.norm(axis)

    @property
    def rotation(self) -> Floats:
        """The smallest rotation (3, 3) of a finite term."""
        return rotation_about(self.axis, 2.0 * math.pi / self.order)

    def __str__(self) -> str:
        return name_axis(self.axis) + ("inf" if math.isinf(self.order) else str(int(self.order)))


def name_axis(axis: ArrayLike) -> str:
    """Return the name of an axis (3,): x, y or z for a positive coordinate axis, else axis(a,b,c) with nine digits."""
    a = np.asarray(axis, dtype=np.float64)
    for letter, unit in zip("xyz", np.eye(3), strict=True):
        if np.array_equal(a, unit):
            return letter
    return "axis(" + ",".join(f"{component:.9g}" for component in a + 0.0) + ")"


def close_rotations(generators: Sequence[Floats]) -> Floats | None:
    """Return all products (K, 3, 3) of generators (3, 3), the identity first; None if there are over MAX_ORDER."""
    found = [np.eye(3)]
    for rotation in found:  # the list grows during the loop
        for generator in generators:
            product = rotation @ generator
            traces = np.einsum("kij,ij->k", np.stack(found), product)
            if traces.max() < 1.0 + 2.0 * math.cos(_SAME_RAD):
                found.append(product)
        if len(found) > MAX_ORDER:
            return None
    return np.stack(found)


@dataclass(frozen=True, eq=False)
class SymmetryGroup:
    """The proper rotations about `centre_m` (3,) in the object frame that map an object onto itself.

    Without a `continuous_axis` (3,), the group's elements are `rotations` (K, 3, 3), the identity first. With a
    continuous axis, the elements are the products of `rotations` and all rotations about this axis. If the object
    `is_sphere`, the elements are all rotations; it also has a continuous axis, which is one of many. Raises
    SymmetryError if the terms generate more than MAX_ORDER rotations.
    """

    centre_m: Floats
    terms: tuple[SymmetryTerm, ...] = ()
    rotations: Floats = field(init=False, repr=False)
    continuous_axis: Floats | None = field(init=False, repr=False)
    is_sphere: bool = field(init=False, repr=False)

    def __post_init__(self) -> None:
        centre_m = np.array(self.centre_m, dtype=np.float64)
        if centre_m.shape != (3,) or not np.isfinite(centre_m).all():
            raise SymmetryError(f"the centre of a symmetry is {self.centre_m!r}; give three finite numbers in metres")
        axis = next((term.unit_axis for term in self.terms if math.isinf(term.order)), None)
        flips = None if axis is None else _list_flips(self.terms, axis)
        is_sphere = axis is not None and flips is None
        object.__setattr__(self, "is_sphere", is_sphere)
        rotations = close_rotations([term.rotation for term in self.terms]) if axis is None else flips
        if rotations is None and not is_sphere:
            raise SymmetryError(
                f"the symmetry '{self}' has more than {MAX_ORDER} rotations; correct an axis or an order"
            )
        rotations = np.eye(3)[None] if rotations is None else rotations
        for name, value in (("centre_m", centre_m), ("rotations", rotations), ("continuous_axis", axis)):
            object.__setattr__(self, name, value)

    @classmethod
    def parse(cls, text: str, centre_m: ArrayLike) -> SymmetryGroup:
        """Read `none`, `sphere`, or terms joined by `*`: each has an axis, such as x or axis(1,1,0), and an order.

        An order is 2, 3, ... or inf. Examples: `z6` has six rotations about z, `zinf*x2` is a cylinder, `x2*y2` is a
        box, and `zinf*xinf` is a sphere. `centre_m` (3,), metres, in the object frame, is the point where all axes
        meet. Raises SymmetryError if the text cannot be read, or if the terms generate too many rotations.
        """
        cleaned = re.sub(r"\s+", "", text).lower()
        cleaned = "zinf*xinf" if cleaned == "sphere" else cleaned
        terms = () if cleaned == "none" else tuple(_parse_term(term, text) for term in cleaned.split("*"))
        return cls(np.asarray(centre_m, dtype=np.float64), terms)

    def __str__(self) -> str:
        return "sphere" if self.is_sphere else "*".join(map(str, self.terms)) or "none"

    @property
    def order(self) -> float:
        """The number of rotations: an int, or math.inf if there is a continuous axis."""
        return len(self.rotations) if self.continuous_axis is None else math.inf

    @property
    def is_trivial(self) -> bool:
        """True if the identity is the only element."""
        return self.order == 1

    def list_elements(self, max_step_rad: float = math.radians(10.0)) -> Floats:
        """Return all elements as transforms T_object_object (K, 4, 4), metres, the identity first.

        A continuous axis is sampled at equal steps of at most `max_step_rad`. Their number is even, so that half turns
        are included. A sphere is sampled by the 60 rotations of an icosahedron, whatever the step. Raises SymmetryError
        if `max_step_rad` is not positive.
        """
        R = self._sample_rotations(max_step_rad)
        return make_transform(R, self.centre_m - R @ self.centre_m)

    def list_half_steps(self) -> Floats:
        """Return the turns by half a step of each rotational symmetry, as transforms T_object_object (K, 4, 4), metres.

        A part whose symmetry is broken by one feature, such as the socket of a screw, looks almost the same after them.
        Half a turn has none.
        """
        finite = [term for term in self.terms if 2 < term.order < math.inf]
        if not finite or self.continuous_axis is not None:
            return np.empty((0, 4, 4))
        R = np.stack([rotation_about(term.axis, math.pi / term.order) for term in finite])
        return make_transform(R, self.centre_m - R @ self.centre_m)

    def is_representative(self, R: Floats, step_rad: float | None = None) -> Bools:
        """Return which rotations R_sensor_object (N, 3, 3) represent their equivalents {R S : S in group}, as (N,).

        The representative is the equivalent nearest to a fixed rotation (a Dirichlet domain). If several are equally
        near, all of them count, so that no pose is lost. Use this method only for sets that contain all equivalents of
        each rotation, such as a grid over all of SO(3).

        For a continuous axis, give `step_rad`, the spacing of the rotations about this axis. A rotation then counts if
        it is within half a step of the nearest equivalent. Raises SymmetryError if `step_rad` is needed but not given.
        For a sphere, one of the rotations counts.
        """
        if self.is_sphere:
            return np.arange(len(R)) == np.einsum("ij,nij->n", _REFERENCE, R).argmax()
        nearness, angle_rad = self._measure_nearness(R)
        is_nearest = nearness[:, 0] >= nearness.max(axis=1) - _TIE
        if self.continuous_axis is None:
            return is_nearest
        if step_rad is None or not step_rad > 0:
            raise SymmetryError(f"the symmetry '{self}' is continuous; give a positive step_rad of the rotations")
        half_step_rad = step_rad / 2.0
        return is_nearest & (angle_rad[:, 0] > -half_step_rad) & (angle_rad[:, 0] <= half_step_rad)

    def measure_least_angle(self, R_reference: Floats, R: Floats) -> Floats:
        """Return the least angle (N,), radians, from R_reference (3, 3) to the equivalents of rotations R (N, 3, 3)."""
        if self.is_sphere:
            return np.zeros(len(R))
        nearness, _ = self._measure_nearness(R, R_reference)  # a trace is 1 + 2 cos(angle)
        return np.arccos(np.clip(0.5 * (nearness.max(axis=1) - 1.0), -1.0, 1.0))

    def _sample_rotations(self, max_step_rad: float) -> Floats:
        if not max_step_rad > 0:
            raise SymmetryError(f"the step along a continuous symmetry is {max_step_rad} rad; give a positive number")
        if self.is_sphere:
            return _list_icosahedral_rotations()
        if self.continuous_axis is None:
            return self.rotations
        count = 2 * math.ceil(math.pi / max_step_rad - 1e-9)
        about_axis = rotation_about(self.continuous_axis, np.arange(count) * (2.0 * math.pi / count))
        return (self.rotations[:, None] @ about_axis[None]).reshape(-1, 3, 3)

    def _measure_nearness(self, R: Floats, R_ref: Floats | None = None) -> tuple[Floats, Floats]:
        """Return the largest tr(R_ref^T R S_k R_axis(angle)) over angles about the continuous axis, (N, K).

        Also return the angles (N, K) at which it occurs.
        """
        A = (_REFERENCE if R_ref is None else R_ref).T @ np.asarray(R, dtype=np.float64)
        if self.continuous_axis is None:
            nearness = A.reshape(-1, 9) @ self.rotations.transpose(0, 2, 1).reshape(-1, 9).T
            return nearness, np.zeros_like(nearness)
        A = A[:, None] @ self.rotations
        along = np.einsum("i,nkij,j->nk", self.continuous_axis, A, self.continuous_axis)
        cosine = np.trace(A, axis1=2, axis2=3) - along
        sine = np.einsum("nkij,ji->nk", A, rotation_about(self.continuous_axis, math.pi / 2)) - along
        return along + np.hypot(cosine, sine), np.arctan2(sine, cosine)


def _parse_term(term: str, text: str) -> SymmetryTerm:
    match = _TERM.fullmatch(term)
    components = _parse_axis(match) if match else None
    if match is None or components is None:
        raise SymmetryError(
            f"the symmetry '{text}' cannot be read at '{term}'; give auto, none, sphere, or terms joined by *, such as "
            "z6 (1/6 turns about z), zinf (round about z) or axis(1,1,0)2"
        )
    order = math.inf if match[3] == "inf" else int(match[3])
    if order < 2:
        raise SymmetryError(f"the order of '{term}' in the symmetry '{text}' is below 2; give 2 or more, or inf")
    return SymmetryTerm(components, order)


def _parse_axis(match: re.Match[str]) -> tuple[float, float, float] | None:
    if match[1]:
        return (float(match[1] == "x"), float(match[1] == "y"), float(match[1] == "z"))
    try:
        a, b, c = (float(part) for part in match[2].split(","))
    except ValueError:
        return None
    length = math.hypot(a, b, c)
    return (a, b, c) if math.isfinite(length) and length > 1e-12 else None


@lru_cache(maxsize=1)
def _list_icosahedral_rotations() -> Floats:
    """Return the rotations (60, 3, 3) of an icosahedron, the identity first."""
    five, three = SymmetryTerm((0.0, 1.0, (1.0 + math.sqrt(5.0)) / 2.0), 5), SymmetryTerm((1.0, 1.0, 1.0), 3)
    rotations = close_rotations([five.rotation, three.rotation])
    assert rotations is not None
    return rotations


def _list_flips(terms: Sequence[SymmetryTerm], axis: Floats) -> Floats | None:
    """Return the identity and, if a term has one, a half turn perpendicular to the continuous axis: (1 or 2, 3, 3).

    Any other term makes the object a sphere. Then the result is None.
    """
    rotations = [np.eye(3)]
    for term in terms:
        along = float(term.unit_axis @ axis)
        if abs(along) > math.cos(_SAME_RAD):
            continue  # the term is about the continuous axis itself
        if term.order != 2 or abs(along) > _SAME_RAD:
            return None
        rotations[1:] = [rotation_about(term.unit_axis - along * axis, math.pi)]
    return np.stack(rotations)
