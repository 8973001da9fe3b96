"""A particle filter over poses that compares drawn contact shapes with the touches."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation
from tactile_loc.plugin import ComponentOptions, ObjectModel, Poses, Renderer, Touch, View, registry
from tactile_loc.plugin.helpers import PoseMetric, invert, make_transform, merge_modes, transform_points

from tactile_loc_benchmark.interfaces import LocatingProblem, Method, ScoredPoses
from tactile_loc_benchmark.methods.icp_starts import draw_starts
from tactile_loc_benchmark.methods.surface_fit import APART_M, LISTED
from tactile_loc_benchmark.methods.touched_points import find_deepest_point, find_sensor_pose, view_touches

RENDERER = "heightmap"
MOST_CLUSTERS = 50  # clusters that are counted
FIRST_TEMPER, RESAMPLING_TEMPER = 0.25, 0.5  # shares of the log-likelihoods at the first round, and for resampling

Floats = NDArray[np.float64]


class ParticleFilter(Method):
    """A particle filter (MidasTouch: Suresh et al., CoRL 2022) that adds one touch after the other.

    MidasTouch compares learned codes of a sliding touch. Here, the log-likelihood of a particle is the imprint IoU of
    its drawn contact shape with the touch, times a sharpness, summed over the touches so far. Touches at far places say
    nothing about small motions, so we add rounds of annealed moves, as in the resample-move filter (Gilks and Berzuini,
    2001). With each touch, a share of the particles starts anew, as in augmented Monte Carlo localization.
    """

    paper: ClassVar[str] = "MidasTouch: Suresh et al., CoRL 2022"

    class Options(ComponentOptions):
        """The number of particles, and the annealing."""

        particles: int = Field(default=300, ge=2, description="number of particles")
        starts: int = Field(default=1500, ge=2, description="number of poses drawn for each touch")
        rounds: int = Field(default=10, ge=1, description="rounds of moves after each touch")
        renewed: float = Field(default=0.3, ge=0, lt=1, description="share of particles that start anew with a touch")
        sharpness: float = Field(default=20.0, gt=0, description="nats for an imprint IoU of 1, at the end")
        noise_mm: float = Field(default=1.0, gt=0, description="first standard deviation of the moves, mm")
        noise_deg: float = Field(default=10.0, gt=0, description="first standard deviation of the moves, degrees")
        freedom_mm: float = Field(default=3.0, ge=0, description="distance to contact that is ignored at first, mm")
        shrinks_to: float = Field(default=0.05, gt=0, le=1, description="share of the noise that is left at the end")
        image_px: int = Field(default=24, ge=8, description="pixels of the longer side of the compared shapes")
        seed: int = Field(default=0, ge=0, description="seed of the random choices")

    def prepare(self, problem: LocatingProblem) -> None:
        """Make the renderer."""
        self._renderer: Renderer = registry().create("renderer", RENDERER, {})

    def locate(self, problem: LocatingProblem, touches: Sequence[Touch]) -> ScoredPoses:
        """Return the clusters of particles, with their shares of the particles as scores and probabilities."""
        options, rng = self.options, np.random.default_rng(self.options.seed)
        T_base_first = find_sensor_pose(touches[0])
        views = view_touches(touches, problem.object, self._renderer)
        T = np.empty((0, 4, 4))
        for n in range(1, len(views) + 1):
            kept = round(options.particles * (1 - options.renewed)) if len(T) else 0
            starts = invert(T_base_first) @ draw_starts(problem.object, touches[n - 1 : n], options.starts, rng)
            likely = FIRST_TEMPER * self._measure(starts, views[n - 1 : n], 1.0)
            T = np.concatenate([T[:kept], starts[resample(likely, options.particles - kept, rng)]])
            T = self._anneal(T, views[:n], rng)
        return _list_clusters(T_base_first @ T, self._measure(T, views, 0.0), problem.object)

    def _anneal(self, T: Poses, views: Sequence[View], rng: np.random.Generator) -> Poses:
        """Move particles (K, 4, 4), metres, by less and less noise, and resample them half-way and at the end."""
        rounds = self.options.rounds
        shares = np.geomspace(1.0, self.options.shrinks_to, rounds)
        for number, (share, temper) in enumerate(zip(shares, np.linspace(FIRST_TEMPER, 1.0, rounds), strict=True), 1):
            T, likely = self._move(T, views, share, temper, rng)
            if number in (rounds // 2, rounds):
                T = T[rng.permutation(resample(RESAMPLING_TEMPER * likely, len(T), rng))]
        return T

    def _move(
        self, T: Poses, views: Sequence[View], share: float, temper: float, rng: np.random.Generator
    ) -> tuple[Poses, Floats]:
        """Move particles (K, 4, 4), metres, by a share of the noise; return them and their log-likelihoods (K,).

        A move is accepted by the rule of Metropolis, with `temper` times the log-likelihoods.
        """
        turns_rad = share * np.radians(self.options.noise_deg) * rng.normal(size=(len(T), 3))
        shifts_m = share * 1e-3 * self.options.noise_mm * rng.normal(size=(len(T), 3))
        moved = _move_about(T, _find_pivot(views[-1]), turns_rad, shifts_m)
        before, after = (self._measure(poses, views, share) for poses in (T, moved))
        accepted = np.log(rng.random(len(T))) < temper * (after - before)
        return np.where(accepted[:, None, None], moved, T), np.where(accepted, after, before)

    def _measure(self, T: Poses, views: Sequence[View], share: float) -> Floats:
        """Return the log-likelihoods (K,) of particles (K, 4, 4), at a share of the noise."""
        freedom_m = 1e-3 * share * self.options.freedom_mm
        ious = [view.imprint_ious(T, self.options.image_px, freedom_m) for view in views]
        return np.asarray(self.options.sharpness * np.sum(ious, axis=0))


def _find_pivot(view: View) -> Floats:
    """Return the deepest point (3,), metres, of a view's touch in the first sensor's frame."""
    return transform_points(invert(view.T_sensor_first), find_deepest_point(view.touch)[None])[0]


def _move_about(T: Poses, pivot_m: Floats, turns_rad: Floats, shifts_m: Floats) -> Poses:
    """Return poses (K, 4, 4) turned by rotation vectors (K, 3) about a point (3,) and shifted by (K, 3), metres."""
    R = Rotation.from_rotvec(turns_rad).as_matrix()
    return np.asarray(make_transform(R, pivot_m - R @ pivot_m + shifts_m) @ T)


def _normalise(log_weights: Floats) -> Floats:
    """Return weights (K,) with the sum 1."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def resample(log_weights: Floats, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the indices (count,) of systematic resampling, in ascending order."""
    at = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(_normalise(log_weights)), at), len(log_weights) - 1)


def _list_clusters(T: Poses, likely: Floats, obj: ObjectModel) -> ScoredPoses:
    """Return the likeliest pose of each cluster of resampled particles (K, 4, 4), metres, the largest cluster first.

    `likely` (K,) are log-likelihoods. Of two clusters with equally many particles, the likelier comes first.
    """
    order = np.argsort(-likely, kind="stable")
    merged = merge_modes(T[order], PoseMetric(obj), APART_M, MOST_CLUSTERS)
    kept, count = np.unique(merged[merged >= 0], return_counts=True)
    largest = np.argsort(-count, kind="stable")[:LISTED]
    p = count[largest] / len(T)
    return ScoredPoses(T[order[kept[largest]]], p, p)
