"""Sources of candidate poses: a listed grid of poses, or a search of all places of the object.

Both kinds of source score poses for touches, choose the poses to refine, and find the pose nearest to the true pose.
The localizer treats both kinds alike.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.runtime.progress import Progress, StageTimes
from tactile_loc.core.sensing.scene import Scene, View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.options import HypothesisOptions
from tactile_loc.locate.hypotheses import choose_best_apart, propose_together, split_modes
from tactile_loc.locate.sources.listed_model import (
    ObjectPoseModel,
    build_bank,
    build_model,
    make_encoder_key,
    train_encoder,
)
from tactile_loc.locate.sources.place_banks import PlaceBanks
from tactile_loc.locate.sources.scoring import GridScores, NewMatcher, Scores
from tactile_loc.locate.sources.whole_object import PlaceSearch
from tactile_loc.simulate.listed_training import ListedProblem
from tactile_loc.slots.encoder import Encoder
from tactile_loc.slots.grid import GridSampler
from tactile_loc.slots.matcher import Matcher
from tactile_loc.store.store import StageStore


class PoseSource(ABC):
    """Scores poses for touches of one object by one sensor.

    If `searched` is true, only the likeliest poses are scored, so the true pose may be missing.
    """

    searched: bool

    @property
    @abstractmethod
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""

    @abstractmethod
    def score(
        self, touches: Sequence[Touch], times: StageTimes, prior: Prior | None = None
    ) -> list[tuple[PoseGrid, Scores]]:
        """Return, for each touch, the poses compared with it (metres) and their scores (N,), unitless.

        A search also scores poses that the `prior` favours; a listed grid ignores the prior. Adds stage durations to
        `times`.
        """

    @abstractmethod
    def propose(
        self, views: Sequence[View], alone: Sequence[PosePosterior], fused: PosePosterior, top: int
    ) -> list[Mode]:
        """Return the modes of the `fused` posterior to refine, at least `top` if there are that many.

        `alone` are the touches' own posteriors.
        """

    @abstractmethod
    def find_truth(self, grid: PoseGrid, touch: Touch) -> int:
        """Return the index of the grid pose nearest to a touch's true pose; -1 if the search found none near it."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return all inputs of the scores except the encoder, the sensor and the touch, as JSON values."""


class PlaceSource(PoseSource):
    """Poses from a search of all places of the object."""

    searched = True

    def __init__(
        self, search: PlaceSearch, banks: PlaceBanks, options: HypothesisOptions, mode_radius_m: float
    ) -> None:
        self.search, self.banks, self.options, self.mode_radius_m = search, banks, options, mode_radius_m

    @property
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""
        return self.banks.trained

    def score(
        self, touches: Sequence[Touch], times: StageTimes, prior: Prior | None = None
    ) -> list[tuple[PoseGrid, Scores]]:
        """Search the whole object for each touch; return the likeliest poses and their imprint IoUs."""
        return [self.search.score(touch, times, prior) for touch in touches]

    def propose(
        self, views: Sequence[View], alone: Sequence[PosePosterior], fused: PosePosterior, top: int
    ) -> list[Mode]:
        """Return the most probable poses that are far enough apart.

        The number of poses is at most the greatest of `top`, the option `refined` and a tenth of all poses.
        """
        count = max(top, self.options.refined, len(fused.grid) // 10)
        return choose_best_apart(fused, self.options.start_radius * self.mode_radius_m, count)

    def find_truth(self, grid: PoseGrid, touch: Touch) -> int:
        """Return the index of the grid pose nearest to a touch's true pose; -1 if the search found none near it."""
        (distance_m,), (index,) = grid.nearest(np.asarray(touch.T_sensor_object)[None])
        return -1 if distance_m > self.search.found_m else int(index)

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the scores except sensor and touch, as JSON values; trains the encoder if necessary."""
        return {**self.search.describe(), "trained": self.trained}


class GridSource(PoseSource):
    """Poses listed by a grid, whose contact shapes are rendered and encoded only once."""

    searched = False

    def __init__(
        self, sampler: GridSampler, scene: Scene, encoder: Encoder, new_matcher: NewMatcher, store: StageStore,
        progress: Progress, options: HypothesisOptions, mode_radius_m: float,
    ) -> None:  # fmt: skip
        """`scene` has the grid's image size and full press."""
        self.sampler, self.scene, self.encoder, self.new_matcher = sampler, scene, encoder, new_matcher
        self.store, self.progress, self.options, self.mode_radius_m = store, progress, options, mode_radius_m

    @cached_property
    def model(self) -> ObjectPoseModel:
        """The object's grid and contact shapes, stored or built now."""
        return build_model(self.scene, self.sampler, self.store, self.progress)

    @cached_property
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""
        if not self.encoder.capabilities.needs_training:
            return ""
        model, scene, sampler = self.model, self.scene, self.sampler
        return train_encoder(
            self.encoder, make_encoder_key(model.key, self.encoder, sampler),
            lambda kept: ListedProblem(model.grid, scene, sampler, model.shapes.shards, self.progress, kept),
            self.store, scene.object.name,
        )  # fmt: skip

    @cached_property
    def banks(self) -> GridScores:
        """The comparison of touches with the grid's banks; each bank is built at first use, or loaded if stored."""
        return GridScores(self.encoder, self.new_matcher, self._bank, self.scene.geometry.max_depth_m)

    def _bank(self, press_depth_m: float) -> Scores:
        return build_bank(
            self.model, self.scene, self.encoder, press_depth_m, self.store, self.progress, self.trained
        )  # fmt: skip

    def matcher(self, press_depth_m: float) -> Matcher:
        """Return the matcher whose bank is cut at this press depth (metres), built at first use."""
        return self.banks.matcher(press_depth_m)

    def press_grid(self, touch: Touch) -> PoseGrid:
        """Return the grid's poses, in metres, at the touch's indentation."""
        return self.model.grid.raise_level(self.scene.geometry.max_depth_m - touch.indentation_m)

    def score(
        self, touches: Sequence[Touch], times: StageTimes, prior: Prior | None = None
    ) -> list[tuple[PoseGrid, Scores]]:
        """Match each touch with all poses of the grid."""
        scores = self.banks.scores(touches, times)
        return list(zip(map(self.press_grid, touches), scores, strict=True))

    def propose(
        self, views: Sequence[View], alone: Sequence[PosePosterior], fused: PosePosterior, top: int
    ) -> list[Mode]:
        """Return the modes of the fused posterior; for several touches, the poses that explain all of them best.

        The modes of one touch are split, because the poses of one mode may end in several poses when refined.
        """
        radius_m = self.options.start_radius * self.mode_radius_m
        if len(views) > 1:
            return propose_together(views, alone, fused, radius_m, self.options)
        return split_modes(fused, fused.modes(self.mode_radius_m, top), radius_m, max(top, self.options.refined))

    def find_truth(self, grid: PoseGrid, touch: Touch) -> int:
        """Return the index of the grid pose nearest to a touch's true pose."""
        return int(grid.nearest(np.asarray(touch.T_sensor_object)[None])[1][0])

    def describe(self) -> dict[str, Any]:
        """Return all inputs of the scores except sensor and touch, as JSON values; trains the encoder if necessary."""
        return {"model": self.model.key.digest, "trained": self.trained}
