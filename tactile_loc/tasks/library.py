"""A library of objects, and two quick comparisons of all objects with touches.

A glance compares a touch, at a few yaws, with some places of each object, encoded once for a few press depths. It takes
a thousandth of the time of locating the object, but is sensitive to noise. A rough search starts from the most similar
places of an object. It registers a few poses roughly to all touches, and takes a thirtieth of the time of locating the
object.

A glance reads only the codes of one press depth from the store. An object's places are read when it is searched. The
parts used last stay in memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.byte_cache import ByteCache
from tactile_loc.core.errors import ConfigError, ObjectError, quote
from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.sensing.places import CAMERA
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.core.slots.matcher import Matcher
from tactile_loc.core.slots.registry import registry
from tactile_loc.locate.localizer import Localizer, make_view
from tactile_loc.locate.scoring import BankMatcher, index_bank
from tactile_loc.locate.search import PlaceSearch, compute_rough_iou, encode_rotated, find_highest
from tactile_loc.locate.stored_places import make_places_key
from tactile_loc.store.keys import StageKey
from tactile_loc.store.workspace import Workspace

Codes = NDArray[np.float16]  # (places, D)

STAGE, STAGE_VERSION = "glances", 2
KEPT_BYTES = 2 * 2**30
WHOLE = math.inf  # stands for an object's places and banks, beside the press depths of its codes
LEVELS_M = (1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3)  # press depths at which touches and places are compared
MOST_PLACES = 2000  # per object, evenly spread
TURNS = 36
YAWS_RAD = 2 * np.pi * np.arange(TURNS) / TURNS
PROPOSED, REGISTERED = 1000, 30  # per object: rotated places for each touch, and poses registered to all touches


@dataclass(frozen=True, eq=False)
class Glance:
    """The similarity of one touch, rotated by each of the M angles YAWS_RAD, to places of each of K objects.

    The touch's place is at the origin of `T_sensor_anchor` (4, 4), metres. `scores` has an array (M, N) for each object
    with N places, unitless; higher is more similar.
    """

    touch: Touch
    T_sensor_anchor: Poses
    scores: tuple[NDArray[np.float32], ...]

    @property
    def alike(self) -> NDArray[np.float64]:
        """The similarity (K,) of the touch to the most similar place of each object, unitless."""
        return np.array([scores.max() for scores in self.scores], float)

    def poses(self, k: int, search: PlaceSearch, count: int) -> Poses:
        """Return the poses (C, 4, 4), metres, of the `count` most similar rotated places of object k."""
        yaw, number = find_highest(self.scores[k], count)
        return self.T_sensor_anchor @ search.places.poses(number * _step(search), YAWS_RAD[yaw])


class Library:
    """The objects that may have been touched, each with its localizer, all for one sensor.

    The order of the objects does not matter. The objects' codes, places and banks that were used last are kept in
    memory, up to `most_bytes` and the object in use. The rest is released, and read again from the store when it is
    used. Raises TactileLocError if there are no objects, if two objects share a name, or if a localizer does not suit
    identification.
    """

    def __init__(self, models: Sequence[Localizer], most_bytes: int = KEPT_BYTES) -> None:
        if not models:
            raise ObjectError("there is no object to identify; give at least one")
        others = [model for model in models if not isinstance(model, Localizer)]
        if others:
            raise ObjectError(f"{quote(others[0])} is not a Localizer; make one for each object with Localizer.create")
        self.models = tuple(sorted(models, key=lambda model: model.object.name))
        self.names = [model.object.name for model in self.models]
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ObjectError(f"two objects are called {twice[0]}; give each its own name")
        listed = [model.object.name for model in self.models if not model.sampler.capabilities.places]
        if listed:
            raise ConfigError(_explain_listed(listed[0]))
        if self.models[0].encoder.capabilities.needs_training:
            raise ConfigError(
                "the encoder has to be trained on one object, so it cannot compare several; choose `encoder` pixel"
            )
        self.progress = self.models[0].progress
        self._kept: ByteCache[tuple[int, float], BankMatcher | Localizer] = ByteCache(
            most_bytes, _count_bytes, _release
        )

    def __len__(self) -> int:
        return len(self.models)

    @property
    def nbytes(self) -> int:
        """The memory of the objects' codes, places and banks that are kept, bytes."""
        return self._kept.nbytes

    @contextmanager
    def use(self, k: int) -> Iterator[Localizer]:
        """Yield the localizer of object k. Afterwards, objects used less recently are released if necessary."""
        try:
            yield self.models[k]
        finally:
            self._kept.keep((k, WHOLE), self.models[k])

    def search(self, k: int) -> PlaceSearch:
        """Return the search of object k. Its places are read from the store, or found if they are not stored."""
        with self.use(k) as model:
            return _open_search(model)

    def glance(self, touch: Touch) -> Glance:
        """Compare a touch with some places of each object. Raises TouchError for a touch of another sensor."""
        for model in self.models:
            model.require_own(touch)
        level_m = max([m for m in LEVELS_M if m <= touch.press_depth_m], default=LEVELS_M[0])
        press_m = min(level_m, touch.press_depth_m)
        T_sensor_anchor, codes = encode_rotated(touch, self.models[0].encoder, press_m, YAWS_RAD)
        scores = []
        with self.progress.task("comparing objects", len(self)) as advance:
            for k in range(len(self)):
                scores.append(self._open_codes(k, level_m).scores(*codes))
                advance(1)
        return Glance(touch, T_sensor_anchor, tuple(scores))

    def look_into(self, k: int, glances: Sequence[Glance]) -> float:
        """Search object k roughly, starting from the touches' glances; return the best mean imprint IoU, 0 to 1.

        If there are several touches, each needs `T_base_sensor`.
        """
        with self.use(k) as model:
            search = _open_search(model)
            views = [make_view(glances[0].touch, model, glance.touch) for glance in glances]
            poses = [
                invert(view.T_sensor_first) @ glance.poses(k, search, PROPOSED)
                for view, glance in zip(views, glances, strict=True)
            ]
            return compute_rough_iou(views, search, np.concatenate(poses), REGISTERED)

    def _open_codes(self, k: int, level_m: float) -> Matcher:
        """Return a matcher that compares touches with places of object k, cut at a press depth (metres)."""
        chosen = self.models[0].config.matcher

        def index() -> BankMatcher:
            with self.use(k) as model:  # the places are opened if the codes are not stored yet
                codes = _load_codes(model, LEVELS_M.index(level_m)).astype(np.float32)
            return index_bank(lambda: registry().create("matcher", chosen.name, chosen.options), codes)

        return cast(BankMatcher, self._kept.get((k, level_m), index)).matcher


