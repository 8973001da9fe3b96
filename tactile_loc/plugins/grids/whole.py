"""The grid over the whole object: the places that can touch first, for every direction.

For each of many directions, a height map of the object is drawn. The local minima of the map can touch first, and so
can equally low pixels along edges and on faces. Translations and yaws are read from the touch, not searched. The
density of directions therefore determines the pose error before refinement.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import (
    Capabilities,
    ConfigError,
    GridError,
    GridSampler,
    ObjectModel,
    Places,
    Poses,
    Progress,
    SensorGeometry,
    TriangleMesh,
)
from tactile_loc.plugin.helpers import (
    PATCH_PX,
    PITCH_M,
    align_to_z,
    draw_nearest_depths,
    draw_rotations,
    make_patches,
    make_transform,
    map_in_threads,
    njit,
)

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

Float = NDArray[np.float64]

AT_ONCE = 50  # directions drawn together
MARGIN_M = 0.01  # distance between the object and the camera
LONGEST_M = 0.5  # largest diameter of an object: height maps of larger ones do not fit into memory
MOST_PLACES = 4096  # largest number of places for one direction
ALIKE, MOST_FLAT = 5e-3, 400  # least difference of distinct normals; largest number of flat faces with own directions
GENERIC = np.array([0.5377, 0.6512, 0.5355])  # of symmetric directions, the one nearest to this direction is kept


class WholeGrid(GridSampler):
    """Indexes the places that can touch first, for all directions. Position and yaw are read from the touch."""

    capabilities = Capabilities(places=True)

    class Options(GridSampler.Options):
        """The density of directions, yaws and places. `spacing_mm` is the distance between two hypotheses."""

        spacing_mm: float = Field(default=3.0, gt=0, description="mean distance between neighbouring hypotheses, mm")
        directions: int = Field(default=4000, ge=100, le=100_000, description="directions over the whole sphere")
        turns: int = Field(default=48, ge=8, le=720, description="yaws by which a touch is rotated")
        apart_mm: float = Field(default=2.0, gt=0, description="distance between places along edges and faces, mm")
        near_mm: float = Field(default=3.0, gt=0, description="radius in which a place is the lowest point, mm")
        level_mm: float = Field(default=0.05, ge=0, description="height difference that counts as equally low, mm")
        flat_mm2: float = Field(default=4.0, gt=0, description="smallest flat face with its own direction, mm^2")
        max_places: int = Field(default=200_000, ge=1, description="largest allowed number of places, 2 kB each")

    def places(self, obj: ObjectModel, progress: Progress) -> Places:
        """Return the places that can touch first. Raises GridError for an object larger than LONGEST_M."""
        options, mesh = self.options, obj.mesh
        radius_m = float(np.linalg.norm(mesh.corners_m - mesh.centroid_m, axis=1).max())
        if 2 * radius_m > LONGEST_M:
            raise GridError(
                f"{obj.name} is {2e3 * radius_m:.0f} mm across, but the whole grid supports at most "
                f"{LONGEST_M * 1e3:.0f} mm; check the mesh's units, or choose `grid` face"
            )
        camera = _make_camera(radius_m)
        step_rad = np.sqrt(4 * np.pi / options.directions)
        every = np.concatenate([make_sphere(options.directions), find_flat_directions(mesh, options.flat_mm2 * 1e-6)])
        directions = find_distinct_directions(every, obj, step_rad)
        self._refuse_too_many(obj, directions, camera)
        batches = [directions[start : start + AT_ONCE] for start in range(0, len(directions), AT_ONCE)]
        poses: list[Float] = []
        patches: list[NDArray[np.uint8]] = []
        with progress.task("finding places that can touch first", len(directions)) as advance:
            for some, found in zip(
                batches, map_in_threads(partial(self._find_places, obj, camera), batches), strict=True
            ):
                for T_place_object, patch in found:
                    poses.append(T_place_object)
                    patches.append(patch)
                advance(len(some))
        return Places(np.concatenate(poses), np.concatenate(patches))

    def _find_places(
        self, obj: ObjectModel, camera: SensorGeometry, directions: Float
    ) -> list[tuple[Poses, NDArray[np.uint8]]]:
        """Return the poses (K, 4, 4), metres, and the patches of the K places of each direction."""
        found = []
        for T_camera, heights in zip(*_draw_height_maps(obj, directions, camera), strict=True):
            around, places_m = _cut_patches(heights, self._find_lowest(heights), camera)
            poses = make_transform(T_camera[:3, :3], T_camera[:3, 3] - places_m)
            found.append((poses, make_patches(around - places_m[:, 2, None, None])))
        return found

    def _refuse_too_many(self, obj: ObjectModel, directions: Float, camera: SensorGeometry) -> None:
        """Raise GridError when a sample of the directions predicts more than `max_places`."""
        some = directions[:: max(1, len(directions) // AT_ONCE)]
        count = sum(len(self._find_lowest(heights)) for heights in _draw_height_maps(obj, some, camera)[1])
        expected, limit = count / len(some) * len(directions), self.options.max_places
        if expected > limit:
            fewer = max(100, int(self.options.directions * limit / expected))
            raise GridError(
                f"the whole grid of {obj.name} would have about {expected:,.0f} places, over the limit of {limit:,}; "
                f"set grid.directions={fewer}, increase grid.apart_mm, or raise grid.max_places (2 kB each)"
            )

    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Raise ConfigError: this grid has places, not poses."""
        raise ConfigError(
            "the grid 'whole' does not list its poses, which this command or encoder needs; choose `grid` face "
            "or `grid` hopf"
        )

    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres, with uniform rotations. z is arbitrary.

        The object's lowest point is uniform over the sensing rectangle, so no part beside the sensor touches first.
        """
        R = draw_rotations(count, rng)
        x0, x1, y0, y1 = geometry.rectangle
        over = np.column_stack([rng.uniform(x0, x1, count), rng.uniform(y0, y1, count), np.zeros(count)])
        corners = obj.mesh.corners_m
        lowest = np.stack([corners[(corners @ down).argmin()] for down in R[:, 2]])
        return make_transform(R, over - np.einsum("nij,nj->ni", R, lowest))

    def _find_lowest(self, heights: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the pixels (K, 2), row and column, of a height map (H, W), metres, that can touch first."""
        options = self.options
        found = np.empty((MOST_PLACES, 2), np.int64)
        near_px, apart_px = (round(mm * 1e-3 / PITCH_M) for mm in (options.near_mm, options.apart_mm))
        low = np.flatnonzero(_is_low(heights, near_px, options.level_mm * 1e-3))
        order = low[np.argsort(heights.ravel()[low], kind="stable")]
        count = _thin(order, heights.shape[1], apart_px, found)
        return found[:count]


