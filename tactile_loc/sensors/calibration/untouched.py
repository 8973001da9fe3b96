"""The untouched gel in a folder of photos: found by its look or by its name, or composed from photos of presses.

A photo from another time is corrected for the drift since: a shift of the gel, and a smooth change of the light.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath

import numpy as np
from scipy.ndimage import gaussian_filter, shift, uniform_filter

from tactile_loc.core.geometry.rigid import Bools, Float32
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.circles import (
    CONTRAST,
    Circle,
    Imprint,
    compare_colours,
    find_imprint,
    fit_robustly,
    measure_concentration,
)

QUIET, STILL = 0.2, 0.5  # limits of an untouched image's change if it looks like a ball or not, share of usual contrast
MOVED_PX, MOVED_SHARE, SEEN = 0.7, 0.5, 4.0  # least shift, share of change and pixels it explains, and texture, counts
COMPARED = 8000  # approximate number of pixels in which a small shift is measured
ALIKE = 0.25  # least gain of correlation by a large shift
LEAST_FREE = 0.1  # least untouched share of the image for measuring a shift
TRIED, JUDGES = 6, 10  # number of images tried as the untouched gel, and of images that are compared with them
KEPT = 6  # number of images from which each pixel of the untouched gel is composed
AWAY = (1.3, 2.0)  # distances from an imprint's centre, radii: touched within the first, hardly beyond the second
ORDER = 5  # degree of the polynomial that fills in pixels that are touched in all images
MOST_STACKED = 40  # approximate number of images of which the median is taken
PIECED = 2  # number of times that the untouched gel is composed, each time with better circles
HOW_TO_PRESS = "press the ball so that its whole imprint is in the image, and add an image of the untouched gel"

NAMED = {"background", "bg", "ref", "reference", "blank", "f0", "frame0", "empty", "untouched", "baseline", "nothing"}
NAMED |= {"nocontact", "notouch"}
DRIFTED = 1.0  # least change of the light that is corrected, counts
MOST = 0.95  # quantile of the pixels whose change of the light is reported
LIGHT_ORDER = 3  # degree of the polynomial that describes a change of the light
FREE = 0.25  # share of a usual ball's area that may differ strongly in an image without contact
ANOTHER_TIME = "the untouched gel at another time"
NAMED_BUT_TOUCHED = "named like the untouched gel, but touched"


@dataclass(frozen=True)
class Drift:
    """The change of the untouched gel between its photo and the presses.

    The gel has moved by `shift_px` (x, y), pixels, and the colours of most pixels have changed by less
    than `light`, counts.
    """

    shift_px: tuple[float, float]
    light: float

    def describe(self) -> str:
        """Return the changes in words."""
        moved_px = float(np.hypot(*self.shift_px))
        moved = f", and the gel moved by {moved_px:.1f} px" if moved_px > 0 else ""
        return f"the light has changed by up to {self.light:.0f} of 255 counts{moved}"


@dataclass(frozen=True, eq=False)
class GelPhotos:
    """The photos of the untouched gel among photos with `numbers`.

    `image` (H, W, 3), counts, shows the gel without dots. It is the mean of the photos with `numbers`, or, with a
    `drift`, one corrected photo. Without numbers, it was composed from presses. `set_aside` maps the numbers of photos
    that are neither used for the gel nor presses to the reason.
    """

    image: Float32
    numbers: tuple[int, ...] = ()
    drift: Drift | None = None
    set_aside: Mapping[int, str] = field(default_factory=dict)


def is_named_untouched(name: str) -> bool:
    """Return whether a file's name says that the image shows the untouched gel, such as `ref_2.png`."""
    stem = PurePath(name).stem.lower()
    return not NAMED.isdisjoint({*re.split(r"[^a-z0-9]+", stem), re.sub(r"[^a-z]", "", stem)})


def find_untouched(names: Sequence[str], images: Sequence[Image]) -> GelPhotos:
    """Find the untouched gel in images (H, W, 3) without marker dots.

    Images that differ little from what most images show are averaged. Otherwise, an image that is named like the
    untouched gel is corrected for its drift, if it shows no contact. Otherwise, the gel is composed from the presses.
    Raises CalibrationError when too few images show a ball.
    """
    reference = _choose_reference(images)
    imprints = list(map_in_threads(lambda image: find_imprint(compare_colours(image, reference)), images))
    numbers = _find_quiet(images, reference, imprints)
    others = [n for n, name in enumerate(names) if is_named_untouched(name) and n not in numbers]
    presses = [n for n in range(len(images)) if n not in others]
    if numbers:
        seen = np.asarray(np.mean([images[n] for n in numbers], axis=0), np.float32)
    elif not others or sum(imprints[n].is_ball for n in presses) >= KEPT:
        seen = _piece_together([images[n] for n in presses], [imprints[n] for n in presses])
    else:
        seen = reference
    balls = [imprints[n] for n in presses if imprints[n].is_ball]
    chosen, drifted, aside = numbers, None, {}
    for number in others:
        image, drift = _correct_drift(images[number], seen)
        if not _is_free(image, seen, balls):
            aside[number] = NAMED_BUT_TOUCHED
        elif chosen:
            aside[number] = ANOTHER_TIME
        else:
            chosen, drifted, seen = [number], drift, image
    return GelPhotos(seen, tuple(chosen), drifted, aside)


