"""Points or triangles in blocks of neighbours, each in a sphere, so that whole blocks out of reach can be skipped."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.objects.mesh import TriangleMesh

TRIANGLES = 24  # per block


class Blocks(NamedTuple):
    """Items of C corners each, in blocks of neighbours, in any unit.

    `corners` (N, C, 3) are the corners of the items whose numbers are `order` (N,). Block b has items from starts[b] to
    starts[b + 1], inside the sphere about centres[b] (B, 3) with radius radii[b] (B,).
    """

    corners: NDArray[np.float64]
    order: NDArray[np.int64]
    starts: NDArray[np.int64]
    centres: NDArray[np.float64]
    radii: NDArray[np.float64]


def make_blocks(corners: NDArray[np.float64], most: int) -> Blocks:
    """Split items with corners (N, C, 3), at the middle of their longest side, into blocks of at most `most`."""
    middles = corners.mean(axis=1)
    waiting, parts = [np.arange(len(corners))], []
    while waiting:
        some = waiting.pop()
        if len(some) <= most:
            parts.append(some)
            continue
        side = np.ptp(middles[some], axis=0).argmax()
        some = some[np.argsort(middles[some, side], kind="stable")]
        waiting += [some[len(some) // 2 :], some[: len(some) // 2]]
    order, starts = np.concatenate(parts), np.cumsum([0, *map(len, parts)])
    corners = np.ascontiguousarray(corners[order], float)
    low = np.minimum.reduceat(corners.min(axis=1), starts[:-1])
    high = np.maximum.reduceat(corners.max(axis=1), starts[:-1])
    centres = (low + high) / 2
    far = np.linalg.norm(corners - np.repeat(centres, np.diff(starts), axis=0)[:, None], axis=2).max(axis=1)
    return Blocks(corners, order, starts, centres, np.maximum.reduceat(far, starts[:-1]) * (1 + 1e-9))


@lru_cache(maxsize=16)
def make_triangle_blocks(mesh: TriangleMesh) -> Blocks:
    """Return the triangles of a mesh in blocks of TRIANGLES, built at first use; metres."""
    return make_blocks(mesh.triangles_m, TRIANGLES)


class NearestTriangles(NamedTuple):
    """Arrays for compiled code, in one unit of length.

    `corners` (F, 3), `sides` (F, 2, 3) from them to the other corners, and unit `normals` (F, 3). Cells of side `cell`
    start at the corner `low` (3,); `nearest` (X, Y, Z) are the numbers of their nearest triangles, -1 beyond reach. The
    triangles that share an edge with triangle f are `beside` (R,) from ends[f] to ends[f + 1].
    """

    corners: NDArray[np.float64]
    sides: NDArray[np.float64]
    normals: NDArray[np.float64]
    low: NDArray[np.float64]
    cell: float
    nearest: NDArray[np.int32]
    beside: NDArray[np.int32]
    ends: NDArray[np.int64]