def make_sphere(count: int) -> Float:
    """Return evenly spread unit directions (count, 3): a Fibonacci lattice (Gonzalez, 2010)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    azimuth_rad = np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(azimuth_rad), across * np.sin(azimuth_rad), z], axis=1)


def find_flat_directions(mesh: TriangleMesh, area_m2: float) -> Float:
    """Return the unit directions (N, 3) along which flat faces of at least `area_m2` are pressed flat on a sensor.

    Only the MOST_FLAT largest faces count. Such faces need exact directions: one degree away, an edge touches first.
    """
    a, b, c = np.moveaxis(mesh.triangles_m, 1, 0)
    across = np.cross(b - a, c - a)
    areas = 0.5 * np.linalg.norm(across, axis=1)
    some = areas > 0
    normals = across[some] / (2 * areas[some, None])
    _, which = np.unique(np.rint(normals / ALIKE).astype(int), axis=0, return_inverse=True)
    area = np.bincount(which.ravel(), areas[some])
    mean = np.stack([np.bincount(which.ravel(), areas[some] * normals[:, k]) for k in range(3)], axis=1)
    largest = np.argsort(-area, kind="stable")[:MOST_FLAT]
    largest = largest[area[largest] >= area_m2]
    return np.asarray(-mean[largest] / np.linalg.norm(mean[largest], axis=1, keepdims=True))


def find_distinct_directions(directions: Float, obj: ObjectModel, step_rad: float) -> Float:
    """Return a subset of unit directions (N, 3) with one representative for each symmetry class of the object.

    Of equivalent directions, the one nearest to GENERIC is kept, and so are directions within `step_rad` of it.
    """
    S = obj.symmetry.list_elements(max_step_rad=0.5 * step_rad)[:, :3, :3]
    if len(S) == 1:
        return directions
    alike = np.einsum("kij,nj->nki", S, directions)
    best = alike[np.arange(len(directions)), (alike @ GENERIC).argmax(axis=1)]
    return directions[np.einsum("ni,ni->n", best, directions) >= np.cos(step_rad)]


def _make_camera(radius_m: float) -> SensorGeometry:
    """Return an orthographic camera, with the pixel pitch of patches, that sees a sphere and half a patch around it."""
    side = 2 * (int(np.ceil(radius_m / PITCH_M)) + PATCH_PX // 2 + 1)
    return SensorGeometry(
        "orthographic", side, side, 1 / PITCH_M, 1 / PITCH_M, side / 2, side / 2, MARGIN_M, 2 * radius_m + MARGIN_M
    )


def _draw_height_maps(obj: ObjectModel, directions: Float, camera: SensorGeometry) -> tuple[Float, NDArray[np.float32]]:
    """Return the camera's poses (N, 4, 4) and height maps (N, H, W), metres, along N directions."""
    R = np.stack([align_to_z(direction) for direction in directions])
    middle = np.array([0.0, 0.0, camera.standoff_m + (camera.max_depth_m - MARGIN_M) / 2])
    T = make_transform(R, middle - R @ obj.mesh.centroid_m)
    return T, draw_nearest_depths(obj.mesh, T, camera)


