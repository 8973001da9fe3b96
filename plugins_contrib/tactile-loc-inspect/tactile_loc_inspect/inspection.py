"""The inspection of a located part: differences from the model, and a verdict about the touched surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tactile_loc import Hypothesis, Localization, ObjectModel, TactileLocError
from tactile_loc.plugin import View
from tactile_loc.plugin.helpers import transform_points

from tactile_loc_inspect.comparison import (
    PLAIN,
    Comparison,
    Floats,
    TouchImage,
    compare_touches,
    fit_plain_pose,
    fit_pose,
)
from tactile_loc_inspect.scan import AGREE, SIZES_M, WIDTH, SurfaceMap, map_differences
from tactile_loc_inspect.shifts import Observation, Shift, find_shift

CERTAIN = "certain"  # the verdict that gives a pose
MOST_OTHERS = 6  # other poses that are compared
MOST = 8  # differences that are listed
APART = 1.5  # widths of a difference within which no other one is listed
NOISY_M = 8e-6  # a noisier reading may show contact that is not there, or miss contact, in one touch
FOUND_SHARE = 1.645  # standard deviations above the limit at which 95 % are found
STATED_WIDTH_M = 1.13e-3  # at half the height, of the differences for which the verdict states a height
MARGIN = 1.15  # of the stated height, because touches must also show a difference alone
FAR_M = 1e-3  # a refinement that moves the surface farther is reported
MOSTLY = 0.4  # share of differing places from which the pose is in doubt
BETTER = 0.7  # another pose explains the touches better if it leaves this share of the misfit
LEAST_MISFIT_M = 2e-5  # a pose with a smaller misfit explains the touches
HALF = 0.5  # share of the height that a blob as wide as the difference has
BOUNDED = 0.2  # share of places with bounds from which a difference is a bound
NUMBERS = ("noise_m", "blur_m", "misfit_m")  # of a touch, in files
SHARP = 0.3  # the height is that of the smallest blob whose statistic is at least this share of the best one


class InspectionError(TactileLocError):
    """The part cannot be inspected."""


@dataclass(frozen=True)
class Limits:
    """When a difference is reported, for one kind of reading.

    `ratio` is the least statistic. `touches` is the least number of touches that alone show the difference, and
    `bounds` their least number if they only bound it. A touch alone shows it from `agree` standard deviations on.
    `shown` is the share of a narrow dent's depth that is read. `shift` is the least statistic of a moved shape.
    """

    ratio: float
    touches: int
    bounds: int
    agree: float = AGREE
    shown: float = 1.0
    shift: float = np.inf

    def are_met(self, one: Difference) -> bool:
        """Return whether enough touches show a difference."""
        return one.touches >= (self.bounds if one.at_least else self.touches)

    def count_shown(self, of: int) -> int:
        """Return how many of a part's touches must show a place, so that any difference there is reported."""
        return max(self.touches, min(self.bounds, of))


EXACT = Limits(8.0, 1, 1, shift=6.0)
NOISY = Limits(5.0, 2, 3)
IMAGES = Limits(8.0, 2, 2, agree=2.0, shown=1 / 6)  # a gel bridges narrow dents


@dataclass(frozen=True, eq=False)
class Difference:
    """A place at which the part differs from the model.

    `point_m` (3,) and `normal` (3,) are of the model's surface, in the object's frame. The part is `height_m` metres
    above the model along the normal, or below it if negative, with the standard deviation `std_m`. With `at_least`, the
    true difference may be larger. `width_m` is the width at half of the height. `touches` alone show it, and
    `against` alone show the opposite.
    """

    point_m: Floats
    normal: Floats
    height_m: float
    std_m: float
    width_m: float
    at_least: bool
    touches: int
    against: int
    ratio: float

    def to_json(self) -> dict[str, Any]:
        """Return the difference as JSON values, in SI units."""
        values = {name: getattr(self, name) for name in ("height_m", "std_m", "width_m", "at_least", "touches")}
        more = {"against": self.against, "statistic": self.ratio}
        return {"point_m": self.point_m.tolist(), "normal": self.normal.tolist(), **values, **more}

    def describe(self) -> str:
        """Return the difference in words."""
        x, y, z = 1e3 * self.point_m
        more = "at least " if self.at_least else ""
        what = "more" if self.height_m > 0 else "less"
        return (
            f"{more}{1e3 * abs(self.height_m):.2f} +- {2e3 * self.std_m:.2f} mm {what} material at "
            f"({x:.1f}, {y:.1f}, {z:.1f}) mm, about {1e3 * self.width_m:.1f} mm wide"
        )


