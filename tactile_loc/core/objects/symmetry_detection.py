"""Detection of the rotations that map an object's surface onto itself, and verification of declared rotations."""

import math
from collections.abc import Iterable

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, axis_angle, rotation_about
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.objects.symmetry import MAX_ORDER, SymmetryGroup, SymmetryTerm, close_rotations, name_axis
from tactile_loc.core.objects.symmetry_surface import SurfaceProbe
from tactile_loc.core.runtime.errors import SymmetryError

RESOLUTION_M = 5e-5
"""The smallest deviation that a tactile sensor sees, on a patch about half a millimetre wide."""

_IGNORED = 1e-3  # share of the few points that may deviate more; the many points show if it is a feature
_EQUAL_MOMENTS = 0.06
_VERIFY_STEP_RAD = math.radians(16.0)
_VERIFY_EVALUATIONS = 40_000
_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))  # its multiples are not rotations of any finite group
_SCAN_ORDERS = (2, 3, 5, 7)
_LETTER_WEIGHTS = (1.002, 1.001, 1.0)  # of equivalent half-turn axes, x is preferred to y, and y to z


def detect_symmetry(mesh: TriangleMesh, tolerance_m: float = RESOLUTION_M) -> SymmetryGroup:
    """Return the rotations about the surface's centroid that map the surface of a mesh onto itself.

    A rotation does not count if a patch of the rotated
    surface, at least half a millimetre wide, is farther than `tolerance_m` from the surface. A pocket therefore breaks
    the symmetry of a plate of any size. On tessellated curves, the error of the facets is also allowed. Axes with up to
    60-fold symmetry, continuous axes and spheres are found. The drawn surface points are about 0.4 mm apart. There are
    at most 40,000 points.
    """
    probe = SurfaceProbe(mesh)
    search = _Search(probe, tolerance_m)
    moments_m2, axes = np.linalg.eigh(probe.covariance_m2)
    equal = np.diff(moments_m2) < _EQUAL_MOMENTS * moments_m2[2]
    if equal.all():
        terms = search.terms_anywhere(axes.T)
    elif equal.any():
        terms = search.terms_about(axes[:, 2] if equal[0] else axes[:, 0])
    else:
        terms = [(axis, 2.0) for axis in axes.T if search.is_symmetry(axis, math.pi)]
    return search.group(terms)


def require_symmetry(group: SymmetryGroup, mesh: TriangleMesh) -> None:
    """Raise SymmetryError if the surface of a mesh differs from itself too much under the group.

    The tolerance is `SurfaceProbe.declared_tolerance_m`. It is larger than in detection, so that the symmetry of an
    inexact scan can be declared. The error names the rotation, the deviation and the position of the deviation.
    """
    probe = SurfaceProbe(mesh)
    tolerance_m = probe.declared_tolerance_m()
    deviation_m, R, point_m = _find_worst(probe, group, tolerance_m)
    if deviation_m > tolerance_m:
        place = ", ".join(f"{1e3 * value:.1f}" for value in point_m)
        raise SymmetryError(
            f"the object does not have the symmetry '{group}': {_name_rotation(R)} changes its surface by "
            f"{1e3 * deviation_m:.2g} mm at ({place}) mm, and the tolerance is {1e3 * tolerance_m:.2g} mm; correct the "
            "symmetry, or give none"
        )


Deviation = tuple[float, Floats, Floats]  # distance, rotation (3, 3), point (3,)


