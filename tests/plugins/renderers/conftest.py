"""Asymmetric cameras, surfaces of known depth, and the exact renderers."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import trimesh

from tactile_loc import TriangleMesh
from tactile_loc.plugin import Renderer, RenderError, registry
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
def new_pyrender() -> Callable[[], Renderer]:
    """Make pyrender renderers; skip the test if pyrender is not installed or this machine has no OpenGL."""
    pytest.importorskip("pyrender")
    kind = registry().load("renderer", "pyrender")
    probe = kind()
    try:
        probe.render(TriangleMesh(np.eye(3), np.array([[0, 1, 2]])), np.eye(4)[None], LOPSIDED_CAMERAS["pinhole"])
    except RenderError as error:
        pytest.skip(str(error))
    probe.close()
    return kind


@pytest.fixture(params=["raycast", "zbuffer", "pyrender"])
def exact_renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    if request.param == "raycast":
        pytest.importorskip("open3d")
    if request.param != "pyrender":
        yield registry().create("renderer", request.param, {})
        return
    renderer = request.getfixturevalue("new_pyrender")()
    yield renderer
    renderer.close()