def _correct_drift(image: Image, seen: Float32) -> tuple[Float32, Drift | None]:
    """Correct an image (H, W, 3) of the untouched gel for its drift since the gel looked as in `seen` (H, W, 3).

    Return the corrected image and the drift. The drift is None, and the image is unchanged, if the drift is small.
    """
    whole = np.asarray(image, np.float32)
    x, y = measure_shift(whole - seen, seen, np.zeros(image.shape[:2], bool))
    if float(np.hypot(x, y)) > MOVED_PX:
        moved = shift(whole, (-y, -x, 0), order=1, cval=np.nan)
        whole = np.where(np.isnan(moved), seen, moved).astype(np.float32)  # the photo does not show the new border
    else:
        x = y = 0.0
    light = _fit_smooth(seen - whole, np.ones(image.shape[:2], np.float32), LIGHT_ORDER)
    drift = Drift((x, y), float(np.quantile(np.abs(light).max(axis=2), MOST)))
    if (x, y) == (0.0, 0.0) and drift.light < DRIFTED:
        return whole, None
    return np.clip(whole + light, 0, 255), drift


def _is_free(image: Float32, seen: Float32, balls: Sequence[Imprint]) -> bool:
    """Return whether an image (H, W, 3) shows no contact, compared with the gel as in `seen` (H, W, 3).

    The limits follow from the contrast and the size of the `balls` in other images. Small spots may differ.
    """
    if not balls:
        return True
    usual = float(np.median([ball.contrast for ball in balls]))
    area_px = np.pi * float(np.median([ball.circle.radius_px for ball in balls])) ** 2
    change = compare_colours(image, seen)
    imprint = find_imprint(change)
    spots = min(0.5, FREE * area_px / image[..., 0].size)
    return bool(np.quantile(_measure_strength(change), 1 - spots) < _find_limit(imprint, usual))


