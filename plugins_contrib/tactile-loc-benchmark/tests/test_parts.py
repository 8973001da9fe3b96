"""The held-out parts in the package are those that the script draws, and any direction of touch makes sense."""

import importlib
from pathlib import Path

import numpy as np
import pytest
import trimesh

import tactile_loc_benchmark
from tactile_loc_benchmark.suite import read_split

FOLDER = Path(tactile_loc_benchmark.__file__).parent / "suites" / "parts"
PARTS = sorted(path.stem for path in FOLDER.glob("*.ply"))


def test_the_script_draws_the_same_surfaces(tmp_path):
    pytest.importorskip("manifold3d", reason="drawing the parts needs manifold3d")
    for path in importlib.import_module("benchmark_parts").write_all(tmp_path):
        drawn, shipped = trimesh.load_mesh(path), trimesh.load_mesh(FOLDER / path.name)
        assert drawn.volume == pytest.approx(shipped.volume, rel=1e-6)
        np.testing.assert_allclose(drawn.bounds, shipped.bounds, atol=1e-7)


@pytest.mark.parametrize("name", PARTS)
def test_parts_are_solid_and_of_a_hand_s_size(name):
    mesh = trimesh.load_mesh(FOLDER / f"{name}.ply")
    assert mesh.is_watertight
    assert len(mesh.split()) == 1
    assert 0.02 < mesh.extents.max() < 0.06


def test_the_split_lists_every_part():
    assert [Path(table["path"]).stem for table in read_split("held-out")] == PARTS
