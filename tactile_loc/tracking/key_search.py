"""The search of a track: its key touches are located together, in another thread."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.poses.priors import PosePrior
from tactile_loc.core.runtime.compiled import run_aside
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import NATS_PER_IOU, compute_imprint_ious
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Localization
from tactile_loc.tracking.belief import believe
from tactile_loc.tracking.key_touches import drop_nearest, measure_motion_m

Floats = NDArray[np.float64]

MOST_LISTED = 30  # poses that the next search also refines
MOST_JUDGED = 10  # of them that are compared with all touches
NATS_PER_M = 10.0  # a key touch this far from the others adds as much as a nat against a wrong pose


@dataclass(frozen=True, eq=False)
class Searched:
    """A finished search: the touches that were located together, and the result; None if no pose fits them."""

    touches: tuple[Touch, ...]
    found: Localization | None

    @property
    def every(self) -> Poses:
        """The poses T_base_object (K, 4, 4), metres, that were found, the most probable first."""
        if self.found is None:
            return np.empty((0, 4, 4))
        poses = [one.T_sensor_object for one in (*self.found.hypotheses, *self.found.unlisted)]
        return np.asarray(self.found.touch.T_base_sensor) @ np.stack(poses)


@dataclass(frozen=True, eq=False)
class KeySearch:
    """Touches of a track at sensor poses far apart, and the search that is under way.

    Of the `touches`, the key touches are located together: those that rule out wrong poses. `begun` are the touches of
    the latest search. The result of a search that is `running` is used at the first frame from the time `due_s`,
    seconds, on. The `prior`, if any, is over T_base_object. `listed` (K, 4, 4), metres, are the poses T_base_object
    that the latest finished search found. The next search also refines them, because it may miss a pose that fewer
    touches led to.
    """

    localizer: Localizer
    touches: tuple[Touch, ...] = ()
    prior: PosePrior | None = None
    begun: tuple[Touch, ...] = ()
    listed: Poses = field(default_factory=lambda: np.empty((0, 4, 4)))
    running: Future[Searched] | None = None
    due_s: float = 0.0

    def is_new_place(self, touch: Touch) -> bool:
        """Return whether a touch's sensor pose is far from that of each kept touch."""
        options, T = self.localizer.config.tracker, np.asarray(touch.T_base_sensor)
        gel_m, lever_m = touch.geometry.gel_middle_m, 1e-3 * options.lever_mm
        return all(
            measure_motion_m(np.asarray(kept.T_base_sensor), T, gel_m, lever_m) > 1e-3 * options.keyframe_mm
            for kept in self.touches
        )

    def add_new_places(self, touches: Iterable[Touch]) -> KeySearch:
        """Return the search with those of the touches that are at new places.

        If these are too many, one of the two nearest is dropped.
        """
        options, kept = self.localizer.config.tracker, self
        for touch in touches:
            if kept.is_new_place(touch):
                more = [*kept.touches, touch]
                more = drop_nearest(more, 1e-3 * options.lever_mm) if len(more) > options.places else more
                kept = replace(kept, touches=tuple(more))
        return kept

    def restart(self, touches: Sequence[Touch], prior: PosePrior | None = None) -> KeySearch:
        """Return a search of `touches` only; a search that is under way is given up."""
        if self.running is not None:
            self.running.cancel()
        return KeySearch(self.localizer, tuple(touches), prior)

    @property
    def is_due(self) -> bool:
        """Whether no search is under way and the touches have changed since the last one."""
        return self.running is None and bool(self.touches) and self.begun != self.touches

    def begin(self, known: Poses, time_s: float) -> KeySearch:
        """Begin the search of the present touches at the time of a frame, seconds.

        It also refines the `known` poses T_base_object (K, 4, 4), metres, so the first pose that it finds explains the
        key touches at least as well as each of them.
        """
        starts = np.concatenate([known, self.listed])
        search = partial(search_touches, self.localizer, self.touches, self.prior, starts)
        due_s = time_s + self.localizer.config.tracker.latency_s
        return replace(self, begun=self.touches, running=run_aside(search), due_s=due_s)

    def finish(self, time_s: float, waits: bool) -> tuple[KeySearch, Searched | None]:
        """Return the search and, if it is due at `time_s` seconds and has finished, its result.

        If it is due and has not finished, it is waited for if the caller `waits`.
        """
        if self.running is None or time_s < self.due_s or not (waits or self.running.done()):
            return self, None
        finished = self.running.result()
        listed = self.listed if finished.found is None else finished.every[:MOST_LISTED]
        return replace(self, running=None, listed=listed), finished


