"""Asymmetric cameras, surfaces of known depth, and the exact renderers."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import trimesh

from tactile_loc.core.geometry.rigid import make_transform
from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.errors import RenderError
from tactile_loc.plugins.renderers.pyrender.renderer import PyrenderRenderer
from tactile_loc.plugins.renderers.raycast import RaycastRenderer
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer
from tactile_loc.slots.renderer import Renderer
from tactile_loc.testing.problems import LOPSIDED_CAMERAS


@pytest.fixture(scope="session")
def sphere() -> TriangleMesh:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.008)
    return TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64))


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
