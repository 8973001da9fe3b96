"""The mechanics of the gel: how an elastic layer deforms under a rigid object, and where it touches the object.

Let d be the reach of a rigid object into the undeformed gel, u the displacement of the gel's surface, and p the
pressure. Frictionless contact satisfies u >= d, p >= 0 and p (u - d) = 0, with u = F^-1[C F[p]] (F: Fourier transform).
C is the compliance of a layer bonded to a rigid plate (Carbone and Mangialardi, J. Mech. Phys. Solids 56, 2008), or of
a half-space. At a given indentation, u does not depend on the stiffness, so p is in units of the shear modulus.

The solver is the constrained conjugate-gradient method of Polonsky and Keer (Wear 231, 1999) without its load
constraint, for many objects at a time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Float32, Floats
from tactile_loc.core.runtime.errors import SensorError

GelKind = Literal["rigid", "layer"]
FAR_M = np.float32(-1.0)  # reach of an object that is nowhere near a pixel
THINNEST_M = 2e-4
LEAST_K = 1e-4  # wave number times thickness, below which the limit is used
DEFAULT_THICKNESS_M = 4e-3  # of a layer whose thickness is unknown
RESOLVED_PX = 4  # thickness, pixels, from which displacements around a point load are smooth enough to be sampled
FARTHEST = 10.0  # thicknesses beyond which a layer does not move
STEEPEST, PLATE_NODES = 20.0, 320  # wave number times thickness at which the plate has no effect; nodes of integration
COMPARED = 0.5  # share of the press
SOLVER_VERSION = 2  # increase if the same object gives another surface of the gel
ITERATIONS = 3  # leave a few micrometres for a press of 0.6 mm: see docs/method-gel.md


@dataclass(frozen=True)
class Gel:
    """The gel's elasticity: a layer of `thickness_m` metres (inf: a half-space) with Poisson's ratio `poisson`.

    A rigid gel (thickness None) shows the object where it would penetrate the undeformed surface. The camera sees the
    underside of a coating, `coating_m` metres below the gel's surface, at which the displacement is smoother. Raises
    SensorError for impossible values.
    """

    thickness_m: float | None = None
    poisson: float = 0.48
    coating_m: float = 0.0

    def __post_init__(self) -> None:
        if self.thickness_m is not None and not THINNEST_M <= self.thickness_m <= math.inf:
            raise SensorError(
                f"the gel is {self.thickness_m * 1e3:g} mm thick; give its thickness in mm, at least "
                f"{THINNEST_M * 1e3:g} mm"
            )
        if not 0 <= self.poisson < 0.5:
            raise SensorError(f"the gel's Poisson's ratio is {self.poisson:g}; give at least 0 and less than 0.5")
        if not 0 <= self.coating_m < (self.thickness_m or math.inf):
            raise SensorError(
                f"the gel's coating is {self.coating_m * 1e3:g} mm thick; give at least 0 mm and less than the gel's "
                "own thickness"
            )

    @property
    def is_elastic(self) -> bool:
        """Whether the gel is an elastic layer or half-space."""
        return self.thickness_m is not None

    @property
    def kind(self) -> GelKind:
        """The kind of gel, as in files: "rigid", or "layer" for an elastic layer or half-space."""
        return "layer" if self.is_elastic else "rigid"

    @property
    def compared_share(self) -> float:
        """The share of the press, from the deepest point, up to which touches and poses are compared.

        Farther up, an elastic gel shows mostly its own slope beside the contact.
        """
        return COMPARED if self.is_elastic else 1.0

    def describe(self) -> dict[str, Any]:
        """Return what identifies the gel, as JSON values."""
        thickness_m = "inf" if self.thickness_m == math.inf else self.thickness_m
        coating = {"coating_m": self.coating_m} if self.coating_m else {}
        return {"thickness_m": thickness_m, "poisson": self.poisson if self.is_elastic else None, **coating}

    @classmethod
    def of_description(cls, described: dict[str, Any]) -> Gel:
        """Return the gel that `describe` describes."""
        if described["thickness_m"] is None:
            return RIGID
        return cls(float(described["thickness_m"]), described["poisson"], described.get("coating_m", 0.0))


RIGID = Gel()


class Contact(NamedTuple):
    """Contacts of N objects: displacements of the gel's surface (N, H, W), metres, and pressures (N, H, W).

    Displacements are towards the sensor; beside a contact, a nearly incompressible gel bulges, so they may be negative.
    Pressures are in units of the gel's shear modulus.
    """

    displacement_m: Float32
    pressure: Float32


class GelSolver:
    """Solves contacts on a window of `shape` (H, W) pixels with `pitch_m` (x, y) metres; `make_solver` keeps solvers.

    The window is `padded` to twice its size (rows, columns), because the Fourier transform repeats it. `compliance` is
    the transform of the displacements under a unit pressure at one pixel, metres. They do not repeat either, so a gel
    may be thicker than the window is wide. Only layers thinner than RESOLVED_PX pixels have a repeated response.
    """

    def __init__(self, gel: Gel, shape: tuple[int, int], pitch_m: tuple[float, float]) -> None:
        from scipy import fft

        if gel.thickness_m is None:
            raise SensorError("a rigid gel has no elastic contact; give the sensor's gel a thickness")
        self.shape = shape
        self.padded = (fft.next_fast_len(2 * shape[0], real=True), fft.next_fast_len(2 * shape[1], real=True))
        if gel.thickness_m < RESOLVED_PX * max(pitch_m):
            compliance = compute_compliance(np.hypot(*list_wave_numbers(self.padded, pitch_m)), gel)
        else:
            compliance = _transform_point_loads(self.padded, pitch_m, gel)
        self.compliance = compliance.astype(np.float32)

    def displace(self, pressure: Float32) -> Float32:
        """Return the displacements (N, H, W), metres, under pressures (N, H, W), unitless."""
        from scipy import fft

        spectrum = fft.rfft2(pressure, self.padded, axes=(-2, -1))
        spectrum *= self.compliance
        moved: Float32 = fft.irfft2(spectrum, self.padded, axes=(-2, -1))
        return moved[..., : self.shape[0], : self.shape[1]]

    def press(self, reach_m: Float32, iterations: int = ITERATIONS) -> Contact:
        """Press rigid objects with reaches (N, H, W), metres, into the gel; where a reach is -inf, nothing touches."""
        d = np.maximum(np.asarray(reach_m, np.float32), FAR_M)
        p: NDArray[Any] = np.maximum(d, np.float32(0))
        u: NDArray[Any] = self.displace(p)
        k = _sum(p * p) / np.maximum(_sum(p * u), np.float32(1e-30))  # the best multiple of the reach
        p, u = p * k, u * k
        along: NDArray[Any] = np.zeros_like(p)
        last: NDArray[Any] = np.ones_like(_sum(p))
        keep: NDArray[Any] = np.zeros_like(last)
        for _ in range(iterations):
            gap, touching = u - d, p > 0
            descent = np.where(touching, gap, np.float32(0))
            size = _sum(descent * descent)
            along = descent + keep * size / np.maximum(last, np.float32(1e-30)) * np.where(touching, along, 0)
            step = _sum(descent * along) / np.maximum(_sum(self.displace(along) * along), np.float32(1e-30))
            pierced = ~touching & (gap < 0)  # the object is below the surface without pressing it
            p = np.asarray(np.maximum(np.where(pierced, -step * gap, p - step * along), np.float32(0)))
            last, keep = size, np.asarray(~pierced.any(axis=(-2, -1), keepdims=True), np.float32)
            u = self.displace(p)
        return Contact(u, p)


make_solver = lru_cache(maxsize=32)(GelSolver)


def compute_compliance(q: Floats, gel: Gel) -> Floats:
    """Return the compliance times the shear modulus (...), metres, of a bonded layer at wave numbers (...), rad/m.

    Carbone and Mangialardi (2008), equation A.30, with exponentials that do not overflow.
    """
    t, nu = float(gel.thickness_m or 0.0), gel.poisson
    k = q * t
    decay = np.exp(-2 * k)
    above = (3 - 4 * nu) * (1 - decay**2) - 4 * k * decay
    below = (3 - 4 * nu) * (1 + decay**2) + 2 * decay * (2 * k**2 + 5 - 12 * nu + 8 * nu**2)
    uniform = t * (1 - 2 * nu) / (2 * (1 - nu))  # the limit for q = 0
    return np.asarray(np.where(k > LEAST_K, (1 - nu) / np.where(q > 0, q, 1.0) * above / below, uniform))


def compute_smoothing(q: Floats, gel: Gel) -> Floats:
    """Return the displacement below the coating as a share (...) of the surface's, at wave numbers (...), rad/m.

    It is that in a half-space under normal pressure: Johnson, Contact Mechanics (1985), section 3.2, transformed.
    """
    k = q * gel.coating_m
    return np.asarray((1 + k / (2 * (1 - gel.poisson))) * np.exp(-k))


def list_wave_numbers(shape: tuple[int, int], pitch_m: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return the wave numbers along x (1, W / 2 + 1) and y (H, 1), rad/m, of a real transform of `shape` (H, W)."""
    qx, qy = np.fft.rfftfreq(shape[1], pitch_m[0]), np.fft.fftfreq(shape[0], pitch_m[1])
    return np.asarray(2 * np.pi * qx[None], float), np.asarray(2 * np.pi * qy[:, None], float)


