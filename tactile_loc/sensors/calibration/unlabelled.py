"""Labels presses of a ball: finds the images of the untouched gel, and the ball's circle in each other image.

Most images must differ from the untouched gel by one imprint only. If no image shows the untouched gel, an image of the
gel is composed from the other images, except their parts near imprints. The transitions between the parts are smooth.

Marker dots on the gel are found in the median of the images, and filled in before imprints are looked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Float32
from tactile_loc.core.runtime.compiled import map_in_threads
from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.sensors.calibration.frames import PressImage
from tactile_loc.sensors.calibration.labels import WIDEST, Image
from tactile_loc.sensors.calibration.untouched import (
    HOW_TO_PRESS,
    MOST_STACKED,
    MOVED_PX,
    Drift,
    find_untouched,
    measure_shift,
)
from tactile_loc.sensors.reading.circles import CONTRAST, LIKENESS, Circle, compare_colours, find_imprint, find_rim
from tactile_loc.sensors.reading.markers import UntouchedGel

BLURRED = 0.45  # least likeness of a ball's imprint if there is a second ball in the image
SECOND = 0.35  # least contrast of a second ball, share of the first ball's contrast
APART = 2.2  # radius of the area that belongs to an imprint, in radii of the imprint
OUTSIDE, CUT = 0.1, 0.6  # part of a circle's radius beyond the border at which it counts as cut, and the largest part
VISIBLE = 0.3  # least share of a cut circle that lies in the image
SETTLED = 0.13  # largest distance between the rim's centre and the imprint's in a cut circle, in radii
EXPOSED, MOST_EXPOSED = 253, 0.25  # least count of a saturated value, and largest share of such values in a circle
OVERSIZED = "imprint larger than the ball"


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
    is empty if `untouched` was composed from images of presses. With a `drift`, `untouched` is the corrected image.
    """

    untouched: Image
    untouched_names: tuple[str, ...]
    presses: tuple[FoundPress, ...]
    drift: Drift | None = None

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
        shown = find_untouched([frame.name for frame in frames], images)
        advance(len(images))
    presses = []
    pressed = [number for number in range(len(frames)) if number not in shown.numbers]

    def judge(number: int) -> FoundPress:
        if number in shown.set_aside:
            return FoundPress(frames[number], None, shown.set_aside[number])
        return _judge(frames[number], images[number], shown.image, gel, ball_px)

    with watcher.task("looking for the ball", len(pressed)) as advance:
        for press in map_in_threads(judge, pressed):
            presses.append(press)
            advance(1)
    untouched = np.clip(np.rint(gel.add_dots(shown.image)), 0, 255).astype(np.uint8)
    found = FoundPresses(untouched, tuple(frames[n].name for n in shown.numbers), tuple(presses), shown.drift)
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


def _judge(frame: PressImage, image: Image, reference: Float32, gel: UntouchedGel, ball_px: float | None) -> FoundPress:
    """Find the ball's circle in an image, or the reason why the image cannot be used.

    `image` (H, W, 3) is the frame's image without marker dots. The dots show whether the camera moved.
    """
    change = compare_colours(image, reference)
    imprint = find_imprint(change)
    around = imprint.circle.measure_distance_px(change.shape[:2]) < APART * imprint.circle.radius_px
    dotted = gel.add_dots(reference)
    moved = change if gel.dots is None else compare_colours(frame.image, dotted)
    if (shift_px := float(np.hypot(*measure_shift(moved, dotted, around)))) > MOVED_PX:
        return FoundPress(frame, None, f"camera moved by {shift_px:.1f} px")
    if imprint.contrast < CONTRAST or imprint.likeness < BLURRED:
        return FoundPress(frame, None, "no ball found")
    other = find_imprint(change, around)
    if other.is_ball and other.contrast > SECOND * imprint.contrast:
        return FoundPress(frame, imprint.circle, "two balls")
    if imprint.likeness < LIKENESS:
        return FoundPress(frame, None, "no ball found")
    circle = find_rim(change, imprint.circle)
    cut = circle.measure_overhang_px(image.shape[:2]) / circle.radius_px
    moved_px = np.hypot(circle.x_px - imprint.circle.x_px, circle.y_px - imprint.circle.y_px)
    unsure = moved_px > SETTLED * circle.radius_px or circle.measure_visible_arc(image.shape[:2]) < VISIBLE
    if cut > CUT or (cut > OUTSIDE and unsure):
        return FoundPress(frame, circle, "cut off at the border")
    return FoundPress(frame, circle, _find_fault(image, reference, circle, ball_px))


def _find_fault(image: Image, reference: Float32, circle: Circle, ball_px: float | None) -> str:
    """Return the reason why a press with this circle cannot be used, or an empty string."""
    inside = circle.measure_distance_px(image.shape[:2]) < circle.radius_px
    white = (image >= EXPOSED) & (reference < EXPOSED)
    if white[inside].mean() > MOST_EXPOSED:
        return "over-exposed"
    if ball_px is not None and circle.radius_px > WIDEST * ball_px:
        return OVERSIZED
    return ""
