"""Asymmetric cameras, surfaces of known depth, and the exact renderers."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import trimesh

from tactile_loc.core.objects.mesh import TriangleMesh
from tactile_loc.core.runtime.errors import RenderError
from tactile_loc.plugins.renderers.pyrender.renderer import PyrenderRenderer
from tactile_loc.plugins.renderers.raycast import RaycastRenderer
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer
from tactile_loc.slots.renderer import Renderer
from tactile_loc.testing.problems import LOPSIDED_CAMERAS, make_plate, make_stepped_block


@pytest.fixture(scope="session")
def sphere() -> TriangleMesh:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.008)
    return TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64))


@pytest.fixture(scope="session")
def quad() -> TriangleMesh:
    """A square plate without thickness, 200 mm wide, in the plane z = 0."""
    return make_plate()


@pytest.fixture(scope="session")
def bracket() -> TriangleMesh:
    """A solid that looks different from every side."""
    return make_stepped_block()


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
