"""From slopes to the surface that has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry


def integrate(slope: NDArray[np.floating], geometry: SensorGeometry) -> NDArray[np.float64]:
    """Return the surface (..., H, W), metres, of zero mean, whose slopes (..., H, W, 2) come nearest to those given.

    Least squares with free borders: the Poisson equation with the slope across the border given, solved by a cosine
    transform; each step between two pixels is the mean of their slopes.
    """
    from scipy.fft import dctn, idctn

    sx, sy = geometry.scale_at_surface
    across, down = slope[..., 0] / sx, slope[..., 1] / sy  # metres a pixel
    pad = [(0, 0)] * (slope.ndim - 3)
    steps_x = np.pad(0.5 * (across[..., 1:] + across[..., :-1]), [*pad, (0, 0), (1, 1)])
    steps_y = np.pad(0.5 * (down[..., 1:, :] + down[..., :-1, :]), [*pad, (1, 1), (0, 0)])
    divergence = np.diff(steps_x, axis=-1) + np.diff(steps_y, axis=-2)
    height, width = divergence.shape[-2:]
    k, m = (2 * np.cos(np.pi * np.arange(n) / n) - 2 for n in (width, height))
    eigenvalues = k[None, :] + m[:, None]
    eigenvalues[0, 0] = np.inf  # the mean is free
    spectrum = dctn(divergence, type=2, axes=(-2, -1), norm="ortho") / eigenvalues
    return np.asarray(idctn(spectrum, type=2, axes=(-2, -1), norm="ortho"))
