"""FilterReg compiled (numba): Gaussian sums over an observed cloud, the equations they give, their twists.

Lengths in mm, in the sensor's frame. A mixture is a `filterreg.refiner.Mixture`. A twist (6,) is a rotation (rad)
before a translation (mm).
"""

from __future__ import annotations

import math

import numpy as np

from tactile_loc.plugin import njit, prange

# mypy: ignore-errors


FAST = {"cache": True, "error_model": "numpy", "fastmath": {"nsz", "arcp", "contract"}}


@njit(**FAST)
def merge(rows, box, low, boxes):
    """Merge the points of one box: rows (M, 7) of their number, mean point and mean normal."""
    number = np.full(boxes[0] * boxes[1] * boxes[2], -1, np.int32)
    merged, found = np.zeros_like(rows), 0
    for j in range(len(rows)):
        k = 0
        for a in range(3):
            k = k * boxes[a] + min(boxes[a] - 1, int((rows[j, 1 + a] - low[a]) / box))
        if number[k] < 0:
            number[k] = found
            found += 1
        merged[number[k]] += rows[j]
    for k in range(found):
        merged[k, 1:] /= merged[k, 0]
    return merged[:found]


@njit(**FAST)
def sort_into_columns(rows, low, cell, columns):
    """Sort rows (M, 7) by the column of the table they lie in; return where each column starts, and the rows."""
    starts = np.zeros(columns[0] * columns[1] + 1, np.int64)
    column = np.empty(len(rows), np.int64)
    for j in range(len(rows)):
        x = min(columns[0] - 1, int((rows[j, 1] - low[0]) / cell))
        y = min(columns[1] - 1, int((rows[j, 2] - low[1]) / cell))
        column[j] = x * columns[1] + y
        starts[column[j] + 1] += 1
    starts = np.cumsum(starts)
    free = starts[:-1].copy()
    ordered = np.empty_like(rows)
    for j in range(len(rows)):
        ordered[free[column[j]]] = rows[j]
        free[column[j]] += 1
    return starts, ordered


@njit(**FAST)
def mean_density(samples, mixture):
    """Return the mean sum of weights at samples (S, 7) of the cloud itself."""
    total = 0.0
    for i in range(len(samples)):
        total += _expect(samples[i, 1:4], samples[i, 4:7], mixture)[0]
    return total / len(samples)


