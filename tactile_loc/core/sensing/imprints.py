"""How well poses explain a touch: what of the contact that they make the touch shows, and how deep.

An intersection over union is easily read, and counts alike what noise hides of a contact and what a wrong pose adds.
Evidence regards besides how much of what is seen a pose accounts for, and how far off the depth is there; its weights
were fitted to the true poses among those that a search of the whole object finds, of simulated touches with strong
noise, with more of the IoU, which clean touches are told apart by.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Floats = NDArray[np.float64]

# Of the press depth, what a pixel counts for being in contact at all: as much as the deepest imprint does. With less,
# the depth, which noise falsifies first, decides between poses; with more, depth hardly matters.
OUTLINE_SHARE = 1.0
# What evidence counts, in nats: imprint IoU, the logarithm of 1 + mm^2 of common contact, and a mm of depth there
IOU_NATS, AREA_NATS, DEPTH_NATS = 10.0, 3.0, 15.0
FAR_OFF_M = 5e-4  # depths that differ by more are no worse


class Explained(NamedTuple):
    """Of N poses the contact IoUs and the imprint IoUs, 0 to 1, and the evidence, nats up to a constant; each (N,)."""

    contact_ious: Floats
    imprint_ious: Floats
    evidence: Floats


def compare_imprints(
    made_m: Float32, seen_m: Float32, press_depth_m: float, observed: NDArray[np.bool_], pixel_pitch_m: float
) -> Explained:
    """Compare contact depths (N, H, W) that poses make with those that a touch shows (H, W); metres.

    Contact is what is less deep than the press depth, where the sensor observes, `observed` (H, W). What explains
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
