"""The effective thickness of a gel, from presses that ContactMechanics or the solver has made, and from real ones."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from tactile_loc.calibration.gel_thickness import estimate_gel
from tactile_loc.core.sensing.gel import Gel
from tactile_loc.core.sensing.gel_surface import deform_gel
from tactile_loc.plugins.sensors.presets import GelSightMini

BALL_M = 4e-3
GEOMETRY = GelSightMini().geometry.resize(160, 120)


@dataclasses.dataclass
class Row:
    kind: str = "ball"


class ElasticPresses:
    """Presses of a ball on an elastic gel, as an estimator without errors reads them."""

    def __init__(self, thickness_m: float, count: int, kind: str = "ball", noise_m: float = 0.0) -> None:
        self.geometry, self.rows, self.images = GEOMETRY, [Row(kind)] * count, list(range(count))
        self.thickness_m, self.noise = thickness_m, noise_m * np.random.default_rng(0).standard_normal(GEOMETRY.shape)

    def place_circle(self, number: int) -> tuple[tuple[float, float], float, float]:
        return (1e-3 * (number % 3 - 1), 5e-4 * (number % 2)), 1.5e-3, BALL_M

    def read_indentation(self, number: int) -> np.ndarray:
        (x_m, y_m), _, _ = self.place_circle(number)
        x, y = self.geometry.pixel_slopes
        below = BALL_M - np.sqrt(np.maximum(BALL_M**2 - (x[None] - x_m) ** 2 - (y[:, None] - y_m) ** 2, 0))
        press_m = 4e-4 + 1e-4 * (number % 4)
        layer = dataclasses.replace(self.geometry, gel=Gel(self.thickness_m))
        depth = deform_gel(np.minimum(below, press_m).astype(np.float32)[None], press_m, layer, 20)[0]
        return press_m - depth + self.noise


def estimate(presses: Any) -> Any:
    return estimate_gel(presses, presses)


@pytest.mark.parametrize("thickness_m", [2e-3, 4e-3, 8e-3])
def test_the_thickness_of_simulated_presses_is_found(thickness_m):
    found = estimate(ElasticPresses(thickness_m, 6))
    assert found.thickness_m == pytest.approx(thickness_m, rel=0.1)
    assert found.rms_m < 0.5 * found.rigid_rms_m


def test_noise_widens_the_stated_error_at_most():
    noisy = estimate(ElasticPresses(4e-3, 6, noise_m=1e-5))
    assert noisy.thickness_m == pytest.approx(4e-3, rel=0.15)
    assert noisy.std_m < 1e-3


@pytest.mark.parametrize(("count", "kind"), [(2, "ball"), (6, "mesh"), (0, "ball")])
def test_too_few_balls_give_no_thickness(count, kind):
    assert estimate(ElasticPresses(4e-3, count, kind)) is None


@pytest.mark.slow
def test_balls_predict_the_surface_beside_another_shape(shared_data, tmp_path):
    """Real photos: with the thickness from the balls alone, the model's error beside a flat prism is halved."""
    import json

    import trimesh
    from PIL import Image
    from scipy.ndimage import distance_transform_edt

    from tactile_loc.calibration.calibrate import calibrate
    from tactile_loc.calibration.presses import convert, read_presses
    from tactile_loc.core.sensing.sensor_geometry import SensorGeometry

    balls, shapes = shared_data / "tactile/gelslim_balls", shared_data / "tactile/gelslim_shapes"
    convert(balls, tmp_path / "presses", "circles", 2.92, 0.059259)
    scale = 1e3 / 0.059259
    camera = SensorGeometry("orthographic", 320, 320, scale, scale, 160, 160, standoff_m=0.01, max_depth_m=1.5e-3)
    presses = read_presses(tmp_path / "presses", camera)
    estimator = calibrate(presses, presses.geometry, presses.background, "photometric").estimator
    fit = estimate_gel(estimator, presses)
    assert fit is not None
    assert 5e-3 < fit.thickness_m < 9e-3
    poses = json.loads((shapes / "poses.json").read_text())
    corners = trimesh.load(shapes / "prism.stl").vertices
    corners = corners[corners[:, 2] > 19.9][:, :2]
    for press in ("0.5", "0.75", "1.0"):
        pose = poses[f"prism_{press}"]
        read_m = estimator.read_indentation(np.asarray(Image.open(shapes / f"prism_{press}_real.png").convert("RGB")))
        turn, (u0, v0) = np.radians(pose["theta_deg"]), pose["origin_px"]
        v, u = np.mgrid[:320, :320]
        du, dv = (u - u0) * 0.059259, (v - v0) * 0.059259
        x, y = np.cos(turn) * du + np.sin(turn) * dv, np.sin(turn) * du - np.cos(turn) * dv
        (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
        tip = (x > x0) & (x < x1) & (y > y0) & (y < y1)
        inner = (x > x0 + 0.3) & (x < x1 - 0.3) & (y > y0 + 0.3) & (y < y1 - 0.3)
        press_m = float(read_m[inner].mean())
        near = distance_transform_edt(~tip) * 0.059259 < 3.0
        layer = dataclasses.replace(camera.press(press_m), gel=Gel(fit.thickness_m))
        shown = press_m - deform_gel(np.where(tip, 0, press_m).astype(np.float32)[None], press_m, layer, 12)[0]
        rigid = np.where(tip, press_m, 0.0)
        errors = [np.sqrt(np.mean((model - read_m)[near] ** 2)) for model in (shown, rigid)]
        assert errors[0] < 0.5 * errors[1]
