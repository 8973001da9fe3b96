"""The benchmarks, which are run by hand, can be imported and measure pose differences correctly."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from tactile_loc.core.geometry.rigid import draw_rotations, make_transform, make_translation, rotation_about

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_a_benchmark_can_be_imported(name, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    module = importlib.import_module(name)
    assert callable(module.main)


def test_pose_differences_are_measured_up_to_symmetry(make_box, cylinder, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    sequences = importlib.import_module("sequences")
    rng = np.random.default_rng(9)
    T = make_transform(draw_rotations(6, rng), 0.02 * rng.normal(size=(6, 3)))
    for obj in (make_box(0.03, 0.02, 0.012, symmetry="x2*y2"), cylinder):
        c = obj.mesh.centroid_m
        S = obj.symmetry.list_elements()[-1]
        shifted = (
            make_translation(c)
            @ make_transform(rotation_about([1, 0, 0], 0.02), np.zeros(3))
            @ make_translation(-c)
            @ S
        )
        off = make_translation([0.0, 3e-4, 4e-4]) @ T @ shifted
        shift_m, turn_rad = sequences.measure_pose_differences(obj, off, T)
        assert np.allclose(shift_m, 5e-4, atol=1e-9)
        assert np.allclose(turn_rad, 0.02, atol=1e-3)  # a continuous symmetry is sampled in steps
