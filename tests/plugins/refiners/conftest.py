"""A scene, touches of it, and candidates near the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import make_transform, make_translation, rotation_about, transform_points
from tactile_loc.core.poses.candidate import Candidate
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.sensing.scene import Scene
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.plugins.sensors.presets import GelSlim
from tactile_loc.simulate.touch_simulation import simulate_touches

OffBy = Callable[[Touch, float, float, float], Candidate]
ErrorMm = Callable[[Touch, np.ndarray], float]


@pytest.fixture(scope="session")
def pin_scene() -> Scene:
    geometry = GelSlim(GelSlim.Options(gel="rigid")).geometry
    return Scene(load_object("pin", symmetry="none"), geometry, HeightmapRenderer())


@pytest.fixture(scope="session")
def pin_touches(pin_scene) -> list[Touch]:
    """Touches of the pin that show both its steps and its ends, so that nothing can slide."""
    drawn = simulate_touches(FaceGrid(), pin_scene, 40, np.random.default_rng(3), 0.001)
    return sorted(drawn, key=lambda t: -t.contact_shape.contact.sum())[:6]


@pytest.fixture(scope="session")
def off_by(pin_scene) -> OffBy:
    """Make a candidate that lies `mm` and `degrees` about z beside a touch's true pose, brought to contact."""

    def make(touch: Touch, mm: float, degrees: float, direction: float) -> Candidate:
        centre = transform_points(touch.T_sensor_object, pin_scene.object.mesh.centroid_m[None])[0]
        turn = make_transform(rotation_about([0, 0, 1], np.radians(degrees)), np.zeros(3))
        step = make_translation([mm * 1e-3 * np.cos(direction), mm * 1e-3 * np.sin(direction), 0])
        T = step @ make_translation(centre) @ turn @ make_translation(-centre) @ touch.T_sensor_object
        return Candidate(pin_scene.bring_to_contact(T[None])[0][0], 0, 0.0)

    return make


@pytest.fixture(scope="session")
def error_mm(pin_scene) -> ErrorMm:
    """Return the distance of a pose (4, 4) from a touch's truth, mm."""
    return lambda touch, T: 1e3 * float(PoseMetric(pin_scene.object).distance(T, touch.T_sensor_object))
