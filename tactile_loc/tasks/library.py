"""Many objects looked through: which of them may touches be of?

At a glance: some places of each object, encoded once and for few press depths, are compared with the touch, turned to
few yaws. That costs a thousandth of locating an object, but noise misleads it. Those that are most alike are
looked into: a few of the poses that the glance saw are registered roughly to all touches, which costs a thirtieth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError, ObjectError, quote
from tactile_loc.core.geometry.rigid import Poses, invert, make_transform
from tactile_loc.core.sensing.places import CAMERA
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.matcher import Matcher
from tactile_loc.core.slots.registry import registry
from tactile_loc.locate.localizer import Localizer, make_view
from tactile_loc.locate.search import PlaceSearch, compute_rough_iou
from tactile_loc.store.keys import StageKey

Codes = NDArray[np.float16]  # (levels, places, D)

STAGE, STAGE_VERSION = "glances", 1
LEVELS_M = (1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3)  # press depths at which touches and places are compared
MOST_PLACES = 2000  # of an object, evenly out of all
TURNS = 36
YAWS_RAD = 2 * np.pi * np.arange(TURNS) / TURNS
PROPOSED, REGISTERED = 1000, 30  # rotated places of an object that each touch is most like; poses of them all


@dataclass(frozen=True, eq=False)
class Glance:
    """How alike one touch, turned by each of YAWS_RAD, and places of each of K objects are.

    The touch's place is at the origin of `T_sensor_anchor` (4, 4), metres. `scores` are of M yaws and each object's
    places (M, N), unitless, higher is more alike.
    """

    touch: Touch
    T_sensor_anchor: Poses
    scores: tuple[NDArray[np.float32], ...]

    @property
    def alike(self) -> NDArray[np.float64]:
        """How alike the touch and the most alike place of each object are (K,), unitless, higher is more alike."""
        return np.array([scores.max() for scores in self.scores], float)

    def poses(self, k: int, search: PlaceSearch, count: int) -> Poses:
        """Return the poses (C, 4, 4), metres, of the `count` rotated places of object k, searched so, most alike."""
        scores = self.scores[k]
        best = np.argpartition(-scores, min(count, scores.size) - 1, axis=None)[:count]
        best = best[scores.ravel()[best] > -np.inf]  # a matcher may look at fewer
        yaw, number = np.unravel_index(best, scores.shape)
        return self.T_sensor_anchor @ search.places.poses(number * _step(search), YAWS_RAD[yaw])


class Library:
    """The objects that a touch may be of, each with its localizer, all of one sensor. Raises TactileLocError.

    Objects are told apart by their names; in which order they are given changes nothing.
    """

    def __init__(self, models: Sequence[Localizer]) -> None:
        if not models:
            raise ObjectError("there is no object to identify; give one at least")
        others = [model for model in models if not isinstance(model, Localizer)]
        if others:
            raise ObjectError(f"{quote(others[0])} is no Localizer; make one of each object with Localizer.create")
        self.models = tuple(sorted(models, key=lambda model: model.object.name))
        self.names = [model.object.name for model in self.models]
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ObjectError(f"two objects are called {twice[0]}; give each a name of its own")
        listed = [model.object.name for model in self.models if not model.sampler.capabilities.places]
        if listed:
            raise ConfigError(f"{listed[0]} is searched by listed poses; to identify objects choose the grid whole")
        if self.models[0].encoder.capabilities.needs_training:
            raise ConfigError(
                "objects are told apart by an encoder that learns nothing of any one of them; choose --encoder pixel"
            )
        self.progress = self.models[0].progress
        self._matchers: dict[float, list[Matcher]] = {}

    def __len__(self) -> int:
        return len(self.models)

    @cached_property
    def searches(self) -> list[PlaceSearch]:
        """What searches each object: from the store, or built now."""
        found = []
        with self.progress.task("opening objects", len(self)) as advance:
            for model in self.models:
                if model.search is not None:
                    found.append(model.search)
                advance(1)
        return found

    def glance(self, touch: Touch) -> Glance:
        """Return how alike a touch and some places of each object are. Raises TouchError for another sensor's."""
        from tactile_loc.core.sensing.rotated_patches import find_anchor, rotate_patches

        for model in self.models:
            model.require_own(touch)
        level_m = max([m for m in LEVELS_M if m <= touch.press_depth_m], default=LEVELS_M[0])
        press_m = min(level_m, touch.press_depth_m)
        anchor_m, R_sensor_gel = find_anchor(touch)
        depths_m, seen = rotate_patches(touch, anchor_m, R_sensor_gel, YAWS_RAD)
        cut_m = np.minimum(depths_m, np.float32(press_m))
        queries, weights = self.models[0].encoder.encode_seen(cut_m, seen, press_m, CAMERA)
        scores = tuple(matcher.scores(queries, weights) for matcher in self._matchers_of(level_m))
        return Glance(touch, make_transform(R_sensor_gel, anchor_m), scores)

    def look_into(self, k: int, glances: Sequence[Glance]) -> float:
        """Return how well object k explains touches that were glanced at, roughly: imprint IoU, their mean, 0 to 1.

        Several touches know their `T_base_sensor`.
        """
        model, search = self.models[k], self.searches[k]
        views = [make_view(glances[0].touch, model, glance.touch) for glance in glances]
        poses = [
            invert(view.T_sensor_first) @ glance.poses(k, search, PROPOSED)
            for view, glance in zip(views, glances, strict=True)
        ]
        return compute_rough_iou(views, search, np.concatenate(poses), REGISTERED)

    def _matchers_of(self, level_m: float) -> list[Matcher]:
        """What compares touches with each object's codes of a level, an object each: it may look at some rows only.

        They are made when they are first asked for.
        """
        if level_m not in self._matchers:
            level, chosen = LEVELS_M.index(level_m), self.models[0].config.matcher
            self._matchers[level_m] = made = []
            for codes in self._codes:
                made.append(registry().create("matcher", chosen.name, chosen.options))
                made[-1].index(codes[level].astype(np.float32))
        return self._matchers[level_m]

    @cached_property
    def _codes(self) -> list[Codes]:
        return [_codes(model, search) for model, search in zip(self.models, self.searches, strict=True)]


def _codes(model: Localizer, search: PlaceSearch) -> Codes:
    """The codes (L, N, D) of some of an object's places, cut at each of LEVELS_M: from the store, or encoded now."""
    key = StageKey(STAGE, STAGE_VERSION, {
        "places": search.key.digest, "encoder": model.encoder.describe(), "levels_m": list(LEVELS_M),
        "most": MOST_PLACES,
    }, model.object.name)  # fmt: skip
    some = slice(None, None, _step(search))

    def encoded() -> Codes:
        levels = [model.encoder.encode(search.places.depths(m, some), m, CAMERA) for m in LEVELS_M]
        return np.stack(levels).astype(np.float16)

    stored = model.store.build(key, lambda work: work.save_array("codes", encoded()))
    return stored.load_array("codes")


def _step(search: PlaceSearch) -> int:
    """From one place of an object that a glance sees to the next."""
    return -(-len(search.places) // MOST_PLACES)
