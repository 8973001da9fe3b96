"""Measures of how well poses explain a touch, from the contact that each pose makes.

An intersection over union (IoU) is easy to interpret. But it gives equal weight to contact that noise hides and to
contact that a wrong pose adds. Evidence therefore also uses the contact area that a pose explains, and the error of
depth in this area. The weights of evidence were fitted to simulated touches with strong noise, so that the true poses
get more evidence than other poses that a search of the whole object finds. Then the weight of the IoU was raised,
because the IoU distinguishes poses well in touches without noise.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tactile_loc.core.geometry.rigid import Bools, Float32, Floats
from tactile_loc.core.runtime.compiled import njit, run_in_threads

# mypy: disable-error-code="no-untyped-def,no-untyped-call,assignment"


# Each pixel in contact counts as its imprint plus this share of the press depth. With a smaller share, the depths would
# decide between poses, although they are noisy. With a larger share, the depths would hardly matter.
OUTLINE_SHARE = 1.0
# Weights of evidence, nats: per imprint IoU, per log(1 + mm^2) of common contact, and per mm of depth error in it
IOU_NATS, AREA_NATS, DEPTH_NATS = 10.0, 3.0, 15.0
FAR_OFF_M = 5e-4  # a larger depth error counts as this much


class Explained(NamedTuple):
    """Measures (N,) of how well N poses explain a touch: contact IoUs and imprint IoUs, 0 to 1, and evidence, nats.

    Only differences between values of evidence have a meaning.
    """

    contact_ious: Floats
    imprint_ious: Floats
    evidence: Floats


def compare_imprints(
    made_m: Float32, seen_m: Float32, press_depth_m: float, observed: Bools, pixel_pitch_m: float
) -> Explained:
    """Compare the contact depths (N, H, W), metres, of N poses with those of a touch (H, W), metres.

    A pixel is in contact if its depth is below the press depth and `observed` (H, W) is True. A pose whose contact does
    not overlap that of the touch has IoUs of 0.
    """
    common, either, least, most, off_m = _sum_up(_add_imprints, 5, made_m, seen_m, press_depth_m, observed)
    imprint_ious = least / np.maximum(most, 1.0)
    area_mm2 = common * (1e3 * pixel_pitch_m) ** 2
    mean_off_m = off_m / np.maximum(common, 1)
    evidence = IOU_NATS * imprint_ious + AREA_NATS * np.log1p(area_mm2) - DEPTH_NATS * 1e3 * mean_off_m
    return Explained(common / np.maximum(either, 1), imprint_ious, evidence)


def _sum_up(
    add: Callable[..., None], count: int, made_m: Float32, seen_m: Float32, press_depth_m: float, observed: Bools
) -> Floats:
    """Return the `count` sums (count, N) that a kernel, `add`, makes of the contact depths of N poses and a touch."""
    made_m, seen_m = np.ascontiguousarray(made_m, np.float32), np.ascontiguousarray(seen_m, np.float32)
    sums = np.empty((len(made_m), count))
    observed = np.ascontiguousarray(observed)
    run_in_threads(add, len(made_m), made_m, seen_m, np.float32(press_depth_m), observed, sums)
    return sums.T


@njit(fast=True)
def _weigh_pixel(mine, other, press):
    """Return whether two contact depths, metres, are in contact, and the smaller of both imprints and the larger.

    An imprint is a share of the press depth plus OUTLINE_SHARE.
    """
    zero, top, scale = np.float32(0), np.float32(1 + OUTLINE_SHARE), np.float32(1) / press
    touches, touched = mine < press, other < press
    a = top - mine * scale if touches else zero
    b = top - other * scale if touched else zero
    return touches, touched, min(a, b), max(a, b)


@njit(fast=True)
def _add_imprints(first, last, made, seen, press, observed, sums):
    """Fill `sums` (N, 5) for the contact depths `made` (N, H, W) from first to last, and those of a touch (H, W).

    The sums are the number of pixels in contact in both, and in one of them; the smaller of both imprints, and the
    larger; and the difference of depths in common contact, metres, at most FAR_OFF_M each.
    """
    zero, far = np.float32(0), np.float32(FAR_OFF_M)
    for k in range(first, last):
        common, either, least, most, off = 0, 0, 0.0, 0.0, 0.0
        for row in range(seen.shape[0]):
            lower, upper, beside = zero, zero, zero
            for column in range(seen.shape[1]):
                if not observed[row, column]:
                    continue
                mine, other = made[k, row, column], seen[row, column]
                touches, touched, smaller, larger = _weigh_pixel(mine, other, press)
                lower += smaller
                upper += larger
                either += touches or touched
                if touches and touched:
                    common += 1
                    beside += min(abs(mine - other), far)
            least, most, off = least + lower, most + upper, off + beside
        sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3], sums[k, 4] = common, either, least, most, off


class Residuals(NamedTuple):
    """What remains unexplained of a touch by N poses, each (N,).

    `imprint_ious` are as in `Explained`. `missing` and `extra` are the areas of contact that the pose lacks and that it
    adds, as shares of the touch's contact. `outline_m` is the mean distance of both outlines, metres: these areas
    divided by the length of the touch's outline. In common contact, `press_m` is the mean difference of depths, metres,
    `relief_m` the root mean square of what differs beside this mean, and `slope` that of the difference of slopes.
    """

    imprint_ious: Floats
    missing: Floats
    extra: Floats
    outline_m: Floats
    press_m: Floats
    relief_m: Floats
    slope: Floats


def measure_residuals(
    made_m: Float32, seen_m: Float32, press_depth_m: float, observed: Bools, pixel_pitch_m: float
) -> Residuals:
    """Return what the contact depths (N, H, W), metres, of N poses leave unexplained of a touch's (H, W), metres."""
    sums = _sum_up(_add_residuals, 10, made_m, seen_m, press_depth_m, observed)
    common, seen, made, edges, least, most, offset, squared, steps, turned = sums
    seen, mean_m = np.maximum(seen, 1), offset / np.maximum(common, 1)
    relief_m = np.sqrt(np.maximum(squared / np.maximum(common, 1) - mean_m**2, 0.0))
    missing, extra = (seen - common) / seen, (made - common) / seen
    outline_m = pixel_pitch_m * (seen + made - 2 * common) / np.maximum(edges, 1)
    slope = np.sqrt(turned / np.maximum(steps, 1)) / pixel_pitch_m
    return Residuals(least / np.maximum(most, 1.0), missing, extra, outline_m, mean_m, relief_m, slope)


