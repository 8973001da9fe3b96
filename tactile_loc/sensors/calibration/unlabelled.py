"""Labels presses of a ball: finds the images of the untouched gel, and the ball's circle in each other image.

Most images must differ from the untouched gel by one imprint only. If no image shows the untouched gel, an image of the
gel is composed from the other images, except their parts near imprints. The transitions between the parts are smooth.

Marker dots on the gel are found in the median of the images, and filled in before imprints are looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.sensors.calibration.circles import (
    CONTRAST,
    LIKENESS,
    Circle,
    Imprint,
    compare_colours,
    find_imprint,
    find_rim,
    fit_robustly,
    measure_concentration,
)
from tactile_loc.sensors.calibration.frames import PressImage
from tactile_loc.sensors.calibration.labels import Float32, Image, Mask
from tactile_loc.sensors.reading.markers import UntouchedGel

BLURRED = 0.45  # least likeness of a ball's imprint if there is a second ball in the image
QUIET, STILL = 0.2, 0.5  # limits of an untouched image's change if it looks like a ball or not, share of usual contrast
SECOND = 0.35  # least contrast of a second ball, share of the first ball's contrast
APART = 2.2  # radius of the area that belongs to an imprint, in radii of the imprint
OUTSIDE = 0.1  # largest part of a circle's radius that may lie beyond the image's border
EXPOSED, MOST_EXPOSED = 253, 0.25  # least count of a saturated value, and largest share of such values in a circle
OVERSIZED = "imprint larger than the ball"
TOO_LARGE = 1.3  # largest radius of a circle with its skirt, in radii of the ball
MOVED_PX, MOVED_SHARE, SEEN = 0.7, 0.5, 4.0  # least shift, share of change and pixels it explains, and texture, counts
ALIKE = 0.25  # least gain of correlation by a large shift
LEAST_FREE = 0.1  # least untouched share of the image for measuring a shift
TRIED, JUDGES = 6, 10  # number of images tried as the untouched gel, and of images that are compared with them
KEPT = 6  # number of images from which each pixel of the untouched gel is composed
AWAY = (1.3, 2.0)  # distances from an imprint's centre, radii: touched within the first, hardly beyond the second
ORDER = 5  # degree of the polynomial that fills in pixels that are touched in all images
MOST_STACKED = 40  # approximate number of images of which the median is taken
PIECED = 2  # number of times that the untouched gel is composed, each time with better circles
HOW_TO_PRESS = "press the ball so that its whole imprint is in the image, and add an image of the untouched gel"

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FoundPress:
    """An image of a press and the ball's circle, if found. `dropped` states why the press is not used, or is empty."""

    frame: PressImage
    circle: Circle | None
    dropped: str = ""

    @property
    def name(self) -> str:
        """The image's path in the table."""
        return self.frame.name


@dataclass(frozen=True, eq=False)
class FoundPresses:
    """The untouched gel and the presses that were found in a folder.

    `untouched` (H, W, 3) uint8 shows the untouched gel. `untouched_names` are the images from which it was averaged. It
    is empty if `untouched` was composed from images of presses.
    """

    untouched: Image
    untouched_names: tuple[str, ...]
    presses: tuple[FoundPress, ...]

    @property
    def used(self) -> tuple[FoundPress, ...]:
        """The presses that were not dropped."""
        return tuple(press for press in self.presses if not press.dropped)

    @property
    def title(self) -> str:
        """The number of used images in words."""
        return f"{len(self.used)} of {len(self.presses)} presses are used"


