import dataclasses

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc.core.runtime.errors import SensorError
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

MM = 1e-3
PINHOLE = SensorGeometry("pinhole", 8, 6, fx=40.0, fy=50.0, cx=3.7, cy=3.1, standoff_m=20 * MM, max_depth_m=2 * MM)
ORTHOGRAPHIC = SensorGeometry(
    "orthographic", 8, 6, fx=10e3, fy=5e3, cx=4.0, cy=3.0, standoff_m=10 * MM, max_depth_m=1 * MM
)
BOTH = pytest.mark.parametrize("geometry", [PINHOLE, ORTHOGRAPHIC], ids=["pinhole", "orthographic"])


def project(geometry: SensorGeometry, points_m: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(points_m, -1, 0)
    k = z if geometry.camera == "pinhole" else 1.0
    return np.stack([geometry.fx * x / k + geometry.cx, geometry.fy * y / k + geometry.cy], axis=-1)


def pixel_centres(geometry: SensorGeometry) -> np.ndarray:
    v, u = np.mgrid[: geometry.height_px, : geometry.width_px] + 0.5
    return np.stack([u, v], axis=-1)


@BOTH
def test_backprojected_points_project_to_pixel_centres(geometry: SensorGeometry) -> None:
    depth = np.random.default_rng(0).uniform(18 * MM, 24 * MM, (3, *geometry.shape))
    points = geometry.backproject(depth)
    assert points.shape == (3, *geometry.shape, 3)
    np.testing.assert_array_equal(points[..., 2], depth)
    np.testing.assert_allclose(project(geometry, points), np.broadcast_to(pixel_centres(geometry), (3, 6, 8, 2)))


@BOTH
def test_a_point_projects_to_the_scaled_pixel_after_resizing(geometry: SensorGeometry) -> None:
    points = np.random.default_rng(1).uniform(-1 * MM, 1 * MM, (20, 3)) + np.array([0, 0, 20 * MM])
    resized = geometry.resize(24, 9)
    assert resized.shape == (9, 24)
    np.testing.assert_allclose(project(resized, points), project(geometry, points) * [3.0, 1.5])
    np.testing.assert_allclose(resized.rectangle, geometry.rectangle)


@BOTH
@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_subsampled_pixels_keep_their_rays(geometry: SensorGeometry, step: int) -> None:
    geometry = dataclasses.replace(geometry, observed=np.random.default_rng(2).random(geometry.shape) < 0.7)
    depth = np.random.default_rng(3).uniform(18 * MM, 24 * MM, geometry.shape)
    sparse = geometry.subsample(step)
    np.testing.assert_allclose(sparse.backproject(depth[::step, ::step]), geometry.backproject(depth)[::step, ::step])
    np.testing.assert_array_equal(sparse.observed_mask, geometry.observed_mask[::step, ::step])


def test_resizing_the_long_side_keeps_the_proportion() -> None:
    assert PINHOLE.resize_long_side(80).shape == (60, 80)
    upright = dataclasses.replace(PINHOLE, width_px=6, height_px=8)
    assert upright.resize_long_side(80).shape == (80, 60)


def test_the_view_is_the_default_rectangle() -> None:
    np.testing.assert_allclose(PINHOLE.rectangle, np.array([-3.7 / 40, 4.3 / 40, -3.1 / 50, 2.9 / 50]) * 20 * MM)
    np.testing.assert_allclose(ORTHOGRAPHIC.rectangle, [-0.4 * MM, 0.4 * MM, -0.6 * MM, 0.6 * MM])
    assert ORTHOGRAPHIC.pixel_pitch_m == pytest.approx(0.15 * MM)
    assert PINHOLE.pixel_pitch_m == pytest.approx(0.5 * (20 / 40 + 20 / 50) * MM)


def test_a_rectangle_may_be_larger_than_the_view() -> None:
    geometry = dataclasses.replace(ORTHOGRAPHIC, rectangle_m=(-0.2 * MM, 5 * MM, -5 * MM, 0.25 * MM))
    np.testing.assert_allclose(geometry.rectangle, [-0.2 * MM, 5 * MM, -5 * MM, 0.25 * MM])
    np.testing.assert_allclose(geometry.subsample(3).rectangle, geometry.rectangle)
    pressed = geometry.press(0.1 * MM, 0.1 * MM)
    for g in (geometry, pressed):
        np.testing.assert_allclose(g.gel_middle_m, [2.4 * MM, -2.375 * MM, geometry.surface_m])


def test_pixels_outside_the_rectangle_or_masked_are_not_observed() -> None:
    observed = np.ones((6, 8), bool)
    observed[5, 7] = False
    geometry = dataclasses.replace(
        ORTHOGRAPHIC, rectangle_m=(-0.21 * MM, 1 * MM, -0.11 * MM, 1 * MM), observed=observed
    )
    # centres x = -0.35 ... 0.35 mm in steps of 0.1, y = -0.5 ... 0.5 mm in steps of 0.2
    expected = np.zeros((6, 8), bool)
    expected[2:, 2:] = True
    expected[5, 7] = False
    np.testing.assert_array_equal(geometry.observed_mask, expected)
    assert ORTHOGRAPHIC.observed_mask.all()
    assert PINHOLE.observed_mask.all()


def test_the_pinhole_mask_is_computed_on_the_surface() -> None:
    geometry = dataclasses.replace(PINHOLE, rectangle_m=(0.0, 1.0, -1.0, 1.0))
    points = geometry.backproject(np.full(geometry.shape, geometry.standoff_m))
    np.testing.assert_array_equal(geometry.observed_mask, points[..., 0] >= 0)
    assert not geometry.observed_mask.all()


def test_the_mask_is_resized_with_the_image() -> None:
    observed = np.zeros((6, 8), bool)
    observed[:3, 4:] = True
    geometry = dataclasses.replace(PINHOLE, observed=observed)
    expected = np.zeros((12, 16), bool)
    expected[:6, 8:] = True
    np.testing.assert_array_equal(geometry.resize(16, 12).observed_mask, expected)
    np.testing.assert_array_equal(geometry.resize(4, 2).observed_mask, [[False, False, True, True], [False] * 4])


CHANGES = {
    "camera": "orthographic",
    "width_px": 9,
    "height_px": 7,
    "fx": 41.0,
    "fy": 51.0,
    "cx": 3.8,
    "cy": 3.2,
    "standoff_m": 21 * MM,
    "max_depth_m": 1 * MM,
    "rectangle_m": (-1 * MM, 1 * MM, -1 * MM, 1 * MM),
    "observed": np.eye(6, 8, dtype=bool),
    "indentation_m": 1 * MM,
    "relief_m": np.full((6, 8), 1e-4, np.float32),
    "gel": Gel(4 * MM),
}


def test_every_field_has_a_change_to_try() -> None:
    assert set(CHANGES) == {f.name for f in dataclasses.fields(SensorGeometry)}


@pytest.mark.parametrize("field", CHANGES)
def test_the_description_changes_with_every_field(field: str) -> None:
    assert dataclasses.replace(PINHOLE, **{field: CHANGES[field]}).describe() != PINHOLE.describe()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"camera": "fisheye"}, "pinhole"),
        ({"fx": 0.0}, "fx"),
        ({"fy": float("nan")}, "fy"),
        ({"width_px": -1}, "width_px"),
        ({"standoff_m": float("inf")}, "standoff_m"),
        ({"max_depth_m": -1.0}, "max_depth_m"),
        ({"cx": float("nan")}, "rectangle"),
        ({"rectangle_m": (1 * MM, -1 * MM, -1 * MM, 1 * MM)}, "rectangle"),
        ({"rectangle_m": (1.0, 2.0, 1.0, 2.0)}, "rectangle"),
        ({"observed": np.ones((8, 6), bool)}, r"\(8, 6\)"),
        ({"observed": np.full((6, 8), 255, np.uint8)}, "uint8"),
        ({"observed": np.zeros((6, 8), bool)}, "observed"),
        ({"width_px": 10**6}, "1000000"),
    ],
)
def test_contradictory_numbers_are_refused(change: dict, words: str) -> None:
    with pytest.raises(SensorError, match=words):
        dataclasses.replace(PINHOLE, **change)


