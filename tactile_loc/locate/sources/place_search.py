"""Search of the whole object for the places and yaws at which a touch can have been made.

The patch around a touch's deepest point, rotated to many yaws, is compared with the patches of all places. The most
similar places are registered to the touch, rendered, and compared with the touch. The results are the likeliest poses
and their imprint IoUs.
"""

from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.common_poses import compute_prior_weights
from tactile_loc.core.geometry.rigid import Poses, make_transform
from tactile_loc.core.places.places import CAMERA, HIGHEST_M
from tactile_loc.core.places.rotated_patches import bound_touch
from tactile_loc.core.poses.merging import suppress_non_maxima
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.priors import Prior, list_peaks
from tactile_loc.core.registration.joint_registration import JointRegistration, RegistrationOptions
from tactile_loc.core.registration.prior_factors import PriorFactors, draw_around, fit_prior_factors
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.clouds import spread_points
from tactile_loc.core.sensing.scene import NATS_PER_IOU, View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import compute_imprint_ious
from tactile_loc.locate.sources.scoring import GridScores, NewMatcher, Scores
from tactile_loc.locate.sources.source import Rated, SourceSetup
from tactile_loc.locate.sources.stored_places import PlaceBanks
from tactile_loc.slots.encoder import Encoder

SEARCH_VERSION = 9
ANCHORS, LEAST_APART_M = 12, 7e-4  # points of a mask tried as the deepest point, and the distance between them
ROUGHLY = 0.1  # share of the press above which a mask's press is known only roughly
MOVED_ALONE, REGISTERED_ALONE = 150, 60  # poses moved, and registered further, to see how well one touch is explained
SPREAD = 2.0  # grid spacings between half of the poses moved to several touches; nearer ones mostly lead to one pose
DRAWN = 64  # poses drawn around the prior's peaks
LEAST_DRAWN = 16  # around one of them
MOST_UNEXPLAINED = 0.2  # loss of mean imprint IoU beyond which a pose is dropped that only the prior chose
SAMPLED = 16  # one score out of this many is looked at to estimate how high the highest scores are


