"""What touches show, as the joint registration takes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_loc.plugin import ContactShape, SensorGeometry, contact_cloud
from tactile_loc.plugins.refiners.joint.kernels import Observed

MILLI = 1e3
NOTHING_MM = 1e6  # the height of what is seen where nothing touches


@dataclass(frozen=True, eq=False)
class Seen:
    """One touch as it is registered: a contact shape, the sensor's geometry while it was pressed, where the sensor is
    seen from the first one, T_sensor_first (4, 4), and the covariance (6, 6) of a twist, rad before m, by which that
    and the press may be off."""

    shape: ContactShape
    geometry: SensorGeometry
    T_sensor_first: NDArray[np.float64]
    freedom: NDArray[np.float64]


def observe(touches: Sequence[Seen], points: int, noise_m: float, patch_m: float, sample_area_m2: float) -> Observed:
    """Return what touches show, in mm: at most about `points` of each on the surface.

    `noise_m` is the standard deviation of a measured surface point; noise is alike over patches of `patch_m` metres.
    """
    parts = [_observe_one(touch, points, noise_m * MILLI, patch_m * MILLI) for touch in touches]
    clouds, cameras, images, centres = ([part[k] for part in parts] for k in range(4))
    P, n, w = (np.concatenate([cloud[k] for cloud in clouds]) for k in range(3))
    cameras = np.stack(cameras)
    cameras[:, 10] = sample_area_m2 / (patch_m * noise_m * MILLI) ** 2
    sizes = np.array([image.shape[:2] for image in images])
    T = np.stack([t.T_sensor_first for t in touches])
    T[:, :3, 3] *= MILLI
    unit = np.array([1.0, 1.0, 1.0, MILLI, MILLI, MILLI])
    return Observed(
        P, n, w, np.cumsum([0, *(len(cloud[0]) for cloud in clouds)]), T,
        np.stack([t.freedom * unit * unit[:, None] for t in touches]), np.stack(centres), cameras,
        np.concatenate([image.reshape(-1, 4) for image in images]), sizes,
        np.cumsum([0, *sizes.prod(axis=1)[:-1]]),
    )  # fmt: skip


def _observe_one(touch: Seen, most: int, noise_mm: float, patch_mm: float):  # type: ignore[no-untyped-def]
    from scipy.ndimage import distance_transform_edt

    shape, geometry = touch.shape, touch.geometry
    cloud, normals = contact_cloud(shape, geometry)
    every = max(1, round(len(cloud) / most))
    points, normals = cloud[::every] * MILLI, normals[::every]
    area_mm2 = len(cloud) * (geometry.pixel_pitch_m * MILLI) ** 2
    patches = max(3.0, area_mm2 / patch_mm**2)
    weights = np.full(len(points), patches / len(points) / noise_mm**2)
    contact = shape.contact & geometry.observed_mask
    z = (shape.depth_m.astype(float) + geometry.standoff_m) * MILLI
    xyz = geometry.backproject(z / MILLI) * MILLI
    rows, columns = distance_transform_edt(~contact, return_distances=False, return_indices=True)
    height = np.where(geometry.observed_mask, np.where(contact, z, NOTHING_MM), np.nan)
    image = np.concatenate([height[..., None], xyz[rows, columns]], axis=-1).astype(np.float32)
    gel = (geometry.standoff_m + shape.press_depth_m) * MILLI
    camera = np.array([
        geometry.is_pinhole, geometry.fx if geometry.is_pinhole else geometry.fx / MILLI,
        geometry.fy if geometry.is_pinhole else geometry.fy / MILLI, geometry.cx, geometry.cy, gel,
        *np.array(geometry.rectangle) * MILLI, 0.0,
    ])  # fmt: skip
    return (points, normals, weights), camera, image, points.mean(axis=0)
