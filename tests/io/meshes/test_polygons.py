"""Polygons become triangles that cover them exactly, whatever their shape, position and first corner."""

from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming
from scipy.spatial.transform import Rotation

from tactile_loc.core.runtime.errors import ObjectError
from tactile_loc.io.meshes.polygons import Polygons

CHANNEL = [(0, 0), (6, 0), (6, 4), (4, 4), (4, 1), (2, 1), (2, 4), (0, 4)]
COMB = [(x, y) for k in range(20) for x, y in ((2 * k, 1), (2 * k, 9), (2 * k + 1, 9), (2 * k + 1, 1))]
OUTLINES = {  # name: corners, and the area that they enclose
    "notch": ([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)], 10.0),
    "channel": (CHANNEL, 18.0),
    "concave quad": ([(0, 0), (3, -1), (1, 0), (3, 1)], 1.0),
    "straight corners": ([(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (0, 2), (0, 1)], 6.0),
    "hole with a bridge": ([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], 12.0),
    "spike": ([(0, 0), (4, 0), (4, 4), (4, 9), (4, 4), (0, 4)], 16.0),
    "repeated corners": ([(0, 0), (0, 0), (4, 0), (4, 4), (4, 4), (4, 4), (2, 1), (0, 4), (0, 0)], 10.0),
    "comb": ([*COMB[::-1], (0, 0), (39, 0)], 199.0),
}


def measure(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the area vectors (T, 3) of triangles."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


@pytest.mark.parametrize("name", OUTLINES)
def test_a_polygon_is_covered_once_in_its_own_orientation(name):
    outline, area = OUTLINES[name]
    rng = np.random.default_rng(0)
    for first in range(len(outline)):
        R, move = Rotation.random(rng=rng).as_matrix(), rng.uniform(-50, 50, 3)
        corners = np.roll(outline, first, axis=0)[:: (-1) ** first]
        vertices = np.c_[corners, np.zeros(len(corners))] @ R.T + move
        count = len(vertices)
        triangles = Polygons(vertices, np.arange(count), np.array([count])).triangulate(Path("part.obj"))
        areas = measure(vertices, triangles) @ R[:, 2] * (-1) ** first
        assert (areas > 1e-6).all()  # with their sum, this shows that no point is covered twice or not at all
        assert areas.sum() == pytest.approx(area)


def test_straight_corners_stay_corners_of_triangles_and_a_face_without_area_is_dropped():
    """Neighbouring faces use these corners, so the surface would have gaps without them."""
    outline, _ = OUTLINES["straight corners"]
    triangles = Polygons(np.c_[outline, np.zeros(8)], np.arange(8), np.array([8])).triangulate(Path("part.obj"))
    assert len(triangles) == 6
    assert set(triangles.ravel()) == set(range(8))
    line = Polygons(np.outer(np.arange(4.0), [1, 0, 0]), np.arange(4), np.array([4]))
    assert len(line.triangulate(Path("part.obj"))) == 0


def test_bent_faces_and_faces_of_several_sizes_keep_their_order_of_corners():
    vertices = np.c_[np.array(CHANNEL, float), np.random.default_rng(1).uniform(-0.1, 0.1, 8)]
    polygons = Polygons(vertices, np.r_[np.arange(8), 0, 1, 4, 0, 1], np.array([8, 3, 2]))
    triangles = polygons.triangulate(Path("part.obj"))
    assert (measure(vertices, triangles)[:, 2] > 0).all()
    assert measure(vertices, triangles)[:, 2].sum() == pytest.approx(18.0 + 3.0)
    assert len(triangles) == 6 + 1


@pytest.mark.parametrize("tip", [1.0, 2.0])
def test_a_face_that_crosses_itself_is_refused_with_its_number(tip):
    vertices = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, tip, 0]], float)
    polygons = Polygons(vertices, np.r_[0, 1, 2, 0, 1, 2, 3], np.array([3, 4]))
    with pytest.raises(ObjectError, match=naming("part.obj", "face 2", "4 corners")):
        polygons.triangulate(Path("part.obj"))
