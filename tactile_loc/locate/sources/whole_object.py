"""Search of the whole object for the places and yaws at which a touch can have been made.

The patch around a touch's deepest point, rotated to many yaws, is compared with the patches of all places. The most
similar places are registered to the touch, rendered, and compared with the touch. The results are the likeliest poses
and their imprint IoUs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.common_poses import compute_prior_weights
from tactile_loc.core.geometry.rigid import Poses, invert, make_transform
from tactile_loc.core.places.places import CAMERA, HIGHEST_M, Places
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.priors import Prior, SeenFrom
from tactile_loc.core.registration.joint_registration import JointRegistration, RegistrationOptions
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.runtime.turns import pause_before, split_into_turns
from tactile_loc.core.sensing.gel_surface import SLACK
from tactile_loc.core.sensing.scene import Scene, View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.options import SearchOptions
from tactile_loc.locate.expected_poses import (
    EXPECTED_SHARE,
    MOST_UNEXPLAINED,
    choose_expected,
    draw_expected,
    keep_expected,
)
from tactile_loc.locate.hypotheses import compare_where_seen, compute_imprint_ious, keep_apart
from tactile_loc.locate.probability.point_distances import estimate_gaps
from tactile_loc.locate.probability.probabilities import TemperatureScaling
from tactile_loc.locate.sources.scoring import GridScores, Scores
from tactile_loc.slots.encoder import Encoder
from tactile_loc.slots.matcher import Matcher
from tactile_loc.store.keys import StageKey

SEARCH_VERSION = 9
MOST_EXCESS = 0.3  # share of the press beyond which a place's distance from the gel's surface counts as equal
FOUND = 1 / 3  # share of the grid spacing; from farther away, refinement seldom reaches the true pose
ANCHORS, LEAST_APART_M = 12, 7e-4  # points of a mask tried as the deepest point, and the distance between them
ROUGHLY = 0.1  # share of the press above which a mask's press is known only roughly
ROUGH_CELL_M = 1e-3  # side of a cell of the surface's field in a rough search
ROUGHLY_COMPARED = 8  # poses of a rough search that are compared in full
MOVED_ALONE, REGISTERED_ALONE = 150, 60  # poses moved, and registered further, to see how well one touch is explained
SPREAD = 2.0  # grid spacings between half of the poses moved to several touches; nearer ones mostly lead to one pose
WIDE_SHARE = 1 / 3  # share of `registered_together` that is registered of each further batch of poses
# rotated places that are scored, chosen by their scores, and compared with the surface of an elastic gel, in one turn
SCORED, CHOSEN, COMPARED = 700_000, 40_000, 20_000
SAMPLED = 16  # one score out of this many is looked at to estimate how high the highest scores are

Matched = tuple[Poses, NDArray[np.float64]]  # rotated places similar to a touch, and their scores (K,)


class PlaceSearch:
    """Searches all places of an object for poses that explain a touch."""

    def __init__(
        self, places: Places, key: StageKey, scene: Scene, encoder: Encoder, new_matcher: Callable[[], Matcher],
        grid_options: Any, options: SearchOptions, bank: Callable[[float], Scores],
        mask_bank: Callable[[float], Scores],
    ) -> None:  # fmt: skip
        """`bank` returns the embeddings (N, D) of the places, cut at a press depth in metres.

        `mask_bank` returns those of their contact, with the depth 0 in contact.
        """
        self.places, self.key, self.scene, self.encoder, self.options = places, key, scene, encoder, options
        self.registration = JointRegistration(
            RegistrationOptions(
                points=options.points,
                stride=options.stride,
                iterations=options.iterations,
                image_px=options.registration_px,
            )
        )
        self.metric, spacing_m = PoseMetric(scene.object), 1e-3 * grid_options.spacing_mm
        # the least distance between starts, and the largest distance at which the true pose counts as found
        self.radius_m, self.found_m = 0.5 * spacing_m, FOUND * spacing_m
        self.spread_m = SPREAD * spacing_m  # the same for half of the poses moved to several touches
        self.yaws_rad = 2 * np.pi * np.arange(grid_options.turns) / grid_options.turns
        # poses proposed for touches that still exist; more touches are often located together with earlier ones
        self._alike: WeakKeyDictionary[Touch, dict[int, Matched]] = WeakKeyDictionary()
        self._banks = GridScores(encoder, new_matcher, bank, HIGHEST_M, follow=True)
        self._mask_banks = GridScores(encoder, new_matcher, mask_bank, HIGHEST_M, follow=True)

    @property
    def nbytes(self) -> int:
        """The memory of the places, their banks, and the poses proposed for touches that still exist, bytes."""
        proposed = [matched for known in list(self._alike.values()) for matched in list(known.values())]
        remembered = sum(poses.nbytes + scores.nbytes for poses, scores in proposed)
        places = self.places.T_place_object.nbytes + self.places.patches.nbytes
        return places + remembered + self._banks.nbytes + self._mask_banks.nbytes

    def score(self, touch: Touch, times: StageTimes, prior: Prior | None = None) -> tuple[PoseGrid, Scores]:
        """Return the likeliest poses of a touch, and their imprint IoUs (K,) in coarse renders.

        With a `prior`, half of the registered poses are the poses with the greatest prior weight in a larger pool of
        similar places. Adds stage durations to `times`.
        """
        view, options = View(touch, self.scene.match_touch(touch)), self.options
        with times.stage("match"):
            groups = self.propose(touch, options.candidates, prior)
        with times.stage("register"):
            poses = np.concatenate([self._register_group(view, *group, len(groups)) for group in groups])
            ious = compute_imprint_ious([view], poses, options.image_px)[:, 0]
            kept = keep_apart(poses, ious, self.metric, options.apart_mm * 1e-3, options.registered)
            if len(groups) > 1 and prior is not None:
                grid, count = PoseGrid(poses, self.metric), options.registered // 2
                expected = choose_expected(grid, ious, prior, options.apart_mm * 1e-3, count)
                kept = np.unique(np.concatenate([kept[: options.registered - count], expected]))
        return PoseGrid(poses[kept], self.metric), ious[kept].astype(np.float32)

    def find_starts_alone(self, view: View, matched: Matched) -> tuple[PoseGrid, NDArray[np.float64]]:
        """Return poses that explain one touch well, and their imprint IoUs (K,) in coarse renders.

        `matched` are the touch's most similar rotated places. Fewer of them are registered than by `score`, so the true
        pose may be missing.
        """
        poses, scores = matched
        apart = keep_apart(poses, scores, self.metric, self.radius_m, MOVED_ALONE)
        poses = self.registration.register_coarsely([view], poses[apart], REGISTERED_ALONE)
        return PoseGrid(poses, self.metric), view.imprint_ious(poses, self.options.image_px)

    def _register_group(self, view: View, poses: Poses, values: NDArray[np.float64], groups: int) -> Poses:
        """Return the registered poses of one of several groups: see `propose`. All groups have equally many."""
        apart = keep_apart(poses, values, self.metric, self.radius_m, self.options.moved // groups)
        # what a prior proposes is not judged by the touch alone
        kept = self.options.registered if groups == 1 else None
        return self.registration.register_coarsely([view], poses[apart], kept)

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the search except the encoder and the touch, as JSON values."""
        return {
            "places": self.key.digest, "search": SEARCH_VERSION, "options": self.options.model_dump(mode="json"),
            "registration": self.registration.describe(),
            "renderer": self.scene.renderer.describe(), "drawing": self.scene.drawing,
        }  # fmt: skip

    def propose(self, touch: Touch, count: int, prior: Prior | None = None) -> list[Matched]:
        """Return groups of poses: the `count` most similar rotated places and, with a prior, a second group.

        The second group has the `count` poses with the greatest prior weights in a larger pool of similar places, and
        poses drawn around the prior's peak. A group has poses (K, 4, 4), metres, and values (K,); poses with greater
        values are better.
        """
        if prior is None:
            return [self._remember_alike(touch, count)]
        poses, scores = self._remember_alike(touch, self.options.pool)
        order = np.argsort(-scores, kind="stable")
        poses, scores = poses[order], scores[order]
        weights = compute_prior_weights(prior, PoseGrid(poses, self.metric))
        alike = poses[:count], scores[:count]
        if np.isneginf(weights).all():
            return [alike]
        drawn = draw_expected(prior, poses[weights.argmax()], self.scene.object.mesh.centroid_m)
        poses = np.concatenate([drawn, poses])
        weights = np.concatenate([prior(drawn), weights])
        likeliest = np.argsort(-weights, kind="stable")[:count]
        likeliest = likeliest[weights[likeliest] > -np.inf]
        return [alike, (poses[likeliest], weights[likeliest])]

    def _remember_alike(self, touch: Touch, count: int) -> Matched:
        """Return what `alike` returns, computed once for each touch."""
        known = self._alike.setdefault(touch, {})
        if count not in known:
            known[count] = self.alike(touch, count)
        return known[count]

    def alike(self, touch: Touch, count: int) -> Matched:
        """Return the poses (K, 4, 4), metres, of the `count` most similar rotated places, and their scores (K,)."""
        if not touch.has_depths:
            return self._match_mask(touch, count)
        compared_m = touch.geometry.gel.find_compared_m(touch.press_depth_m)
        matcher = self._banks.matcher(compared_m)
        pause_before(len(self.yaws_rad) * len(self.places) / SCORED)
        cut_m = min(self._banks.bank_press_m(compared_m), compared_m)
        T_sensor_anchor, codes = encode_rotated(touch, self.encoder, cut_m, self.yaws_rad)
        similar = matcher.scores(*codes)
        pause_before(count / CHOSEN)
        elastic = touch.geometry.gel.is_elastic
        yaw, number = find_highest(similar, max(count, self.options.compared_again) if elastic else count)
        scores = similar[yaw, number]
        if elastic:
            excess = bound_touch(touch, self.yaws_rad).measure_excess(self.places, number, yaw)
            best = np.argsort(excess, kind="stable")[:count]
            yaw, number, scores = yaw[best], number[best], -excess[best]
        return T_sensor_anchor @ self.places.poses(number, self.yaws_rad[yaw]), scores.astype(float)

    def _match_mask(self, touch: Touch, count: int) -> Matched:
        """Return what `alike` returns, for a contact mask, whose deepest point and press are unknown.

        Points spread over the mask are tried as the deepest point, with several presses that the mask allows.
        """
        from tactile_loc.core.places.rotated_patches import rotate_patches

        found_poses, found_scores = [], []
        for pressed in list_presses(touch):
            cut_m = self._mask_banks.bank_press_m(pressed.press_depth_m)
            matcher = self._mask_banks.matcher(cut_m)
            for anchor_m in spread_anchors(pressed, ANCHORS):
                depths_m, known = rotate_patches(pressed, anchor_m, np.eye(3), self.yaws_rad)
                codes = self.encoder.encode_seen(np.minimum(depths_m, np.float32(cut_m)), known, cut_m, CAMERA)
                similar = matcher.scores(*codes)
                yaw, number = find_highest(similar, count)
                found_scores.append(similar[yaw, number].astype(float))
                T_sensor_anchor = make_transform(np.eye(3), anchor_m)
                found_poses.append(T_sensor_anchor @ self.places.poses(number, self.yaws_rad[yaw]))
        poses, scores = np.concatenate(found_poses), np.concatenate(found_scores)
        best = np.argsort(-scores, kind="stable")[:count]
        return poses[best], scores[best]