def _cut_patches(
    heights: NDArray[np.float32], pixels: NDArray[np.int64], camera: SensorGeometry
) -> tuple[NDArray[np.float32], Float]:
    """Return patches (K, S, S) around pixels (K, 2) of a height map (H, W), and their places (K, 3), all in metres."""
    offsets = np.arange(PATCH_PX) - PATCH_PX // 2
    rows, columns = pixels.T
    around = heights[(rows[:, None] + offsets)[:, :, None], (columns[:, None] + offsets)[:, None, :]]
    x, y = camera.pixel_slopes
    return around, np.stack([x[columns], y[rows], heights[rows, columns].astype(float)], axis=1)


@njit
def _is_low(heights, near, level):
    """Mark pixels (H, W) for which no pixel within `near` pixels is lower by more than `level`."""
    rows, columns = heights.shape
    low = np.zeros(heights.shape, np.bool_)
    for r in range(rows):
        for c in range(columns):
            limit = heights[r, c] - level
            if not np.isfinite(limit):
                continue
            up, down, left, right = (
                max(0, r - near),
                min(rows - 1, r + near),
                max(0, c - near),
                min(columns - 1, c + near),
            )
            if min(heights[up, c], heights[down, c], heights[r, left], heights[r, right]) < limit:  # on most slopes
                continue
            lowest = True
            for i in range(up, down + 1):
                for j in range(left, right + 1):
                    if heights[i, j] < limit and (i - r) ** 2 + (j - c) ** 2 <= near**2:
                        lowest = False
                        break
                if not lowest:
                    break
            low[r, c] = lowest
    return low


@njit
def _thin(order, columns, apart, found):
    """Copy pixels to `found`, except pixels nearer than `apart` to a copied pixel. Return the number of copied pixels.

    `order` holds the flat indices of the pixels, in the order in which they are tried.
    """
    count = 0
    for flat in order:
        r, c = flat // columns, flat % columns
        free = count < len(found)
        for k in range(count):
            if (found[k, 0] - r) ** 2 + (found[k, 1] - c) ** 2 < apart**2:
                free = False
                break
        if free:
            found[count, 0], found[count, 1] = r, c
            count += 1
    return count
