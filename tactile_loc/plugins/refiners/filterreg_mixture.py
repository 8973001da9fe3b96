"""The Gaussian mixture that an observed cloud is to FilterReg at one standard deviation, laid out for quick sums."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import Cloud
from tactile_loc.plugins.refiners import filterreg_kernels as kernels

REACH = 2.5  # standard deviations at which a Gaussian is cut off
MOST_BOXES = 2_000_000  # into which points are merged; a cloud that spans more is left as it is
MOST_COLUMNS = 256  # a side of the table in which the points are looked up
SAMPLES = 100  # points of the cloud at which its own density is measured


class Mixture(NamedTuple):
    """Components `rows` (M, 7): how many points, their mean point (mm) and mean normal; sorted by column of a table.

    Column k = x_index * columns[1] + y_index, `cell_mm` wide from the corner `low_mm` (3,), holds the rows from
    starts[k] to starts[k + 1]. `outlier` is the weight that a point has in being no part of the cloud, in the unit of
    the sums of Gaussians.
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
    """A cloud as mixtures of any standard deviation; `outlier` (0 to 1): the share of points with no part in it."""

    def __init__(self, cloud: Cloud, outlier: float) -> None:
        points = cloud.points_mm
        self._rows = np.column_stack([np.ones(len(points)), points, cloud.normals])
        self._low, self._extent = points.min(axis=0), np.ptp(points, axis=0)
        self._samples = self._rows[:: max(1, len(points) // SAMPLES)].copy()
        self._odds = outlier / (1.0 - outlier)

    def at(self, sigma_mm: float, merged: bool) -> Mixture:
        """Return the mixture with one Gaussian a point or, `merged`, one for all points of a box one sigma wide.

        Merging changes the sums by little, as Gaussians a sigma apart add up to a nearly even density, and saves time
        where many points lie within reach.
        """
        rows = self._merged(sigma_mm) if merged else self._rows
        cell = max(REACH * sigma_mm, float(self._extent[:2].max()) / MOST_COLUMNS)
        columns = (self._extent[:2] / cell).astype(np.int64) + 1
        starts, rows = kernels.sort_into_columns(rows, self._low, cell, columns)
        bare = Mixture(rows, starts, self._low, cell, columns, float(sigma_mm), REACH * sigma_mm, 0.0)
        return bare._replace(outlier=self._odds * kernels.mean_density(self._samples, bare))

    def _merged(self, box_mm: float) -> NDArray[np.float64]:
        boxes = np.floor(self._extent / box_mm) + 1
        if boxes.prod() > MOST_BOXES:
            return self._rows
        rows: NDArray[np.float64] = kernels.merge(self._rows, box_mm, self._low, boxes.astype(np.int64))
        return rows
