"""Training data for encoders with a grid of listed poses: each key is a pose's contact shape."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tactile_loc.core.geometry.rigid import Float32, Floats, Ints
from tactile_loc.core.poses.metric import PoseGrid
from tactile_loc.core.runtime.progress import Progress
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.noise import TouchNoise
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.simulate.contact_poses import draw_contacts
from tactile_loc.slots.encoder import Checkpoints, TrainingBatch, TrainingProblem, TrainingTouches
from tactile_loc.slots.grid import GridSampler


@dataclass(frozen=True, eq=False)
class ListedTouches(TrainingTouches):
    """Contact depths (N, H, W), metres, without noise, at the maximal depth, and the touches' labels (N,).

    The label of a touch is the index of the nearest grid pose.
    """

    depth_m: Float32
    labels: Ints
    noise: TouchNoise
    geometry: SensorGeometry

    def __len__(self) -> int:
        return len(self.labels)

    def batch(self, count: int, rng: np.random.Generator, press_m: float) -> TrainingBatch:
        """Draw `count` different touches with noise, at random press depths."""
        chosen = np.sort(rng.choice(len(self), count, replace=False))
        deepest = self.geometry.max_depth_m
        press = self.noise.draw_press(count, deepest, rng)
        measured = self.noise.measure_press(press, deepest, rng)
        shown = deform_gel(self.depth_m[chosen], press, self.geometry)
        depth = self.noise.cut(self.noise.corrupt(shown, press, self.geometry, rng), press, measured)
        seen = np.broadcast_to(self.geometry.observed_mask, depth.shape)
        return TrainingBatch(depth, seen, measured, self.labels[chosen])


@dataclass(frozen=True, eq=False)
class ListedProblem(TrainingProblem):
    """The problem of finding the nearest pose of a `grid`.

    `shapes` yields the contact depths (S, H, W), metres, of the grid's poses at the maximal depth, in shards, in the
    grid's order. Touches are at new poses from `sampler`, and are rendered with `scene`.
    """

    grid: PoseGrid
    scene: Scene
    sampler: GridSampler
    shapes: Callable[[], Iterable[Float32]]
    progress: Progress = field(default_factory=Progress)
    checkpoints: Checkpoints = field(default_factory=Checkpoints)
    partly_seen = False

    @property
    def geometry(self) -> SensorGeometry:
        """The sensor's geometry."""
        return self.scene.geometry

    @property
    def key_presses_m(self) -> Floats:
        """The sensor's maximal depth (1,), metres."""
        return np.array([self.scene.geometry.max_depth_m])

    def __len__(self) -> int:
        return len(self.grid)

    def clean_keys(self, press_m: float) -> Iterable[Float32]:
        """Yield the contact depths (S, H, W), metres, of the grid's poses at the maximal depth, in shards."""
        return self.shapes()

    def draw(self, count: int, noise: TouchNoise, rng: np.random.Generator) -> TrainingTouches:
        """Render `count` touches at random poses from the continuous set that the grid covers."""
        depths: list[Float32] = []
        labels: list[Ints] = []
        misplace = partial(noise.misplace, geometry=self.geometry, rng=rng)
        for poses, depth in draw_contacts(self.sampler, self.scene, count, rng, misplace):
            depths.append(depth)
            labels.append(self.grid.nearest(poses)[1])
        return ListedTouches(np.concatenate(depths), np.concatenate(labels), noise, self.geometry)

    def key_distances(self, first: Ints, second: Ints) -> Floats:
        """Return the distances (K,), metres, between grid poses `first` and `second` (K,), ignoring symmetry."""
        phi = self.grid.phi
        return np.asarray(np.linalg.norm(phi[first] - phi[second], axis=1))