def list_presses(touch: Touch) -> list[Touch]:
    """Return a touch without depths at its press and, if the press is known only roughly, at two other presses."""
    shape, std_m = touch.contact_shape, touch.contact_shape.indentation_std_m
    if std_m <= ROUGHLY * shape.press_depth_m:
        return [touch]
    least_m, most_m = 0.3 * shape.press_depth_m, touch.geometry.surface_m / 2
    presses_m = np.clip(shape.press_depth_m + std_m * np.array([-1.0, 0.0, 1.0]), least_m, most_m).tolist()
    return [replace(touch, contact_shape=shape.assume(press_m), geometry=touch.geometry) for press_m in presses_m]


def spread_anchors(touch: Touch, count: int) -> NDArray[np.float64]:
    """Return at most `count` points (K, 3), metres, spread over the mask of a touch at full penetration."""
    geometry, shape = touch.geometry, touch.contact_shape
    points = geometry.backproject(np.broadcast_to(geometry.full_penetration_m, geometry.shape))
    inside = points[shape.contact & geometry.observed_mask]
    chosen = [inside[np.linalg.norm(inside - inside.mean(axis=0), axis=1).argmin()]]
    far = np.linalg.norm(inside - chosen[0], axis=1)
    while len(chosen) < count and far.max() > LEAST_APART_M:
        chosen.append(inside[far.argmax()])
        far = np.minimum(far, np.linalg.norm(inside - chosen[-1], axis=1))
    return np.array(chosen)