@njit(**FAST)
def _expect(x, n, mixture):
    """The E step of one point x (3,) with normal n (3,), as sums over the mixture's components y_k, n_k.

    The weight of a component is a Gaussian of its distance times max(0, n . n_k). Returns the sum of weights, and the
    weighted sums of x - y_k and of n_k.
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


@njit(parallel=True, **FAST)
def equations(points, normals, starts, which, T, centres, mixture, along):
    """Return the normal equations (K, 6, 7) of the candidates `which` (K,), shared out among threads.

    Candidate c has the points from starts[c] to starts[c + 1], moved by T (C, 4, 4); they turn about centres (K, 3).
    """
    result = np.zeros((len(which), 6, 7))
    for k in prange(len(which)):
        c = which[k]
        some = slice(starts[c], starts[c + 1])
        equations_of_one(points[some], normals[some], T[c], centres[k], mixture, along, result[k])
    return result


@njit(**FAST)
def equations_of_one(points, normals, T, centre, mixture, along, result):
    """Add the equations (6, 7) of one candidate: the matrix, and what it times the twist must equal.

    A point at x counts (n . (x - y))^2, n and y the weighted mean normal and point of the E step, and `along`, 0 to 1,
    shifts that from the distance along n to the whole distance. Its weight is the chance that it is no outlier.
    """
    x, n, A, g = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(3)
    for i in range(len(points)):
        for a in range(3):
            x[a] = T[a, 0] * points[i, 0] + T[a, 1] * points[i, 1] + T[a, 2] * points[i, 2] + T[a, 3]
            n[a] = T[a, 0] * normals[i, 0] + T[a, 1] * normals[i, 1] + T[a, 2] * normals[i, 2]
        m, d0, d1, d2, n0, n1, n2 = _expect(x, n, mixture)
        if m > 0.0:
            trust = 1.0 / (m + mixture.outlier)
            apart, mean = (d0, d1, d2), (n0 / m, n1 / m, n2 / m)
            off = mean[0] * d0 + mean[1] * d1 + mean[2] * d2
            for a in range(3):
                for b in range(3):
                    A[a, b] = trust * (1.0 - along) * m * mean[a] * mean[b]
                A[a, a] += trust * along * m
                g[a] = trust * ((1.0 - along) * off * mean[a] + along * apart[a])
            _add(x - centre, A, g, result)


@njit(**FAST)
def _add(lever, A, g, result):
    """Add J^T A J and -J^T g to the equations, J = [-[lever]x, 1] (3, 6)."""
    J = np.zeros((3, 6))
    J[0, 1], J[0, 2], J[1, 2] = lever[2], -lever[1], lever[0]
    J[1, 0], J[2, 0], J[2, 1] = -lever[2], lever[1], -lever[0]
    J[0, 3] = J[1, 4] = J[2, 5] = 1.0
    for r in range(6):
        a0 = J[0, r] * A[0, 0] + J[1, r] * A[1, 0] + J[2, r] * A[2, 0]
        a1 = J[0, r] * A[0, 1] + J[1, r] * A[1, 1] + J[2, r] * A[2, 1]
        a2 = J[0, r] * A[0, 2] + J[1, r] * A[1, 2] + J[2, r] * A[2, 2]
        for s in range(6):
            result[r, s] += a0 * J[0, s] + a1 * J[1, s] + a2 * J[2, s]
        result[r, 6] -= J[0, r] * g[0] + J[1, r] * g[1] + J[2, r] * g[2]


# mypy: ignore-errors


RIDGE = 1e-3  # of the equations' mean diagonal: damps steps in directions that a contact hardly fixes
SMALL = 1e-3  # rad: below, the series' next terms are lost in rounding


@njit(cache=True, error_model="numpy")
def solved(equations):
    """Return the twists (K, 6) that solve normal equations (K, 6, 7), and the root mean square (K,), mm, of the moves.

    Both are NaN where there are no points.
    """
    twists, moved_mm = np.full((len(equations), 6), np.nan), np.full(len(equations), np.nan)
    for k in range(len(equations)):
        A, b = equations[k, :, :6], equations[k, :, 6]
        turning, sliding = A[0, 0] + A[1, 1] + A[2, 2], A[3, 3] + A[4, 4] + A[5, 5]
        if not (sliding > 0 and turning >= 0 and np.isfinite(turning + sliding)):
            continue
        unit = np.ones(6)
        unit[:3] = math.sqrt(sliding / turning) if turning > 0 else 1.0  # radians a mm
        stiff = A * unit.reshape(6, 1) * unit
        ridge = RIDGE * np.trace(stiff) / 6.0
        for a in range(6):
            stiff[a, a] += ridge
        scaled = np.linalg.solve(stiff, b * unit)
        twists[k], moved_mm[k] = scaled * unit, math.sqrt((scaled * scaled).sum())
    return twists, moved_mm


@njit(cache=True, error_model="numpy")
def exponential(twists):
    """Return the rigid motions (K, 4, 4), translation in mm, of twists (K, 6)."""
    motions = np.zeros((len(twists), 4, 4))
    for k in range(len(twists)):
        x, y, z = twists[k, 0], twists[k, 1], twists[k, 2]
        angle = math.sqrt(x * x + y * y + z * z)
        if angle < SMALL:
            sine, versine, rest = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
        else:
            sine, versine = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
            rest = (angle - math.sin(angle)) / angle**3
        W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        squared = W @ W
        motions[k, :3, :3] = np.eye(3) + sine * W + versine * squared
        motions[k, :3, 3] = (np.eye(3) + versine * W + rest * squared) @ np.ascontiguousarray(twists[k, 3:])
        motions[k, 3, 3] = 1.0
    return motions


@njit(cache=True, error_model="numpy")
def turned_about(T, centres, twists):
    """Return the poses (K, 4, 4), translation in mm, after twists (K, 6) about centres (K, 3), mm."""
    motions, result = exponential(twists), np.empty_like(T)
    for k in range(len(T)):
        motion = motions[k]
        motion[:3, 3] += centres[k] - np.ascontiguousarray(motion[:3, :3]) @ centres[k]
        result[k] = motion @ T[k]
    return result
