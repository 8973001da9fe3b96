"""Points or triangles in blocks of neighbours. A sphere bounds each block, so that far blocks can be skipped."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.objects.mesh import TriangleMesh

TRIANGLES = 24  # largest number of triangles per block


class Blocks(NamedTuple):
    """N items with C corners each, in B blocks of neighbours, in any unit of length.

    `corners` (N, C, 3) are sorted by blocks. Block b has the items from starts[b] to starts[b + 1]. They are inside a
    sphere with centre centres[b] (3,) and radius radii[b].
    """

    corners: Floats
    starts: Ints
    centres: Floats
    radii: Floats


def make_blocks(corners: Floats, most: int) -> Blocks:
    """Split items with corners (N, C, 3) into blocks of at most `most` items.

    Larger blocks are split in two halves along their longest sides.
    """
    middles, order, starts = corners.mean(axis=1), np.arange(len(corners)), np.array([0, len(corners)])
    while (sizes := np.diff(starts)).max() > most:
        some, block, large = middles[order], np.repeat(np.arange(len(sizes)), sizes), sizes > most
        extents = np.maximum.reduceat(some, starts[:-1]) - np.minimum.reduceat(some, starts[:-1])
        along = np.where(large[block], some[np.arange(len(some)), extents.argmax(axis=1)[block]], 0.0)
        order = order[np.lexsort((along, block))]
        starts = np.sort(np.concatenate([starts, starts[:-1][large] + sizes[large] // 2]))
    corners = np.ascontiguousarray(corners[order], float)
    low = np.minimum.reduceat(corners.min(axis=1), starts[:-1])
    high = np.maximum.reduceat(corners.max(axis=1), starts[:-1])
    centres = (low + high) / 2
    far = np.linalg.norm(corners - np.repeat(centres, np.diff(starts), axis=0)[:, None], axis=2).max(axis=1)
    return Blocks(corners, starts, centres, np.maximum.reduceat(far, starts[:-1]) * (1 + 1e-9))


@lru_cache(maxsize=16)
def make_triangle_blocks(mesh: TriangleMesh) -> Blocks:
    """Return the triangles of a mesh, metres, in blocks of at most TRIANGLES. They are built at the first use."""
    return make_blocks(mesh.triangles_m, TRIANGLES)


class NearestTriangles(NamedTuple):
    """Arrays for compiled code, in one unit of length.

    A row of `faces` (F, 16) describes a triangle: its first corner, the sides b and c from there to the other corners,
    and its unit normal, each with three numbers. Then follow b.b, b.c, c.c and (b.b)(c.c) - (b.c)^2. Cells of side
    `cell` start at the corner `low` (3,). `nearest` (X, Y, Z) is the number of the triangle nearest to each cell, or -1
    beyond reach. The triangles that share an edge with triangle f are those in `beside` (R,) from ends[f] to ends[f+1].
    """

    faces: Floats
    low: Floats
    cell: float
    nearest: NDArray[np.int32]
    beside: NDArray[np.int32]
    ends: Ints

    @property
    def normals(self) -> Floats:
        """The triangles' unit normals (F, 3)."""
        return self.faces[:, 9:12]
