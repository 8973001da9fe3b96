"""All renderers draw the same contact shapes of real parts, to within a height map's resolution."""

from pathlib import Path

import numpy as np
import pytest

from tactile_loc import DEMO_OBJECTS, SensorGeometry, TriangleMesh, load_object
from tactile_loc.plugin import Renderer, registry
from tactile_loc.plugin.helpers import bring_to_contact, draw_rotations, make_transform
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.plugins.renderers.zbuffer import ZBufferRenderer

MESHES = Path(__file__).parents[4] / "shared" / "data" / "meshes"

PARTS = {
    "pin": DEMO_OBJECTS["pin"].path,
    "hook": DEMO_OBJECTS["hook"].path,
    "bolt": MESHES / "factory" / "factory_bolt_m16_loose.obj",
    "plug": MESHES / "automate" / "00062_plug.obj",
    "pillow block": MESHES / "o2ac" / "05_MBRFA30-2-P6.stl",
}

CAMERAS = {
    "pinhole": SensorGeometry("pinhole", 470, 470, 291.5, 289.0, 235.0, 235.0, 0.025, 0.002).resize(200, 200),
    "orthographic": SensorGeometry("orthographic", 200, 200, 5000.0, 5000.0, 100.0, 100.0, 0.025, 0.002),
}
LEAST_MASK_AGREEMENT = {"pinhole": 0.99, "orthographic": 0.995}


@pytest.fixture(scope="module", params=list(PARTS))
def part(request: pytest.FixtureRequest) -> TriangleMesh:
    if not PARTS[request.param].is_file():
        pytest.skip(f"the mesh {PARTS[request.param].name} is not on this machine")
    return load_object(PARTS[request.param], symmetry="none").mesh


@pytest.fixture(scope="module", params=list(CAMERAS))
def touches(request: pytest.FixtureRequest, part: TriangleMesh):
    """The camera, its name, contact poses, and the contact depths of the z-buffer."""
    g = CAMERAS[request.param]
    rng = np.random.default_rng(11)
    R = np.repeat(draw_rotations(4, rng), 3, axis=0)
    offset = np.c_[rng.uniform(-0.01, 0.01, (len(R), 2)), np.zeros(len(R))]
    T, touching = bring_to_contact(part, make_transform(R, offset - R @ part.centroid_m), g)
    return request.param, g, T[touching], ZBufferRenderer().render(part, T[touching], g)


def agreement(a: np.ndarray, b: np.ndarray, g: SensorGeometry) -> tuple[float, float]:
    """Share of pixels whose contact is the same, and the median depth difference (m) of pixels where both touch."""
    limit = np.float32(g.standoff_m + g.max_depth_m)
    both = (a < limit) & (b < limit)
    assert both.any()
    return float(((a < limit) == (b < limit)).mean()), float(np.median(np.abs(a[both] - b[both])))


def test_the_height_map_agrees_with_the_zbuffer(part, touches):
    name, g, T, expected = touches
    mask, difference_m = agreement(HeightmapRenderer().render(part, T, g), expected, g)
    assert mask >= LEAST_MASK_AGREEMENT[name]
    assert difference_m <= 20e-6


def test_pyrender_agrees_with_the_zbuffer(part, touches, new_pyrender):
    _, g, T, expected = touches
    renderer: Renderer = new_pyrender()
    mask, difference_m = agreement(renderer.render(part, T, g), expected, g)
    assert mask >= 0.9999
    assert difference_m <= 0.1e-6


def test_ray_casting_agrees_with_the_zbuffer(part, touches):
    pytest.importorskip("open3d")
    _, g, T, expected = touches
    mask, difference_m = agreement(registry().create("renderer", "raycast", {}).render(part, T, g), expected, g)
    assert mask >= 0.9999
    assert difference_m <= 0.1e-6
