"""The compiled part of FilterReg: Gaussian sums over an observed cloud, and normal equations.

Lengths are in mm, in the sensor's frame. A mixture is a `filterreg.refiner.Mixture`. A twist (6,) is a rotation (rad)
before a translation (mm).
"""

import math

import numpy as np

from tactile_loc.plugin.helpers import njit

# mypy: ignore-errors


@njit(fast=True)
def merge(rows, box, low, boxes):
    """Merge the points of each box into one row (7,): the number of points, the mean point and the mean normal."""
    number = np.full(boxes[0] * boxes[1] * boxes[2], -1, np.int32)
    merged, found = np.zeros(rows.shape), 0
    for j in range(len(rows)):
        k = 0
        for a in range(3):
            k = k * boxes[a] + min(boxes[a] - 1, int((rows[j, 1 + a] - low[a]) / box))
        if number[k] < 0:
            number[k] = found
            found += 1
        for a in range(rows.shape[1]):
            merged[number[k], a] += rows[j, a]
    for k in range(found):
        for a in range(1, rows.shape[1]):
            merged[k, a] /= merged[k, 0]
    return merged[:found]


@njit(fast=True)
def measure_mean_density(samples, mixture):
    """Return the mean sum of weights at samples (S, 7) of the cloud."""
    total = 0.0
    for i in range(len(samples)):
        total += _expect(samples[i, 1:4], samples[i, 4:7], mixture)[0]
    return total / len(samples)


@njit(fast=True)
def _expect(x, n, mixture):
    """Do the E step for one point x (3,) with normal n (3,), by sums over the mixture's components y_k, n_k.

    The weight of a component is a Gaussian of its distance from x, times max(0, n . n_k). Return the sum of weights,
    and the weighted sums of x - y_k and of n_k.
    """
    rows = mixture.rows
    scale, limit = -0.5 / mixture.sigma_mm**2, mixture.reach_mm**2
    column = math.floor((x[0] - mixture.low_mm[0]) / mixture.cell_mm)
    row = math.floor((x[1] - mixture.low_mm[1]) / mixture.cell_mm)
    first, last = max(0, row - 1), min(mixture.columns[1] - 1, row + 1)
    m = d0 = d1 = d2 = n0 = n1 = n2 = 0.0
    if first > last:
        return m, d0, d1, d2, n0, n1, n2
    for c in range(max(0, column - 1), min(mixture.columns[0], column + 2)):
        at = c * mixture.columns[1]
        for k in range(mixture.starts[at + first], mixture.starts[at + last + 1]):
            e0, e1, e2 = x[0] - rows[k, 1], x[1] - rows[k, 2], x[2] - rows[k, 3]
            squared = e0 * e0 + e1 * e1 + e2 * e2
            facing = n[0] * rows[k, 4] + n[1] * rows[k, 5] + n[2] * rows[k, 6]
            if squared < limit and facing > 0.0:
                w = rows[k, 0] * facing * math.exp(scale * squared)
                m += w
                d0, d1, d2 = d0 + w * e0, d1 + w * e1, d2 + w * e2
                n0, n1, n2 = n0 + w * rows[k, 4], n1 + w * rows[k, 5], n2 + w * rows[k, 6]
    return m, d0, d1, d2, n0, n1, n2


@njit(fast=True)
def add_equations(first, last, cloud, candidates, mixture, result):
    """Add to the normal equations `result` (K, 6, 7) of the candidates `which` (K,) from first to last.

    Candidate c has the points from starts[c] to starts[c + 1], moved by T[c] (4, 4). Candidates rotate about `centres`
    (K, 3). `cloud` has the points, normals and starts, and `candidates` have `which`, T and the centres.
    """
    (points, normals, starts), (which, T, centres) = cloud, candidates
    for k in range(first, last):
        c = which[k]
        some = slice(starts[c], starts[c + 1])
        _add_equations(points[some], normals[some], T[c], centres[k], mixture, result[k])


@njit(fast=True)
def _add_equations(points, normals, T, centre, mixture, result):
    """Add the equations (6, 7) of one candidate: the matrix and the right-hand side.

    The cost of a point at x is (n . (x - y))^2, with the weighted mean normal n and point y of the E step. Its
    derivative by the twist is (lever x n, n), where the lever is x - centre. The weight of a point is the probability
    that it is not an outlier.
    """
    x, n, row = np.empty(3), np.empty(3), np.empty(6)
    for i in range(len(points)):
        for a in range(3):
            x[a] = T[a, 0] * points[i, 0] + T[a, 1] * points[i, 1] + T[a, 2] * points[i, 2] + T[a, 3]
            n[a] = T[a, 0] * normals[i, 0] + T[a, 1] * normals[i, 1] + T[a, 2] * normals[i, 2]
        m, d0, d1, d2, n0, n1, n2 = _expect(x, n, mixture)
        if m > 0.0:
            trust = 1.0 / (m + mixture.outlier)
            row[3], row[4], row[5] = n0 / m, n1 / m, n2 / m
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                row[a] = (x[b] - centre[b]) * row[3 + c] - (x[c] - centre[c]) * row[3 + b]
            off = row[3] * d0 + row[4] * d1 + row[5] * d2
            for r in range(6):
                for s in range(6):
                    result[r, s] += trust * m * row[r] * row[s]
                result[r, 6] -= trust * off * row[r]