@dataclass(frozen=True, eq=False)
class Inspection:
    """The differences of a part from its model at the touched places.

    `differences` are certain enough to report, the greatest first, and `unconfirmed` are seen by a single touch of a
    noisy reading. `detectable_m` is the height of a difference that would have been found with 95 % probability at the
    touched places. `touched` is the share of the surface that enough touches show. `moved_m` is how far the differences
    move an ordinary pose: the largest displacement of a surface point. `refined_m` is how far the refinement moved the
    given pose. `unexplained` is the share of the touched places that differ. `better` is the number of another pose,
    from 1, that explains the touches better; None if there is none. `shift` is the place where the shape is moved; None
    if none is found.
    """

    object: ObjectModel
    comparisons: tuple[Comparison, ...]
    map: SurfaceMap
    limits: Limits
    differences: tuple[Difference, ...]
    unconfirmed: tuple[Difference, ...]
    detectable_m: float
    touched: float
    moved_m: float
    refined_m: float
    unexplained: float
    better: int | None = None
    shift: Shift | None = None

    @property
    def verdict(self) -> str:
        """One of "as the model", "differs", "another pose" and "not enough touches"."""
        if self.better is not None:
            return "another pose"
        if self.differences or self.shift is not None:
            return "differs"
        return "as the model" if np.isfinite(self.detectable_m) else "not enough touches"

    def list_notes(self) -> list[str]:
        """Return what else a reader of the verdict must know, as sentences."""
        notes = []
        if self.differences and self.shift is not None:
            notes.append(self.shift.describe())
        if self.moved_m > 0:
            notes.append(f"the differences move an ordinary pose by up to {1e3 * self.moved_m:.2f} mm")
        if self.limits is NOISY and self.verdict == "as the model":
            notes.append("the reading has noise, so a difference of the stated height is found less often than in 95 %")
        if self.limits is EXACT and self.verdict == "as the model" and self.comparisons[0].geometry.gel.is_elastic:
            notes.append("the gel is elastic, so a dent of the stated height is found less often than in 95 %")
        if self.refined_m > FAR_M:
            notes.append(
                f"the touches fit best at a pose {1e3 * self.refined_m:.1f} mm from the given one; check the pose"
            )
        if self.unexplained > MOSTLY:
            notes.append(
                f"{100 * self.unexplained:.0f} % of the touched surface differs, so the pose or the model may be wrong"
            )
        if self.limits is IMAGES and (self.differences or self.unconfirmed):
            notes.append("the touches are read from images, which may err at edges, so check each difference by eye")
        if self.limits is IMAGES and not self.differences:
            notes.append(
                "the touches are read from images, so small differences cannot be found, and one of the stated height "
                "is found less often than in 95 %"
            )
        return notes

    def to_json(self) -> dict[str, Any]:
        """Return the inspection as JSON values, in SI units."""
        return {
            "object": self.object.name,
            "verdict": self.verdict,
            "says": self.describe(),
            "detectable_m": self.detectable_m if np.isfinite(self.detectable_m) else None,
            "touched": self.touched,
            "moved_m": self.moved_m,
            "refined_m": self.refined_m,
            "unexplained": self.unexplained,
            "better_pose": self.better,
            "shift": None if self.shift is None else self.shift.to_json(),
            "notes": self.list_notes(),
            "differences": [one.to_json() for one in self.differences],
            "unconfirmed": [one.to_json() for one in self.unconfirmed],
            "touches": [
                {"T_sensor_object": one.T.tolist(), **{name: getattr(one, name) for name in NUMBERS}}
                for one in self.comparisons
            ],
        }

    def describe(self) -> str:
        """Return the verdict in one line."""
        where = f"; the touches show {100 * self.touched:.1f} % of the surface"
        if self.better is not None:
            return f"pose {self.better} explains the touches better, so no difference is reported{where}"
        width = 1e3 * STATED_WIDTH_M
        if self.verdict == "not enough touches":
            count = self.limits.count_shown(len(self.comparisons))
            if count == 1 or (self.map.touches >= count).any():
                return (
                    f"not enough touches: no contact is wide and deep enough to find differences {width:.1f} mm wide; "
                    "press deeper"
                )
            return f"not enough touches: the reading has errors, so {count} touches must show the same place"
        if self.verdict == "as the model":
            within = f"{1e3 * self.detectable_m:.2f} mm at the touched places (differences {width:.1f} mm wide)"
            more = f"; unconfirmed differences: {len(self.unconfirmed)}" if self.unconfirmed else ""
            return f"as the model, within {within}{where}{more}"
        first = self.differences[0] if self.differences else self.shift
        return f"differs here: {first.describe() if first else ''}{where}"