class PlaceSearch:
    """Searches all places of an object for poses that explain a touch."""

    def __init__(self, setup: SourceSetup, banks: PlaceBanks, new_matcher: NewMatcher) -> None:
        self.places, self.key, self.scene, self.encoder = banks.places, banks.key, setup.scene, setup.encoder
        self.options = options = setup.config.search
        self.registration = JointRegistration(
            RegistrationOptions(
                points=options.points,
                stride=options.stride,
                iterations=options.iterations,
                image_px=options.registration_px,
            )
        )
        grid_options = setup.sampler.options
        self.metric, spacing_m = setup.metric, 1e-3 * grid_options.spacing_mm
        # the least distance between starts, and the largest distance at which the true pose counts as found
        self.radius_m = 0.5 * spacing_m
        self.spread_m = SPREAD * spacing_m  # the same for half of the poses moved to several touches
        self.yaws_rad = 2 * np.pi * np.arange(grid_options.turns) / grid_options.turns
        # poses proposed for touches that still exist; more touches are often located together with earlier ones
        self._alike: WeakKeyDictionary[Touch, dict[int, Rated]] = WeakKeyDictionary()
        self._banks = GridScores(setup.encoder, new_matcher, banks.bank, HIGHEST_M, follow=True)
        self._mask_banks = GridScores(setup.encoder, new_matcher, banks.mask_bank, HIGHEST_M, follow=True)

    def prepare(self, compared_m: float) -> None:
        """Build the bank of touches that are compared at this press depth, metres."""
        self._banks.matcher(compared_m)

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
            kept = suppress_non_maxima(poses, ious, self.metric, options.apart_mm * 1e-3, options.registered)
            if len(groups) > 1 and prior is not None:
                grid, count = PoseGrid(poses, self.metric), options.registered // 2
                expected = choose_expected(grid, ious, prior, options.apart_mm * 1e-3, count)
                kept = np.unique(np.concatenate([kept[: options.registered - count], expected]))
        return PoseGrid(poses[kept], self.metric), ious[kept].astype(np.float32)

    def find_starts_alone(self, view: View) -> tuple[PoseGrid, NDArray[np.float64]]:
        """Return poses that explain one touch well, and their imprint IoUs (K,) in coarse renders.

        Fewer of the most similar rotated places are registered than by `score`, so the true pose may be missing.
        """
        ((poses, scores),) = self.propose(view.touch, self.options.candidates_together)
        apart = suppress_non_maxima(poses, scores, self.metric, self.radius_m, MOVED_ALONE)
        poses = self.registration.register_coarsely([view], poses[apart], REGISTERED_ALONE)
        return PoseGrid(poses, self.metric), view.imprint_ious(poses, self.options.image_px)

    def _register_group(self, view: View, poses: Poses, values: NDArray[np.float64], groups: int) -> Poses:
        """Return the registered poses of one of several groups: see `propose`. All groups have equally many."""
        apart = suppress_non_maxima(poses, values, self.metric, self.radius_m, self.options.moved // groups)
        # what a prior proposes is not judged by the touch alone
        kept = self.options.registered if groups == 1 else None
        return self.registration.register_coarsely([view], poses[apart], kept)

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the search except the encoder and the touch, as JSON values."""
        return {
            "places": self.key.digest,
            "search": SEARCH_VERSION,
            "options": self.options.model_dump(mode="json"),
            "registration": self.registration.describe(),
            "renderer": self.scene.renderer.describe(),
        }

    def propose(self, touch: Touch, count: int, prior: Prior | None = None) -> list[Rated]:
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

    def _remember_alike(self, touch: Touch, count: int) -> Rated:
        """Return what `alike` returns, computed once for each touch."""
        known = self._alike.setdefault(touch, {})
        if count not in known:
            known[count] = self.alike(touch, count)
        return known[count]

    def alike(self, touch: Touch, count: int) -> Rated:
        """Return the poses (K, 4, 4), metres, of the `count` most similar rotated places, and their scores (K,)."""
        if not touch.has_depths:
            return self._match_mask(touch, count)
        compared_m = touch.press_depth_m * touch.geometry.gel.compared_share
        matcher = self._banks.matcher(compared_m)
        cut_m = min(self._banks.bank_press_m(compared_m), compared_m)
        T_sensor_anchor, codes = encode_rotated(touch, self.encoder, cut_m, self.yaws_rad)
        similar = matcher.scores(*codes)
        elastic = touch.geometry.gel.is_elastic
        yaw, number = find_highest(similar, max(count, self.options.compared_again) if elastic else count)
        scores = similar[yaw, number]
        if elastic:
            excess = bound_touch(touch, self.yaws_rad).measure_excess(self.places, number, yaw)
            best = np.argsort(excess, kind="stable")[:count]
            yaw, number, scores = yaw[best], number[best], -excess[best]
        return T_sensor_anchor @ self.places.poses(number, self.yaws_rad[yaw]), scores.astype(float)

    def _match_mask(self, touch: Touch, count: int) -> Rated:
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


def draw_expected(prior: Prior, T: Poses, middle_m: NDArray[np.float64]) -> Poses:
    """Draw poses (K, 4, 4), metres, around the peak of a prior near the pose T (4, 4), and around its listed peaks.

    There are none where the prior is flat. `middle_m` (3,), metres, is the centre of the object.
    """
    factors = fit_prior_factors(prior, np.concatenate([T[None], list_peaks(prior)]), middle_m)
    sharp = np.flatnonzero(factors.information.any(axis=(1, 2)))
    count = max(LEAST_DRAWN, DRAWN // max(len(sharp), 1))
    parts = [PriorFactors(factors.T[[k]], factors.information[[k]]) for k in sharp]
    return np.concatenate([T[None][:0], *(draw_around(part, count, middle_m) for part in parts)])


def choose_expected(
    grid: PoseGrid, ious: NDArray[np.float64], prior: Prior, radius_m: float, count: int
) -> NDArray[np.int64]:
    """Return the indices of at most `count` poses that explain a touch, and that the prior favours, the best first.

    `ious` (K,), 0 to 1, are the poses' imprint IoUs. No pose is within `radius_m` metres of a better one.
    """
    worth = ious + compute_prior_weights(prior, grid) / NATS_PER_IOU
    explaining = np.flatnonzero(ious >= ious.max() - MOST_UNEXPLAINED)
    apart = suppress_non_maxima(grid.T_sensor_object[explaining], worth[explaining], grid.metric, radius_m, count)
    return explaining[apart]


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
    middle = int(np.linalg.norm(inside - inside.mean(axis=0), axis=1).argmin())
    return np.asarray(inside[spread_points(inside, count, middle, LEAST_APART_M)])


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
