"""The touches of a track at different places, and the search that locates them together, in another thread."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Poses, invert, rotation_angle
from tactile_loc.core.poses.priors import PosePrior
from tactile_loc.core.runtime.compiled import run_aside
from tactile_loc.core.runtime.errors import GridError
from tactile_loc.core.sensing.scene import NATS_PER_IOU
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import compute_imprint_ious
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Localization
from tactile_loc.tracking.belief import believe

MOST_LISTED = 30  # poses that the next search also refines
MOST_JUDGED = 10  # of them that are compared with all touches
DEEPER = 1.5  # times the contact with which a touch replaces one at the same place
NATS_PER_M = 10.0  # a key touch this far from the others adds as much as a nat against a wrong pose


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
    running: Future[Localization | None] | None = None
    due_s: float = 0.0

    def find_near(self, touch: Touch) -> list[Touch]:
        """Return the kept touches at the place of a touch: those whose sensor poses are near."""
        options, T = self.localizer.config.tracker, np.asarray(touch.T_base_sensor)
        gel_m, lever_m = touch.geometry.gel_middle_m, 1e-3 * options.lever_mm
        motions_m = [measure_motion_m(np.asarray(kept.T_base_sensor), T, gel_m, lever_m) for kept in self.touches]
        return [kept for kept, m in zip(self.touches, motions_m, strict=True) if m <= 1e-3 * options.keyframe_mm]

    def add_new_places(self, touches: Iterable[Touch]) -> KeySearch:
        """Return the search with those of the touches that are at new places, or have far more contact than before.

        If these are too many, one of the two nearest is dropped.
        """
        options, found = self.localizer.config.tracker, self
        for touch in touches:
            near = found.find_near(touch)
            if all(touch.contact_share > DEEPER * one.contact_share for one in near):
                kept = [*(one for one in found.touches if all(one is not other for other in near)), touch]
                kept = drop_nearest(kept, 1e-3 * options.lever_mm) if len(kept) > options.places else kept
                found = replace(found, touches=tuple(kept))
        return found

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

    def finish(self, time_s: float, waits: bool) -> tuple[KeySearch, Localization | None]:
        """Return the search and, if it is due at `time_s` seconds and has found a pose for `begun`, its result.

        If it is due and has not finished, it is waited for if the caller `waits`.
        """
        if self.running is None or time_s < self.due_s or not (waits or self.running.done()):
            return self, None
        found = self.running.result()
        listed = self.listed if found is None else list_poses(found)[:MOST_LISTED]
        return replace(self, running=None, listed=listed), found


def search_touches(
    localizer: Localizer, touches: Sequence[Touch], prior: PosePrior | None, starts: Poses
) -> Localization | None:
    """Search with the touches that rule out wrong poses, then judge what is found by all of them.

    The prior is over T_base_object. The poses `starts` (K, 4, 4), metres, of T_base_object are compared in any case.
    Returns None if no pose fits the touches.
    """
    keys = choose_telling(localizer, touches, starts, localizer.config.tracker.keyframes)
    found = _locate(localizer, keys, prior, starts)
    if found is not None and len(keys) < len(touches):
        poses = list_poses(found)
        best = np.argsort(-compare_poses(localizer, touches, poses).mean(axis=1), kind="stable")[:MOST_JUDGED]
        found = _locate(localizer, touches, prior, poses[best], searches=False) or found
    return None if found is None else believe(found, localizer.object, localizer.config.tolerance)


def list_poses(found: Localization) -> Poses:
    """Return the poses T_base_object (K, 4, 4), metres, of a result, also unlisted ones, the most probable first."""
    poses = [one.T_sensor_object for one in (*found.hypotheses, *found.unlisted)]
    return np.asarray(found.touch.T_base_sensor) @ np.stack(poses)


def compare_poses(localizer: Localizer, touches: Sequence[Touch], T_base_object: Poses) -> Floats:
    """Return the imprint IoUs (K, N), 0 to 1, of poses (K, 4, 4), metres, with touches, in coarse renders."""
    T_first_object = invert(np.asarray(touches[0].T_base_sensor)) @ T_base_object
    return compute_imprint_ious(localizer.make_views(touches), T_first_object, localizer.config.tracker.image_px)


def _locate(
    localizer: Localizer, touches: Sequence[Touch], prior: PosePrior | None, starts: Poses, searches: bool = True
) -> Localization | None:
    T_base_first = np.asarray(touches[0].T_base_sensor)
    seen = None if prior is None else prior.view_from(T_base_first)
    here = invert(T_base_first) @ starts if len(starts) else None
    try:
        return localizer.localize(touches, seen, starts=here, searches=searches)
    except GridError:
        return None


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


def measure_motion_m(T_base_first: Floats, T_base_second: Floats, gel_m: Floats, lever_m: float) -> float:
    """Return the distance that the point `gel_m` (3,), metres, of a sensor moved between two poses (4, 4), metres.

    A rotation counts as the motion at the end of a lever of `lever_m` metres.
    """
    T = invert(T_base_first) @ T_base_second
    shift_m = np.linalg.norm(T[:3, :3] @ gel_m + T[:3, 3] - gel_m)
    return float(shift_m + lever_m * rotation_angle(T[:3, :3]))


def drop_nearest(touches: Sequence[Touch], lever_m: float) -> list[Touch]:
    """Return touches without one of the two whose sensor poses are nearest to each other: the one with less contact."""
    gel_m, poses = touches[0].geometry.gel_middle_m, [np.asarray(touch.T_base_sensor) for touch in touches]
    nearest = min(
        itertools.combinations(range(len(touches)), 2),
        key=lambda pair: measure_motion_m(poses[pair[0]], poses[pair[1]], gel_m, lever_m),
    )
    less = min(nearest, key=lambda number: touches[number].contact_share)
    return [touch for number, touch in enumerate(touches) if number != less]