def _transform_point_loads(shape: tuple[int, int], pitch_m: tuple[float, float], gel: Gel) -> Floats:
    """Return the transform of a gel's displacements, metres, around a pixel under unit pressure.

    The padded window holds every distance between two pixels, so there are no repeated contacts, however thick the gel
    is. Half-space: Johnson, Contact Mechanics (1985), equation 3.25.
    """
    x = np.asarray(np.fft.fftfreq(shape[1], 1 / shape[1]), float)[None] * pitch_m[0]
    y = np.asarray(np.fft.fftfreq(shape[0], 1 / shape[0]), float)[:, None] * pitch_m[1]
    total = np.zeros(shape)
    for right, down, sign in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        u, v = x + right * pitch_m[0] / 2, y + down * pitch_m[1] / 2
        total += sign * (u * np.arcsinh(v / np.abs(u)) + v * np.arcsinh(u / np.abs(v)))
    moved_m = (1 - gel.poisson) / (2 * np.pi) * total
    if gel.thickness_m is not None and math.isfinite(gel.thickness_m):
        away = np.hypot(x, y) / gel.thickness_m
        plate = np.interp(away, *_compute_plate_effect(gel.poisson)) * pitch_m[0] * pitch_m[1] / gel.thickness_m
        moved_m = np.where(away < FARTHEST, moved_m + plate, 0.0)
    return np.asarray(np.fft.rfft2(moved_m).real)


@lru_cache(maxsize=8)
def _compute_plate_effect(poisson: float) -> tuple[Floats, Floats]:
    """Return distances from a point load, and there a layer's displacement minus a half-space's, in thicknesses.

    The load has the size of the shear modulus times the squared thickness. The difference of both compliances is
    integrated: a Hankel transform. It vanishes for wave numbers above STEEPEST over the thickness.
    """
    from scipy.special import j0

    nodes, weights = np.polynomial.legendre.leggauss(PLATE_NODES)
    k = STEEPEST / 2 * (nodes + 1)
    difference = k * compute_compliance(k, Gel(1.0, poisson)) - (1 - poisson)
    away = np.linspace(0.0, FARTHEST, PLATE_NODES)
    return away, j0(np.outer(away, k)) @ (STEEPEST / 2 * weights * difference) / (2 * np.pi)


def _sum(images: Float32) -> Float32:
    """Return the sums of images (N, H, W) as (N, 1, 1)."""
    return np.asarray(np.sum(images, axis=(-2, -1), keepdims=True))
