"""FilterReg: registration by expectation-maximisation, for all candidates of a touch at once.

The method follows Gao and Tedrake, "FilterReg: Robust and Efficient Probabilistic Point-Set Registration using Gaussian
Filter and Twist Parameterization", CVPR 2019. The observed cloud is a Gaussian mixture. The E step gives each moving
point a weighted mean point, a mean normal, and a probability of belonging to the cloud. The sums are exact up to a
cut-off. Points match only if their normals are similar, so a wall is not matched to the face beside the wall. The M
step is a Gauss-Newton step on the twist of the rigid motion. The mixture's standard deviation decreases from one
iteration to the next.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin.helpers import Cloud, CloudRefiner, Registration, exponential, run_in_threads
from tactile_loc.plugins.refiners.filterreg import kernels

Floats = NDArray[np.float64]

REACH = 2.5  # standard deviations at which a Gaussian is cut off
MOST_BOXES = 2_000_000  # the points of a cloud that spans more boxes are not merged
MOST_COLUMNS = 256  # largest number of columns along each side of the lookup table
SAMPLES = 100  # points of the cloud at which its own density is measured


class Mixture(NamedTuple):
    """A Gaussian mixture with a lookup table of its components.

    A component in `rows` (M, 7) is the number of points, the mean point (mm) and the mean normal. The rows are sorted
    by the column of the table in which they lie. Columns are `cell_mm` wide in x and y, from the corner `low_mm` (3,).
    Column k = x_index * columns[1] + y_index holds the rows from starts[k] to starts[k + 1]. `outlier` is the weight of
    the outlier component, in the unit of the Gaussian sums.
    """

    rows: NDArray[np.float64]
    starts: NDArray[np.int64]
    low_mm: NDArray[np.float64]
    cell_mm: float
    columns: NDArray[np.int64]
    sigma_mm: float
    reach_mm: float
    outlier: float


class Mixtures:
    """Makes Gaussian mixtures of any standard deviation from a cloud. `outlier` (0 to 1) is the share of outliers."""

    def __init__(self, cloud: Cloud, outlier: float) -> None:
        points = cloud.points_mm
        self._rows = np.column_stack([np.ones(len(points)), points, cloud.normals])
        self._low, self._extent = points.min(axis=0), np.ptp(points, axis=0)
        self._samples = self._rows[:: max(1, len(points) // SAMPLES)].copy()
        self._odds = outlier / (1.0 - outlier)

    def make_mixture(self, sigma_mm: float, merged: bool) -> Mixture:
        """Return the mixture with one Gaussian for each point or, if `merged`, for each box that is one sigma wide.

        With merged points, the sums take less time and hardly change, because Gaussians one sigma apart add up to a
        nearly even density.
        """
        rows = self._merge(sigma_mm) if merged else self._rows
        cell = max(REACH * sigma_mm, float(self._extent[:2].max()) / MOST_COLUMNS)
        columns = (self._extent[:2] / cell).astype(np.int64) + 1
        x, y = np.minimum(((rows[:, 1:3] - self._low[:2]) / cell).astype(np.int64), columns - 1).T
        order = np.argsort(x * columns[1] + y, kind="stable")
        starts = np.searchsorted((x * columns[1] + y)[order], np.arange(columns.prod() + 1))
        bare = Mixture(rows[order], starts, self._low, cell, columns, float(sigma_mm), REACH * sigma_mm, 0.0)
        return bare._replace(outlier=self._odds * kernels.measure_mean_density(self._samples, bare))

    def _merge(self, box_mm: float) -> NDArray[np.float64]:
        boxes = np.floor(self._extent / box_mm) + 1
        if boxes.prod() > MOST_BOXES:
            return self._rows
        rows: NDArray[np.float64] = kernels.merge(self._rows, box_mm, self._low, boxes.astype(np.int64))
        return rows


RIDGE = 1e-3  # share of the equations' mean diagonal that damps directions which a contact hardly determines
ANNEAL = 0.5  # factor of the standard deviation from one iteration to the next
SETTLED_MM = 1e-3  # RMS move of a candidate's points at convergence
SPACINGS = 0.5  # least standard deviation, in spacings of neighbouring points: narrower Gaussians would not overlap


class FilterRegRefiner(CloudRefiner):
    """Registers by FilterReg, point to plane, at standard deviations from `sigma_mm` down to `sigma_end_mm`."""

    class Options(CloudRefiner.Options):
        """Standard deviations of the Gaussians, share of outliers, and number of iterations."""

        moving_points: int = Field(default=400, ge=50, description="points of the candidate's cloud, thinned evenly")
        sigma_mm: float = Field(default=2.0, gt=0, description="first standard deviation of the Gaussians, mm")
        sigma_end_mm: float = Field(
            default=0.15, gt=0, description="last standard deviation, mm; larger when points are sparse"
        )
        outlier: float = Field(default=0.03, gt=0, lt=1, description="expected share of points without a counterpart")
        iterations: int = Field(default=30, ge=1, description="most iterations of expectation and maximisation")

    def register(self, source: Cloud, target: Cloud) -> Registration:
        """Return the registration (mm) after the last iteration. It is empty if no point was near the target."""
        return self.register_many([source], target)[0]

    def register_many(self, sources: Sequence[Cloud], target: Cloud) -> list[Registration]:
        """Register all clouds together. Each cloud stops when it has converged at the last standard deviation."""
        if not sources:
            return []
        moving, going = _Moving(sources), np.arange(len(sources))
        for observed, last in self._anneal(target):
            moved_mm = moving.step(going, observed)
            moving.converged[going] = last & (moved_mm < SETTLED_MM)
            going = going[(moved_mm >= SETTLED_MM) if last else np.isfinite(moved_mm)]
            if len(going) == 0:
                break
        return moving.results()

    def _anneal(self, target: Cloud) -> Iterator[tuple[Mixture, bool]]:
        """Yield the target's mixture for each iteration, and whether its standard deviation is the smallest."""
        options, mixtures = self.options, Mixtures(target, self.options.outlier)
        sigma, last, done = options.sigma_mm, max(options.sigma_end_mm, SPACINGS * target.spacing_mm), 0
        while sigma > last and done < options.iterations:
            yield mixtures.make_mixture(sigma, merged=True), False
            sigma, done = sigma * ANNEAL, done + 1
        if done < options.iterations:
            final = mixtures.make_mixture(last, merged=False)
            yield from ((final, True) for _ in range(options.iterations - done))


