"""A sensor's passport: checks of a calibrated sensor on photos of today. Each check is a row of CHECKS.

The photos show presses at different places, so that together they show today's untouched gel. It is compared with the
untouched gel of the calibration. The scale and the contrast are judged from presses of a ball.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter

from tactile_loc.core.geometry.rigid import Float32, Floats
from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.sensors.calibration.labels import Image
from tactile_loc.sensors.reading.circles import compare_colours, find_imprint
from tactile_loc.sensors.reading.markers import UntouchedGel
from tactile_loc.sensors.reading.photometric import PhotometricEstimator
from tactile_loc.sensors.reading.reading import LEAST_M, measure_press_m, reduce_image

FEWEST = 3  # fewest photos whose middle shows the untouched gel
TOUCHED = 2.0  # radius of the area around an imprint that does not show the untouched gel, in radii of the imprint
DEEP = 0.5  # share of the press depth that bounds the part of an imprint from which scale and contrast are measured
LEAST_PRESSES = 3  # fewest presses for scale and contrast
QUARTILE = 0.75  # of the contrasts of presses; light presses show less than their full contrast
FINE_PX, WIDE_PX = 1.0, 3.0  # range of the sizes of scratches
STUCK = 15  # least deviation of a dead pixel from the pixels around it, counts
EXPLAINED = 8.0  # largest mean difference of a gel that a turn explains, counts
LIKE_BALL, CLEAR = 0.75, 8.0  # least likeness and contrast, counts, of a touch in the zero image
ASPECT, CURVATURE = "aspect", "curvature"  # values of the calibration that checks compare with
EQUAL_SCALES = "equal scales"  # name of a check
MARGIN = 2.0  # least ratio of a faulty value to that of the calibration
SMALL = 0.35  # largest radius of that touch, share of the image's shorter side

NAN = float("nan")


@dataclass(frozen=True)
class Turn:
    """A wrong order of an image's rows, columns or colours: its name, and how the image was changed."""

    name: str
    change: Callable[[NDArray[np.generic]], NDArray[np.generic]]
    of_colours: bool = False


TURNS = (
    Turn("red and blue are swapped", lambda image: image[..., [2, 1, 0]], True),
    Turn("red and green are swapped", lambda image: image[..., [1, 0, 2]], True),
    Turn("green and blue are swapped", lambda image: image[..., [0, 2, 1]], True),
    Turn("left and right are swapped", lambda image: image[:, ::-1]),
    Turn("top and bottom are swapped", lambda image: image[::-1]),
    Turn("the image is turned by 180°", lambda image: image[::-1, ::-1]),
)


@dataclass(frozen=True)
class Reading:
    """The reading of a photo, after the change of the untouched gel is removed.

    `press_m` is the press depth, and `bulge_m` the height above the untouched gel. `aspect` is the width of the deep
    part of the imprint divided by its height, both in metres. `curvature` is that of the surface there, 1/m.
    """

    press_m: float
    bulge_m: float
    aspect: float
    curvature: float