@njit(fast=True)
def _add_residuals(first, last, made, seen, press, observed, sums):
    """Fill `sums` (N, 10) for the contact depths `made` (N, H, W) from first to last, and those of a touch (H, W).

    The sums are: pixels in contact in both, in the touch, and in the pose; sides of pixels on the touch's outline; the
    smaller of both imprints, and the larger; in common contact the difference of depths, metres, and its square; and
    the number of steps between neighbours in common contact, and the squares of the differences of steps, m^2.
    """
    far = np.float32(FAR_OFF_M)
    height, width = seen.shape
    for k in range(first, last):
        common, touched_count, touching_count, edges, steps = 0, 0, 0, 0, 0
        least, most, offset, squared, turned = 0.0, 0.0, 0.0, 0.0, 0.0
        for row in range(height):
            for column in range(width):
                if not observed[row, column]:
                    continue
                mine, other = made[k, row, column], seen[row, column]
                touches, touched, smaller, larger = _weigh_pixel(mine, other, press)
                least, most = least + smaller, most + larger
                touched_count += touched
                touching_count += touches
                for side in range(2):
                    i, j = row + side, column + 1 - side
                    if i < height and j < width and observed[i, j]:
                        edges += touched != (seen[i, j] < press)
                if not (touches and touched):
                    continue
                common += 1
                off = max(-far, min(far, mine - other))
                offset += off
                squared += off * off
                for side in range(2):
                    i, j = row + side, column + 1 - side
                    if i < height and j < width and observed[i, j] and made[k, i, j] < press and seen[i, j] < press:
                        step = max(-far, min(far, (made[k, i, j] - mine) - (seen[i, j] - other)))
                        turned += step * step
                        steps += 1
        sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3] = common, touched_count, touching_count, edges
        sums[k, 4], sums[k, 5], sums[k, 6], sums[k, 7] = least, most, offset, squared
        sums[k, 8], sums[k, 9] = steps, turned