def _count_bytes(kept: BankMatcher | Localizer) -> int:
    return kept.loaded_bytes if isinstance(kept, Localizer) else kept.nbytes


def _release(kept: BankMatcher | Localizer) -> None:
    if isinstance(kept, Localizer):
        kept.release()


def _load_codes(model: Localizer, level: int) -> Codes:
    """Return the codes (N, D) of some of an object's places, cut at LEVELS_M[level], stored or encoded now.

    The codes of all levels are stored together, but only the file of this level is read and its checksum verified.
    """
    key = StageKey(STAGE, STAGE_VERSION, {
        "places": make_places_key(model.sampler, model.scene).digest, "encoder": model.encoder.describe(),
        "levels_m": list(LEVELS_M), "most": MOST_PLACES,
    }, model.object.name)  # fmt: skip
    name = f"codes-{level}"
    stored = model.store.build(key, partial(_save_codes, model), [f"{name}.npy"])
    return stored.load_array(name)


def _save_codes(model: Localizer, work: Workspace) -> None:
    search = _open_search(model)
    some = slice(None, None, _step(search))
    for level, press_m in enumerate(LEVELS_M):
        codes = model.encoder.encode(search.places.depths(press_m, some), press_m, CAMERA)
        work.save_array(f"codes-{level}", codes.astype(np.float16))


def _open_search(model: Localizer) -> PlaceSearch:
    if model.search is None:
        raise ConfigError(_explain_listed(model.object.name))
    return model.search


def _explain_listed(name: str) -> str:
    return f"{name} has a grid of listed poses; to identify objects, choose the grid whole"


def _step(search: PlaceSearch) -> int:
    """Return the step between the places of an object that a glance uses."""
    return -(-len(search.places) // MOST_PLACES)
