"""Simulated images and training pairs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from imaging_helpers import ball_depth, presses, rng, sensor, tip_depth

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.sensors.optics.boards import make_board
from tactile_loc.sensors.optics.lamps import OPTICS
from tactile_loc.sensors.optics.shading import render_background, render_images
from tactile_loc.sensors.optics.simulate import BATCH, LIGHTEST, press_boards, press_gel, render_touches

GELSLIM = OPTICS["gelslim"]


def elastic(side_px: int):
    """A sensor with an elastic gel of 4 mm."""
    return dataclasses.replace(sensor(side_px), gel=Gel(4e-3))


def test_the_picture_of_a_touch_is_the_shaded_gel():
    geometry = sensor()
    depth = np.concatenate([ball_depth(geometry), tip_depth(geometry)])
    photo = render_background(geometry, OPTICS["digit"])
    for own in (None, photo):
        picture = render_touches(depth, presses(2), geometry, GELSLIM, rng(5), own)
        surface = press_gel(depth, presses(2), geometry)
        assert np.array_equal(picture, render_images(surface, geometry, GELSLIM, rng(5), own))


def test_the_picture_of_an_elastic_gel_is_its_surface():
    """The contact depths of an elastic gel are not pressed into a soft gel again."""
    geometry = elastic(64)
    depth = deform_gel(tip_depth(geometry), presses(), geometry)
    surface = press_gel(depth, presses(), geometry, 0.0)
    picture = render_touches(depth, presses(), geometry, GELSLIM, rng(5))
    assert np.array_equal(picture, render_images(surface, geometry, GELSLIM, rng(5)))


def test_boards_are_pressed_into_an_elastic_gel():
    """The same presses displace the gel in a larger area, and as deep."""
    rigid, soft = (
        next(press_boards(one, 4, GELSLIM, rng(2), HeightmapRenderer())) for one in (sensor(64), elastic(64))
    )
    np.testing.assert_array_equal(soft.press_depth_m, rigid.press_depth_m)
    deepest = [presses.indentation_m.max(axis=(1, 2)) for presses in (rigid, soft)]
    np.testing.assert_allclose(deepest[1], deepest[0], rtol=0.05)
    assert ((soft.indentation_m > 0).sum(axis=(1, 2)) > 1.2 * (rigid.indentation_m > 0).sum(axis=(1, 2))).all()
    assert (soft.indentation_m >= rigid.indentation_m - 1e-7).all()


def test_board_presses_come_in_batches_with_their_true_shapes():
    geometry, optics = sensor(64), GELSLIM.remove_noise()
    batches = list(press_boards(geometry, BATCH + 3, optics, rng(), HeightmapRenderer()))
    assert [len(b.images) for b in batches] == [BATCH, 3]
    unpressed = render_background(geometry, optics).astype(int)
    for images, indentation_m, press_depth_m in batches:
        assert images.dtype == np.uint8
        assert images.shape == (*indentation_m.shape, 3)
        assert indentation_m.dtype == np.float32
        assert indentation_m.min() == 0
        deepest = indentation_m.max(axis=(1, 2))
        assert (deepest <= press_depth_m * (1 + 1e-6)).all()
        assert (deepest > 0).all()
        assert (press_depth_m >= LIGHTEST * geometry.max_depth_m).all()
        assert (press_depth_m <= geometry.max_depth_m).all()
        changed = np.abs(images.astype(int) - unpressed).max(axis=-1)
        assert (changed.max(axis=(1, 2)) > 20).all()
    first = np.concatenate([b.press_depth_m for b in batches])
    assert len(np.unique(first)) == BATCH + 3


@pytest.mark.slow
def test_equal_seeds_give_equal_presses_under_any_lights():
    geometry = sensor(24)
    a, b, c = (
        next(press_boards(geometry, 4, optics, rng(seed), HeightmapRenderer()))
        for optics, seed in ((GELSLIM, 3), (GELSLIM, 3), (GELSLIM, 4))
    )
    assert np.array_equal(a.images, b.images)
    assert np.array_equal(a.indentation_m, b.indentation_m)
    assert not np.array_equal(a.indentation_m, c.indentation_m)
    quiet, noisy = (
        list(press_boards(geometry, 2 * BATCH, optics, rng(3), HeightmapRenderer()))
        for optics in (GELSLIM.remove_noise(), OPTICS["digit"])
    )
    for q, n in zip(quiet, noisy, strict=True):
        assert np.array_equal(q.indentation_m, n.indentation_m)
        assert not np.array_equal(q.images, n.images)


@pytest.mark.slow
def test_the_boards_alternate():
    seen = []

    class Watching(HeightmapRenderer):
        def render_apart(self, mesh, T_sensor_object, geometry):
            seen.append(mesh.digest)
            return super().render_apart(mesh, T_sensor_object, geometry)

    assert len(list(press_boards(sensor(16), 3 * BATCH, GELSLIM, rng(), Watching()))) == 3
    turns = [digest for i, digest in enumerate(seen) if i == 0 or digest != seen[i - 1]]
    assert turns == [make_board(number).mesh.digest for number in (1, 2, 1)]
    assert list(press_boards(sensor(16), 0, GELSLIM, rng(), HeightmapRenderer())) == []


class Nothing(HeightmapRenderer):
    """A renderer that finds no surface at any pixel."""

    def render_apart(self, mesh, T_sensor_object, geometry):
        return np.full((len(T_sensor_object), *geometry.shape), np.inf, np.float32)


def test_boards_without_any_imprint_are_refused():
    with pytest.raises(TouchError, match="calibration-board-1"):
        next(press_boards(sensor(16), 2, GELSLIM, rng(), Nothing()))
