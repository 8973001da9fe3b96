"""The search of a track: its key touches are located together, in another thread."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.poses.priors import PosePrior
from tactile_loc.core.runtime.compiled import run_aside
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import compare_refined
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Localization
from tactile_loc.tracking.key_touches import drop_nearest, measure_motion_m
from tactile_loc.tracking.track_modes import TrackMode

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Searched:
    """A finished search of `keys`; `found` is None if no pose fits them.

    `right`, 0 to 1, is the probability that the first pose found is within the tolerance. The search may miss poses.
    `gains` (K,) state how much more imprint IoU each of the `known` modes has than the first pose found, after it was
    registered to the keys; -inf if it is within the tolerance of that pose.
    """

    keys: tuple[Touch, ...]
    found: Localization | None
    right: float
    known: tuple[TrackMode, ...]
    gains: Floats

    @property
    def listed(self) -> Poses | None:
        """The listed poses T_base_object (K, 4, 4), metres, the most probable first; None if no pose was found."""
        if self.found is None:
            return None
        poses = np.stack([hypothesis.T_sensor_object for hypothesis in self.found.hypotheses])
        return np.asarray(self.found.touch.T_base_sensor) @ poses


@dataclass(frozen=True, eq=False)
class KeySearch:
    """The key touches of a track, at sensor poses far apart, and the search that is under way.

    `begun` are the key touches of the latest search. The result of a search that is `running` is used at the first
    frame from the time `due_s`, seconds, on. The `prior`, if any, is over T_base_object. `listed` (K, 4, 4),
    metres, are the poses T_base_object that the latest finished search listed. The next search also refines them,
    because it may miss a pose that fewer touches led to.
    """

    localizer: Localizer
    keys: tuple[Touch, ...] = ()
    prior: PosePrior | None = None
    begun: tuple[Touch, ...] = ()
    listed: Poses | None = None
    running: Future[Searched] | None = None
    due_s: float = 0.0

    def is_new_place(self, touch: Touch) -> bool:
        """Return whether a touch's sensor pose is far from that of each key touch."""
        options, T = self.localizer.config.tracker, np.asarray(touch.T_base_sensor)
        gel_m, lever_m = touch.geometry.gel_middle_m, 1e-3 * options.lever_mm
        return all(
            measure_motion_m(np.asarray(key.T_base_sensor), T, gel_m, lever_m) > 1e-3 * options.keyframe_mm
            for key in self.keys
        )

    def add_new_places(self, touches: Sequence[Touch]) -> KeySearch:
        """Return the search with those of the touches that are at new places as key touches."""
        found = self
        for touch in touches:
            found = found.add(touch) if found.is_new_place(touch) else found
        return found

    def add(self, touch: Touch) -> KeySearch:
        """Return the search with one more key touch; if these are too many, one of the two nearest is dropped."""
        options, keys = self.localizer.config.tracker, [*self.keys, touch]
        if len(keys) > options.keyframes:
            keys = drop_nearest(keys, 1e-3 * options.lever_mm)
        return replace(self, keys=tuple(keys))

    def restart(self, touches: Sequence[Touch], prior: PosePrior | None = None) -> KeySearch:
        """Return a search whose only key touches are `touches`; a search that is under way is given up."""
        if self.running is not None:
            self.running.cancel()
        return KeySearch(self.localizer, tuple(touches), prior)

    @property
    def is_due(self) -> bool:
        """Whether no search is under way and the key touches have changed since the last one."""
        return self.running is None and bool(self.keys) and self.begun != self.keys

    def begin(self, known: Sequence[TrackMode], time_s: float) -> KeySearch:
        """Begin the search of the present key touches at the time of a frame, seconds.

        It compares the poses that it finds with the `known` modes.
        """
        search = partial(search_keys, self.localizer, self.keys, self.prior, tuple(known), self.listed)
        due_s = time_s + self.localizer.config.tracker.latency_s
        return replace(self, begun=self.keys, running=run_aside(search), due_s=due_s)

    def finish(self, time_s: float, waits: bool) -> tuple[KeySearch, Searched | None]:
        """Return the search and, if it is due at `time_s` seconds and has finished, its result.

        If it is due and has not finished, it is waited for if the caller `waits`.
        """
        if self.running is None or time_s < self.due_s or not (waits or self.running.done()):
            return self, None
        finished = self.running.result()
        return replace(self, running=None, listed=self.listed if finished.found is None else finished.listed), finished


def search_keys(
    localizer: Localizer,
    keys: tuple[Touch, ...],
    prior: PosePrior | None,
    known: tuple[TrackMode, ...],
    starts: Poses | None = None,
) -> Searched:
    """Locate touches together, and compare the first pose with the `known` modes. `starts` are as for `locate_keys`."""
    found = locate_keys(localizer, keys, prior, starts)
    right = 0.0 if found is None else found.probability_within()
    if found is None or not known:
        return Searched(keys, found, right, (), np.zeros(0))
    views = localizer.make_views(keys)
    T_first_object = invert(np.asarray(keys[0].T_base_sensor)) @ np.stack([mode.known.T_base_object for mode in known])
    refined = localizer.registration.refine(views, T_first_object)
    ious = compare_refined(views, refined, range(len(views))).mean(axis=1)
    poses = np.stack([pose.T_sensor_object for pose in refined])
    same = localizer.config.tolerance.find_within(localizer.object, found.best.T_sensor_object, poses)
    return Searched(keys, found, right, known, np.where(same, -np.inf, ious - found.best.imprint_iou))


def locate_keys(
    localizer: Localizer, keys: Sequence[Touch], prior: PosePrior | None = None, starts: Poses | None = None
) -> Localization | None:
    """Return the result of touches located together; None if no pose fits them.

    The prior is over T_base_object. The poses `starts` (K, 4, 4), metres, of T_base_object are compared in any case.
    """
    T_base_first = np.asarray(keys[0].T_base_sensor)
    seen = None if prior is None else prior.view_from(T_base_first)
    here = None if starts is None else invert(T_base_first) @ starts
    try:
        return localizer.localize(keys, seen, starts=here)
    except GridError:
        return None
