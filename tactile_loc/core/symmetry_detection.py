"""Which rotations map an object's surface onto itself: found from the mesh, or checked when declared."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import SymmetryError
from tactile_loc.core.geometry import rotation_about
from tactile_loc.core.symmetry import MAX_ORDER, SymmetryGroup, SymmetryTerm, axis_name, close_rotations
from tactile_loc.core.symmetry_surface import SurfaceProbe

_logger = logging.getLogger(__name__)

_IGNORED = 1e-3  # the fraction of the surface that may lie farther off than the tolerance: stray triangles
_EQUAL_MOMENTS = 0.06
_VERIFY_STEP_RAD = math.radians(16.0)
_VERIFY_EVALUATIONS = 40_000
_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))  # its multiples meet no finite group
_SCAN_ORDERS = (2, 3, 5, 7)
_LETTER_WEIGHTS = (1.002, 1.001, 1.0)  # of equivalent half turns, that about x is named before y and z


def detect_symmetry(
    vertices_m: NDArray[np.float64], faces: NDArray[np.int64], tolerance_m: float | None = None, seed: int = 0
) -> SymmetryGroup:
    """Return the rotations about the surface's centroid that map the surface of a mesh onto itself.

    `vertices_m` (V, 3), `faces` (F, 3). A rotation counts if all of the rotated surface but a thousandth lies within
    `tolerance_m` of the surface, and its rms distance within half of that; the default is
    `SurfaceProbe.default_tolerance_m`. Axes of up to 60-fold symmetry and continuous ones are found. A sphere is
    reported as a cylinder, with a warning. `seed` draws the surface points that are looked at. Raises ObjectError for
    a mesh without a surface.
    """
    probe = SurfaceProbe(vertices_m, faces, seed)
    search = _Search(probe, probe.default_tolerance_m() if tolerance_m is None else tolerance_m)
    moments_m2, axes = np.linalg.eigh(probe.covariance_m2())
    equal = np.diff(moments_m2) < _EQUAL_MOMENTS * moments_m2[2]
    if equal.all():
        terms = search.terms_anywhere(axes.T)
    elif equal.any():
        terms = search.terms_about(axes[:, 2] if equal[0] else axes[:, 0])
    else:
        terms = [(axis, 2.0) for axis in axes.T if search.is_symmetry(axis, math.pi)]
    return search.group(terms)


def verify_symmetry(
    group: SymmetryGroup, vertices_m: NDArray[np.float64], faces: NDArray[np.int64], tolerance_m: float | None = None
) -> float:
    """Return how far, in metres, the surface lies from itself under the worst of the group's elements.

    `vertices_m` (V, 3), `faces` (F, 3). A thousandth of the surface is left out of account, and a continuous axis is
    sampled. Distances below `tolerance_m` (default as in `detect_symmetry`) may be reported a little too large.
    Raises ObjectError for a mesh without a surface.
    """
    probe = SurfaceProbe(vertices_m, faces)
    return _worst(probe, group, probe.default_tolerance_m() if tolerance_m is None else tolerance_m)[0]


def require_symmetry(
    group: SymmetryGroup, vertices_m: NDArray[np.float64], faces: NDArray[np.int64], tolerance_m: float | None = None
) -> None:
    """Raise SymmetryError if the surface of a mesh differs from itself by more than `tolerance_m` under the group.

    Arguments and default as in `verify_symmetry`; the error says under which turn, by how much and where.
    """
    probe = SurfaceProbe(vertices_m, faces)
    tolerance_m = probe.default_tolerance_m() if tolerance_m is None else tolerance_m
    deviation_m, R, point_m = _worst(probe, group, tolerance_m)
    if deviation_m > tolerance_m:
        place = ", ".join(f"{1e3 * value:.1f}" for value in point_m)
        raise SymmetryError(
            f"The object does not have the symmetry '{group}': the surface differs by {1e3 * deviation_m:.2g} mm after"
            f" {_turn_name(R)}, at ({place}) mm, and the tolerance is {1e3 * tolerance_m:.2g} mm; correct the"
            " symmetry, or declare none."
        )


def _worst(
    probe: SurfaceProbe, group: SymmetryGroup, tolerance_m: float
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Return the largest deviation over the elements, the element's rotation (3, 3), and where in the object frame."""
    T_object_object = group.elements(_VERIFY_STEP_RAD)
    points_m = probe.points_m[: _VERIFY_EVALUATIONS // len(T_object_object)] + probe.centre_m
    worst = (0.0, np.eye(3), probe.centre_m)
    for T in T_object_object[1:]:
        mapped_m = points_m @ T[:3, :3].T + T[:3, 3]
        distance_m = probe.distance_m(mapped_m - probe.centre_m, tolerance_m)
        index = np.argsort(distance_m)[_kept(len(distance_m)) - 1]
        if distance_m[index] > worst[0]:
            worst = (float(distance_m[index]), T[:3, :3], mapped_m[index])
    return worst


def _kept(count: int) -> int:
    return count - int(count * _IGNORED)


class _Search:
    """Looks for symmetry axes through the centroid of a surface, given the tolerance."""

    def __init__(self, probe: SurfaceProbe, tolerance_m: float) -> None:
        self._probe = probe
        self._tolerance_m = tolerance_m

    def group(self, candidates: Iterable[tuple[NDArray[np.float64], float]]) -> SymmetryGroup:
        """Return the group of those candidate (axis, order) that hold together with the ones before, higher first."""
        group = SymmetryGroup(self._probe.centre_m)
        for term in sorted((self._term(*candidate) for candidate in candidates), key=_by_order_and_letter):
            if math.isinf(group.order):
                larger = SymmetryGroup(self._probe.centre_m, (*group.terms, term))
            elif math.isinf(term.order):
                larger = SymmetryGroup(self._probe.centre_m, (term,))
            else:
                rotations = close_rotations([t.rotation for t in (*group.terms, term)])
                if rotations is None or len(rotations) == group.order:
                    continue
                larger = SymmetryGroup(self._probe.centre_m, (*group.terms, term))
            if _worst(self._probe, larger, self._tolerance_m)[0] <= self._tolerance_m:
                group = larger
        return group

    def is_symmetry(self, axis: NDArray[np.float64], angle_rad: float) -> bool:
        """Say whether a turn maps the surface onto itself, within the tolerance."""
        R = rotation_about(axis, angle_rad)
        few_m = self._probe.distance_m(self._probe.points_m[:150] @ R.T, math.inf)
        if np.count_nonzero(few_m > 2.0 * self._tolerance_m) > 10:
            return False
        distance_m = self._probe.distance_m(self._probe.points_m @ R.T, self._tolerance_m)
        kept_m = np.sort(distance_m)[: _kept(len(distance_m))]
        return bool(kept_m[-1] <= self._tolerance_m and np.mean(kept_m**2) <= (0.5 * self._tolerance_m) ** 2)

    def order_about(self, axis: NDArray[np.float64], multiple_of: int = 1) -> float:
        """Return the order of the symmetry about an axis (3,): math.inf, up to 60, or 1 for none."""
        if all(self.is_symmetry(axis, k * _GOLDEN_RAD) for k in range(1, 7)):
            return math.inf
        largest = MAX_ORDER // 2
        held = [p for p in _primes(largest) if self._has_order(axis, p)]
        for order in range(largest, 1, -1):
            factors = [p for p in _primes(order) if order % p == 0]
            if order % multiple_of == 0 and set(factors) <= set(held) and self._has_order(axis, order):
                return order
        return 1

    def _has_order(self, axis: NDArray[np.float64], order: int) -> bool:
        # a screw thread passes a small turn, so every multiple is looked at, the half turn first
        return all(self.is_symmetry(axis, 2.0 * math.pi * k / order) for k in range(order // 2, 0, -1))

    def terms_about(self, axis: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], float]]:
        """Return the terms about an axis (3,) whose moment stands out, and about one perpendicular to it."""
        order = self.order_about(axis)
        terms = [(axis, order)] if order > 1 else []
        flip = self._flip(axis, order)
        return terms if flip is None else [*terms, (flip, 2.0)]

    def terms_anywhere(self, extra: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], float]]:
        """Return the terms of a surface with three equal moments; `extra` (E, 3) directions are looked at first."""
        if np.ptp(np.linalg.norm(self._probe.points_m, axis=1)) <= self._tolerance_m:
            _logger.warning("The object is a sphere, whose symmetry is not supported: it is treated as a cylinder.")
            return [(np.array([0.0, 0.0, 1.0]), math.inf), (np.array([1.0, 0.0, 0.0]), 2.0)]
        terms: list[tuple[NDArray[np.float64], float]] = []
        points_m = self._probe.points_m[:200]
        for scanned in _SCAN_ORDERS:
            if scanned > 3 and any(order > 2 for _, order in terms):
                break  # half turns and third turns generate all groups but the cyclic and dihedral ones
            for axis in np.concatenate([extra, np.eye(3), self._scan(_hemisphere(1000), scanned, points_m[:50], 14)]):
                if _is_among(terms, axis):
                    continue
                polished = self._polish(axis, 2.0 * math.pi / scanned, points_m)
                if _is_among(terms, polished) or not self.is_symmetry(polished, 2.0 * math.pi / scanned):
                    continue
                order = self.order_about(polished, scanned)
                if math.isinf(order):
                    return self.terms_about(polished)
                terms.append((polished, max(order, scanned)))
        return terms

    def _flip(self, axis: NDArray[np.float64], order: float) -> NDArray[np.float64] | None:
        """Return an axis (3,) of a half turn perpendicular to one of the given order, or None if there is none."""
        u = _perpendicular(axis)
        if math.isinf(order):
            return u if self.is_symmetry(u, math.pi) else None
        # the half turns of a dihedral group repeat every pi / order
        turns = rotation_about(axis, np.linspace(0.0, math.pi / order, 120, endpoint=False))
        points_m = self._telling_points(rotation_about(axis, np.arange(1, 6) * _GOLDEN_RAD) @ u)
        for candidate in self._scan(turns @ u, 2, points_m, 12):
            polished = self._polish(candidate, math.pi, points_m)
            polished = polished - (polished @ axis) * axis
            if self.is_symmetry(polished, math.pi):
                equivalents = rotation_about(axis, np.arange(int(order)) * (math.pi / order)) @ polished
                return equivalents[np.argmax((np.abs(equivalents) * _LETTER_WEIGHTS).max(axis=1))]
        return None

    def _telling_points(self, axes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (200, 3): half anywhere, half where half turns about arbitrary `axes` (K, 3) show most."""
        points_m = self._probe.points_m[:1500]
        turned_m = np.concatenate([points_m @ rotation_about(axis, math.pi).T for axis in axes])
        distance_m = self._probe.distance_m(turned_m, math.inf).reshape(len(axes), -1).max(axis=0)
        return points_m[np.concatenate([np.argsort(distance_m)[-100:], np.arange(100)])]

    def _scan(
        self, directions: NDArray[np.float64], order: int, points_m: NDArray[np.float64], count: int
    ) -> NDArray[np.float64]:
        """Return up to `count` directions (K, 3), some way apart, about which one turn of an order looks best."""
        turned_m = np.concatenate([points_m @ rotation_about(axis, 2.0 * math.pi / order).T for axis in directions])
        distance_m = self._probe.distance_m(turned_m, math.inf, candidates=1)
        scores = np.square(distance_m).reshape(len(directions), -1).mean(axis=1)
        spacing = np.sort(np.abs(directions @ directions[0]))[-min(4, len(directions))]
        chosen: list[NDArray[np.float64]] = []
        for direction in directions[np.argsort(scores)]:
            if len(chosen) < count and all(abs(direction @ other) < spacing for other in chosen):
                chosen.append(direction)
        return np.stack(chosen)

    def _polish(
        self, axis: NDArray[np.float64], angle_rad: float, points_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the axis (3,) tilted so that a turn about it fits the surface best: Gauss-Newton, point to plane.

        A tilt by epsilon turns S into exp(epsilon) S exp(-epsilon), which moves q = S p by ((1 - S) epsilon) x q.
        """
        for _ in range(10):
            R = rotation_about(axis, angle_rad)
            q_m = points_m @ R.T
            residual_m, normals, facing = self._probe.plane_residuals(q_m)
            u = _perpendicular(axis)
            tangents = np.stack([u, np.cross(axis, u)], axis=1)
            jacobian = np.cross(q_m, normals) @ (np.eye(3) - R) @ tangents
            tilt = tangents @ np.linalg.lstsq(jacobian[facing], -residual_m[facing], rcond=1e-6)[0]
            axis = axis + np.cross(tilt, axis) * min(1.0, 0.1 / max(float(np.linalg.norm(tilt)), 1e-12))
            axis = axis / np.linalg.norm(axis)
            if np.linalg.norm(tilt) < 1e-9:
                break
        return axis

    def _term(self, axis: NDArray[np.float64], order: float) -> SymmetryTerm:
        """Return a term about a coordinate axis if it is one within a twentieth of the tolerance."""
        axis = axis / np.linalg.norm(axis)
        main = int(np.argmax(np.abs(axis).round(6)))
        axis = axis * np.sign(axis[main])
        if np.linalg.norm(axis - np.eye(3)[main]) * self._probe.radius_m < 0.05 * self._tolerance_m:
            axis = np.eye(3)[main]
        a, b, c = (round(float(value), 8) + 0.0 for value in axis)
        return SymmetryTerm((a, b, c), order)


def _is_among(terms: list[tuple[NDArray[np.float64], float]], axis: NDArray[np.float64]) -> bool:
    return any(abs(axis @ other) > math.cos(0.06) for other, _ in terms)


def _primes(largest: int) -> list[int]:
    return [p for p in range(2, largest + 1) if all(p % d for d in range(2, math.isqrt(p) + 1))]


def _by_order_and_letter(term: SymmetryTerm) -> tuple[float, bool, str]:
    name = axis_name(term.axis)
    return (-term.order, len(name) > 1, name if len(name) == 1 else "")


def _perpendicular(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a unit vector (3,) perpendicular to an axis: nearly a coordinate axis where it can be."""
    unit = np.eye(3)[np.argmin(np.abs(axis).round(2))]
    u = unit - (unit @ axis) * axis
    return u / np.linalg.norm(u)


def _hemisphere(count: int) -> NDArray[np.float64]:
    """Return directions (count, 3) spread evenly over a half sphere (a Fibonacci spiral)."""
    z = 1.0 - (np.arange(count) + 0.5) / count
    azimuth = np.arange(count) * _GOLDEN_RAD
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def _turn_name(R: NDArray[np.float64]) -> str:
    """Describe a rotation (3, 3) as 'a turn of 60 deg about z'."""
    angle_rad = math.acos(float(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if np.linalg.norm(axis) < 1e-6:  # a half turn: R + 1 = 2 a a^T
        axis = (R + np.eye(3))[np.argmax(np.diag(R))]
    axis = (axis / np.linalg.norm(axis)).round(3) + 0.0
    if axis[np.argmax(np.abs(axis))] < 0:
        axis, angle_rad = -axis + 0.0, 2.0 * math.pi - angle_rad
    return f"a turn of {math.degrees(angle_rad):.4g} deg about {axis_name(axis)}"
