"""Many objects looked through at a glance: which of them may a touch be of?

Some places of each object, encoded once and for few press depths, are searched in one index, the touch turned to few
yaws. That costs a thousandth of locating an object, and says which few are worth it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.errors import ConfigError, ObjectError
from tactile_loc.core.interfaces import Matcher
from tactile_loc.core.places import CAMERA
from tactile_loc.core.registry import registry
from tactile_loc.core.sensing import Touch
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.search import PlaceSearch
from tactile_loc.store.keys import StageKey

Codes = NDArray[np.float16]  # (levels, places, D)

STAGE, STAGE_VERSION = "glances", 1
LEVELS_M = (1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3)  # press depths at which touches and places are compared
MOST_PLACES = 2000  # of an object, evenly out of all
TURNS = 36


class Library:
    """The objects that a touch may be of, each with its localizer, all of one sensor. Raises TactileLocError.

    Objects are told apart by their names; in which order they are given changes nothing.
    """

    def __init__(self, models: Sequence[Localizer]) -> None:
        if not models:
            raise ObjectError("there is no object to identify; give one at least")
        self.models = tuple(sorted(models, key=lambda model: model.object.name))
        self.names = [model.object.name for model in self.models]
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ObjectError(f"two objects are called {twice[0]}; give each a name of its own")
        listed = [model.object.name for model in self.models if not model.sampler.capabilities.places]
        if listed:
            raise ConfigError(f"{listed[0]} is searched by listed poses; to identify objects choose the grid whole")
        self.progress = self.models[0].progress
        self._matchers: dict[float, Matcher] = {}

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

    def glance(self, touch: Touch) -> NDArray[np.float64]:
        """Return how alike a touch and the most alike place of each object are (K,), unitless, higher is more alike."""
        from tactile_loc.core.turned_patches import anchor, turned_patches

        for model in self.models:
            model.require_own(touch)
        level_m = max([m for m in LEVELS_M if m <= touch.press_depth_m], default=LEVELS_M[0])
        press_m = min(level_m, touch.press_depth_m)
        yaws_rad = 2 * np.pi * np.arange(TURNS) / TURNS
        depths_m, seen = turned_patches(touch, *anchor(touch), yaws_rad)
        cut_m = np.minimum(depths_m, np.float32(press_m))
        queries, weights = self.models[0].encoder.encode_seen(cut_m, seen, press_m, CAMERA)
        scores = self._matcher(level_m).weighted_scores(queries, weights).max(axis=0)
        ends = np.cumsum([codes.shape[1] for codes in self._codes])
        return np.array([part.max() for part in np.split(scores, ends[:-1])], float)

    def _matcher(self, level_m: float) -> Matcher:
        """What compares touches with all objects' codes of a level, made when it is first asked for."""
        if level_m not in self._matchers:
            level, chosen = LEVELS_M.index(level_m), self.models[0].config.matcher
            matcher = registry().create("matcher", chosen.name, chosen.options)
            matcher.index(np.concatenate([codes[level].astype(np.float32) for codes in self._codes]))
            self._matchers[level_m] = matcher
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
    some = slice(None, None, -(-len(search.places) // MOST_PLACES))

    def encoded() -> Codes:
        levels = [model.encoder.encode(search.places.depths(m, some), m, CAMERA) for m in LEVELS_M]
        return np.stack(levels).astype(np.float16)

    stored = model.store.build(key, lambda work: work.save_array("codes", encoded()))
    return stored.array("codes")
