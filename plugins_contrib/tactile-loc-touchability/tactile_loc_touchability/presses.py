"""Presses at random places of an object's surface, along the surface's normal or tilted from it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tactile_loc import Approach, Clearance, PoseModes, SensorGeometry
from tactile_loc.plugin import GridError, ObjectModel, Poses
from tactile_loc.plugin.helpers import bring_to_contact, invert, make_transform, make_translation

Floats = NDArray[np.float64]

TRIES = 8  # directions that are tried at a place
STRATUM, BITS = 16, 8  # points of which one is taken; bits of each coordinate of a place in the order
MOST_PLACES = 20  # places drawn at most, as a multiple of those wanted


@dataclass(frozen=True, eq=False)
class PressingSensor:
    """A sensor that presses `press_m` metres deep, tilted from the surface's normal by at most `tilt_rad`.

    The body that carries it must not hit the object: see `Clearance`. Without a `clearance`, only the gel is checked.
    """

    geometry: SensorGeometry
    press_m: float
    tilt_rad: float
    clearance: Clearance | None = None


@dataclass(frozen=True, eq=False)
class Presses:
    """N presses of a sensor on an object: `T_sensor_object` (N, 4, 4), metres, of the pressed object.

    The gel touches the places `places_m` (N, 3), metres, where the surface has the `normals` (N, 3), both in the
    object's frame. `reached` is the share of the drawn places that the gel touches from a tried direction, 0 to 1.
    """

    T_sensor_object: Poses
    places_m: Floats
    normals: Floats
    reached: float

    def __len__(self) -> int:
        return len(self.places_m)


def draw_presses(obj: ObjectModel, sensor: PressingSensor, count: int, rng: np.random.Generator) -> Presses:
    """Draw `count` presses at places drawn uniformly over the surface that a sensor can touch.

    The sensor moves against the surface's normal, tilted: directions are uniform in a cone, and so is the turn about
    them. It stops at the first contact and presses. If the gel does not touch the place then, because other parts of
    the object are in the way, another direction is tried. Raises GridError if the gel touches hardly any place.
    """
    found: list[Presses] = []
    tried = 0
    while (missing := count - sum(map(len, found))) > 0:
        if tried >= MOST_PLACES * count:
            raise GridError(
                f"the sensor touches hardly any place of {obj.name}; press deeper, tilt more, or check the mesh's unit"
            )
        found.append(_press_places(obj, sensor, *draw_places(obj, missing, rng), rng))
        tried += missing
    T, places, normals = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("T_sensor_object", "places_m", "normals")
    )
    return Presses(T, places, normals, count / tried)


def draw_places(obj: ObjectModel, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw points (count, 3), metres, and the surface's normals (count, 3) there, spread evenly over the surface.

    Each point is uniformly distributed. STRATUM times as many points are put in an order in which neighbours are near
    each other and face alike. Of each STRATUM successive points, one is taken.
    """
    points_m, faces = obj.mesh.sample_faces(STRATUM * count, rng)
    normals = obj.mesh.face_normals[faces]
    low, extent_m = points_m.min(axis=0), obj.mesh.extents_m.max()
    order = _sort_in_space(np.concatenate([(points_m - low) / extent_m, 0.5 + 0.5 * normals], axis=1))
    taken = order.reshape(count, STRATUM)[np.arange(count), rng.integers(STRATUM, size=count)]
    return points_m[taken], normals[taken]


def _sort_in_space(points: Floats) -> NDArray[np.intp]:
    """Return the order of points (N, D), 0 to 1, along Morton's curve."""
    cells = np.clip((points * 2**BITS).astype(np.int64), 0, 2**BITS - 1)
    key = np.zeros(len(points), np.int64)
    for bit in reversed(range(BITS)):
        for column in cells.T:
            key = 2 * key + (column >> bit & 1)
    return np.argsort(key, kind="stable")


def _press_places(
    obj: ObjectModel, sensor: PressingSensor, places_m: Floats, normals: Floats, rng: np.random.Generator
) -> Presses:
    """Return the presses at those of the places (N, 3) that the sensor touches from one of TRIES directions."""
    poses, left = np.tile(np.eye(4), (len(places_m), 1, 1)), np.arange(len(places_m))
    for _ in range(TRIES):
        T = _aim(sensor.geometry, places_m[left], _tilt(normals[left], sensor.tilt_rad, rng), rng)
        T, touching = bring_to_contact(obj.mesh, T, sensor.geometry)
        T[:, 2, 3] -= sensor.press_m
        height_m = np.einsum("nj,nj->n", T[:, 2, :3], places_m[left]) + T[:, 2, 3]
        hit = np.flatnonzero(touching & (height_m < sensor.geometry.standoff_m))
        hit = hit[find_clear(obj, sensor, T[hit])]
        poses[left[hit]] = T[hit]
        left = np.delete(left, hit)
    kept = np.setdiff1d(np.arange(len(places_m)), left)
    return Presses(poses[kept], places_m[kept], normals[kept], len(kept) / max(1, len(places_m)))


def find_clear(obj: ObjectModel, sensor: PressingSensor, T_sensor_object: Poses) -> NDArray[np.bool_]:
    """Return for which presses (N, 4, 4) the body that carries the sensor hits nothing on its straight way."""
    if sensor.clearance is None or not len(T_sensor_object):
        return np.ones(len(T_sensor_object), bool)
    modes = PoseModes((obj,), np.eye(4)[None], np.ones(1), sensor.geometry, sensor.press_m)
    away_m = 2 * float(np.linalg.norm(obj.mesh.extents_m))
    ways_m = np.full((len(T_sensor_object), 1), away_m)
    reasons = sensor.clearance.explain(modes, list_approaches(T_sensor_object, sensor.press_m, away_m), ways_m)
    return np.array([not reason for reason in reasons])


def list_approaches(T_sensor_object: Poses, press_m: float, away_m: float) -> list[Approach]:
    """Return presses (N, 4, 4) as approaches in the object's frame that start `away_m` metres before their end.

    Each is named by its number.
    """
    starts = invert(T_sensor_object) @ make_translation([0.0, 0.0, -away_m])
    return [Approach(T, press_m, 2 * away_m, name=str(k)) for k, T in enumerate(starts)]


def _tilt(normals: Floats, tilt_rad: float, rng: np.random.Generator) -> Floats:
    """Return directions (N, 3), uniform in cones about normals (N, 3)."""
    cosines = rng.uniform(np.cos(tilt_rad), 1.0, (len(normals), 1))
    return cosines * normals + np.sqrt(1 - cosines**2) * _draw_across(normals, rng)


def _draw_across(axes: Floats, rng: np.random.Generator) -> Floats:
    """Return random unit vectors (N, 3) that are perpendicular to unit vectors (N, 3)."""
    drawn = rng.normal(size=axes.shape)
    drawn -= np.einsum("nj,nj->n", drawn, axes)[:, None] * axes
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def _aim(geometry: SensorGeometry, places_m: Floats, outward: Floats, rng: np.random.Generator) -> Poses:
    """Return T_sensor_object (N, 4, 4) of sensors that look along -`outward` (N, 3), places at the gel's middle."""
    x = _draw_across(outward, rng)
    R_object_sensor = np.stack([x, np.cross(-outward, x), -outward], axis=-1)
    gel_m = R_object_sensor @ geometry.gel_middle_m
    return np.asarray(invert(make_transform(R_object_sensor, places_m - gel_m)))
