"""The whole object: every direction from which it can be touched, and the places that touch first from there.

For each of many directions the object's height map is drawn; its local minima, and what is as low as they are along
edges and on faces, are what can touch first. How dense the directions are decides how far a pose can be off before it
is refined; translations and yaws are read off a touch, not searched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactile_loc.plugin import (
    PATCH_PX,
    PITCH_M,
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
    align_to_z,
    draw_nearest_depths,
    draw_rotations,
    make_patches,
    make_transform,
    njit,
)

# mypy: disable-error-code="no-untyped-def,no-untyped-call"

Float = NDArray[np.float64]

AT_ONCE = 50  # directions drawn together
MARGIN_M = 0.01  # between the object and the camera
LONGEST_M = 0.5  # of an object's diameter: its height maps have as many pixels as fit the memory
MOST_PLACES = 4096  # of one direction
ALIKE, MOST_FLAT = 5e-3, 400  # normals that differ by less are one; faces that are looked at straight on
GENERIC = np.array([0.5377, 0.6512, 0.5355])  # no direction of symmetry: which of several that look alike is kept


class WholeGrid(GridSampler):
    """All directions: what touches first is indexed, and a touch says where it is and how it is turned."""

    capabilities = Capabilities(places=True)

    class Options(GridSampler.Options):
        """How dense directions, turns and places are. `spacing_mm` is how far apart two hypotheses are."""

        spacing_mm: float = Field(default=3.0, gt=0, description="mean distance between neighbouring hypotheses, mm")
        directions: int = Field(default=4000, ge=100, le=100_000, description="over the whole sphere")
        turns: int = Field(default=120, ge=8, le=720, description="yaws by which a touch is turned")
        apart_mm: float = Field(default=2.0, gt=0, description="distance between places along edges and faces, mm")
        near_mm: float = Field(default=3.0, gt=0, description="a place is the lowest so far around, mm")
        level_mm: float = Field(default=0.05, ge=0, description="what is higher by less is as low, mm")
        flat_mm2: float = Field(default=4.0, gt=0, description="flat faces so large are looked at straight on, mm^2")
        max_places: int = Field(default=200_000, ge=1, description="refuse more places than this: 2 kB each")

    def places(self, obj: ObjectModel, progress: Progress) -> Places:
        """Return what can touch first, direction by direction. Raises GridError for an object of half a metre."""
        options, mesh = self.options, obj.mesh
        radius_m = float(np.linalg.norm(mesh.corners_m - mesh.centroid_m, axis=1).max())
        if 2 * radius_m > LONGEST_M:
            raise GridError(
                f"{obj.name} is {2e3 * radius_m:.0f} mm across, and the whole grid searches objects of at most "
                f"{LONGEST_M * 1e3:.0f} mm; check the mesh's units, or choose the face that touches with --grid face"
            )
        camera = _make_camera(radius_m)
        step_rad = np.sqrt(4 * np.pi / options.directions)
        every = np.concatenate([make_sphere(options.directions), find_flat_directions(mesh, options.flat_mm2 * 1e-6)])
        directions = find_distinct_directions(every, obj, step_rad)
        self._refuse_too_many(obj, directions, camera)
        poses: list[Float] = []
        patches: list[NDArray[np.uint8]] = []
        with progress.task("looking for what touches first", len(directions)) as advance:
            for start in range(0, len(directions), AT_ONCE):
                some = directions[start : start + AT_ONCE]
                for T_camera, heights in zip(*_draw_height_maps(obj, some, camera), strict=True):
                    around, places_m = _cut_patches(heights, self._find_lowest(heights), camera)
                    poses.append(make_transform(T_camera[:3, :3], T_camera[:3, 3] - places_m))
                    patches.append(make_patches(around - places_m[:, 2, None, None]))
                advance(len(some))
        return Places(np.concatenate(poses), np.concatenate(patches))

    def _refuse_too_many(self, obj: ObjectModel, directions: Float, camera: SensorGeometry) -> None:
        """Count the places of some directions, before the rest is looked at. Raises GridError if all are too many."""
        some = directions[:: max(1, len(directions) // AT_ONCE)]
        count = sum(len(self._find_lowest(heights)) for heights in _draw_height_maps(obj, some, camera)[1])
        expected, limit = count / len(some) * len(directions), self.options.max_places
        if expected > limit:
            fewer = max(100, int(self.options.directions * limit / expected))
            raise GridError(
                f"the whole grid of {obj.name} would have about {expected:,.0f} places, over the limit of {limit:,}; "
                f"take grid.directions={fewer}, a greater grid.apart_mm, or raise grid.max_places, at 2 kB each"
            )

    def sample(self, obj: ObjectModel, geometry: SensorGeometry, spacing_m: float) -> Poses:
        """Raise ConfigError: the poses of a whole object are not listed."""
        raise ConfigError(
            "the whole grid lists no poses: it is searched by places, which the command or encoder that was asked for "
            "does not know; choose --grid face or --grid hopf"
        )

    def random(self, obj: ObjectModel, geometry: SensorGeometry, count: int, rng: np.random.Generator) -> Poses:
        """Draw poses (count, 4, 4), metres: all rotations alike, the lowest point anywhere over the sensing rectangle.

        z is free. So a sensor is pressed by an object that is not held up by what is beside the gel.
        """
        R = draw_rotations(count, rng)
        x0, x1, y0, y1 = geometry.rectangle
        over = np.column_stack([rng.uniform(x0, x1, count), rng.uniform(y0, y1, count), np.zeros(count)])
        corners = obj.mesh.corners_m
        lowest = np.stack([corners[(corners @ down).argmin()] for down in R[:, 2]])
        return make_transform(R, over - np.einsum("nij,nj->ni", R, lowest))

    def _find_lowest(self, heights: NDArray[np.float32]) -> NDArray[np.int64]:
        """The pixels (K, 2), row and column, of a height map (H, W), metres, that touch first."""
        options = self.options
        found = np.empty((MOST_PLACES, 2), np.int64)
        near_px, apart_px = (round(mm * 1e-3 / PITCH_M) for mm in (options.near_mm, options.apart_mm))
        low = np.flatnonzero(_is_low(heights, near_px, options.level_mm * 1e-3))
        order = low[np.argsort(heights.ravel()[low], kind="stable")]
        count = _thin(order, heights.shape[1], apart_px, found)
        return found[:count]


def make_sphere(count: int) -> Float:
    """Return `count` unit directions (count, 3), spread evenly: a Fibonacci lattice (Gonzalez, 2010)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    azimuth_rad = np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(azimuth_rad), across * np.sin(azimuth_rad), z], axis=1)