@dataclass(frozen=True, eq=False)
class Examination:
    """Photos (N, H, W, 3) of today at the size of a sensor, in the order in which they were taken.

    The sensor has an `estimator` and an untouched `gel`. `usual` are the values of `measure_usual` at its calibration.
    """

    estimator: PhotometricEstimator
    gel: UntouchedGel
    photos: NDArray[np.uint8]
    usual: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def before(self) -> Float32:
        """The untouched gel (H, W, 3) with which the sensor compares photos, without dots, counts."""
        return self.gel.clear.astype(np.float32)

    @cached_property
    def clear(self) -> Float32:
        """The photos (N, H, W, 3) without dots, counts."""
        return np.stack([self.gel.clear_image(photo) for photo in self.photos]).astype(np.float32)

    @cached_property
    def bare(self) -> Float32:
        """The photos (N, H, W, 3) without dots, counts; NaN at and around their imprints."""
        middle = np.median(self.clear, axis=0).astype(np.float32)
        shown = self.clear.copy()
        for photo in shown:
            imprint = find_imprint(compare_colours(photo, middle))
            if imprint.is_ball:
                away = imprint.circle.measure_distance_px(middle.shape[:2]) / imprint.circle.radius_px
                photo[away < TOUCHED] = np.nan
        hidden = np.isnan(shown[..., 0]).all(axis=0)
        shown[:, hidden] = middle[hidden]
        return shown

    @cached_property
    def today(self) -> Float32:
        """The untouched gel (H, W, 3) of today, counts: the median of the photos, without their imprints."""
        return np.nanmedian(self.bare, axis=0).astype(np.float32)

    @cached_property
    def light(self) -> Floats:
        """The change (N, 3) of the light of each photo since the calibration, counts."""
        return np.asarray(np.nanmedian(self.bare - self.before, axis=(1, 2)), np.float64)

    @cached_property
    def change(self) -> Float32:
        """The change (H, W, 3) of the untouched gel since the calibration, counts, with median 0 in each colour."""
        return compare_colours(self.today, self.before)

    def read(self, image: Float32) -> tuple[Float32, Floats]:
        """Return the indentation (H, W), metres, and the slopes (H, W, 2) in an image (H, W, 3), counts."""
        indentation, slopes = self.estimator.read(np.clip(np.rint(image), 0, 255).astype(np.uint8))
        return indentation, slopes.astype(np.float64)

    @cached_property
    def readings(self) -> list[Reading]:
        """The readings of the photos that show a press."""
        found = [self._measure(photo - self.today + self.before) for photo in self.clear]
        return [one for one in found if max(one.press_m, one.bulge_m) > LEAST_M]

    def _measure(self, image: Float32) -> Reading:
        geometry = self.estimator.geometry
        indentation, slopes = self.read(image)
        press_m, bulge_m = (measure_press_m(sign * indentation, geometry) for sign in (np.float32(1), np.float32(-1)))
        deep = indentation > DEEP * press_m
        y, x = np.argwhere(deep).T / np.array(geometry.scale_at_surface)[::-1, None]
        falls = [
            -float(np.cov(along, slope)[0, 1]) / max(float(along.var()), 1e-12)
            for along, slope in ((x, slopes[deep, 0]), (y, slopes[deep, 1]))
        ]
        return Reading(press_m, bulge_m, float(x.std()) / max(float(y.std()), 1e-9), sum(falls) / 2)

    @cached_property
    def turned(self) -> list[float]:
        """The mean difference, counts, of today's gel from that of the calibration: unchanged, then by TURNS."""
        made = [self.before, *(turn.change(self.before).astype(np.float32) for turn in TURNS)]
        return [float(np.abs(compare_colours(self.today, one)).mean()) for one in made]

    def find_turn(self) -> Turn:
        """Return the turn that explains today's gel best."""
        return TURNS[int(np.argmin(self.turned[1:]))]

    @cached_property
    def mixing(self) -> Floats:
        """The linear map (2, 2) from right slopes to those that are read after the turn that explains the gel best."""
        turn = self.find_turn()
        right, read = [], []
        for photo in self.clear:
            undone = turn.change(photo).astype(np.float32)  # swapping twice restores the image
            indentation, known = self.read(undone)
            deep = indentation > DEEP * measure_press_m(indentation, self.estimator.geometry)
            right.append(known[deep])
            read.append(self.read(photo)[1][deep])
        return np.asarray(np.linalg.lstsq(np.concatenate(right), np.concatenate(read), rcond=None)[0])

    @cached_property
    def read_today(self) -> tuple[Float32, Floats]:
        """The indentation (H, W), metres, and the slopes (H, W, 2) that are read in today's untouched gel."""
        return self.read(self.today)


def _measure_order(seen: Examination) -> float:
    """Return how much better a turn explains today's gel than no turn; 0 if no turn explains it."""
    unchanged, *turned = seen.turned
    return unchanged / max(min(turned), 1.0) if min(turned) < EXPLAINED else 0.0


def _measure_light(seen: Examination) -> Floats:
    """Return the brightness (3,) of each colour today, divided by that of the calibration."""
    now, before = (np.median(image, axis=(0, 1)).astype(np.float64) for image in (seen.today, seen.before))
    return np.asarray((now + 5) / (before + 5))


def _measure_lamp(seen: Examination) -> float:
    """Return how much darker the darkest colour has become than the middle one, as a logarithm."""
    light = _measure_light(seen)
    return float(np.log(np.median(light) / light.min()))


def _measure_bulge(seen: Examination) -> float:
    ratios = [one.bulge_m / max(one.press_m, LEAST_M) for one in seen.readings]
    return float(np.median(ratios)) if ratios else NAN


def _measure_aspect(seen: Examination) -> float:
    """Return the logarithm of the imprints' median aspect, compared with that of the calibration."""
    aspects = [float(np.log(one.aspect)) for one in seen.readings]
    return float(np.median(aspects)) - seen.usual.get(ASPECT, 0.0) if len(aspects) >= LEAST_PRESSES else NAN


