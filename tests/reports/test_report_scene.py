"""The scene of a run's page, and its small pictures."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image
from report_helpers import UNFRIENDLY, floats

from tactile_loc.core.geometry import make_transform
from tactile_loc.core.sensing import ContactShape
from tactile_loc.drawing.raytracing import View
from tactile_loc.reports import scene3d
from tactile_loc.reports.shape_pictures import difference_png, outline_path, shape_png, shape_svg


def test_a_box_has_twelve_creases(box):
    pairs = scene3d.creases(box.mesh)
    lengths = np.linalg.norm(np.diff(box.mesh.vertices_m[np.array(pairs)], axis=1)[:, 0], axis=1)
    assert sorted(lengths.round(4)) == sorted([0.030, 0.020, 0.012] * 4)


def test_meshes_and_poses_are_in_mm(box):
    packed = scene3d.packed_mesh(box.mesh)
    assert floats(packed["vertices_mm"]).reshape(-1, 3) == pytest.approx(1e3 * box.mesh.vertices_m)
    T = make_transform(np.eye(3), [0.001, -0.002, 0.025])
    assert scene3d.rows_mm(T) == [1, 0, 0, 1.0, 0, 1, 0, -2.0, 0, 0, 1, 25.0]


def test_the_camera_sees_every_point():
    """By plotly's rules: unit the geometric mean of the ranges, origin their middle, 45 degrees from side to side."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-60, -10, 20], [30, 40, 60], (200, 3))
    bounds = [[-80.0, 50.0], [-30.0, 60.0], [0.0, 70.0]]
    view = View(35.0, 28.0)
    camera = scene3d.camera_on(points, bounds, view)
    unit, middle = np.prod(np.ptp(bounds, axis=1)) ** (1 / 3), np.mean(bounds, axis=1)
    eye, centre = ([camera[name][k] for k in "xyz"] for name in ("eye", "center"))
    seen = ((points - middle) / unit - eye) @ view.axes.T
    towards = (np.array(centre) - eye) / np.linalg.norm(np.array(centre) - eye)
    assert towards == pytest.approx(-view.axes[2], abs=1e-3)
    angles = np.degrees(np.arctan2(np.abs(seen[:, :2]), -seen[:, 2:]))
    assert angles.max() < 22.5
    assert angles.max() > 15  # and from not too far away


def test_the_numbers_around_the_pad_are_its_coordinates(flat_camera):
    ticks = scene3d.pad_ticks(flat_camera, View(35.0, 28.0))
    x0, x1, y0, y1 = (1e3 * v for v in flat_camera.rectangle)
    for x, y, text in zip(ticks["x"], ticks["y"], ticks["text"], strict=True):
        if "mm" in text:
            continue
        value = float(text.replace("\N{MINUS SIGN}", "-"))
        assert value in (pytest.approx(x), pytest.approx(y))
        assert x0 - 10 < x < x1 + 10
        assert y0 - 10 < y < y1 + 10


@pytest.mark.parametrize(("low", "high", "first", "last"), [(-20, 20, -20, 20), (-11.6, 12.4, -10, 10), (0, 3, 0, 3)])
def test_round_values_lie_within(low, high, first, last):
    values = scene3d.round_values(low, high)
    assert (values[0], values[-1]) == (first, last)
    assert len(values) <= 7


def pixels(uri: str) -> np.ndarray:
    """RGBA of a data URI."""
    head, data = uri.split(",")
    assert head == "data:image/png;base64"
    return np.array(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA"))


@pytest.fixture
def shapes(flat_camera) -> tuple[ContactShape, ContactShape]:
    """A square imprint of half the press, and one that lies five columns further and is as deep as it goes."""
    found = []
    for start, depth_m in ((20, 0.001), (25, 0.0)):
        depth = np.full(flat_camera.shape, 0.002, np.float32)
        depth[10:30, start : start + 20] = depth_m
        found.append(ContactShape(depth, 0.002))
    return found[0], found[1]


def test_a_shape_s_picture_shows_contact_only(shapes, flat_camera):
    image = pixels(shape_png(shapes[0], flat_camera))
    assert image.shape[:2] == flat_camera.shape
    assert (image[..., 3] > 0).sum() == 20 * 20
    assert image[15, 25, :3].astype(int) == pytest.approx([33, 145, 140], abs=3)  # the middle of viridis


def test_a_difference_is_red_where_pressed_deeper_and_blue_where_less(shapes, flat_camera):
    observed, made = shapes
    image = pixels(difference_png(made, observed, flat_camera)).astype(int)
    (r0, _, b0), (r1, _, b1), (r2, _, b2) = (image[15, column, :3] for column in (22, 30, 42))
    assert b0 > r0  # only observed
    assert r1 > b1  # deeper than observed
    assert r2 > b2  # not observed
    assert image[5, 5, 3] == 0
    assert not pixels(difference_png(observed, observed, flat_camera))[..., 3].any()


def test_an_outline_encloses_the_contact_in_mm(shapes, flat_camera):
    path = outline_path(shapes[0], flat_camera)
    x, y = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path), float).T
    sx, sy = flat_camera.scale_at_surface
    expected = [1e3 * (20 - flat_camera.cx) / sx, 1e3 * (40 - flat_camera.cx) / sx]
    assert [x.min(), x.max()] == pytest.approx(expected, abs=0.01)
    assert [y.min(), y.max()] == pytest.approx([1e3 * (v - flat_camera.cy) / sy for v in (10, 30)], abs=0.01)


def test_an_outline_at_the_border_is_closed(flat_camera):
    shape = ContactShape(np.zeros(flat_camera.shape, np.float32), 0.002)
    path = outline_path(shape, flat_camera)
    points = re.findall(r"(-?[\d.]+) (-?[\d.]+)", path)
    assert points[0] == points[-1]


def test_pictures_name_what_they_show_and_nothing_of_it_is_markup(shapes, flat_camera):
    svg = shape_svg("data:image/png;base64,", flat_camera, "", UNFRIENDLY)
    assert "<script" not in svg
    assert "10 mm" in shape_svg("", flat_camera, "", "x") or "5 mm" in shape_svg("", flat_camera, "", "x")
    assert "x (mm)" in shape_svg("", flat_camera, "", "x", ticks=True)
