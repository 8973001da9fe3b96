"""Sources of candidate poses: a listed grid of poses, or a search of all places of the object.

A source scores poses for touches, chooses the poses to refine, and finds the pose nearest to the true pose. Whether it
lists poses or searches them is known to this package alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Poses
from tactile_loc.core.places.places import Places
from tactile_loc.core.poses.metric import PoseGrid, PoseMetric
from tactile_loc.core.poses.posterior import Mode, PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.runtime.errors import ConfigError
from tactile_loc.core.runtime.progress import Progress, StageTimes
from tactile_loc.core.sensing.scene import DepthRenderer, Scene, View
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import RunConfig, choose_component
from tactile_loc.locate.probability.temperature import TemperatureScaling
from tactile_loc.locate.sources.scoring import NewMatcher, Scores
from tactile_loc.locate.stored_object import load_surface_field
from tactile_loc.slots.encoder import Encoder
from tactile_loc.slots.grid import GridSampler
from tactile_loc.slots.registry import registry
from tactile_loc.store.store import StageStore

STAGE_VERSIONS = {"grid": 5, "shapes": 3, "encoder": 3, "bank": 3}
Values = NDArray[np.float64]
Rated = tuple[Poses, Values]  # poses (K, 4, 4), metres, and values (K,), the greater the better
Posteriors = Sequence[PosePosterior]  # each touch's own posterior, over poses in the frame of its own sensor
FindPlaces = Callable[[], Places]


@dataclass(frozen=True, eq=False)
class SourceSetup:
    """What a source is made from: the object before a sensor (`scene`), the grid, the encoder, and where to store.

    `find_places` returns the object's places; if it is None, they are found once and stored.
    """

    config: RunConfig
    scene: Scene
    sampler: GridSampler
    encoder: Encoder
    store: StageStore
    progress: Progress
    find_places: FindPlaces | None = None

    @cached_property
    def coarse_scene(self) -> Scene:
        """The scene with the few pixels of a listed grid's contact shapes, at full press."""
        coarse = self.scene.geometry.resize_long_side(self.config.shape_px)
        return replace(self.scene, geometry=coarse.press(coarse.max_depth_m))

    @cached_property
    def judge(self) -> DepthRenderer:
        """The renderer that decides which poses of a listed grid make enough contact: always the default one.

        So grids of different renderers have the same poses.
        """
        chosen = choose_component("renderer")
        renderer: DepthRenderer = registry().create("renderer", chosen.name, chosen.options)
        return renderer

    @cached_property
    def metric(self) -> PoseMetric:
        """The distance between two poses of the object."""
        return PoseMetric(self.scene.object)

    @property
    def mode_radius_m(self) -> float:
        """Distance below which poses belong to one mode, metres."""
        spacing_mm: float = self.sampler.options.spacing_mm
        return self.config.hypotheses.mode_radius * spacing_mm * 1e-3

    @property
    def merge_radius_m(self) -> float:
        """Distance below which refined poses count as one hypothesis, metres."""
        return self.config.hypotheses.merge_radius * self.mode_radius_m

    @property
    def start_radius_m(self) -> float:
        """Least distance between poses to refine, metres."""
        return self.config.hypotheses.start_radius * self.mode_radius_m


