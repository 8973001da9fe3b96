"""Recovers the contact from the slopes that a camera sees: the pressure, and the displacement of the gel's surface.

The camera sees the underside of the gel's coating, whose displacement is v = F^-1[K C F[p]] (see `core.sensing.gel`).
The pressure is the p >= 0 for which the slopes of v are nearest to the seen slopes, in the least-squares sense. Slopes
determine the pressure well: both are of the same order, because C falls with the wave number. The displacement of the
surface, u = F^-1[C F[p]], then has its absolute level, which an integral of the slopes does not have, and the sharp
features that the coating hides. The solver is the accelerated projected gradient method of Beck and Teboulle (SIAM J.
Imaging Sciences 2, 2009).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.gel import Contact, Float32, Gel, compute_smoothing, list_wave_numbers, make_solver
from tactile_loc.core.sensing.gel_surface import Window
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

STEPS = 20  # of each of the two searches for the pressure
CONTINUED = 4  # steps after which the slopes beyond the image are predicted anew
LEAST = 0.5  # pressure at the contact's border, as a share of the contact's median pressure
RIDGE = 0.01  # weight of the squared pressure, as a share of the steepest response; it damps ringing at edges
SMOOTHING_PX = 1.0  # standard deviation of the smoothing of the pressure before the contact's border is sought

Mask = NDArray[np.bool_]


def recover_contact(slopes: Float32, candidates: Mask, geometry: SensorGeometry) -> Contact:
    """Return the contact, with displacements and pressures (H, W), given seen slopes (H, W, 2) along x and y, unitless.

    Only the `candidates` (H, W) can touch the object. After a first search, pixels with little pressure no longer
    count as candidates. Slopes are ignored where the sensor does not observe the gel.
    """
    from scipy.ndimage import gaussian_filter

    window = Window.around(np.ones(geometry.shape, bool), geometry, 0.0)
    planes = np.moveaxis(np.where(geometry.observed_mask[..., None], slopes, 0), -1, 0).astype(np.float32)
    few = window.reduce(gaussian_filter(planes, (0, *2 * [0.3 * window.step])))
    masks = np.stack([geometry.observed_mask, candidates & geometry.observed_mask])
    seen, allowed = window.reduce(masks.astype(np.float32)) > 0.5
    inverse = _make_inverse(geometry.gel, *window.solved)
    pressure = inverse.search(few, seen, allowed, np.zeros(few.shape[1:], np.float32))
    smooth = gaussian_filter(pressure, SMOOTHING_PX)
    pressed = allowed & (smooth > 0)
    if pressed.any():
        touching = allowed & (smooth > LEAST * np.median(smooth[pressed]))
        pressure = inverse.search(few, seen, touching, np.where(touching, pressure, np.float32(0)))
    both = window.enlarge(np.stack([inverse.solver.displace(pressure[None])[0], pressure]))
    return Contact(both[0], np.where(candidates, both[1], np.float32(0)))


class _Inverse:
    """Finds pressures on a window of `shape` (H, W) pixels with `pitch_m` (x, y) metres."""

    def __init__(self, gel: Gel, shape: tuple[int, int], pitch_m: tuple[float, float]) -> None:
        self.shape, self.solver = shape, make_solver(gel, shape, pitch_m)
        qx, qy = list_wave_numbers(self.solver.padded, pitch_m)
        seen = self.solver.compliance * compute_smoothing(np.hypot(qx, qy), gel)
        steps = (np.sin(qx * pitch_m[0]) / pitch_m[0], np.sin(qy * pitch_m[1]) / pitch_m[1])  # central differences
        self._slopes = np.stack([1j * step * seen for step in steps]).astype(np.complex64)
        power = (np.abs(self._slopes) ** 2).sum(axis=0)
        self._power = power + RIDGE * power.max()
        self._steepest = np.float32(self._power.max())

    def search(self, slopes: Float32, seen: Mask, allowed: Mask, pressure: Float32) -> Float32:
        """Return the pressures (H, W) that explain slopes (2, H, W) at the `seen` pixels (H, W) best.

        The pressure is zero except at the `allowed` pixels (H, W). `pressure` (H, W) is a guess to start from.
        """
        from scipy import fft

        height, width = self.shape
        known = np.zeros((2, *self.solver.padded), bool)
        known[:, :height, :width] = seen
        measured = np.zeros(known.shape, np.float32)
        measured[:, :height, :width] = slopes
        ahead, last, momentum = pressure, pressure, 1.0
        for step in range(STEPS):
            if step % CONTINUED == 0:  # the model's own slopes continue the seen slopes
                modelled = fft.irfft2(self._slopes * fft.rfft2(last, self.solver.padded), self.solver.padded)
                spectrum = fft.rfft2(np.where(known, measured, modelled))
                wanted = (np.conj(self._slopes) * spectrum).sum(axis=0)
            rest = fft.irfft2(self._power * fft.rfft2(ahead, self.solver.padded) - wanted, self.solver.padded)
            found = np.where(allowed, np.maximum(ahead - rest[:height, :width] / self._steepest, np.float32(0)), 0)
            after = 0.5 * (1 + math.sqrt(1 + 4 * momentum**2))
            ahead = (found + np.float32((momentum - 1) / after) * (found - last)).astype(np.float32)
            last, momentum = found.astype(np.float32), after
        return last


@lru_cache(maxsize=8)
def _make_inverse(gel: Gel, shape: tuple[int, int], pitch_m: tuple[float, float]) -> _Inverse:
    return _Inverse(gel, shape, pitch_m)
