"""The surface of a curved gel, learned from presses of balls, and the labels of balls on it."""

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import CalibrationError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.core.sensing.touch import compute_contact_depth
from tactile_loc.io.images import write_image
from tactile_loc.plugins.sensors.presets import CurvedDigit
from tactile_loc.sensors.calibration.labels import label_ball
from tactile_loc.sensors.calibration.presses import PressFolder, read_presses
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background, render_images
from tactile_loc.sensors.optics.simulate import press_gel
from tactile_loc.sensors.reading.relief import learn_relief

GEL_M, BALL_M = 35e-3, 4e-3
CURVED = CurvedDigit(CurvedDigit.Options(image_size_px=(90, 120))).geometry
FLAT = dataclasses.replace(CURVED, relief_m=None)
COLUMNS = ["image", "kind", "center_x_px", "center_y_px", "radius_px", "ball_radius_mm"]


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


@pytest.fixture(scope="module")
def presses(tmp_path_factory) -> PressFolder:
    folder: Path = tmp_path_factory.mktemp("presses")
    rng, optics = np.random.default_rng(0), OPTICS["digit"]
    write_image(folder / "untouched.png", render_background(CURVED, optics))
    rows = [["untouched.png", "background", "", "", "", ""]]
    for number in range(30):
        press_m = rng.uniform(4e-4, 9e-4)
        depth_m = pressed(CURVED, *rng.uniform([-5.5e-3, -8e-3], [5.5e-3, 8e-3]), press_m)
        surface_m = press_gel(depth_m[None], [press_m], CURVED)
        write_image(folder / f"{number}.png", render_images(surface_m, CURVED, optics, rng)[0])
        (x, y), radius = circle_px(depth_m < press_m)
        rows.append([f"{number}.png", "ball", str(x), str(y), str(radius), str(1e3 * BALL_M)])
    with (folder / "presses.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    return read_presses(folder, FLAT)


@pytest.mark.slow
def test_balls_teach_the_surface_of_a_curved_gel(presses):
    relief_m = learn_relief(presses)
    off_m = relief_m - CURVED.relief_m
    assert relief_m.shape == CURVED.shape
    assert relief_m.max() == 0.0
    assert (off_m - off_m.mean()).std() < 0.25 * CURVED.relief_m.std()
    middle = np.s_[20:-20, 15:-15]
    along_y, along_x = np.gradient(off_m[middle], 1 / CURVED.fy)
    assert np.hypot(along_x, along_y).mean() < 0.06  # radians; the gel's own slope there is 0.16


def test_too_few_balls_are_refused(presses):
    few = dataclasses.replace(presses, rows=presses.rows[:7], images=presses.images[:7])
    with pytest.raises(CalibrationError, match=naming("7 presses", 8)):
        learn_relief(few)


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