def inspect_part(
    views: Sequence[View], poses: Sequence[Floats], others: Mapping[int, Sequence[Floats]] | None = None
) -> Inspection:
    """Inspect a part from touches, given its pose (4, 4), metres, in the sensor frame of each touch.

    `others` are further poses by their numbers, each in the frames of all touches, that may explain the touches better.
    """
    comparisons, obj = tuple(compare_touches(views, poses)), views[0].scene.object
    limits, pairs = choose_limits(comparisons), list(zip(views, comparisons, strict=True))
    found = map_differences(comparisons, limits.agree)
    listed = list_differences(found, limits)
    enough = [one for one in listed if limits.are_met(one)]
    moved = find_moved_shape(views, poses, comparisons, limits)
    stated_m = state_heights(found, limits)
    shown = np.isfinite(stated_m)
    return Inspection(
        obj,
        comparisons,
        found,
        limits,
        tuple(enough),
        tuple(one for one in listed if not limits.are_met(one)),
        float(np.quantile(stated_m[shown], 0.95)) if shown.any() else np.inf,
        min(1.0, float(found.areas_m2[shown].sum() / obj.mesh.face_areas.sum())),
        max(measure_motion(obj, fit_plain_pose(view, one.T), one.T) for view, one in pairs) if enough else 0.0,
        max(measure_motion(obj, T, one.T) for T, one in zip(poses, comparisons, strict=True)),
        float((np.abs(found.ratios[1]) > limits.ratio).mean()),
        find_better(views, comparisons, others or {}),
        moved if moved and (moved.explains or not enough) else None,
    )


def find_moved_shape(
    views: Sequence[View], poses: Sequence[Floats], comparisons: Sequence[Comparison], limits: Limits
) -> Shift | None:
    """Return the place where the shape is moved, if the statistic exceeds its limit.

    Readings with noise are not tested, because they raise false alarms. Elastic gels and readings from images are not
    tested, because no limit was measured for them.
    """
    if not np.isfinite(limits.shift) or views[0].touch.geometry.gel.is_elastic:
        return None
    images = [TouchImage.of(view) for view in views]  # an exact reading has no blur
    plain = [fit_pose(image, one.T, T, PLAIN).T for image, one, T in zip(images, comparisons, poses, strict=True)]
    observations = [Observation(*one) for one in zip(images, poses, strict=True)]
    return find_shift(observations, plain, limits.shift)


def choose_limits(comparisons: Sequence[Comparison]) -> Limits:
    """Return the limits for the reading of touches."""
    if any(one.from_image for one in comparisons):
        return IMAGES
    noise_m = np.median([one.noise_m for one in comparisons])
    return NOISY if comparisons[0].blur_m or noise_m > NOISY_M else EXACT


def state_heights(found: SurfaceMap, limits: Limits) -> Floats:
    """Return the heights (N,), metres, of STATED_WIDTH_M wide differences that would be found with 95 % at each place.

    A blob's mean is lower than the peak of a difference, so each place counts by its best size of blobs. The height is
    infinite where too few touches press the place deeper than the dent that is read: there, it would leave the gel.
    """
    stated = (STATED_WIDTH_M / WIDTH) ** 2
    shares = stated / (stated + np.square(SIZES_M))
    heights_m = MARGIN * ((limits.ratio + FOUND_SHARE) * found.std_m / shares[:, None]).min(axis=0)
    count = limits.count_shown(len(found.pressed_m))
    if count > len(found.pressed_m):
        return np.full(len(heights_m), np.inf)
    return np.where(np.sort(found.pressed_m, axis=0)[-count] > heights_m, heights_m / limits.shown, np.inf)


