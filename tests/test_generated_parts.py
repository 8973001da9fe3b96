"""Generated parts are solids of the size of machine parts, always the same ones, and include parts that look alike."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("manifold3d")

PATH = Path(__file__).parent.parent / "benchmarks" / "generated_parts.py"
SPEC = importlib.util.spec_from_file_location("generated_parts", PATH)
assert SPEC is not None
assert SPEC.loader is not None
parts = importlib.util.module_from_spec(SPEC)
sys.modules.setdefault("generated_parts", parts)
SPEC.loader.exec_module(parts)


@pytest.mark.parametrize("family", list(parts.EVERY))
def test_parts_are_solids_of_the_size_of_machine_parts(family):
    for number in (0, 1, 2, 3, 1210, 1582):
        mesh = parts.make_mesh(f"{family}-{number:05d}")
        assert mesh.volume > 50  # mm^3
        assert 8 < mesh.extents.max() < 100


def test_names_are_spread_over_the_families():
    names = parts.list_names(2 * len(parts.FAMILIES))
    assert len(set(names)) == len(names)
    assert {name.rpartition("-")[0] for name in names} == set(parts.FAMILIES)


def test_a_name_determines_the_shape():
    one, again, other = (parts.make_mesh(name) for name in ("cam-00002", "cam-00002", "cam-00003"))
    assert np.array_equal(one.vertices, again.vertices)
    assert one.volume != pytest.approx(other.volume)


def test_some_parts_are_mirror_images_or_have_a_hole_more():
    like, mirrored, drilled = (parts.make_mesh(f"cam-{n:05d}") for n in (1, 8, 9))
    assert mirrored.volume == pytest.approx(like.volume, rel=1e-5)
    assert mirrored.centroid == pytest.approx(like.centroid * [-1, 1, 1], abs=1e-3)
    assert 0.5 * like.volume < drilled.volume < like.volume
