"""The search of the whole object: a source of poses near the places that one touch, or several touches, may be of.

One touch is compared with all places: see `place_search`. For several touches, the places most similar to each of them
are registered to all touches.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_loc.bases.common_poses import compute_prior_weights
from tactile_loc.core.geometry.rigid import Poses, invert
from tactile_loc.core.objects.surface_field import build_surface_field
from tactile_loc.core.places.places import Places
from tactile_loc.core.poses.merging import suppress_non_maxima
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import Prior, SeenFrom
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.core.sensing.clouds import make_contact_cloud, make_outline_cloud
from tactile_loc.core.sensing.scene import View, compare_where_seen
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.locate.hypotheses import DOUBT, choose_best_apart, compute_imprint_ious
from tactile_loc.locate.probability.temperature import SEARCHED, TemperatureScaling
from tactile_loc.locate.sources.place_search import MOST_UNEXPLAINED, PlaceSearch
from tactile_loc.locate.sources.scoring import Scores
from tactile_loc.locate.sources.source import PoseSource, Posteriors, Values, rate_poses, require_one_kind
from tactile_loc.locate.sources.stored_places import PlaceBanks, load_places

ROUGH_CELL_M = 1e-3  # side of a cell of the surface's field in a rough search
ROUGHLY_COMPARED = 8  # poses of a rough search that are compared in full
WIDE_SHARE = 1 / 3  # share of `registered_together` that is registered of each further batch of poses
EXPECTED_SHARE = 0.5  # poses of several touches that the prior chooses, per pose that the touches choose
DISTANCE_PER_NAT_M = 1e-4  # mean distance of a touch's points from the surface that counts as a nat of the prior
FIRST, EXPECTED_MODES = 8, 4  # modes before the modes that the prior favours, and number of the latter
FEW_POINTS, FEW_PX = 30, 60  # points per touch, and long side of their image, pixels, to compare many poses quickly
# Coarse mean imprint IoUs: from PROMISING on, poses are refined without a trial. If all poses are below UNPROMISING
# even after coarse registration, only one is refined, because refined poses hardly explain the touches well then.
PROMISING, UNPROMISING = 0.8, 0.6


class WholeObjectSource(PoseSource):
    """Poses from a search of all places of the object."""

    all_stages = ("places", "encoder")
    may_miss = True

    @cached_property
    def banks(self) -> PlaceBanks:
        """The object's places with their embeddings, stored or built now."""
        return PlaceBanks(self.setup, *load_places(self.setup))

    @cached_property
    def place_search(self) -> PlaceSearch:
        """The search with one touch."""
        return PlaceSearch(self.setup, self.banks, self.new_matcher)

    @property
    def places(self) -> Places:
        """The places that are searched."""
        return self.banks.places

    @property
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""
        return self.banks.trained

    def score(self, touch: Touch, times: StageTimes, prior: Prior | None = None) -> tuple[PoseGrid, Scores]:
        """Search the whole object for a touch; return the likeliest poses and their imprint IoUs."""
        return self.place_search.score(touch, times, prior)

    def search(
        self, views: Sequence[View], sources: Sequence[PoseSource], times: StageTimes, prior: Prior | None = None
    ) -> Posteriors:
        """Search with one touch, or with all touches together: see `PoseSource`."""
        if len(views) == 1:
            return super().search(views, sources, times, prior)
        require_one_kind(sources)
        self.load_field()
        searches = [source.place_search for source in sources if isinstance(source, WholeObjectSource)]
        return rate_poses(views, sources, *search_together(views, searches, times, prior))

    def propose(
        self, views: Sequence[View], alone: Posteriors, fused: PosePosterior, prior: Prior | None, top: int
    ) -> list[Mode]:
        """Return the most probable poses that are far enough apart, and those that the prior favours.

        The number of the former is at most the greatest of `top`, the option `refined` and a tenth of all poses.
        """
        count, radius_m = (
            max(top, self.setup.config.hypotheses.refined, len(fused.grid) // 10),
            self.setup.start_radius_m,
        )
        modes = choose_best_apart(fused, radius_m, count)
        return add_expected_modes(modes, fused, prior, radius_m)

    def list_starts_alone(self, view: View, own: PosePosterior, times: StageTimes) -> tuple[PoseGrid, Values]:
        """Return poses that explain one touch well, and their imprint IoUs (K,) in coarse renders."""
        with times.stage("register"):
            return self.place_search.find_starts_alone(view)

    def keep_promising(
        self, modes: Sequence[Mode], imprint_ious: NDArray[np.float64], trusted: Sequence[View], times: StageTimes
    ) -> Sequence[Mode]:
        """Return all modes, or only the best one if no mode can explain the touches well.

        Modes that do not explain the touches yet are registered coarsely, which takes less time than to refine them.
        """
        if imprint_ious[0] >= PROMISING:
            return modes
        with times.stage("register"):
            poses = np.stack([mode.T_sensor_object for mode in modes])
            poses = self.place_search.registration.register_coarsely(trusted, poses)
            options = self.setup.config.hypotheses
            ious = compute_imprint_ious(trusted, poses, options.image_px, self.setup.start_radius_m).mean(axis=1)
        return modes if ious.max() >= UNPROMISING else [modes[int(ious.argmax())]]

    def prepare(self, press_depth_m: float) -> None:
        """Build or load the places, their bank of this press depth, metres, and train the encoder."""
        super().prepare(press_depth_m)
        self.place_search.prepare(press_depth_m * self.setup.scene.geometry.gel.compared_share)

    def find_scaling(self) -> TemperatureScaling:
        """Return the shipped scaling from imprint IoUs to probabilities."""
        return SEARCHED

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the scores except sensor and touch, as JSON values; trains the encoder if necessary."""
        return {**self.place_search.describe(), "trained": self.trained}

    @property
    def searched(self) -> WholeObjectSource:
        """The search of places: this source."""
        return self

    def count_poses(self) -> dict[str, Any]:
        """Return the number of places, and the turns in which each is compared with a touch."""
        return {"places": len(self.places), "turns": len(self.place_search.yaws_rad)}

    @property
    def nbytes(self) -> int:
        """The memory of the places, their banks, and the poses proposed for touches that still exist, bytes."""
        return self.place_search.nbytes

    def fit_roughly(self, views: Sequence[View], poses: Poses, count: int) -> tuple[float, float]:
        """Return the evidence, nats, of several touches for the best of the poses, and its imprint IoU.

        The poses (K, 4, 4), metres, are in the first touch's sensor frame. Only the `count` poses whose surface is
        nearest to the touches are registered roughly and rendered coarsely. The field of the surface has larger cells,
        because its building takes longest. The ROUGHLY_COMPARED poses with the greatest imprint IoUs are then compared
        in full. The imprint IoU, 0 to 1, is the mean over the touches.
        """
        nearest = _keep_nearest(views, self.place_search, poses, 0, count, ROUGH_CELL_M)
        registered, coarse = _register(views, self.place_search, nearest, cell_m=ROUGH_CELL_M)
        some = np.argsort(-coarse.mean(axis=1), kind="stable")[:ROUGHLY_COMPARED]
        ious, evidence = compare_where_seen(views, registered[some])
        best = int(evidence.sum(axis=1).argmax())
        return float(evidence[best].sum()), float(ious[best].mean())


def search_together(
    views: Sequence[View], searches: Sequence[PlaceSearch], times: StageTimes, prior: Prior | None = None
) -> tuple[Poses, NDArray[np.float64]]:
    """Return the likeliest poses (K, 4, 4), metres, given N touches, and their imprint IoUs (K, N) with each touch.

    The poses are in the first touch's sensor frame. Stage durations are added to `times`.

    The rotated places most similar to each touch are collected. The poses whose surface is nearest to all touches are
    moved by a few steps of registration. A wrong pose may be as near as a pose beside the true one, but stays as far
    from the touches then. So the poses that are nearest now are registered further, rendered, and compared with each
    touch. No returned pose is near a better one. If none of the first poses explains the touches well, further batches
    are registered, until one of them brings no better pose. A `prior` is over poses in the first touch's sensor frame.
    """
    seen = [None if prior is None else SeenFrom(prior, invert(view.T_sensor_first)) for view in views]
    search, options = searches[0], searches[0].options
    with times.stage("match"):
        poses = np.concatenate(
            [
                invert(view.T_sensor_first) @ some
                for view, one, from_here in zip(views, searches, seen, strict=True)
                for some, _ in one.propose(view.touch, one.options.candidates_together, from_here)
            ]
        )
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
        kept = suppress_non_maxima(
            registered, ious.mean(axis=1), search.metric, options.apart_mm * 1e-3, options.registered_widely
        )
    return registered[kept], ious[kept]


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


def _keep_nearest(
    views: Sequence[View], search: PlaceSearch, poses: Poses, spread: int, count: int, cell_m: float | None = None
) -> Poses:
    """Return at most `count` poses whose surface is near to the touches.

    The first `spread` poses are far apart, so that they lead to different places of the object. Then follow the poses
    nearest to the touches. `poses` (K, 4, 4), metres, are in the first touch's sensor frame.
    """
    worth = -estimate_surface_distances(views, poses, cell_m)
    first = suppress_non_maxima(poses, worth, search.metric, search.spread_m, spread)
    nearest = suppress_non_maxima(poses, worth, search.metric, search.radius_m, count)
    return poses[np.concatenate([first, nearest[~np.isin(nearest, first)]])[:count]]


def _register(
    views: Sequence[View],
    search: PlaceSearch,
    poses: Poses,
    kept: int | None = None,
    prior: Prior | None = None,
    cell_m: float | None = None,
) -> tuple[Poses, NDArray[np.float64]]:
    """Register poses (K, 4, 4), metres, roughly to all N touches; return them and their coarse imprint IoUs (K, N).

    `kept`, `prior` and `cell_m` are as for `JointRegistration.register_coarsely`.
    """
    registered, options = search.registration.register_coarsely(views, poses, kept, prior, cell_m), search.options
    return registered, compute_imprint_ious(views, registered, options.image_px, 1e-3 * options.free_z_mm)


def keep_expected(views: Sequence[View], grid: PoseGrid, prior: Prior | None, radius_m: float, count: int) -> Poses:
    """Return at most `count` poses of a grid that are near all touches, and that the prior favours; none without one.

    The grid's poses are in the first touch's sensor frame. No pose is within `radius_m` metres of a better one.
    """
    if prior is None:
        return grid.T_sensor_object[:0]
    weights = compute_prior_weights(prior, grid)
    possible = np.flatnonzero(weights > -np.inf)
    poses = grid.T_sensor_object[possible]
    worth = weights[possible] - estimate_surface_distances(views, poses) / DISTANCE_PER_NAT_M
    return poses[suppress_non_maxima(poses, worth, grid.metric, radius_m, count)]


def add_expected_modes(
    modes: Sequence[Mode], posterior: PosePosterior, prior: Prior | None, radius_m: float
) -> list[Mode]:
    """Add the poses with the greatest prior weights to modes, so that they are refined too and count for the verdict.

    Only poses that the touches make less probable than the best pose by at most DOUBT nats are added. None of them is
    within `radius_m` metres of one with a greater weight. The `posterior` includes the prior.
    """
    if prior is None:
        return list(modes)
    weights = compute_prior_weights(prior, posterior.grid)
    evidence = np.where(weights > -np.inf, posterior.log_p - np.maximum(weights, -1e300), -np.inf)
    some = np.flatnonzero(evidence >= evidence.max() - DOUBT)
    poses = posterior.grid.T_sensor_object
    best = some[suppress_non_maxima(poses[some], weights[some], posterior.grid.metric, radius_m, EXPECTED_MODES)]
    known = {mode.index for mode in modes}
    added = [Mode(int(k), 0.0, poses[k], np.array([k])) for k in best if int(k) not in known]
    return [*modes[:FIRST], *added, *modes[FIRST:]]


def estimate_surface_distances(views: Sequence[View], poses: Poses, cell_m: float | None = None) -> NDArray[np.float64]:
    """Return the summed distances (K,), metres, from the touches' points to the object's surface at poses (K, 4, 4).

    `cell_m`, metres, is the size of the cells of the surface's field: see `build_surface_field`.
    """
    field, seen_from = build_surface_field(views[0].scene.object.mesh, cell_m), invert(poses)
    distances_m = np.zeros(len(poses))
    for view in views:
        points_m = _list_few_points(view.touch)
        distances_m += field.estimate_distances(points_m, seen_from @ invert(view.T_sensor_first))
    return distances_m


@lru_cache(maxsize=32)
def _list_few_points(touch: Touch) -> NDArray[np.float64]:
    """Return about FEW_POINTS points (P, 3), metres, of the surface in contact or, without depths, of its outline."""
    geometry, shape = touch.thin(FEW_PX)
    points_m = (make_contact_cloud if shape.depths_known else make_outline_cloud)(shape, geometry)[0]
    return points_m[:: max(1, len(points_m) // FEW_POINTS)]
