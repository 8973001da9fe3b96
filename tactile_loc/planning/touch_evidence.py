"""The evidence that an expected contact gives for the pose that makes it, against other poses.

The evidence is that of `imprints.py`. An elastic gel shows the object only where it touches it, so only this part of a
contact gives evidence.
"""

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats
from tactile_loc.core.sensing.gel_surface import SLACK, mark_touching
from tactile_loc.core.sensing.imprints import AREA_NATS, DEPTH_NATS, IOU_NATS, OUTLINE_SHARE, compare_imprints


def compare_contacts(depth_m: Float32, press_m: float, observed: Bools, pixel_pitch_m: float) -> Floats:
    """Return the evidence (K, K), nats, of each of K contacts for the mode that made it, against each other mode.

    Element (i, j) is the evidence that contact i gives for depths i, minus the evidence that it gives for depths j
    (`core.sensing.imprints.compare_imprints`). `depth_m` (K, H, W) is in metres. All pairs are compared at once, from
    the contacts' sums and the sums of their differences.
    """
    from scipy.spatial.distance import pdist, squareform

    depth = depth_m[:, observed]
    contact = (depth < np.float32(press_m)).astype(np.float32)
    weight = (np.float32(1 + OUTLINE_SHARE) - depth / np.float32(press_m)) * contact
    total = weight.sum(axis=1, dtype=float)
    apart = squareform(pdist(weight, "cityblock"))
    both = total[:, None] + total[None]
    ious = (both - apart) / np.maximum(both + apart, 1.0)
    common = contact @ contact.T
    alone = total[:, None] - weight @ contact.T  # sum over contact i where j has no contact
    off_mm = 1e3 * press_m * np.maximum(apart - alone - alone.T, 0.0) / np.maximum(common, 1.0)
    area_mm2 = common * (1e3 * pixel_pitch_m) ** 2
    evidence = IOU_NATS * ious + AREA_NATS * np.log1p(area_mm2) - DEPTH_NATS * off_mm
    return np.asarray(np.maximum(np.diag(evidence)[:, None] - evidence, 0.0))


def compare_elastic_contacts(
    depth_m: Float32, shown_m: Float32, press_m: float, observed: Bools, pixel_pitch_m: float
) -> Floats:
    """Return the evidence (K, K), nats, of each of K contacts with an elastic gel, as `compare_contacts` does.

    `depth_m` (K, H, W), metres, are the contact depths in a rigid gel, and `shown_m` (K, H, W) those that the elastic
    gel shows. The touch of mode i contradicts mode j only where the gel touches mode i, and where mode j pierces the
    gel's surface.
    """
    press, nats = np.float32(press_m), np.empty((len(depth_m), len(depth_m)))
    for i, (touching, shown) in enumerate(zip(mark_touching(depth_m, shown_m, press_m), shown_m, strict=True)):
        seen = np.where(touching, depth_m[i], press)
        made = np.where(touching | (depth_m < shown - np.float32(SLACK) * press), depth_m, press)
        evidence = compare_imprints(made, seen, press_m, observed, pixel_pitch_m).evidence
        nats[i] = evidence[i] - evidence
    return np.maximum(nats, 0.0)
