"""Sources of images: their balls, their poses, and the sensors that are calibrated on them."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from tactile_loc.plugin import ConfigError, MissingLibraryError, SensorError, SensorGeometry, registry
from tactile_loc.plugin.helpers import transform_points
from tactile_loc.testing import list_checks

from tactile_loc_benchmark.sources.calibrating import BallPresses, press_ball
from tactile_loc_benchmark.sources.gelslim_shapes import GelslimShapes, make_camera, place_prism
from tactile_loc_benchmark.sources.simulated import RenderedTouches

DATA = Path(__file__).parents[4] / "shared" / "data" / "tactile"
CAMERA = SensorGeometry("orthographic", 80, 60, 4e3, 4e3, 40, 30, 10e-3, 1e-3)
POSE = {"origin_px": [207.0, 165.0], "theta_deg": 20.0}


def check(source) -> None:
    for one in list_checks(source):
        one(source)


def test_balls_are_pressed_as_deep_as_stated_and_first_not_at_all():
    balls = BallPresses(count=20)
    (first, _), *others = balls.draw_poses(CAMERA)
    lowest = [T[2, 3] - balls.radius_m for T, _ in others]
    assert first[2, 3] - balls.radius_m > CAMERA.surface_m
    assert np.allclose(lowest, [CAMERA.surface_m - press_m for _, press_m in others])
    assert all(balls.depth_m[0] <= press_m <= balls.depth_m[1] for _, press_m in others)
    again = [T for T, _ in BallPresses(count=20).draw_poses(CAMERA)]
    assert np.array_equal(again, [first, *(T for T, _ in others)])


def test_a_source_of_contact_shapes_has_nothing_to_calibrate():
    with pytest.raises(SensorError):
        press_ball(RenderedTouches(), CAMERA, BallPresses(count=5, depth_m=(0.5e-3, 0.6e-3)))


def test_the_prism_is_where_its_pose_in_the_image_says():
    T, camera, press_m = place_prism(POSE, 0.5e-3), make_camera(), 0.5e-3
    x, y = 2.5e-3, -3.5e-3
    c, s = np.cos(np.radians(20)), np.sin(np.radians(20))
    u = POSE["origin_px"][0] + 0.5 + (c * x + s * y) * camera.fx
    v = POSE["origin_px"][1] + 0.5 + (s * x - c * y) * camera.fy
    found = transform_points(T, np.array([[x, y, 20e-3]]))[0]
    assert np.allclose(found[:2], [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], atol=1e-9)
    assert found[2] == pytest.approx(camera.surface_m - press_m)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)


def test_a_missing_recording_is_an_error():
    with pytest.raises(ConfigError, match="gelslim_shapes"):
        GelslimShapes(GelslimShapes.Options(data="nowhere")).find_objects()


def test_a_missing_library_is_named_with_the_line_that_installs_it():
    if importlib.util.find_spec("tactile_mnist") is not None:
        pytest.skip("tactile-mnist is installed")
    with pytest.raises(MissingLibraryError, match=r"pip install './plugins_contrib/tactile-loc-benchmark\[cyclegan\]'"):
        registry().load("touch-source", "tactile-mnist")


@pytest.mark.slow
def test_taxim_keeps_the_contract():
    pytest.importorskip("taxim")
    check(registry().create("touch-source", "taxim", {"presses": 12}))


@pytest.mark.slow
def test_the_cycle_gan_keeps_the_contract():
    pytest.importorskip("tactile_mnist", reason="tactile-mnist is not installed")
    check(registry().create("touch-source", "tactile-mnist", {"presses": 12}))


@pytest.mark.slow
def test_the_recorded_prism_keeps_the_contract():
    if not DATA.is_dir():
        pytest.skip(f"there is no {DATA}")
    source = GelslimShapes(GelslimShapes.Options(data=str(DATA)))
    check(source)
    touches = list(source.read_touches("prism"))
    poses = json.loads((DATA / "gelslim_shapes" / "poses.json").read_text())
    assert [touch.name for touch in touches] == ["prism_0.25", *sorted(poses)]
