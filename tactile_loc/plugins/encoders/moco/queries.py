"""The learned encoder's training touches, rendered ahead of the trainer."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from tactile_loc.plugin import TouchNoise, TrainingProblem, TrainingTouches


class QuerySource:
    """Renders `count` touches for each epoch, while the trainer uses the epoch before.

    Processes that train together have different `rank`s, and render different touches.
    """

    def __init__(self, problem: TrainingProblem, noise: TouchNoise, count: int, seed: int, rank: int = 0) -> None:
        self.problem, self.noise, self.count, self.seed, self.rank = problem, noise, count, seed, rank

    def epochs(self, first: int, last: int) -> Iterator[TrainingTouches]:
        """Yield the touches of epochs `first` ... `last` - 1."""
        if first >= last:
            return
        with ThreadPoolExecutor(1) as ahead:
            coming = ahead.submit(self._render, [self.seed, first, 0, self.rank], self.count)
            for epoch in range(first, last):
                touches = coming.result()
                if epoch + 1 < last:
                    coming = ahead.submit(self._render, [self.seed, epoch + 1, 0, self.rank], self.count)
                yield touches

    def validation(self, count: int) -> TrainingTouches:
        """Return touches that are not used in training."""
        return self._render([self.seed, 0, 1], count)

    def _render(self, seed: list[int], count: int) -> TrainingTouches:
        return self.problem.draw(count, self.noise, np.random.default_rng(seed))