def search_touches(localizer: Localizer, touches: Sequence[Touch], prior: PosePrior | None, starts: Poses) -> Searched:
    """Locate touches together: search with those that rule out wrong poses, then judge what is found by all of them.

    The prior is over T_base_object. The poses `starts` (K, 4, 4), metres, of T_base_object are compared in any case.
    """
    keys = choose_telling(localizer, touches, starts, localizer.config.tracker.keyframes)
    found = _locate(localizer, keys, prior, starts)
    if found.found is not None and len(keys) < len(touches):
        best = np.argsort(-compare_poses(localizer, touches, found.every).mean(axis=1), kind="stable")
        judged = _locate(localizer, touches, prior, found.every[best[:MOST_JUDGED]], searches=False)
        found = found if judged.found is None else judged
    if found.found is None:
        return found
    return replace(found, found=believe(found.found, localizer.object, localizer.config.tolerance))


def compare_poses(localizer: Localizer, touches: Sequence[Touch], T_base_object: Poses) -> Floats:
    """Return the imprint IoUs (K, N), 0 to 1, of poses (K, 4, 4), metres, with touches, in coarse renders."""
    T_first_object = invert(np.asarray(touches[0].T_base_sensor)) @ T_base_object
    return compute_imprint_ious(localizer.make_views(touches), T_first_object, localizer.config.tracker.image_px)


def _locate(
    localizer: Localizer, touches: Sequence[Touch], prior: PosePrior | None, starts: Poses, searches: bool = True
) -> Searched:
    T_base_first = np.asarray(touches[0].T_base_sensor)
    seen = None if prior is None else prior.view_from(T_base_first)
    here = invert(T_base_first) @ starts if len(starts) else None
    try:
        found = localizer.localize(touches, seen, starts=here, searches=searches)
    except GridError:
        return Searched(tuple(touches), None)
    return Searched(tuple(touches), found)


def choose_telling(localizer: Localizer, touches: Sequence[Touch], known: Poses, most: int) -> list[Touch]:
    """Return at most `most` touches: those that together rule out most of the weight of wrong poses.

    Of the `known` poses T_base_object (K, 4, 4), metres, the one that explains all touches best is taken as right.
    Touches that rule out as much are chosen for their distance from the others.
    """
    if len(touches) <= most:
        return list(touches)
    options, gel_m = localizer.config.tracker, touches[0].geometry.gel_middle_m
    T = [np.asarray(touch.T_base_sensor) for touch in touches]
    far_m = np.array([[measure_motion_m(a, b, gel_m, 1e-3 * options.lever_mm) for b in T] for a in T])
    losses = np.zeros((1, len(touches)))  # of imprint IoU, of each wrong pose
    if len(known):
        ious = compare_poses(localizer, touches, known)
        best = int(ious.mean(axis=1).argmax())
        wrong = ~localizer.config.tolerance.find_within(localizer.object, known[best], known)
        losses = ious[best] - ious[wrong] if wrong.any() else losses
    chosen: list[int] = []
    while len(chosen) < most:
        left = [k for k in range(len(touches)) if k not in chosen]
        weights = np.exp(-NATS_PER_IOU * (losses[:, chosen].sum(axis=1)[:, None] + losses[:, left])).sum(axis=0)
        apart_m = far_m[np.ix_(left, chosen)].min(axis=1) if chosen else far_m[left].max(axis=1)
        chosen.append(left[int((NATS_PER_M * apart_m - np.log(weights)).argmax())])
    return [touches[k] for k in sorted(chosen)]
