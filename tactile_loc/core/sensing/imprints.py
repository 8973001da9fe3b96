"""Comparison of the contacts that poses make with that of a touch, to measure how well they explain it.

An intersection over union is easy to read, but weighs contact hidden by noise and contact added by a wrong pose alike.
Evidence also uses the area that a pose explains and the error of depth there. Its weights were fitted to simulated
touches with strong noise: to the true poses among all poses that a search of the whole object finds. The IoU's weight
was then raised, because the IoU discriminates between clean touches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Floats = NDArray[np.float64]

# The value of any pixel in contact, as a share of the press depth: as much as the deepest imprint. With less, depth
# decides between poses, which noise falsifies first; with more, depth hardly matters.
OUTLINE_SHARE = 1.0
# Weights of evidence, nats: per imprint IoU, per log(1 + mm^2) of common contact, and per mm of depth error there
IOU_NATS, AREA_NATS, DEPTH_NATS = 10.0, 3.0, 15.0
FAR_OFF_M = 5e-4  # larger depth errors count as this


class Explained(NamedTuple):
    """Contact IoUs and imprint IoUs, 0 to 1, and evidence, nats up to a constant, of N poses; each (N,)."""

    contact_ious: Floats
    imprint_ious: Floats
    evidence: Floats


def compare_imprints(
    made_m: Float32, seen_m: Float32, press_depth_m: float, observed: NDArray[np.bool_], pixel_pitch_m: float
) -> Explained:
    """Compare contact depths (N, H, W) that poses make with those that a touch shows (H, W); metres.

    Contact is where the depth is below the press depth and the sensor observes, `observed` (H, W). A pose that explains
    nothing has an IoU of 0.
    """
    press = np.float32(press_depth_m)
    made, seen = ((depth_m < press) & observed for depth_m in (made_m, seen_m))
    common = made & seen
    count, either = (np.count_nonzero(both, axis=(-2, -1)) for both in (common, made | seen))
    a, b = (
        np.where(contact, np.float32(1 + OUTLINE_SHARE) - depth_m / press, np.float32(0))
        for contact, depth_m in ((made, made_m), (seen, seen_m))
    )
    least, most = (np.sum(both, axis=(-2, -1), dtype=float) for both in (np.minimum(a, b), np.maximum(a, b)))
    off_m = np.where(common, np.minimum(np.abs(made_m - seen_m), np.float32(FAR_OFF_M)), np.float32(0))
    mean_off_m = off_m.sum(axis=(-2, -1), dtype=float) / np.maximum(count, 1)
    imprint_ious = least / np.maximum(most, 1.0)
    area_mm2 = count * (1e3 * pixel_pitch_m) ** 2
    evidence = IOU_NATS * imprint_ious + AREA_NATS * np.log1p(area_mm2) - DEPTH_NATS * 1e3 * mean_off_m
    return Explained(count / np.maximum(either, 1), imprint_ious, evidence)