def encode_rotated(
    touch: Touch, encoder: Encoder, cut_m: float, yaws_rad: NDArray[np.float64]
) -> tuple[Poses, tuple[Scores, Scores]]:
    """Return T_sensor_anchor (4, 4), metres, and the codes and weights (M, ...) of a touch rotated to M yaws.

    The touch is cut at `cut_m` metres. The anchor is the frame at the touch's deepest point, about which the touch is
    rotated.
    """
    from tactile_loc.core.places.rotated_patches import find_anchor, rotate_patches

    anchor_m, R_sensor_gel = find_anchor(touch)
    depths_m, known = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad, touch.find_known(cut_m))
    cut_depths_m = np.minimum(depths_m, np.float32(cut_m))
    return make_transform(R_sensor_gel, anchor_m), encoder.encode_seen(cut_depths_m, known, cut_m, CAMERA)


@dataclass(frozen=True, eq=False)
class TouchBounds:
    """The bounds of a touch for the surface of a place, for each of M yaws by which a place may be rotated.

    `low_m` and `high_m` (M, PATCH_PX, PATCH_PX), metres, and `most_m` are as for `measure_excess`. The yaws are about
    the z axis of the frame at the touch's deepest point, `T_sensor_anchor` (4, 4), metres.
    """

    T_sensor_anchor: Poses
    low_m: Scores
    high_m: Scores
    most_m: float

    def measure_excess(self, places: Places, numbers: NDArray[np.int64], yaws: NDArray[np.int64]) -> Scores:
        """Return how far rotated places leave the bounds (K,), square metres: see `measure_excess`.

        Pair k is the place `numbers[k]` at the yaw number `yaws[k]`.
        """
        from tactile_loc.core.places.rotated_patches import measure_excess

        return np.concatenate([
            measure_excess(places, numbers[some], yaws[some], self.low_m, self.high_m, self.most_m)
            for some in split_into_turns(len(numbers), COMPARED)
        ])  # fmt: skip