def test_the_same_sensor_may_differ_only_in_image_size_and_mask() -> None:
    blind = np.ones(PINHOLE.shape, bool)
    blind[0] = False
    assert PINHOLE.is_same_sensor(dataclasses.replace(PINHOLE.resize(3, 20), observed=None))
    assert PINHOLE.is_same_sensor(dataclasses.replace(PINHOLE, observed=blind))
    assert PINHOLE.is_same_sensor(PINHOLE.subsample(2))
    inner = dataclasses.replace(PINHOLE, rectangle_m=(-1e-3, 1e-3, -1e-3, 1e-3))
    assert not inner.is_same_sensor(dataclasses.replace(inner, fx=2 * inner.fx))
    for change in (
        {"fx": 1.01 * PINHOLE.fx},
        {"cy": PINHOLE.cy + 1},
        {"standoff_m": 2 * PINHOLE.standoff_m},
        {"max_depth_m": 2 * PINHOLE.max_depth_m},
        {"camera": "orthographic"},
    ):
        assert not PINHOLE.is_same_sensor(dataclasses.replace(PINHOLE, **change))


@pytest.mark.parametrize("pixels_a_metre", [1e-300, 0.05, 1e9])
def test_impossible_pixel_sizes_are_refused(pixels_a_metre):
    with pytest.raises(SensorError, match=naming(f"{pixels_a_metre / 1e3:.3g}")):
        SensorGeometry("orthographic", 32, 32, 2e3, pixels_a_metre, 16, 16, 0.01, 1e-3)