def _measure_touch(seen: Examination) -> float:
    """Return the depth, metres, of a touch in the zero image, compared with today's gel; 0 without one.

    If today's gel is the deeper one, it has a permanent dent.
    """
    imprint = find_imprint(seen.change)
    small = imprint.circle.radius_px < SMALL * min(seen.before.shape[:2])
    if imprint.likeness < LIKE_BALL or imprint.contrast < CLEAR or not small:
        return 0.0
    touched, dented = seen.read(2 * seen.before - seen.today)[0], seen.read_today[0]
    touch_m, dent_m = (measure_press_m(one, seen.estimator.geometry) for one in (touched, dented))
    return touch_m if touch_m > dent_m else 0.0


def _measure_texture(seen: Examination) -> float:
    even = median_filter(seen.change, (3, 3, 1))  # without dead pixels
    fine = gaussian_filter(even, (FINE_PX, FINE_PX, 0)) - gaussian_filter(even, (WIDE_PX, WIDE_PX, 0))
    return float(np.quantile(np.abs(fine), 0.99))


def _measure_offset(seen: Examination) -> float:
    return max(measure_press_m(sign * seen.read_today[0], seen.estimator.geometry) for sign in (-1, 1))


def _measure_trend(seen: Examination) -> float:
    """Return the change of the light from the first photo to the last, counts, by a line through all photos."""
    return float(np.abs(_fit_trend(seen)).max())


def _fit_trend(seen: Examination) -> Floats:
    last = len(seen.light) - 1
    return np.asarray(last * np.polyfit(np.arange(last + 1), seen.light, 1)[0])


def _count_dead(seen: Examination) -> float:
    change = seen.clear - seen.before
    alone = np.median(change - median_filter(change, (1, 3, 3, 1)), axis=0)
    return float((np.abs(alone).max(axis=-1) > STUCK).sum())


def _measure_curvature(seen: Examination) -> float:
    """Return the curvature of the ball as it is read, 1/m."""
    curvatures = [one.curvature for one in seen.readings]
    return float(np.quantile(curvatures, QUARTILE)) if len(curvatures) >= LEAST_PRESSES else NAN


def _measure_loss(seen: Examination) -> float:
    """Return the share of the ball's slopes at the calibration that is not read today."""
    usual = seen.usual.get(CURVATURE, NAN)
    return 1 - _measure_curvature(seen) / usual


@dataclass(frozen=True)
class SensorCheck:
    """A check: its `name`, a statistic in units of `unit`, and the `limit` above which the sensor has the fault.

    `says` states the fault, and `advice` what to do. If `explains` is true, the checks below are not judged after this
    fault. `distort` maps slopes (H, W, 2) of a touch to those that the faulty sensor reads; None if nothing changes.
    """

    name: str
    measure: Callable[[Examination], float]
    limit: float
    unit: str
    says: str
    advice: str
    explains: bool = False
    distort: Callable[[Examination, Floats], Floats] | None = None

    def find_limit(self, seen: Examination) -> float:
        """Return the limit for this sensor: larger if the value was large at the calibration."""
        return max(self.limit, MARGIN * seen.usual.get(self.name, 0.0))


def _turn_slopes(seen: Examination, slopes: Floats) -> Floats:
    turn = seen.find_turn()
    return np.asarray(slopes @ seen.mixing if turn.of_colours else turn.change(slopes), np.float64)


def _stretch_slopes(seen: Examination, slopes: Floats) -> Floats:
    """Return the slopes of a touch whose image is stretched along x about its middle."""
    stretch, width = float(np.exp(_measure_aspect(seen))), slopes.shape[1]
    columns = np.clip(np.rint((np.arange(width) - width / 2) / stretch + width / 2), 0, width - 1).astype(int)
    return np.asarray(slopes[:, columns])


def _add_gel(seen: Examination, slopes: Floats) -> Floats:
    """Return the slopes of a touch, added to those that are read in today's untouched gel."""
    return np.asarray(slopes + seen.read_today[1])


def _add_trend(seen: Examination, slopes: Floats) -> Floats:
    """Return the slopes of a touch in the light of the last photo."""
    after = seen.before + _fit_trend(seen).astype(np.float32)
    return np.asarray(slopes + seen.read(after)[1] - seen.read(seen.before)[1])


