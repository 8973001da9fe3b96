"""Touches of an object pressed into sensors, with a known truth, and their views."""

import numpy as np

from tactile_loc.core.geometry.rigid import invert, make_transform, make_translation, rotation_about
from tactile_loc.core.sensing.scene import Scene, View
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.testing.problems import ReferenceRenderer


def pressed(obj, geometry, R, xy_m, press_m) -> Touch:
    """The touch of an object rotated by R and pressed in, with its centroid at x, y over the sensor."""
    scene = Scene(obj, geometry.press(press_m), ReferenceRenderer())
    start = make_transform(R, [*xy_m, 0.0] - R @ obj.mesh.centroid_m)
    T = scene.bring_to_contact(start[None])[0]
    shape = ContactShape(scene.render_contact_depths(T)[0], press_m)
    return Touch(shape, geometry, T_base_sensor=invert(T[0]), T_sensor_object=T[0])


def views_of(obj, touches, **errors) -> list[View]:
    first = touches[0]
    return [
        View(t, Scene(obj, t.geometry, ReferenceRenderer()), invert(t.T_base_sensor) @ first.T_base_sensor, **errors)
        for t in touches
    ]


def towards(direction) -> np.ndarray:
    """A rotation that maps a direction of the object to -z, into the sensor."""
    d = np.array(direction, float) / np.linalg.norm(direction)
    axis, angle = np.cross(d, [0, 0, -1]), np.arccos(-d[2])
    return (
        np.eye(3)
        if np.linalg.norm(axis) < 1e-9 and d[2] < 0
        else rotation_about(axis if np.linalg.norm(axis) > 1e-9 else [1, 0, 0], angle)
    )


def moved(T, obj, shift_m, turn_deg, about) -> np.ndarray:
    centre = T[:3, :3] @ obj.mesh.centroid_m + T[:3, 3]
    turn = make_transform(rotation_about(about, np.radians(turn_deg)), np.zeros(3))
    return make_translation(centre + np.array(shift_m)) @ turn @ make_translation(-centre) @ T