def bound_touch(touch: Touch, yaws_rad: NDArray[np.float64]) -> TouchBounds:
    """Return the bounds of what an elastic gel shows, at M yaws.

    Where the gel touches, a place must be at the gel's surface. Elsewhere, it must be beyond the surface.
    """
    from tactile_loc.core.places.rotated_patches import find_anchor, rotate_patches

    anchor_m, R_sensor_gel = find_anchor(touch)
    surface_m, seen = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad)
    contact = touch.geometry.observed_mask & touch.touching_shape.contact
    touching = rotate_patches(touch, anchor_m, R_sensor_gel, yaws_rad, contact)[1]
    far = np.float32(np.inf)
    beyond_m = surface_m - np.float32(SLACK * touch.indentation_m)
    low_m = np.where(touching, surface_m, np.where(seen, beyond_m, -far))
    high_m = np.where(touching, surface_m, far)
    T_sensor_anchor = make_transform(R_sensor_gel, anchor_m)
    return TouchBounds(T_sensor_anchor, low_m, high_m, MOST_EXCESS * touch.indentation_m)


def find_highest(scores: Scores, count: int) -> tuple[NDArray[np.int64], ...]:
    """Return the rows and columns (K,) of the `count` highest scores (M, N), unsorted; scores of -inf are left out."""
    flat = scores.ravel()
    some = flat[::SAMPLED]
    rank = min(len(some), 2 * count // SAMPLED + 1)
    high = np.flatnonzero(flat >= np.partition(some, len(some) - rank)[len(some) - rank])
    if len(high) < count:  # the sample was not like the others
        high = np.arange(len(flat))
    best = high[np.argpartition(-flat[high], min(count, len(high)) - 1)[:count]]
    return np.unravel_index(best[flat[best] > -np.inf], scores.shape)


@dataclass(frozen=True, eq=False)
class FoundTogether:
    """The likeliest poses given N touches.

    `T_first_object` (K, 4, 4), metres, is in the first touch's sensor frame. `ious` (K, N), 0 to 1, are the poses'
    imprint IoUs with the touches. `matched` are the rotated places most similar to each touch, as poses in the frame of
    its own sensor.
    """

    T_first_object: Poses
    ious: NDArray[np.float64]
    metric: PoseMetric
    matched: Sequence[Matched]

    @property
    def best(self) -> float:
        """The greatest mean imprint IoU of any pose over the touches, 0 to 1."""
        return float(self.ious.mean(axis=1).max())

    def posteriors(
        self, views: Sequence[View], scalings: Sequence[TemperatureScaling], elsewhere: float
    ) -> list[PosePosterior]:
        """Return each touch's posterior over the poses, in its own sensor frame, with its own scaling.

        `elsewhere` is the probability that the true pose is near none of the poses.
        """
        grids = [PoseGrid(view.T_sensor_first @ self.T_first_object, self.metric) for view in views]
        return [
            replace(scaling.posterior(grid, ious), elsewhere=elsewhere)
            for grid, scaling, ious in zip(grids, scalings, self.ious.T, strict=True)
        ]


def search_together(
    views: Sequence[View], searches: Sequence[PlaceSearch], times: StageTimes, prior: Prior | None = None
) -> FoundTogether:
    """Return the likeliest poses given several touches. Adds stage durations to `times`.

    The rotated places most similar to each touch are collected. The poses whose surface is nearest to all touches are
    moved by a few steps of registration. A wrong pose may be as near as a pose beside the true one, but stays as far
    from the touches then. So the poses that are nearest now are registered further, rendered, and compared with each
    touch. No returned pose is near a better one. If none of the first poses explains the touches well, further batches
    are registered, until one of them brings no better pose. A `prior` is over poses in the first touch's sensor frame.
    """
    seen = [None if prior is None else SeenFrom(prior, invert(view.T_sensor_first)) for view in views]
    search, options = searches[0], searches[0].options
    with times.stage("match"):
        proposed = [
            one.propose(view.touch, one.options.candidates_together, from_here)
            for view, one, from_here in zip(views, searches, seen, strict=True)
        ]
        poses = np.concatenate([
            invert(view.T_sensor_first) @ some
            for view, groups in zip(views, proposed, strict=True) for some, _ in groups
        ])  # fmt: skip
        grid, count = PoseGrid(poses, search.metric), max(1, round(EXPECTED_SHARE * options.moved_together))
        expected = keep_expected(views, grid, prior, 2 * search.radius_m, count)
        poses = _keep_nearest(views, search, poses, options.moved_together // 2, options.registered_widely)
    with times.stage("register"):
        registered, ious = _register_in_batches(views, search, poses)
        if len(expected):
            others, other_ious = _register(views, search, expected, prior=prior)
            explain = other_ious.mean(axis=1) >= ious.mean(axis=1).max() - MOST_UNEXPLAINED
            others, other_ious = others[explain], other_ious[explain]
            registered, ious = np.concatenate([registered, others]), np.concatenate([ious, other_ious])
        kept = keep_apart(
            registered, ious.mean(axis=1), search.metric, options.apart_mm * 1e-3, options.registered_widely
        )
    return FoundTogether(registered[kept], ious[kept], search.metric, [groups[0] for groups in proposed])


def _register_in_batches(views: Sequence[View], search: PlaceSearch, poses: Poses) -> tuple[Poses, NDArray[np.float64]]:
    """Register poses (K, 4, 4), metres, until one explains the touches well, and return what `_register` returns.

    The most promising poses come first. If a batch brings nothing better, the others are not registered.
    """
    options = search.options
    registered, ious = _register(views, search, poses[: options.moved_together], options.registered_together)
    more = max(1, round(WIDE_SHARE * options.registered_together))
    for start in range(options.moved_together, len(poses), options.moved_together):
        best = ious.mean(axis=1).max()
        if best >= options.wide_below_iou:
            break
        others, other_ious = _register(views, search, poses[start : start + options.moved_together], more)
        registered, ious = np.concatenate([registered, others]), np.concatenate([ious, other_ious])
        if other_ious.mean(axis=1).max() <= best:
            break
    return registered, ious


def fit_roughly(views: Sequence[View], search: PlaceSearch, poses: Poses, count: int) -> tuple[float, float]:
    """Return the evidence, nats, of several touches for the best of the poses (K, 4, 4), metres, and its imprint IoU.

    Only the `count` poses whose surface is nearest to the touches are registered roughly and rendered coarsely. The
    field of the surface has larger cells, because its building takes longest. The ROUGHLY_COMPARED poses with the
    greatest imprint IoUs are then compared in full. The imprint IoU, 0 to 1, is the mean over the touches.
    """
    nearest = _keep_nearest(views, search, poses, 0, count, ROUGH_CELL_M)
    registered, coarse = _register(views, search, nearest, cell_m=ROUGH_CELL_M)
    some = np.argsort(-coarse.mean(axis=1), kind="stable")[:ROUGHLY_COMPARED]
    ious, evidence = compare_where_seen(views, registered[some])
    best = int(evidence.sum(axis=1).argmax())
    return float(evidence[best].sum()), float(ious[best].mean())


def _keep_nearest(
    views: Sequence[View], search: PlaceSearch, poses: Poses, spread: int, count: int, cell_m: float | None = None
) -> Poses:
    """Return at most `count` poses whose surface is near to the touches.

    The first `spread` poses are far apart, so that they lead to different places of the object. Then follow the poses
    nearest to the touches. `poses` (K, 4, 4), metres, are in the first touch's sensor frame.
    """
    worth = -estimate_gaps(views, poses, cell_m)
    first = keep_apart(poses, worth, search.metric, search.spread_m, spread)
    nearest = keep_apart(poses, worth, search.metric, search.radius_m, count)
    return poses[np.concatenate([first, nearest[~np.isin(nearest, first)]])[:count]]


def _register(
    views: Sequence[View], search: PlaceSearch, poses: Poses, kept: int | None = None, prior: Prior | None = None,
    cell_m: float | None = None,
) -> tuple[Poses, NDArray[np.float64]]:  # fmt: skip
    """Register poses (K, 4, 4), metres, roughly to all N touches; return them and their coarse imprint IoUs (K, N).

    `kept`, `prior` and `cell_m` are as for `JointRegistration.register_coarsely`.
    """
    registered, options = search.registration.register_coarsely(views, poses, kept, prior, cell_m), search.options
    return registered, compute_imprint_ious(views, registered, options.image_px, 1e-3 * options.free_z_mm)
