"""Pictures of a touch and of an object's poses, with the same blur, so that they can be compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import ContactShape, Poses, SensorGeometry, TriangleMesh
from tactile_loc.plugin.helpers import bring_to_contact, draw_nearest_depths, exponential, njit, run_in_threads

Floats = NDArray[np.float64]
Float32 = NDArray[np.float32]

BLOCK = 0.8  # width of averaged blocks, in standard deviations of the blur
SHARP = 0.3  # width of the narrowest blur that is applied, pixels
LEAST_LEVER_PX = 4.0  # least lever of a rotation about the contact's centre
CUT = 2.5  # standard deviations at which the blur is cut off
THINNED = 2  # pixels drawn on each side of a block
REACH = 2.0  # height above the sensing surface, in maximal depths, beyond which parts appear in no picture


@dataclass(frozen=True, eq=False)
class Pictures:
    """Draws poses as a touch's sensor would see them, and moves them.

    A picture is (P,) float32, unitless: the indentation as a share of the press depth. It is averaged over blocks of
    `block` x `block` pixels and blurred with weights `taps` (2 K + 1,). A move (6,) is a translation along x, y, z and
    a rotation vector about the contact's centre `centre_m`, in units of `steps` (metres and radians). If `in_contact`,
    z follows from contact.
    """

    mesh: TriangleMesh
    geometry: SensorGeometry
    wanted: ContactShape
    block: int
    taps: Float32
    centre_m: Floats
    steps: Floats
    in_contact: bool

    @classmethod
    def blurred(
        cls, mesh: TriangleMesh, geometry: SensorGeometry, wanted: ContactShape, width_m: float, in_contact: bool
    ) -> Pictures:
        """Return an instance for the contact shape `wanted`, with a Gaussian blur of `width_m` metres."""
        pitch_m = geometry.pixel_pitch_m
        block = min(max(1, int(BLOCK * width_m / pitch_m)), *geometry.shape)
        thinning = max(1, block // THINNED)
        block //= thinning
        geometry, wanted = geometry.subsample(thinning), wanted.subsample(thinning)
        taps = _make_gaussian(width_m / (block * geometry.pixel_pitch_m))
        centre_m, radius_m = _measure_contact(geometry, wanted)
        lever_m = max(radius_m, LEAST_LEVER_PX * pitch_m)
        # A step moves the picture by half the blur, or by half a pixel along z, in which depths are not blurred.
        across, along = 0.5 * max(width_m, pitch_m), 0.5 * pitch_m
        steps = np.array([across, across, along, along / lever_m, along / lever_m, across / lever_m])
        return cls(mesh, geometry, wanted, block, taps, centre_m, steps, in_contact)

    @property
    def directions(self) -> Floats:
        """The moves (D, 6) by one step, one row for each degree of freedom."""
        return np.delete(np.eye(6), 2, axis=0) if self.in_contact else np.eye(6)

    @property
    def pixel_m(self) -> float:
        """The size of a picture's pixel, metres."""
        return self.block * self.geometry.pixel_pitch_m

    def draw_touch(self) -> Float32:
        """Return the picture (P,) of the touch."""
        return self._draw_depths(self.wanted.depth_m[None])[0]

    def draw_poses(self, T_sensor_object: Poses) -> tuple[Float32, Poses]:
        """Return the pictures (N, P) of poses (N, 4, 4), metres, and the poses that were drawn."""
        T = bring_to_contact(self.mesh, T_sensor_object, self.geometry)[0] if self.in_contact else T_sensor_object
        depth = draw_nearest_depths(self.mesh, T, self.geometry.band)
        depth -= self.geometry.full_penetration_m
        return self._draw_depths(depth), T

    def move(self, T_sensor_object: Poses, moves: Floats) -> Poses:
        """Return the poses (N, 4, 4), metres, after `moves` (N, 6), in steps."""
        by = moves * self.steps
        return exponential(np.roll(by, 3, axis=1), self.centre_m) @ T_sensor_object

    def _draw_depths(self, depth_m: Float32) -> Float32:
        """Return the pictures (N, P) of contact depths (N, H, W), metres, which may exceed the press depth."""
        small = np.empty((len(depth_m), *(side // self.block for side in self.geometry.shape)), np.float32)
        press = np.float32(self.wanted.press_depth_m)
        run_in_threads(_average, len(small), depth_m, self.geometry.observed_mask, press, self.block, small)
        if len(self.taps) > 1:
            run_in_threads(_filter, len(small), small, self.taps)
        return small.reshape(len(small), -1)


def keep_within_reach(mesh: TriangleMesh, geometry: SensorGeometry, T_sensor_object: Poses) -> TriangleMesh:
    """Return the part of a mesh that can press the sensor at contact poses near the given poses (N, 4, 4), metres."""
    height = mesh.vertices_m @ T_sensor_object[:, 2, :3].T + T_sensor_object[:, 2, 3]
    near = height.min(axis=1)[mesh.faces].min(axis=1) < geometry.band.standoff_m + REACH * geometry.band.max_depth_m
    kept, faces = np.unique(mesh.faces[near], return_inverse=True)
    return TriangleMesh(mesh.vertices_m[kept], faces.reshape(-1, 3))


def _measure_contact(geometry: SensorGeometry, wanted: ContactShape) -> tuple[Floats, float]:
    """Return the centre (3,) and the root mean square radius of a contact, metres."""
    contact = wanted.contact & geometry.observed_mask
    points = geometry.backproject(wanted.depth_m + geometry.full_penetration_m)[contact]
    centre = points.mean(axis=0)
    return centre, float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))


def _make_gaussian(width_px: float) -> Float32:
    """Return weights (2 K + 1,), with sum one, of a Gaussian whose standard deviation is `width_px`."""
    half = int(np.ceil(CUT * width_px)) if width_px > SHARP else 0
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / max(width_px, SHARP)) ** 2)
    return (weights / weights.sum()).astype(np.float32)


@njit
def _average(first, last, depth, observed, press, block, small):  # type: ignore[no-untyped-def]
    """Fill `small` (N, h, w) with the mean indentation, a share of the press, over blocks of depths (N, H, W)."""
    share = np.float32(1.0 / (block * block))
    for i in range(first, last):
        small[i] = 0.0
        for r in range(small.shape[1] * block):
            for c in range(small.shape[2] * block):
                if observed[r, c] and depth[i, r, c] < press:
                    small[i, r // block, c // block] += share * min(np.float32(1.0), 1 - depth[i, r, c] / press)


@njit
def _filter(first, last, pictures, taps):  # type: ignore[no-untyped-def]
    """Filter pictures (N, h, w) with the same weights along rows and columns, in place; zero beyond the border."""
    half = len(taps) // 2
    height, width = pictures.shape[1:]
    for i in range(first, last):
        rows = np.zeros((height, width), np.float32)
        for r in range(height):
            for k in range(max(-half, -r), min(half, height - 1 - r) + 1):
                for c in range(width):
                    rows[r, c] += taps[half + k] * pictures[i, r + k, c]
        for r in range(height):
            for c in range(width):
                total = np.float32(0)
                for k in range(max(-half, -c), min(half, width - 1 - c) + 1):
                    total += taps[half + k] * rows[r, c + k]
                pictures[i, r, c] = total