def _find_worst(probe: SurfaceProbe, group: SymmetryGroup, tolerance_m: float, all_points: bool = True) -> Deviation:
    """Return the largest deviation of the surface, metres, under a group's rotations.

    A few points are mapped by all elements of the group, ignoring the worst thousandth of these points. With
    `all_points`, many points are mapped by the generators, too. These are enough: if an element moves a feature of the
    surface, then so does a generator.
    """
    elements, generators = group.list_elements(_VERIFY_STEP_RAD)[1:, :3, :3], _list_generators(group)
    few, many = probe.few[: _VERIFY_EVALUATIONS // (len(elements) + 1)], probe.many
    worst, shift_m = (0.0, np.eye(3), probe.centre_m), group.centre_m - probe.centre_m
    for number, R in enumerate([*elements, *(generators if all_points else ())]):
        moved = (few if number < len(elements) else many).rotate(R, shift_m)
        if number < len(elements):
            each_m = probe.deviation_m(moved, tolerance_m)
            index = int(np.argsort(each_m)[_count_kept(len(few)) - 1])
            deviation_m = float(each_m[index])
        else:
            deviation_m, index = probe.patch_deviation_m(moved, tolerance_m)
        if deviation_m > worst[0]:
            worst = deviation_m, R, moved.points_m[index] + probe.centre_m
    return worst


def _list_generators(group: SymmetryGroup) -> list[Floats]:
    """Return a group's generators (3, 3) and their inverses. One rotation represents a continuous axis."""
    forward = [rotation_about(t.axis, _GOLDEN_RAD) if math.isinf(t.order) else t.rotation for t in group.terms]
    return [R for one in forward for R in ((one,) if np.allclose(one, one.T) else (one, one.T))]


def _count_kept(count: int) -> int:
    return count - int(count * _IGNORED)


class _Search:
    """A search for symmetry axes through the centroid of a surface, with a given tolerance."""

    def __init__(self, probe: SurfaceProbe, tolerance_m: float) -> None:
        self._probe = probe
        self._tolerance_m = tolerance_m

    def group(self, candidates: Iterable[tuple[Floats, float]]) -> SymmetryGroup:
        """Return the group of those candidates (axis, order) that are compatible, with the highest orders preferred."""
        group = SymmetryGroup(self._probe.centre_m)
        for term in sorted((self._find_term(*candidate) for candidate in candidates), key=_rank_term):
            if math.isinf(group.order):
                larger = SymmetryGroup(self._probe.centre_m, (*group.terms, term))
            elif math.isinf(term.order):
                larger = SymmetryGroup(self._probe.centre_m, (term,))
            else:
                rotations = close_rotations([t.rotation for t in (*group.terms, term)])
                if rotations is None or len(rotations) == group.order:
                    continue
                larger = SymmetryGroup(self._probe.centre_m, (*group.terms, term))
            if _find_worst(self._probe, larger, self._tolerance_m, all_points=False)[0] <= self._tolerance_m:
                group = larger
        return group

    def is_symmetry(self, axis: Floats, angle_rad: float) -> bool:
        """Return whether a rotation about an axis (3,) maps the surface onto itself, within the tolerance."""
        return self._is_nearly_symmetry(axis, angle_rad) and self._has_no_feature(axis, angle_rad)

    def _is_nearly_symmetry(self, axis: Floats, angle_rad: float) -> bool:
        """Return whether a rotation maps a few points of the surface onto the surface, except a thousandth of them."""
        R, few, half_m = rotation_about(axis, angle_rad), self._probe.few, 0.5 * self._tolerance_m
        deviation_m = self._probe.deviation_m(few[:150].rotate(R), half_m, candidates=24)
        if np.count_nonzero(deviation_m > 2.0 * self._tolerance_m) > 10:
            return False
        deviation_m = self._probe.deviation_m(few.rotate(R), half_m)
        kept_m = np.sort(deviation_m)[: _count_kept(len(deviation_m))]
        return bool(kept_m[-1] <= self._tolerance_m and np.mean(kept_m**2) <= half_m**2)

    def _has_no_feature(self, axis: Floats, angle_rad: float) -> bool:
        """Return whether no patch of the surface, rotated in either direction, is beyond the tolerance."""
        angles_rad = (angle_rad,) if angle_rad == math.pi else (angle_rad, -angle_rad)
        rotated = (self._probe.many.rotate(rotation_about(axis, angle)) for angle in angles_rad)
        return not any(self._probe.patch_deviation_m(moved, self._tolerance_m)[0] for moved in rotated)

    def _is_continuous(self, axis: Floats) -> bool:
        """Return whether every rotation about an axis (3,) maps the surface onto itself."""
        angles_rad = [k * _GOLDEN_RAD for k in range(1, 7)]
        return all(self._is_nearly_symmetry(axis, a) for a in angles_rad) and self._has_no_feature(axis, _GOLDEN_RAD)

    def order_about(self, axis: Floats, multiple_of: int = 1) -> float:
        """Return the order of the symmetry about an axis (3,): math.inf, 2 to 60, or 1 without symmetry."""
        if self._is_continuous(axis):
            return math.inf
        largest = MAX_ORDER // 2
        held = [p for p in _list_primes(largest) if self._has_nearly_order(axis, p)]
        for order in range(largest, 1, -1):
            factors = [p for p in _list_primes(order) if order % p == 0]
            possible = order % multiple_of == 0 and set(factors) <= set(held) and self._has_nearly_order(axis, order)
            if possible and self._has_no_feature(axis, 2.0 * math.pi / order):
                return order
        return 1

    def _has_nearly_order(self, axis: Floats, order: int) -> bool:
        # a screw thread passes the test for small angles, so every multiple is tested, the half turn first
        return all(self._is_nearly_symmetry(axis, 2.0 * math.pi * k / order) for k in range(order // 2, 0, -1))

    def terms_about(self, axis: Floats) -> list[tuple[Floats, float]]:
        """Return the terms about an axis (3,) with a distinct moment, and about a perpendicular axis."""
        order = self.order_about(axis)
        terms = [(axis, order)] if order > 1 else []
        flip = self._flip(axis, order)
        return terms if flip is None else [*terms, (flip, 2.0)]

    def terms_anywhere(self, extra: Floats) -> list[tuple[Floats, float]]:
        """Return the terms of a surface with three equal moments. The directions `extra` (E, 3) are tested first."""
        few = self._probe.few
        if all(self._is_continuous(axis) for axis in np.eye(3)):
            return [(axis, math.inf) for axis in np.eye(3)[[2, 0]]]  # a sphere
        terms: list[tuple[Floats, float]] = []
        points_m = few.points_m[:200]
        for scanned in _SCAN_ORDERS:
            if scanned > 3 and any(order > 2 for _, order in terms):
                break  # half turns and third turns generate all groups except cyclic and dihedral groups
            for axis in np.concatenate(
                [extra, np.eye(3), self._scan(_sample_hemisphere(1000), scanned, points_m[:50], 14)]
            ):
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

    def _flip(self, axis: Floats, order: float) -> Floats | None:
        """Return the axis (3,) of a half-turn symmetry that is perpendicular to `axis`, or None if there is none."""
        u = _find_perpendicular(axis)
        if math.isinf(order):
            return u if self.is_symmetry(u, math.pi) else None
        # the half turns of a dihedral group repeat every pi / order
        rotations = rotation_about(axis, np.linspace(0.0, math.pi / order, 120, endpoint=False))
        points_m = self._choose_points(rotation_about(axis, np.arange(1, 6) * _GOLDEN_RAD) @ u)
        for candidate in self._scan(rotations @ u, 2, points_m, 12):
            polished = self._polish(candidate, math.pi, points_m)
            polished = polished - (polished @ axis) * axis
            if self.is_symmetry(polished, math.pi):
                equivalents = rotation_about(axis, np.arange(int(order)) * (math.pi / order)) @ polished
                return equivalents[np.argmax((np.abs(equivalents) * _LETTER_WEIGHTS).max(axis=1))]
        return None

    def _choose_points(self, axes: Floats) -> Floats:
        """Return points (200, 3): half anywhere, half where half turns about `axes` (K, 3) leave the surface most."""
        points_m = self._probe.few.points_m[:1500]
        rotated_m = np.concatenate([points_m @ rotation_about(axis, math.pi).T for axis in axes])
        distance_m = self._probe.distance_m(rotated_m).reshape(len(axes), -1).max(axis=0)
        return points_m[np.concatenate([np.argsort(distance_m)[-100:], np.arange(100)])]

    def _scan(self, directions: Floats, order: int, points_m: Floats, count: int) -> Floats:
        """Return up to `count` clearly different `directions` (K, 3) about which a symmetry of an order fits best."""
        rotated_m = np.concatenate([points_m @ rotation_about(axis, 2.0 * math.pi / order).T for axis in directions])
        distance_m = self._probe.distance_m(rotated_m, candidates=1)
        scores = np.square(distance_m).reshape(len(directions), -1).mean(axis=1)
        spacing = np.sort(np.abs(directions @ directions[0]))[-min(4, len(directions))]
        chosen: list[Floats] = []
        for direction in directions[np.argsort(scores)]:
            if len(chosen) < count and all(abs(direction @ other) < spacing for other in chosen):
                chosen.append(direction)
        return np.stack(chosen)

    def _polish(self, axis: Floats, angle_rad: float, points_m: Floats) -> Floats:
        """Return the axis (3,), tilted so that a rotation about it fits the surface best.

        Gauss-Newton steps reduce the point-to-plane distances. A tilt by epsilon changes the rotation S into
        exp(epsilon) S exp(-epsilon), which moves q = S p by ((1 - S) epsilon) x q.
        """
        for _ in range(10):
            R = rotation_about(axis, angle_rad)
            q_m = points_m @ R.T
            residual_m, normals, facing = self._probe.plane_residuals(q_m)
            u = _find_perpendicular(axis)
            tangents = np.stack([u, np.cross(axis, u)], axis=1)
            jacobian = np.cross(q_m, normals) @ (np.eye(3) - R) @ tangents
            tilt = tangents @ np.linalg.lstsq(jacobian[facing], -residual_m[facing], rcond=1e-6)[0]
            axis = axis + np.cross(tilt, axis) * min(1.0, 0.1 / max(float(np.linalg.norm(tilt)), 1e-12))
            axis = axis / np.linalg.norm(axis)
            if np.linalg.norm(tilt) < 1e-9:
                break
        return axis

    def _find_term(self, axis: Floats, order: float) -> SymmetryTerm:
        """Return the term. If a coordinate axis is within a fifth of the tolerance of `axis`, use that axis instead."""
        axis = axis / np.linalg.norm(axis)
        main = int(np.argmax(np.abs(axis).round(6)))
        axis = axis * np.sign(axis[main])
        if np.linalg.norm(axis - np.eye(3)[main]) * self._probe.radius_m < 0.2 * self._tolerance_m:
            axis = np.eye(3)[main]
        a, b, c = (round(float(value), 8) + 0.0 for value in axis)
        return SymmetryTerm((a, b, c), order)


def _is_among(terms: list[tuple[Floats, float]], axis: Floats) -> bool:
    return any(abs(axis @ other) > math.cos(0.06) for other, _ in terms)


def _list_primes(largest: int) -> list[int]:
    return [p for p in range(2, largest + 1) if all(p % d for d in range(2, math.isqrt(p) + 1))]


def _rank_term(term: SymmetryTerm) -> tuple[float, bool, str]:
    name = name_axis(term.axis)
    return (-term.order, len(name) > 1, name if len(name) == 1 else "")


def _find_perpendicular(axis: Floats) -> Floats:
    """Return a unit vector (3,) that is perpendicular to an axis, and near a coordinate axis if possible."""
    unit = np.eye(3)[np.argmin(np.abs(axis).round(2))]
    u = unit - (unit @ axis) * axis
    return u / np.linalg.norm(u)


def _sample_hemisphere(count: int) -> Floats:
    """Return directions (count, 3) spread evenly over a half sphere (a Fibonacci spiral)."""
    z = 1.0 - (np.arange(count) + 0.5) / count
    azimuth = np.arange(count) * _GOLDEN_RAD
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def _name_rotation(R: Floats) -> str:
    """Describe a rotation (3, 3), for instance as 'a rotation of 60 deg about z'."""
    angle_deg, axis = axis_angle(R)
    axis = axis.round(3) + 0.0
    if axis[np.argmax(np.abs(axis))] < 0:
        axis, angle_deg = -axis + 0.0, 360.0 - angle_deg
    return f"a rotation of {angle_deg:.4g} deg about {name_axis(axis)}"