def find_presses(
    frames: Sequence[PressImage], ball_px: float | None = None, progress: Progress | None = None
) -> FoundPresses:
    """Find the untouched gel and each ball's circle in images (H, W, 3) of one camera, in any order.

    `ball_px` is the ball's radius in pixels, if known; much larger circles are dropped. Raises CalibrationError when no
    image shows a ball, when the camera moved in most images, or when there are too few images.
    """
    if len(frames) < 3:
        raise CalibrationError(
            f"there are only {len(frames)} images; give one of the untouched gel and at least five presses, better 30"
        )
    watcher = progress or Progress()
    some = [frame.image for frame in frames[:: max(1, len(frames) // MOST_STACKED)]]
    gel = UntouchedGel.of(np.rint(np.median(some, axis=0)).astype(np.uint8))  # most images show a dot at its place
    images = [gel.clear_image(frame.image) for frame in frames]
    with watcher.task("looking for the untouched gel", len(images)) as advance:
        reference = _choose_reference(images)
        imprints = [find_imprint(compare_colours(image, reference)) for image in images]
        quiet = _find_quiet(images, reference, imprints)
        reference = np.mean([images[n] for n in quiet], axis=0) if quiet else _piece_together(images, imprints)
        reference = np.asarray(reference, np.float32)
        advance(len(images))
    presses = []
    with watcher.task("looking for the ball", len(images)) as advance:
        for number, frame in enumerate(frames):
            if number not in quiet:
                presses.append(_judge(frame, images[number], reference, gel, ball_px))
            advance(1)
    untouched = np.clip(np.rint(gel.add_dots(reference)), 0, 255).astype(np.uint8)
    found = FoundPresses(untouched, tuple(frames[n].name for n in quiet), tuple(presses))
    _require_balls(found, ball_px)
    return found


def _require_balls(found: FoundPresses, ball_px: float | None) -> None:
    reasons = [press.dropped for press in found.presses]
    moved = sum(reason.startswith("camera moved") for reason in reasons)
    if moved > len(reasons) / 2:
        raise CalibrationError(
            f"the camera or the gel moved in {moved} of {len(reasons)} images; mount the sensor firmly, and take the "
            "images again"
        )
    if found.used:
        return
    counted = sorted(((reasons.count(reason), reason) for reason in set(reasons)), reverse=True)
    if ball_px is not None and counted and counted[0][1] == OVERSIZED:
        usual_px = float(np.median([press.circle.radius_px for press in found.presses if press.circle is not None]))
        raise CalibrationError(
            f"the imprints have a radius of about {usual_px:.0f} px, larger than the ball's {ball_px:.2g} px; check "
            "`ball_radius` and `mm_per_px`, both in mm"
        )
    causes = ", ".join(f"{reason} in {n} {'image' if n == 1 else 'images'}" for n, reason in counted)
    causes = f"rejected: {causes}" if causes else "all show the untouched gel"
    raise CalibrationError(f"no image shows one whole ball ({causes}); {HOW_TO_PRESS}")


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
        least = max(CONTRAST / 2, (QUIET if imprint.is_ball else STILL) * usual)
        side = max(3, max(image.shape) // 40)
        smooth = uniform_filter(compare_colours(image, reference), (side, side, 0))
        if np.sqrt((smooth**2).mean(axis=2).max()) < least:
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


def _judge(frame: PressImage, image: Image, reference: Float32, gel: UntouchedGel, ball_px: float | None) -> FoundPress:
    """Find the ball's circle in an image, or the reason why the image cannot be used.

    `image` (H, W, 3) is the frame's image without marker dots. The dots show whether the camera moved.
    """
    change = compare_colours(image, reference)
    imprint = find_imprint(change)
    around = imprint.circle.measure_distance_px(change.shape[:2]) < APART * imprint.circle.radius_px
    dotted = gel.add_dots(reference)
    moved = change if gel.dots is None else compare_colours(frame.image, dotted)
    if (shift_px := _measure_shift(moved, dotted, around)) > MOVED_PX:
        return FoundPress(frame, None, f"camera moved by {shift_px:.1f} px")
    if imprint.contrast < CONTRAST or imprint.likeness < BLURRED:
        return FoundPress(frame, None, "no ball found")
    other = find_imprint(change, around)
    if other.is_ball and other.contrast > SECOND * imprint.contrast:
        return FoundPress(frame, imprint.circle, "two balls")
    if imprint.likeness < LIKENESS:
        return FoundPress(frame, None, "no ball found")
    circle = find_rim(change, imprint.circle)
    return FoundPress(frame, circle, _find_fault(image, reference, circle, ball_px))


def _find_fault(image: Image, reference: Float32, circle: Circle, ball_px: float | None) -> str:
    """Return the reason why a press with this circle cannot be used, or an empty string."""
    if circle.measure_overhang_px(image.shape[:2]) > OUTSIDE * circle.radius_px:
        return "cut off at the border"
    inside = circle.measure_distance_px(image.shape[:2]) < circle.radius_px
    white = (image >= EXPOSED) & (reference < EXPOSED)
    if white[inside].mean() > MOST_EXPOSED:
        return "over-exposed"
    if ball_px is not None and circle.radius_px > TOO_LARGE * ball_px:
        return OVERSIZED
    return ""


def _measure_shift(change: Float32, reference: Float32, touched: Mask) -> float:
    """Return the shift of the gel's texture outside the touched pixels (H, W), pixels; 0 without a clear shift.

    A small shift is found by least squares: the change is a multiple of the gel's gradients. A large shift is found by
    correlation.
    """
    free = ~touched
    gel, seen = _extract_details(reference), _extract_details(change)
    if free.mean() < LEAST_FREE or np.quantile(np.abs(gel[free]), 0.99) < SEEN:
        return 0.0
    gradients = np.stack([np.gradient(gel, axis=axis)[free].ravel() for axis in (1, 0)], axis=1)
    values = seen[free].ravel()
    evenly = np.ones(len(values))
    factors, weight = fit_robustly(gradients, values[:, None], evenly, lambda typical: 4 * 1.48 * typical + 1e-6, 8)
    shift = factors[:, 0]
    made = gradients @ shift
    share = 1 - float((weight * (values - made) ** 2).sum()) / max(float((weight * values**2).sum()), 1e-9)
    explains = min(share, float(weight.mean())) > MOVED_SHARE and np.quantile(np.abs(made), 0.99) > SEEN
    small_px = float(np.hypot(*shift)) if explains else 0.0
    return small_px if small_px > MOVED_PX else _measure_large_shift(gel + seen, gel, free)


def _measure_large_shift(seen: Float32, gel: Float32, free: Mask) -> float:
    """Return the length of the shift by whole pixels that increases the correlation of details (H, W, 3), or 0.

    The result is 0 if no shift increases the correlation by more than ALIKE.
    """
    one, other = (values * free[..., None] for values in (seen, gel))
    spectra = np.fft.rfft2(one, axes=(0, 1)) * np.conj(np.fft.rfft2(other, axes=(0, 1)))
    alike = np.fft.irfft2(spectra.sum(axis=2), s=free.shape)
    alike /= max(float(np.sqrt((one**2).sum() * (other**2).sum())), 1e-9)
    place = np.unravel_index(int(alike.argmax()), alike.shape)
    gained = float(alike[place] - alike[:2, :2].max())  # a shift of up to one pixel counts as none
    away = [min(p, n - p) for p, n in zip(place, free.shape, strict=True)]
    return float(np.hypot(*away)) if gained > ALIKE else 0.0


def _extract_details(image: Float32) -> Float32:
    """Return the details of an image (H, W, 3), without noise and without slow changes such as those of the light."""
    return np.asarray(gaussian_filter(image, (1, 1, 0)) - gaussian_filter(image, (6, 6, 0)), np.float32)
