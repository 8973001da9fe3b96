"""The score of all presses: calibration, repeatability, errors between places, and one number for all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
from tactile_loc import Localizer
from tactile_loc.plugin import Progress

from tactile_loc_test_object.scoring import FLAT_M, RIGHT_M, Floats, Photo, ScoredPress, read_press
from tactile_loc_test_object.shape import NAME, PLACES, VERSION

SCHEMA_VERSION = 1
HAND_M = 2e-4  # error of a place that a person reaches with the plate's lines
MM = 1e3


def score_photos(
    localizer: Localizer, photos: Sequence[Photo], turn_rad: float = 0.0, progress: Progress | None = None
) -> Score:
    """Locate the photos of a localizer's sensor, and return their score. The localizer's object is the test object."""
    presses = []
    with (progress or Progress()).task("locating the photos", len(photos)) as advance:
        for photo in photos:
            presses.append(read_press(localizer, photo, turn_rad))
            advance(1)
    return Score(tuple(presses))


@dataclass(frozen=True, eq=False)
class Score:
    """The presses of a folder, and what they say about the sensor.

    The sensor's middle has an unknown place in its housing. So the median shift of all presses, `middle_m` (2,), and
    their median turn are no errors. Only what differs from them is. All values are in metres and radians, and None if
    too few presses were located.
    """

    presses: tuple[ScoredPress, ...]

    @cached_property
    def located(self) -> tuple[ScoredPress, ...]:
        """The presses with a pose that fits, whose place is where it should be, within RIGHT_M."""
        return tuple(press for press in self.presses if press.fits and not self._is_astray(press))

    def _is_astray(self, press: ScoredPress) -> bool:
        assert press.shift_m is not None
        return bool(np.linalg.norm(press.shift_m - self.middle_m) > RIGHT_M)

    @cached_property
    def middle_m(self) -> Floats:
        """The median shift (2,) of all presses with a pose that fits, metres: x to the right, y down in the photo."""
        shifts = [press.shift_m for press in self.presses if press.shift_m is not None and press.fits]
        return np.median(shifts, axis=0) if shifts else np.zeros(2)

    @cached_property
    def turn_rad(self) -> float:
        """The median turn of the located presses."""
        return float(np.median([press.turn_rad for press in self.located])) if self.located else 0.0

    @cached_property
    def by_place(self) -> dict[int, list[ScoredPress]]:
        """All presses of each place."""
        return {place.number: [one for one in self.presses if one.photo.place == place] for place in PLACES}

    def describe_state(self, press: ScoredPress) -> str:
        """Return the state of a press in words: its verdict, "astray" or "refused"."""
        if press.shift_m is None:
            return "refused"
        return "astray" if press.fits and self._is_astray(press) else press.verdict

    def rate(self, press: ScoredPress) -> float:
        """Return the points of a press for the shape, 0 to 100: 0 if it was not located."""
        return 100 * press.surfaces.share if press.surfaces is not None and press in self.located else 0.0

    @cached_property
    def shape_points(self) -> float:
        """The mean over all places of the mean points of their presses, 0 to 100. Missing places count 0."""
        return sum(weight * self.rate(press) for press, weight in self._weigh())

    @cached_property
    def height_points(self) -> float:
        """The share of located presses minus the mean error of their height scales, 0 to 100.

        The mean has a sign, so that errors of single shapes cancel. A scale error counts as 1 at most. So the points of
        a press that is refused are never less than what its scale cost.
        """
        found = [(weight, press.surfaces.scale) for press, weight in self._weigh(True) if press.surfaces is not None]
        off = sum(weight * (min(max(scale, 0.0), 2.0) - 1) for weight, scale in found)
        return 100 * (sum(weight for weight, _ in found) - abs(off))

    @property
    def points(self) -> float:
        """The score, 0 to 100: the mean of the points for the shape and for the heights."""
        return (self.shape_points + self.height_points) / 2

    def _weigh(self, located: bool = False) -> Iterator[tuple[ScoredPress, float]]:
        """Yield each press with its weight, or the located ones only. All places weigh the same."""
        for some in self.by_place.values():
            for press in some:
                if not located or press in self.located:
                    yield press, 1 / (len(PLACES) * len(some))

    @property
    def calibration_m(self) -> float | None:
        """The median over the located presses of the RMS difference of the seen and the expected surface."""
        errors = [press.surfaces.error_m for press in self.located if press.surfaces is not None]
        return float(np.median(errors)) if errors else None

    @property
    def height_scale(self) -> float | None:
        """The factor from true to read heights, from all located presses."""
        known = [(one.surfaces.scale, one.surfaces.relief_m**2) for one in self.located if one.surfaces is not None]
        scales, weights = np.array(known or [(0.0, 0.0)]).T
        return float(scales @ weights / weights.sum()) if weights.sum() > 0 else None

    @property
    def repeatability_m(self) -> float | None:
        """The standard deviation of the shift about its mean at places that were pressed again."""
        several = [some for some in self._group_shifts() if len(some) > 1]
        if not several:
            return None
        squares = sum(float(((some - some.mean(axis=0)) ** 2).sum()) for some in several)
        return float(np.sqrt(squares / sum(len(some) - 1 for some in several)))

    @property
    def between_places_m(self) -> float | None:
        """The RMS over places of the distance of their mean shift from that of all places. The hand's error counts."""
        means = [some.mean(axis=0) for some in self._group_shifts()]
        if len(means) < 2:
            return None
        return float(np.sqrt(((np.array(means) - np.mean(means, axis=0)) ** 2).sum(axis=1).mean()))

    def _group_shifts(self) -> list[Floats]:
        """Return the shifts (N, 2) of the located presses of each place that has some."""
        groups = [[one.shift_m for one in some if one in self.located] for some in self.by_place.values()]
        return [np.array(shifts) for shifts in groups if shifts]

    def describe(self) -> Iterator[str]:
        """Yield the score in words."""
        places = {press.photo.place.number for press in self.located}
        yield (
            f"score: {self.points:.1f} of 100 (shape {self.shape_points:.1f}, heights {self.height_points:.1f}); "
            f"{len(self.located)} of {len(self.presses)} photos located, "
            f"{len(places)} of {len(PLACES)} places"
        )
        if self.calibration_m is None or self.height_scale is None:
            return
        yield (
            f"calibration: the surface differs from the shape by {MM * self.calibration_m:.3f} mm (median RMS); "
            f"heights are read as {100 * self.height_scale:.0f} % of the true ones"
        )
        if self.repeatability_m is not None:
            yield f"repeatability: {MM * self.repeatability_m:.2f} mm, with the error of the hand"
        if self.between_places_m is not None:
            between, hand = MM * self.between_places_m, MM * HAND_M
            yield f"between places: {between:.2f} mm; the hand's error alone is about {hand:.1f} mm"
        (x, y), turn = MM * self.middle_m, np.degrees(self.turn_rad)
        yield f"the place appears {x:+z.2f} mm right and {y:+z.2f} mm below the middle, turned by {turn:+z.1f}°"

    def list_rows(self) -> list[list[str]]:
        """Return the table of the presses, with its header."""
        header = ["photo", "place", "state", "points", "press mm", "error mm", "heights %", "x mm", "y mm", "turn deg"]
        rows = []
        for press in self.presses:
            cells, found = [""] * 6, press.surfaces
            if press.shift_m is not None and found is not None:
                heights = f"{100 * found.scale:.0f}" if found.relief_m > FLAT_M else "flat"
                x, y = MM * (press.shift_m - self.middle_m)
                turn = np.degrees(press.turn_rad - self.turn_rad)
                cells = [f"{MM * found.deepest_m:.2f}", f"{MM * found.error_m:.3f}", heights]
                cells += [f"{x:+z.2f}", f"{y:+z.2f}", f"{turn:+z.1f}"]
            state, points = self.describe_state(press), f"{self.rate(press):.0f}"
            rows.append([press.photo.path.name, press.photo.place.name, state, points, *cells])
        return [header, *rows]

    def to_row(self, sensor: str) -> dict[str, Any]:
        """Return the row for a table of sensors, as JSON values; lengths in mm. `sensor` is the sensor's name."""
        return {
            "schema_version": SCHEMA_VERSION,
            "test_object": VERSION,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": {name: version(name) for name in ("tactile-loc", f"tactile-loc-{NAME}")},
            "sensor": sensor,
            "score": round(self.points, 1),
            "shape": round(self.shape_points, 1),
            "heights": round(self.height_points, 1),
            "photos": len(self.presses),
            "places": sum(map(bool, self.by_place.values())),
            "located": len(self.located),
            "certain": sum(press.verdict == "certain" for press in self.located),
            "calibration_mm": _round_mm(self.calibration_m),
            "height_scale": None if self.height_scale is None else round(self.height_scale, 3),
            "repeatability_mm": _round_mm(self.repeatability_m),
            "between_places_mm": _round_mm(self.between_places_m),
        }

    def to_json(self, sensor: str) -> dict[str, Any]:
        """Return the row, the middle of the sensor, and all presses, as JSON values."""
        presses = []
        for press in self.presses:
            shift = None if press.shift_m is None else press.shift_m - self.middle_m
            found = press.surfaces
            presses.append(
                {
                    "photo": press.photo.path.name,
                    "place": press.photo.place.number,
                    "shape": press.photo.place.name,
                    "feature_mm": press.photo.place.feature,
                    "state": self.describe_state(press),
                    "reason": press.refused,
                    "points": round(self.rate(press), 1),
                    "press_mm": None if found is None else _round_mm(found.deepest_m),
                    "error_mm": None if found is None else _round_mm(found.error_m),
                    "relief_mm": None if found is None else _round_mm(found.relief_m),
                    "height_scale": None if found is None else round(found.scale, 3),
                    "shift_mm": None if shift is None else [round(MM * float(v), 3) for v in shift],
                    "turn_deg": None if shift is None else round(float(np.degrees(press.turn_rad - self.turn_rad)), 2),
                }
            )
        return {
            "row": self.to_row(sensor),
            "middle_mm": [round(MM * float(v), 3) for v in self.middle_m],
            "turn_deg": round(float(np.degrees(self.turn_rad)), 2),
            "presses": presses,
        }


def _round_mm(value_m: float | None) -> float | None:
    return None if value_m is None else round(MM * value_m, 4)
