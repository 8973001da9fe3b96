"""The small pictures of a run's page."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image
from report_helpers import UNFRIENDLY

from tactile_loc.core.sensing.touch import ContactShape
from tactile_loc.reports.page import load_templates
from tactile_loc.reports.pictures import ImageBorders, draw_difference, trace_outline


def pixels(uri: str) -> np.ndarray:
    """RGBA of a data URI."""
    head, data = uri.split(",")
    assert head == "data:image/png;base64"
    return np.array(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA"))


@pytest.fixture
def shapes(flat_camera) -> tuple[ContactShape, ContactShape]:
    """A square imprint of half the press, and another one, five columns further, of the full press."""
    found = []
    for start, depth_m in ((20, 0.001), (25, 0.0)):
        depth = np.full(flat_camera.shape, 0.002, np.float32)
        depth[10:30, start : start + 20] = depth_m
        found.append(ContactShape(depth, 0.002))
    return found[0], found[1]


def test_a_difference_is_red_for_deeper_pixels_and_blue_for_shallower_ones(shapes, flat_camera):
    observed, made = shapes
    image = pixels(draw_difference(made, observed, flat_camera)).astype(int)
    (r0, _, b0), (r1, _, b1), (r2, _, b2) = (image[15, column, :3] for column in (22, 30, 42))
    assert b0 > r0  # only observed
    assert r1 > b1  # deeper than observed
    assert r2 > b2  # not observed
    assert image[5, 5, 3] == 0
    assert not pixels(draw_difference(observed, observed, flat_camera))[..., 3].any()


def read_points(path: str) -> np.ndarray:
    """The points (N, 2) of an SVG path."""
    return np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path), float)


def test_an_outline_encloses_the_contact_alone_in_mm(shapes, flat_camera, press_block_elastically):
    x, y = read_points(trace_outline(shapes[0], flat_camera)).T
    sx, sy = flat_camera.scale_at_surface
    expected = [1e3 * (20 - flat_camera.cx) / sx, 1e3 * (40 - flat_camera.cx) / sx]
    assert [x.min(), x.max()] == pytest.approx(expected, abs=0.01)
    assert [y.min(), y.max()] == pytest.approx([1e3 * (v - flat_camera.cy) / sy for v in (10, 30)], abs=0.01)
    touch = press_block_elastically(0.008, 0.006)
    sides_mm = np.ptp(read_points(trace_outline(touch.contact_shape, touch.geometry)), axis=0)
    assert sides_mm == pytest.approx([8, 6], abs=1.0)
    everywhere = ContactShape(np.zeros(flat_camera.shape, np.float32), 0.002)
    points = read_points(trace_outline(everywhere, flat_camera))
    assert (points[0] == points[-1]).all(), "an outline at the border is not closed"


def test_pictures_label_their_axes_and_escape_markup(shapes, flat_camera):
    shape, frame = load_templates().get_template("shapes.html.j2").module.shape, ImageBorders.of(flat_camera)
    svg = shape("data:image/png;base64,", frame, "", UNFRIENDLY)
    assert "<script" not in svg
    assert "10 mm" in shape("", frame, "", "x") or "5 mm" in shape("", frame, "", "x")
    assert "x (mm)" in shape("", frame, "", "x", ticks=True)