class PoseSource(ABC):
    """Scores poses for touches of one object by one sensor.

    `all_stages` are the stages of the store that it builds with a trained encoder. `may_miss` states whether the true
    pose may be near none of the poses that it scores.
    """

    all_stages: ClassVar[tuple[str, ...]]
    may_miss: ClassVar[bool]

    def __init__(self, setup: SourceSetup, new_matcher: NewMatcher) -> None:
        self.setup, self.new_matcher = setup, new_matcher

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages of the store that the source builds, the first ones first."""
        trains = self.setup.encoder.capabilities.needs_training
        return tuple(stage for stage in self.all_stages if trains or stage != "encoder")

    @property
    @abstractmethod
    def trained(self) -> str:
        """The digest of the encoder's weights, trained now or stored; empty if the encoder needs no training."""

    @abstractmethod
    def score(self, touch: Touch, times: StageTimes, prior: Prior | None = None) -> tuple[PoseGrid, Scores]:
        """Return the poses compared with a touch (metres) and their scores (N,), unitless.

        A search also scores poses that the `prior` favours; a listed grid ignores the prior. Adds stage durations to
        `times`.
        """

    def search(
        self, views: Sequence[View], sources: Sequence[PoseSource], times: StageTimes, prior: Prior | None = None
    ) -> Posteriors:
        """Return the posteriors of one touch, or of several touches of one object.

        `sources` are those of each touch's sensor, this source first. The `prior` is over poses in the
        first touch's sensor frame. Adds stage durations to `times`. Raises ConfigError if some sources list poses and
        others search them.
        """
        require_one_kind(sources)
        self.load_field()
        alone = []
        for view, source in zip(views, sources, strict=True):
            scaling = source.temperature_scaling  # perhaps fitted first, with its own progress
            grid, scores = source.score(view.touch, times, prior)
            alone.append(scaling.posterior(grid, scores))
        return alone

    @cached_property
    def temperature_scaling(self) -> TemperatureScaling:
        """The scaling from scores to probabilities: with the user's temperature, or else the source's own."""
        given = self.setup.config.temperature
        return self.find_scaling() if given is None else TemperatureScaling(given)

    @abstractmethod
    def find_scaling(self) -> TemperatureScaling:
        """Return the source's own scaling from scores to probabilities."""

    @abstractmethod
    def propose(
        self, views: Sequence[View], alone: Posteriors, fused: PosePosterior, prior: Prior | None, top: int
    ) -> list[Mode]:
        """Return the modes of the `fused` posterior to refine, at least `top` if there are that many.

        The `prior` is over poses in the first touch's sensor frame.
        """

    @abstractmethod
    def list_starts_alone(self, view: View, own: PosePosterior, times: StageTimes) -> tuple[PoseGrid, Values]:
        """Return poses to refine against one touch alone, and their values (K,); greater ones are better.

        `view` is the touch's own view, and `own` its own posterior.
        """

    def keep_promising(
        self, modes: Sequence[Mode], imprint_ious: NDArray[np.float64], trusted: Sequence[View], times: StageTimes
    ) -> Sequence[Mode]:
        """Return the modes worth refining against `trusted` touches, given their coarse mean imprint IoUs (K,)."""
        return modes

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return all inputs of the scores except the sensor and the touch, as JSON values; trains the encoder."""

    def describe_scores(self) -> dict[str, Any]:
        """Return all inputs of the scores except the touch, as JSON values; trains the encoder if necessary.

        The matcher is left out, because all matchers that score all poses compute the same scores.
        """
        return {
            **self.describe(),
            "sensor": self.setup.scene.geometry.describe(),
            "encoder": self.setup.encoder.describe(),
            "training": STAGE_VERSIONS["encoder"],
            "bank": STAGE_VERSIONS["bank"],
        }

    def prepare(self, press_depth_m: float) -> None:
        """Build or load what a touch of this press depth, metres, needs."""
        _ = self.trained
        self.load_field()

    def load_field(self) -> None:
        """Build or load the field of the object's surface, in which poses are registered."""
        load_surface_field(self.setup.scene.object, self.setup.store)

    @abstractmethod
    def count_poses(self) -> dict[str, Any]:
        """Return the size of the source, as JSON values in SI units."""

    @property
    def nbytes(self) -> int:
        """The memory, bytes, that freeing the source frees."""
        return 0

    @property
    def searched(self) -> Any:
        """The search of places. Raises ConfigError if poses are listed."""
        raise self._refuse("lists the poses of {}, but this needs a search of its places; choose `grid` whole")

    @property
    def listed(self) -> Any:
        """The listed grid. Raises ConfigError if the source lists no poses."""
        raise self._refuse(
            "does not list the poses of {}, which this command or encoder needs; choose `grid` face or `grid` hopf"
        )

    def _refuse(self, reason: str) -> ConfigError:
        return ConfigError(f"the grid {self.setup.config.grid.name!r} {reason.format(self.setup.scene.object.name)}")


def require_one_kind(sources: Sequence[PoseSource]) -> None:
    """Raise ConfigError if some sources list poses and others search them."""
    if len({type(source) for source in sources}) > 1:
        raise ConfigError(
            "some localizers search the whole object and others a grid of listed poses; give all of them the grid "
            "whole, or none"
        )


def rate_poses(views: Sequence[View], sources: Sequence[PoseSource], T_first_object: Poses, ious: Values) -> Posteriors:
    """Return each touch's posterior over poses (K, 4, 4), metres, in its own sensor frame, with its source's scaling.

    The poses are in the first touch's sensor frame. `ious` (K, N), 0 to 1, are their imprint IoUs with the touches.
    """
    alone = []
    for view, source, own in zip(views, sources, ious.T, strict=True):
        grid = PoseGrid(view.T_sensor_first @ T_first_object, source.setup.metric)
        alone.append(source.temperature_scaling.posterior(grid, own))
    return alone
