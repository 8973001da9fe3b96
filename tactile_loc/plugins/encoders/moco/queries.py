"""The touches that the learned encoder trains on: rendered ahead of the trainer, labelled, and made noisy."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import Float32, Poses, SensorGeometry, TouchNoise, TrainingProblem, random_contacts


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
    """Renders `count` touches an epoch, the next epoch's while the present one is being used.

    Each `rank` of processes that train together renders others.
    """

    def __init__(self, problem: TrainingProblem, noise: TouchNoise, count: int, seed: int, rank: int = 0) -> None:
        self.problem, self.noise, self.count, self.seed, self.rank = problem, noise, count, seed, rank

    def epochs(self, first: int, last: int) -> Iterator[Queries]:
        """Yield the touches of epochs `first` ... `last` - 1."""
        if first >= last:
            return
        with ThreadPoolExecutor(1) as ahead:
            coming = ahead.submit(self._render, [self.seed, first, 0, self.rank], self.count)
            for epoch in range(first, last):
                queries = coming.result()
                if epoch + 1 < last:
                    coming = ahead.submit(self._render, [self.seed, epoch + 1, 0, self.rank], self.count)
                yield queries

    def validation(self, count: int) -> Queries:
        """Return touches that no epoch trains on."""
        return self._render([self.seed, 0, 1], count)

    def _render(self, seed: list[int], count: int) -> Queries:
        rng = np.random.default_rng(seed)
        scene, grid = self.problem.scene, self.problem.grid
        depths: list[Float32] = []
        labels: list[NDArray[np.int64]] = []

        def misplaced(poses: Poses) -> Poses:
            return self.noise.misplace(poses, scene.geometry, rng)

        for poses, depth in random_contacts(self.problem.sampler, scene, count, rng, misplaced):
            depths.append(depth)
            labels.append(grid.nearest(poses)[1])
        return Queries(np.concatenate(depths), np.concatenate(labels), self.noise, scene.geometry)
