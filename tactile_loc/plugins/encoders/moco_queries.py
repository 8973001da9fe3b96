"""The touches that the learned encoder trains on: rendered ahead of the trainer, labelled, and made noisy."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.grids import random_contact_poses
from tactile_loc.core.interfaces import Float32, TrainingProblem
from tactile_loc.core.noise import TouchNoise
from tactile_loc.core.sensing import SensorGeometry

RENDERED_AT_ONCE = 512


@dataclass(frozen=True, eq=False)
class Queries:
    """Clean contact depths (N, H, W) in metres at full press, and each touch's label (N,): its nearest grid pose."""

    depth_m: Float32
    labels: NDArray[np.int64]
    noise: TouchNoise
    geometry: SensorGeometry

    def __len__(self) -> int:
        return len(self.labels)

    def batch(self, count: int, rng: np.random.Generator) -> tuple[Float32, NDArray[np.float64], NDArray[np.int64]]:
        """Draw `count` touches, made noisy: depths (count, H, W) and measured presses (count,) in metres, labels."""
        chosen = np.sort(rng.choice(len(self), count, replace=False))
        deepest = self.geometry.max_depth_m
        press = self.noise.draw_press(count, deepest, rng)
        measured = self.noise.measure_press(press, deepest, rng)
        depth = self.noise.corrupt(self.depth_m[chosen], press, self.geometry, rng)
        return self.noise.cut(depth, press, measured), measured, self.labels[chosen]


class QuerySource:
    """Renders `count` touches an epoch, the next epoch's while the present one is being used."""

    def __init__(self, problem: TrainingProblem, noise: TouchNoise, count: int, seed: int) -> None:
        self.problem, self.noise, self.count, self.seed = problem, noise, count, seed

    def epochs(self, first: int, last: int) -> Iterator[Queries]:
        """Yield the touches of epochs `first` ... `last` - 1."""
        if first >= last:
            return
        with ThreadPoolExecutor(1) as ahead:
            coming = ahead.submit(self._render, [self.seed, first, 0], self.count)
            for epoch in range(first, last):
                queries = coming.result()
                if epoch + 1 < last:
                    coming = ahead.submit(self._render, [self.seed, epoch + 1, 0], self.count)
                yield queries

    def validation(self, count: int) -> Queries:
        """Return touches that no epoch trains on."""
        return self._render([self.seed, 0, 1], count)

    def _render(self, seed: list[int], count: int) -> Queries:
        rng = np.random.default_rng(seed)
        scene, grid = self.problem.scene, self.problem.grid
        depths: list[Float32] = []
        labels: list[NDArray[np.int64]] = []
        while (missing := count - sum(map(len, labels))) > 0:
            poses = random_contact_poses(self.problem.sampler, scene, min(RENDERED_AT_ONCE, missing), rng)
            seen, touching = scene.in_contact(self.noise.misplace(poses, scene.geometry, rng))
            depths.append(scene.contact_depths(seen[touching]))
            labels.append(grid.nearest(poses[touching])[1])
        return Queries(np.concatenate(depths), np.concatenate(labels), self.noise, scene.geometry)
