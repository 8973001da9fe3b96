"""The labels of balls on a curved gel."""

import dataclasses

import numpy as np
import pytest

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import compute_contact_depth
from tactile_loc.plugins.sensors.presets import CurvedDigit
from tactile_loc.sensors.calibration.labels import label_ball

GEL_M, BALL_M = 35e-3, 4e-3
CURVED = CurvedDigit(CurvedDigit.Options(image_size_px=(90, 120))).geometry
FLAT = dataclasses.replace(CURVED, relief_m=None)


def pressed(geometry: SensorGeometry, x: float, y: float, press_m: float) -> np.ndarray:
    """The contact depths (H, W) of a ball that touches a spherical gel over (x, y) and is pressed in along z."""
    z = geometry.surface_m - GEL_M + np.sqrt((GEL_M + BALL_M) ** 2 - x**2 - y**2) - press_m
    across, down = np.meshgrid(*geometry.pixel_slopes)
    below2 = BALL_M**2 - (across - x) ** 2 - (down - y) ** 2
    ball = np.where(below2 > 0, z - np.sqrt(np.maximum(below2, 0)), np.inf)
    return compute_contact_depth(ball, geometry.press(press_m), press_m)


def circle_px(contact: np.ndarray) -> tuple[tuple[float, float], float]:
    rows, columns = np.nonzero(contact)
    return (columns.mean() + 0.5, rows.mean() + 0.5), float(np.sqrt(contact.sum() / np.pi))


@pytest.mark.parametrize("place", [(0.0, 0.0), (3e-3, 5e-3), (-4e-3, -6e-3)])
def test_a_balls_label_on_a_curved_gel_matches_its_indentation(place):
    press_m = 7e-4
    depth_m = pressed(CURVED, *place, press_m)
    contact = depth_m < press_m
    label = label_ball(CURVED, *circle_px(contact), BALL_M)
    both = contact & label.contact
    assert both.sum() > 0.95 * contact.sum()
    assert label.indentation_m[both] == pytest.approx((press_m - depth_m)[both], abs=8e-5)
    along_y, along_x = np.gradient(press_m - depth_m.astype(float), 1 / CURVED.fy)
    inner = np.hypot(*(np.indices(contact.shape).T - np.array(circle_px(contact)[0])[::-1]).T) < 8
    assert label.slope[inner] == pytest.approx(np.stack([along_x, along_y], axis=-1)[inner], abs=0.04)


def test_a_zero_relief_gives_the_label_of_a_flat_gel():
    level = dataclasses.replace(FLAT, relief_m=np.zeros(FLAT.shape, np.float32))
    ours, theirs = (label_ball(geometry, (40.0, 60.0), 9.0, BALL_M) for geometry in (level, FLAT))
    assert ours.slope == pytest.approx(theirs.slope, abs=1e-6)
    assert ours.indentation_m == pytest.approx(theirs.indentation_m, abs=3e-5)