class _Moving:
    """The concatenated clouds of several candidates, and the current state of each candidate."""

    def __init__(self, sources: Sequence[Cloud]) -> None:
        self.points = np.concatenate([source.points_mm for source in sources])
        self.normals = np.concatenate([source.normals for source in sources])
        self.starts = np.cumsum([0, *(len(source) for source in sources)])
        self.middles = np.stack([source.points_mm.mean(axis=0) for source in sources])
        self.T = np.tile(np.eye(4), (len(sources), 1, 1))
        self.iterations = np.zeros(len(sources), int)
        self.converged = np.zeros(len(sources), bool)
        self.found = np.zeros(len(sources), bool)

    def step(self, going: NDArray[np.int64], observed: Mixture) -> Floats:
        """Do one iteration of the candidates `going` (K,). Return the RMS moves (K,) of their points, mm.

        The move is NaN for a candidate without a point near the observed cloud. Such a candidate does not move.
        """
        T, middles = self.T[going], self.middles[going]
        centres = (T[:, :3, :3] @ middles[:, :, None])[:, :, 0] + T[:, :3, 3]
        equations = np.zeros((len(going), 6, 7))
        cloud, candidates = (self.points, self.normals, self.starts), (going, self.T, centres)
        run_in_threads(kernels.add_equations, len(going), cloud, candidates, observed, equations)
        twists, moved_mm = solve(equations)
        reached = np.isfinite(moved_mm)
        self.iterations[going] += 1
        self.found[going] |= reached
        these = going[reached]
        self.T[these] = exponential(twists[reached], centres[reached]) @ self.T[these]
        return moved_mm

    def results(self) -> list[Registration]:
        rows = zip(self.T, self.found, self.converged, self.iterations, strict=True)
        return [Registration(T if found else None, bool(done), int(count)) for T, found, done, count in rows]


# A twist (6,) is a rotation (rad), then a translation (mm).


def solve(equations: Floats) -> tuple[Floats, Floats]:
    """Return the twists (K, 6) that solve normal equations (K, 6, 7), and the RMS moves (K,), mm.

    Both are NaN for a candidate whose equations are empty.
    """
    diagonal = np.diagonal(equations[:, :, :6], axis1=1, axis2=2)
    turning, sliding = diagonal[:, :3].sum(axis=1), diagonal[:, 3:].sum(axis=1)
    known = (sliding > 0) & (turning >= 0) & np.isfinite(turning + sliding)
    turning, sliding = turning[known], sliding[known]
    unit = np.ones((len(turning), 6))  # radians per mm
    unit[:, :3] = np.sqrt(np.divide(sliding, turning, out=np.ones_like(sliding), where=turning > 0))[:, None]
    stiff = equations[known, :, :6] * unit[:, :, None] * unit[:, None]
    ridge = RIDGE * np.trace(stiff, axis1=1, axis2=2) / 6
    wanted = (equations[known, :, 6] * unit)[..., None]
    scaled = np.linalg.solve(stiff + ridge[:, None, None] * np.eye(6), wanted)[..., 0]
    twists, moved_mm = np.full((len(equations), 6), np.nan), np.full(len(equations), np.nan)
    twists[known], moved_mm[known] = scaled * unit, np.sqrt((scaled**2).sum(axis=1))
    return twists, moved_mm
