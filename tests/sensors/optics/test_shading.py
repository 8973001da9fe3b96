"""Images of surfaces with known shades."""

import dataclasses
import math

import numpy as np
import pytest
from imaging_helpers import ball_depth, lamp, lit, presses, rng, sensor, tip_depth
from press_sets import places
from scipy.special import ndtr

from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.sensors.optics.lamps import OPTICS, Optics
from tactile_loc.sensors.optics.shading import measure_slopes, render_background, render_images
from tactile_loc.sensors.optics.simulate import press_gel

ELEVATION = math.radians(30)


def rendered(indentation, geometry, optics, seed=0) -> np.ndarray:
    return render_images(indentation, geometry, optics, rng(seed))


def plane(geometry: SensorGeometry, slope_x: float, slope_y: float) -> np.ndarray:
    sx, sy = geometry.scale_at_surface
    x = (np.arange(geometry.width_px) + 0.5 - geometry.cx) / sx
    y = (np.arange(geometry.height_px) + 0.5 - geometry.cy) / sy
    return (0.01 + slope_x * x + slope_y * y[:, None])[None].astype(np.float32)


def pressed_tip(geometry: SensorGeometry) -> np.ndarray:
    return press_gel(tip_depth(geometry), presses(), geometry)


@pytest.mark.parametrize(
    "geometry",
    [sensor(40), sensor(90), SensorGeometry("pinhole", 64, 48, 42.0, 40.0, 31.0, 25.0, 0.025, 0.002)],
    ids=["coarse", "fine", "pinhole"],
)
def test_a_tilted_plane_has_lamberts_shade_at_any_pixel_size(geometry):
    tilted = plane(geometry, 0.3, -0.2)
    slope_x, slope_y = measure_slopes(tilted, geometry)
    assert slope_x == pytest.approx(0.3, abs=1e-4)
    assert slope_y == pytest.approx(-0.2, abs=1e-4)
    for side, slope in {"right": -0.3, "left": 0.3, "below": 0.2, "above": -0.2}.items():
        lambert = (slope * math.cos(ELEVATION) + math.sin(ELEVATION)) / math.sqrt(1 + 0.3**2 + 0.2**2)
        expected = 255 * 0.9 * lambert
        assert rendered(tilted, geometry, lit(side)) == pytest.approx(expected, abs=0.6), side


def test_a_domed_gel_has_the_shade_of_a_flat_gel_pressed_to_a_dome():
    geometry = sensor(120)
    radius_m = 0.008 * math.sqrt(2)
    x, y = places(geometry)
    dome = ((x**2 + y**2) * 0.4 / (2 * radius_m)).astype(np.float32)[None]
    optics = lit("right", "above")
    domed = render_background(geometry, dataclasses.replace(optics, dome=0.4))
    pushed = rendered(dome, geometry, optics)[0]
    assert domed[1:-1, 1:-1] == pytest.approx(pushed[1:-1, 1:-1], abs=1)  # at the border a difference is one-sided
    assert domed[60, 0, 0] > domed[60, 119, 0] + 40  # it faces the lamp on the other side


def test_a_flat_tip_has_the_colour_of_the_unpressed_gel_inside():
    for name, optics in OPTICS.items():
        geometry = sensor(160)
        picture = rendered(pressed_tip(geometry), geometry, optics.remove_noise())[0].astype(int)
        unpressed = render_background(geometry, optics)
        x, y = (np.abs(a) for a in places(geometry))
        inside, wall = np.maximum(x, y) < 3.4e-3, (np.maximum(x, y) > 4e-3) & (np.maximum(x, y) < 4.3e-3)
        change = np.abs(picture - unpressed).max(axis=-1)
        assert change[inside].max() <= 1, name
        assert np.median(change[wall]) > 25, name


def test_an_image_without_press_and_noise_is_the_background():
    geometry, unpressed = sensor(), np.zeros((2, 80, 80), np.float32)
    for optics in OPTICS.values():
        expected = render_background(geometry, optics)
        assert expected.shape == (80, 80, 3)
        pictures = rendered(unpressed, geometry, optics.remove_noise())
        assert np.array_equal(pictures, np.stack([expected, expected]))