def find_flat_directions(mesh: TriangleMesh, area_m2: float) -> Float:
    """Return the unit directions (N, 3) along which faces of at least an area, m^2, are pressed flat on a sensor.

    At most MOST_FLAT, the largest faces'. A face that is touched flat shows none of its tilt: a direction that is a
    degree off it would have its edge touch first.
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
    """Return those of unit directions (N, 3) that stand for all that look alike by the object's symmetry.

    Of those that look alike the one most along GENERIC is kept, and what is within a step of it.
    """
    S = obj.symmetry.list_elements(max_step_rad=0.5 * step_rad)[:, :3, :3]
    if len(S) == 1:
        return directions
    alike = np.einsum("kij,nj->nki", S, directions)
    best = alike[np.arange(len(directions)), (alike @ GENERIC).argmax(axis=1)]
    return directions[np.einsum("ni,ni->n", best, directions) >= np.cos(step_rad)]


def _make_camera(radius_m: float) -> SensorGeometry:
    """Parallel rays at the pitch of patches, over a sphere of a radius in metres, and a patch's half around it."""
    side = 2 * (int(np.ceil(radius_m / PITCH_M)) + PATCH_PX // 2 + 1)
    return SensorGeometry(
        "orthographic", side, side, 1 / PITCH_M, 1 / PITCH_M, side / 2, side / 2, MARGIN_M, 2 * radius_m + MARGIN_M
    )


def _draw_height_maps(obj: ObjectModel, directions: Float, camera: SensorGeometry) -> tuple[Float, NDArray[np.float32]]:
    """What a camera sees along each of N directions, its poses (N, 4, 4) and heights (N, H, W), metres."""
    R = np.stack([align_to_z(direction) for direction in directions])
    middle = np.array([0.0, 0.0, camera.standoff_m + (camera.max_depth_m - MARGIN_M) / 2])
    T = make_transform(R, middle - R @ obj.mesh.centroid_m)
    return T, draw_nearest_depths(obj.mesh, T, camera)


def _cut_patches(
    heights: NDArray[np.float32], pixels: NDArray[np.int64], camera: SensorGeometry
) -> tuple[NDArray[np.float32], Float]:
    """What surrounds pixels (K, 2) of a height map (H, W): patches (K, S, S), metres, and the places (K, 3), metres."""
    offsets = np.arange(PATCH_PX) - PATCH_PX // 2
    rows, columns = pixels.T
    around = heights[(rows[:, None] + offsets)[:, :, None], (columns[:, None] + offsets)[:, None, :]]
    x, y = camera.pixel_slopes
    return around, np.stack([x[columns], y[rows], heights[rows, columns].astype(float)], axis=1)


@njit
def _is_low(heights, near, level):
    """Whether no pixel within `near` pixels of one (H, W) is lower by more than `level`; outside nothing is."""
    rows, columns = heights.shape
    low = np.zeros(heights.shape, np.bool_)
    for r in range(rows):
        for c in range(columns):
            limit = heights[r, c] - level
            if not np.isfinite(limit):
                continue
            lowest = True
            for i in range(max(0, r - near), min(rows, r + near + 1)):
                for j in range(max(0, c - near), min(columns, c + near + 1)):
                    if heights[i, j] < limit and (i - r) ** 2 + (j - c) ** 2 <= near**2:
                        lowest = False
                        break
                if not lowest:
                    break
            low[r, c] = lowest
    return low


@njit
def _thin(order, columns, apart, found):
    """Take pixels, flat indices, in order, none nearer than `apart` pixels to one before; return how many (K, 2)."""
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