def list_differences(found: SurfaceMap, limits: Limits) -> list[Difference]:
    """Return the differences of a map whose statistic is above the limit, the greatest first."""
    ratios = np.abs(found.ratios)
    size, best = ratios.argmax(axis=0), ratios.max(axis=0)
    left, listed = best > limits.ratio, list[Difference]()
    while left.any() and len(listed) < MOST:
        place = int(np.where(left, best, 0).argmax())
        k, point = int(size[place]), found.points_m[place]
        sharp = int(np.argmax(ratios[:, place] > max(limits.ratio, SHARP * best[place])))
        # a mean over a blob is lower than the peak, by an amount that is four times as large at the next size
        wider = min(sharp + 1, len(SIZES_M) - 1)
        flattened = float(found.heights_m[sharp, place] - found.heights_m[wider, place]) / 3
        heights = found.heights_m[:, place] / found.heights_m[sharp, place]
        width = WIDTH * SIZES_M[int(np.flatnonzero(heights > HALF)[-1])]
        distances = np.linalg.norm(found.points_m - point, axis=1)
        bridged = limits.shown < 1 and found.heights_m[sharp, place] < 0
        listed.append(
            Difference(
                point,
                found.normals[place],
                float(found.heights_m[sharp, place] + flattened),
                float(np.hypot(found.std_m[sharp, place], flattened)),
                width,
                bool(bridged or found.bounds[distances < width].mean() > BOUNDED),
                int(found.support[k, place]),
                int(found.against[k, place]),
                float(best[place]),
            )
        )
        widest = WIDTH * SIZES_M[int(np.flatnonzero(ratios[:, place] > limits.ratio)[-1])]
        left &= distances > APART * max(width, widest)
    return listed


def measure_motion(obj: ObjectModel, T: Floats, other: Floats) -> float:
    """Return the largest displacement of a surface point between two poses (4, 4), metres."""
    corners = obj.mesh.hull_corners_m
    return float(np.linalg.norm(transform_points(T, corners) - transform_points(other, corners), axis=1).max())


def find_better(
    views: Sequence[View], comparisons: Sequence[Comparison], others: Mapping[int, Sequence[Floats]]
) -> int | None:
    """Return the number of the best other pose, if it explains the touches better than the pose compared."""
    misfit = float(np.mean([one.misfit_m for one in comparisons]))
    if misfit < LEAST_MISFIT_M:
        return None
    best, number = BETTER * misfit, None
    for k, poses in others.items():
        other = float(np.mean([one.misfit_m for one in compare_touches(views, poses)]))
        if other < best:
            best, number = other, k
    return number


def inspect_localization(located: Localization, pose: int | None = None) -> Inspection:
    """Inspect the part of a result at its first pose, which must be certain, or at `pose`, counted from 1.

    Raises InspectionError if the verdict is another one and no pose is given, or if there is no such pose.
    """
    if pose is None and located.verdict != CERTAIN:
        raise InspectionError(
            f"inspection needs the part's pose, but the verdict is '{located.verdict}'; touch again at another place, "
            "or give --pose 1 if you know that the first pose is right"
        )
    number = pose or 1
    if not 1 <= number <= len(located.hypotheses):
        raise InspectionError(f"there is no pose {number}; give --pose 1 to {len(located.hypotheses)}")
    views = located.make_views()
    numbered = {k: _list_poses(one, views) for k, one in enumerate(located.hypotheses[: MOST_OTHERS + 1], 1)}
    chosen = numbered.pop(number, None) or _list_poses(located.hypotheses[number - 1], views)
    return inspect_part(views, chosen, numbered)


def _list_poses(one: Hypothesis, views: Sequence[View]) -> list[Floats]:
    """Return a hypothesis's pose (4, 4), metres, in the frame of each touch's sensor."""
    seen = one.refined.T_sensors_object
    return list(seen) if seen is not None else [view.T_sensor_first @ one.T_sensor_object for view in views]