def _measure_strength(change: Float32) -> Float32:
    """Return the strength (H, W) of a colour change (H, W, 3), counts, without its noise."""
    side = max(3, max(change.shape) // 40)
    return np.asarray(np.sqrt((uniform_filter(change, (side, side, 0)) ** 2).mean(axis=2)), np.float32)


def _find_limit(imprint: Imprint, usual: float) -> float:
    """Return the greatest change of an untouched image, counts, if a ball's `usual` contrast is given, counts."""
    return max(CONTRAST / 2, (QUIET if imprint.is_ball else STILL) * usual)


def _choose_reference(images: Sequence[Image]) -> Float32:
    """Return the best approximation (H, W, 3) of the untouched gel: an image, the median image or a smoothed median.

    Relative to the best approximation, single imprints explain the largest share of the images' changes.
    """
    median = np.median(images[:: max(1, len(images) // MOST_STACKED)], axis=0).astype(np.float32)
    off = [float(np.abs(compare_colours(image, median)).mean()) for image in images]
    candidates = [median, _fit_smooth(median, np.ones(median.shape[:2], np.float32), 3)]
    candidates += [images[n].astype(np.float32) for n in np.argsort(off)[:TRIED]]
    judges = [images[n] for n in np.argsort(off)[::-1][:: max(1, len(images) // JUDGES)]]
    scores = [np.median([measure_concentration(compare_colours(judge, one)) for judge in judges]) for one in candidates]
    return candidates[int(np.argmax(scores))]


def _find_quiet(images: Sequence[Image], reference: Float32, imprints: Sequence[Imprint]) -> list[int]:
    """Return the numbers of the untouched images: their strongest change is far below the contrast of a usual ball."""
    contrasts = [imprint.contrast for imprint in imprints if imprint.is_ball]
    if not contrasts:
        return []
    usual, found = float(np.median(contrasts)), []
    for number, (image, imprint) in enumerate(zip(images, imprints, strict=True)):
        if _measure_strength(compare_colours(image, reference)).max() < _find_limit(imprint, usual):
            found.append(number)
    return found


def _piece_together(images: Sequence[Image], imprints: Sequence[Imprint]) -> Float32:
    """Compose the untouched gel (H, W, 3), counts, from images that all show a press.

    Raises CalibrationError when too few images show a ball.
    """
    balls = [(image, i.circle) for image, i in zip(images, imprints, strict=True) if i.is_ball]
    if not balls:
        raise CalibrationError(f"no image shows one whole ball: {HOW_TO_PRESS}")
    gel = None
    for _ in range(PIECED):
        if len(balls) < KEPT:
            raise CalibrationError(
                f"no image shows the untouched gel, and {len(balls)} images with a ball are too few to compose it; add "
                "an image of the untouched gel"
            )
        gel = _merge_away(balls)
        found = [(image, find_imprint(compare_colours(image, gel))) for image, _ in balls]
        balls = [(image, i.circle) for image, i in found if i.is_ball]
    assert gel is not None
    return gel


def _merge_away(balls: Sequence[tuple[Image, Circle]]) -> Float32:
    """Return the untouched gel (H, W, 3): for each pixel, the median of the KEPT images whose balls are farthest away.

    A smooth fit replaces the median at pixels where a ball is near in one of these images.
    """
    shape = balls[0][0].shape[:2]
    away = np.stack([circle.measure_distance_px(shape) / circle.radius_px for _, circle in balls]).astype(np.float32)
    order = np.argsort(-away, axis=0)[:KEPT]
    images = np.stack([image for image, _ in balls])
    seen = np.median(np.take_along_axis(images, order[..., None], axis=0), axis=0).astype(np.float32)
    least = np.take_along_axis(away, order[-1:], axis=0)[0]
    trust = np.clip((least - AWAY[0]) / (AWAY[1] - AWAY[0]), 0, 1)
    smooth = _fit_smooth(seen, trust + np.float32(1e-3), ORDER)
    share = np.clip((least - AWAY[0]) / (AWAY[1] - AWAY[0]) * 2 - 0.5, 0, 1)[..., None]
    return np.asarray(share * seen + (1 - share) * smooth, np.float32)


def _fit_smooth(image: Float32, weight: Float32, order: int) -> Float32:
    """Fit a polynomial in x and y robustly to an image (H, W, 3) with pixel weights (H, W), and return its values."""
    height, width = image.shape[:2]
    y, x = (np.linspace(-1, 1, n) for n in (height, width))
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    terms = np.stack([np.outer(y**j, x**i) for i, j in powers], axis=-1)
    some = np.s_[:: max(1, height // 80), :: max(1, width // 80)]
    base, wanted = terms[some].reshape(-1, len(powers)), image[some].reshape(-1, 3)
    factors, _ = fit_robustly(base, wanted, weight[some].ravel(), lambda typical: 3 * (2 * typical + 1), 12)
    return np.asarray(terms @ factors, np.float32)


def measure_shift(change: Float32, reference: Float32, touched: Bools) -> tuple[float, float]:
    """Return the shift (x, y) of the gel's texture outside the touched pixels (H, W), pixels; 0 without a clear shift.

    A small shift is found by least squares: the change is a multiple of the gel's gradients. A large shift is found by
    correlation.
    """
    free = ~touched
    gel, seen = _extract_details(reference), _extract_details(change)
    if free.mean() < LEAST_FREE or np.quantile(np.abs(gel[free]), 0.99) < SEEN:
        return 0.0, 0.0
    some = np.s_[:: max(1, int(free.sum()) // COMPARED)]
    gradients = np.stack([np.gradient(gel, axis=axis)[free][some].ravel() for axis in (1, 0)], axis=1)
    values = seen[free][some].ravel()
    evenly = np.ones(len(values))
    factors, weight = fit_robustly(gradients, values[:, None], evenly, lambda typical: 4 * 1.48 * typical + 1e-6, 8)
    x, y = factors[:, 0].tolist()
    made = gradients @ factors[:, 0]
    share = 1 - float((weight * (values - made) ** 2).sum()) / max(float((weight * values**2).sum()), 1e-9)
    explains = min(share, float(weight.mean())) > MOVED_SHARE and np.quantile(np.abs(made), 0.99) > SEEN
    if explains and np.hypot(x, y) > MOVED_PX:
        return -x, -y  # a gel that has moved to the right has the colours from its left
    return _measure_large_shift(gel + seen, gel, free)


def _measure_large_shift(seen: Float32, gel: Float32, free: Bools) -> tuple[float, float]:
    """Return the shift (x, y) by whole pixels that increases the correlation of details (H, W, 3), or 0.

    The result is 0 if no shift increases the correlation by more than ALIKE.
    """
    one, other = (values * free[..., None] for values in (seen, gel))
    spectra = np.fft.rfft2(one, axes=(0, 1)) * np.conj(np.fft.rfft2(other, axes=(0, 1)))
    alike = np.fft.irfft2(spectra.sum(axis=2), s=free.shape)
    alike /= max(float(np.sqrt((one**2).sum() * (other**2).sum())), 1e-9)
    place = np.unravel_index(int(alike.argmax()), alike.shape)
    if float(alike[place] - alike[:2, :2].max()) <= ALIKE:  # a shift of up to one pixel counts as none
        return 0.0, 0.0
    y, x = (float(p if 2 * p < n else p - n) for p, n in zip(place, free.shape, strict=True))
    return x, y


def _extract_details(image: Float32) -> Float32:
    """Return the details of an image (H, W, 3), without noise and without slow changes such as those of the light."""
    return np.asarray(gaussian_filter(image, (1, 1, 0)) - gaussian_filter(image, (6, 6, 0)), np.float32)