def test_the_lens_blurs_by_its_width_in_metres():
    for px in (80, 240):
        geometry = sensor(px)
        x, _ = places(geometry)
        roof = (0.01 - 0.2 * np.abs(x)).astype(np.float32)[None]  # falls away to both sides
        row = rendered(roof, geometry, lit("right", blur_m=1e-3))[0, px // 2, :, 0]
        left, right = (
            255 * 0.9 * (s * 0.2 * math.cos(ELEVATION) + math.sin(ELEVATION)) / math.sqrt(1.04) for s in (-1, 1)
        )
        assert row == pytest.approx(left + (right - left) * ndtr(x[0] / 1e-3), abs=1.0)


def test_vignetting_darkens_the_corner_by_the_stated_share():
    bright, dark = (render_background(sensor(), lit("right", vignetting=v)).astype(float) for v in (0.0, 0.4))
    assert (dark / bright)[0, 0] == pytest.approx(1 - 0.4 * (79 / 80) ** 2, abs=0.01)
    assert (dark / bright)[40, 40] == pytest.approx(1.0, abs=0.01)


def test_gloss_is_brightest_halfway_to_the_lamp():
    geometry, shine = sensor(40), {}
    for slope in (-0.3, 0.0, 0.3):
        optics = (lit("right", specular=0.3, shininess=12.0), lit("right"))
        gloss, matt = (int(rendered(plane(geometry, -slope, 0), geometry, one)[0, 20, 20, 0]) for one in optics)
        shine[slope] = gloss - matt
    assert shine[0.0] == pytest.approx(255 * 0.9 * 0.3 * math.cos(math.radians(30)) ** 12, abs=1)
    away = math.radians(30) - math.atan(0.3)  # half of the 60 degrees between lamp and camera
    assert shine[0.3] == pytest.approx(255 * 0.9 * 0.3 * math.cos(away) ** 12, abs=1)
    assert shine[-0.3] < shine[0.0] < shine[0.3]


def test_brightness_is_clipped_at_black_and_white():
    geometry = sensor(40)
    bright = lit("right", ambient=(2.0, 0.0, 0.0))
    assert (render_background(geometry, bright)[..., 0] == 255).all()
    shadow = rendered(plane(geometry, 2.0, 0.0), geometry, lit("right"))
    assert (shadow == 0).all()


@pytest.mark.parametrize(("read", "shot", "brightness"), [(3.0, 0.0, 0.5), (0.0, 6.0, 0.25), (2.0, 4.0, 0.5)])
def test_noise_has_the_stated_strength(read, shot, brightness):
    geometry = sensor(120)
    even = Optics((lamp(strength=0.0),), ambient=(brightness,) * 3, read_noise=read, shot_noise=shot)
    flat = np.zeros((4, 120, 120), np.float32)
    one, same, other = (rendered(flat, geometry, even, seed) for seed in (0, 0, 1))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    noise = one.astype(float) - 255 * brightness
    expected = math.sqrt(read**2 + shot**2 * brightness + 1 / 12)
    assert noise.std() == pytest.approx(expected, rel=0.02)
    assert noise.mean() == pytest.approx(0, abs=0.05)


def test_pixels_outside_the_sensing_rectangle_do_not_change():
    geometry = sensor(rectangle_m=(-0.006, 0.004, -0.005, 0.008))
    optics = lit("right", "below")
    surface = press_gel(np.zeros((1, 80, 80), np.float32), presses(), geometry)
    blurred = dataclasses.replace(optics, blur_m=2e-4, vignetting=0.5)
    assert np.array_equal(rendered(surface, geometry, optics)[0], render_background(geometry, optics))
    assert rendered(surface, geometry, blurred)[0] == pytest.approx(render_background(geometry, blurred), abs=1)
    ball = press_gel(ball_depth(geometry, 4e-3), presses(), geometry)
    changed = (rendered(ball, geometry, optics)[0] != render_background(geometry, optics)).any(axis=-1)
    assert changed.any()
    assert not (changed & ~geometry.observed_mask).any()