def _shrink_slopes(seen: Examination, slopes: Floats) -> Floats:
    return np.asarray(slopes * (1 - _measure_loss(seen)))


CHECKS = (
    SensorCheck("order of colours and pixels", _measure_order, 1.5, "times", "{turn}",
                "change the camera's settings back", True, _turn_slopes),
    SensorCheck("same sensor", lambda seen: seen.turned[0], 12.0, "counts",
                "the photos are of another sensor, or the light is quite different", "calibrate this sensor",
                True, _add_gel),
    SensorCheck("lamps", _measure_lamp, 0.35, "", "a lamp is dark", "repair the lamp, or calibrate again",
                True, _add_gel),
    SensorCheck("sign of the imprints", _measure_bulge, 0.4, "times", "presses are read as bulges",
                "check the order of the colours, and whether the image is mirrored", True),
    SensorCheck(EQUAL_SCALES, lambda seen: abs(_measure_aspect(seen)), 0.06, "",
                "a ball's imprint is {percent:.0f} % {longer}, so x and y have different scales",
                "correct the scales in sensor.toml, or the camera's image size", True, _stretch_slopes),
    SensorCheck("zero image", _measure_touch, 5e-5, "m", "the zero image shows a touch",
                "give a new photo of the untouched gel as the zero image", True, _add_gel),
    SensorCheck("surface of the gel", _measure_texture, 8.0, "counts", "the gel is worn: scratches or stains are new",
                "replace the gel and calibrate again", False, _add_gel),
    SensorCheck("offset without contact", _measure_offset, 6e-5, "m", "an indentation is read where nothing touches",
                "give a new photo of the untouched gel as the zero image", False, _add_gel),
    SensorCheck("drift", _measure_trend, 6.0, "counts", "the light changes from photo to photo",
                "let the lamps warm up, and fix the camera's exposure", False, _add_trend),
    SensorCheck("dead pixels", _count_dead, 4.0, "pixels", "single pixels are stuck", "mark them in the sensor's mask"),
    SensorCheck("contrast of the gel", _measure_loss, 0.2, "",
                "the gel is worn: slopes are read {percent:.0f} % too small", "replace the gel and calibrate again",
                False, _shrink_slopes),
)  # fmt: skip


@dataclass(frozen=True)
class SensorFinding:
    """The `value` of a check's statistic. It is NaN if the check was not possible or is explained by another fault."""

    check: SensorCheck
    value: float
    says: str = ""

    @property
    def is_fault(self) -> bool:
        """Whether the sensor has the check's fault."""
        return bool(self.says)


def examine_photos(seen: Examination) -> list[SensorFinding]:
    """Return the findings of all CHECKS, in their order."""
    found: list[SensorFinding] = []
    explained = False
    for check in CHECKS:
        value = NAN if explained else check.measure(seen)
        fault = value > check.find_limit(seen)
        found.append(SensorFinding(check, value, _describe(check, seen, value) if fault else ""))
        explained = explained or (fault and check.explains)
    return found


def measure_usual(seen: Examination) -> dict[str, float]:
    """Return the values of all checks for presses of the calibration, with the aspect and the curvature of the ball."""
    values = {check.name: check.measure(seen) for check in CHECKS}
    values |= {ASPECT: _measure_aspect(seen), CURVATURE: _measure_curvature(seen)}
    return {name: value for name, value in values.items() if np.isfinite(value)}


def _describe(check: SensorCheck, seen: Examination, value: float) -> str:
    longer = "wider than high" if _measure_aspect(seen) > 0 else "higher than wide"
    return check.says.format(turn=seen.find_turn().name, percent=100 * value, longer=longer)


def require_photos(photos: Sequence[Image], camera_px: tuple[int, int], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return photos as (N, H, W, 3) at the sensor's `shape`. Raises TouchError for too few, or for another size.

    Photos of the camera's size `camera_px` (rows, columns) are reduced.
    """
    if len(photos) < FEWEST:
        raise TouchError(f"there are only {len(photos)} photos; give at least {FEWEST} of presses, better 10")
    other = next((photo for photo in photos if photo.shape[:2] not in (camera_px, shape)), None)
    if other is not None:
        got, want = (f"{size[1]} x {size[0]}" for size in (other.shape[:2], camera_px))
        raise TouchError(
            f"a photo is {got} px (width x height) but the sensor's are {want} px; the photos are of another sensor"
        )
    return np.stack([reduce_image(photo, shape) for photo in photos])
