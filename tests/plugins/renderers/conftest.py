"""Asymmetric cameras, surfaces of known depth, and the exact renderers."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.errors import RenderError
from tactile_loc.core.sensing.sensor_geometry import SensorGeometry
from tactile_loc.plugins.renderers.pyrender.renderer import PyrenderRenderer
from tactile_loc.plugins.renderers.raycast import RaycastRenderer
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer
from tactile_loc.slots.renderer import Renderer
from tactile_loc.testing.problems import LOPSIDED_CAMERAS

SPHERE_RADIUS_M = 0.008


@pytest.fixture(scope="session")
def sphere() -> TriangleMesh:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=SPHERE_RADIUS_M)
    return TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64))


@pytest.fixture(scope="session")
def inner_radius_m(sphere: TriangleMesh) -> float:
    """The radius of the largest ball inside the tessellated sphere: its faces lie between this and the true radius."""
    a, b, c = np.moveaxis(sphere.triangles_m, 1, 0)
    normal = np.cross(b - a, c - a)
    return float((np.einsum("fk,fk->f", a, normal) / np.linalg.norm(normal, axis=1)).min())


@pytest.fixture(scope="session")
def quad() -> TriangleMesh:
    """A square plate without thickness, 200 mm wide, in the plane z = 0."""
    corners = 0.1 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.fixture(scope="session")
def bracket() -> TriangleMesh:
    """A closed solid that looks different from every side: a low step, a tall post and a slanted roof, 24 mm long."""
    parts = [
        trimesh.creation.box([0.024, 0.010, 0.004]),
        trimesh.creation.cylinder(
            0.002, 0.012, sections=24, transform=make_transform(np.eye(3), [0.008, 0.002, 0.005])
        ),
        trimesh.creation.icosphere(2, 0.003).apply_translation([-0.007, -0.003, -0.002]),
    ]
    solid = trimesh.util.concatenate(parts)
    return TriangleMesh(np.asarray(solid.vertices), np.asarray(solid.faces, np.int64))


@pytest.fixture(scope="session")
def new_pyrender() -> Callable[[], PyrenderRenderer]:
    """Make pyrender renderers; skip the test if this machine has no OpenGL."""
    probe = PyrenderRenderer()
    try:
        probe.render(TriangleMesh(np.eye(3), np.array([[0, 1, 2]])), np.eye(4)[None], LOPSIDED_CAMERAS["pinhole"])
    except RenderError as error:
        pytest.skip(str(error))
    probe.close()
    return PyrenderRenderer


@pytest.fixture(params=["raycast", "zbuffer", "pyrender"])
def exact_renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    if request.param != "pyrender":
        yield RaycastRenderer() if request.param == "raycast" else ZBufferRenderer()
        return
    renderer = request.getfixturevalue("new_pyrender")()
    yield renderer
    renderer.close()


@pytest.fixture
def rays() -> Callable[[SensorGeometry], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Origins and directions (H, W, 3) of a camera's rays at half-integer pixel centres; a unit step is a unit of z."""

    def of(g: SensorGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        u, v = np.meshgrid(np.arange(g.width_px) + 0.5, np.arange(g.height_px) + 0.5)
        x, y = (u - g.cx) / g.fx, (v - g.cy) / g.fy
        zero, one = np.zeros_like(x), np.ones_like(x)
        if g.camera == "pinhole":
            return np.stack([zero, zero, zero], -1), np.stack([x, y, one], -1)
        return np.stack([x, y, zero], -1), np.stack([zero, zero, one], -1)

    return of
