"""Simulated images, and the gel's surface: smooth around the contact, at any resolution."""

import dataclasses

import numpy as np
import pytest
from imaging_helpers import BALL_M, PRESS_M, ball_depth, presses, rng, sensor, tip_depth
from press_sets import places
from scipy.ndimage import gaussian_filter

from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.core.sensing.noise import GelPixels
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_images
from tactile_loc.sensors.optics.simulate import press_gel, relax, render_touches

GELSLIM = OPTICS["gelslim"]


def elastic(side_px: int):
    """A sensor with an elastic gel of 4 mm."""
    return dataclasses.replace(sensor(side_px), gel=Gel(4e-3))


def test_the_picture_of_a_touch_is_the_shaded_gel():
    geometry = sensor()
    depth = np.concatenate([ball_depth(geometry), tip_depth(geometry)])
    picture = render_touches(depth, presses(2), geometry, GELSLIM, rng(5))
    surface = press_gel(depth, presses(2), geometry)
    assert np.array_equal(picture, render_images(surface, geometry, GELSLIM, rng(5)))


def test_the_picture_of_an_elastic_gel_is_its_surface():
    """The contact depths of an elastic gel are not pressed into a soft gel again."""
    geometry = elastic(64)
    depth = deform_gel(tip_depth(geometry), presses(), geometry)
    surface = press_gel(depth, presses(), geometry)
    picture = render_touches(depth, presses(), geometry, GELSLIM, rng(5))
    assert np.array_equal(picture, render_images(surface, geometry, GELSLIM, rng(5)))


def test_the_gel_follows_the_surface_of_a_ball():
    geometry = sensor(160)
    surface = press_gel(ball_depth(geometry), presses(), geometry)
    x, y = places(geometry)
    near = np.hypot(x, y) < 0.4 * BALL_M
    true = np.sqrt(BALL_M**2 - x**2 - y**2, where=near, out=np.zeros_like(x)) - BALL_M + PRESS_M
    assert surface[0][near] == pytest.approx(true[near], abs=2e-6)  # the last blur lowers the surface slightly


def test_relaxing_never_lifts_the_contact():
    geometry = sensor()
    bumps = gaussian_filter(1e-3 * np.random.default_rng(0).normal(size=(3, 80, 80)), (0, 2, 2))
    contact = np.maximum(bumps, 0).astype(np.float32)
    surface = relax(contact, GelPixels.of(geometry))
    assert (surface >= contact).all()
    assert surface.max() <= contact.max() * (1 + 1e-5)
    tip = PRESS_M - tip_depth(geometry)
    touching = tip > 0
    assert relax(tip, GelPixels.of(geometry))[touching] == pytest.approx(tip[touching], rel=1e-5)


def test_the_gel_has_no_step_around_a_tip():
    geometry = sensor(320)
    surface = press_gel(tip_depth(geometry), presses(), geometry)[0, 160, 240:]  # from the edge outwards
    fall = -np.diff(surface)
    assert (fall > 0).all()
    assert fall.max() < 0.12 * PRESS_M  # over a pixel of 0.05 mm
    assert surface[[0, 20, 60]] == pytest.approx(np.array([0.87, 0.34, 0.06]) * PRESS_M, abs=0.05 * PRESS_M)


def test_the_gel_bridges_a_narrow_groove_but_not_a_wide_one():
    geometry = sensor(160)
    x, _ = places(geometry)
    middles = []
    for half_m in (2e-4, 4e-3):
        depth = np.where(np.abs(x) < half_m, PRESS_M, 0.0).astype(np.float32)[None]
        middles.append(press_gel(depth, presses(), geometry)[0, 80, 80])
    assert middles[0] > 0.7 * PRESS_M
    assert middles[1] < 0.1 * PRESS_M


def test_the_surface_does_not_depend_on_the_pixel_size():
    coarse, fine = (press_gel(ball_depth(g), presses(), g)[0] for g in (sensor(80), sensor(240)))
    assert coarse == pytest.approx(fine.reshape(80, 3, 80, 3).mean((1, 3)), abs=0.01 * PRESS_M)


def test_images_of_a_batch_are_independent_and_no_contact_leaves_no_imprint():
    geometry = sensor()
    depth = np.concatenate([tip_depth(geometry), np.full((1, 80, 80), 5e-4, np.float32), ball_depth(geometry)])
    press = np.array([PRESS_M, 5e-4, PRESS_M])
    surface = press_gel(depth, press, geometry)
    assert not surface[1].any()
    alone = press_gel(depth[2:], press[2:], geometry)
    assert surface[2] == pytest.approx(alone[0], abs=1e-9)
    assert press_gel(depth[:0], press[:0], geometry).shape == (0, 80, 80)


def test_the_gel_covers_only_the_sensing_rectangle():
    geometry = sensor(rectangle_m=(-0.006, 0.004, -0.005, 0.008))
    surface = press_gel(np.zeros((1, 80, 80), np.float32), presses(), geometry)
    assert np.array_equal(surface[0] > 0, geometry.observed_mask)
    assert surface[0][geometry.observed_mask] == pytest.approx(PRESS_M, rel=1e-5)
