"""The benchmarks, which are run by hand, can be imported. Their poses, altered surfaces and parts are what they state.

The distances of altered surfaces come from an independent closest-point computation.
"""

import importlib
from pathlib import Path

import bench
import numpy as np
import pytest
import trimesh
from trimesh.triangles import closest_point

from tactile_loc import SensorGeometry, TriangleMesh
from tactile_loc.plugin.helpers import draw_rotations, make_transform, make_translation, rotation_about

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(BENCHMARKS)
    outside, sequences = (importlib.import_module(name) for name in ("outside", "sequences"))

GEOMETRY = SensorGeometry("orthographic", 64, 48, 3200.0, 3200.0, 32.0, 24.0, 0.010, 0.002)


@pytest.mark.parametrize("name", bench.list_benchmarks())
def test_a_benchmark_can_be_imported(name, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    module = importlib.import_module(name)
    assert callable(module.main)


def test_pose_differences_are_measured_up_to_symmetry(make_box, cylinder):
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


def meshed(solid: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.array(solid.vertices), np.array(solid.faces, np.int64))


def distances_m(points: np.ndarray, mesh: TriangleMesh) -> np.ndarray:
    """The distances (P,) of points (P, 3) from a surface, by brute force over its triangles."""
    triangles = mesh.triangles_m
    return np.array([np.linalg.norm(closest_point(triangles, np.tile(p, (len(triangles), 1))) - p, axis=1).min()
                     for p in points])  # fmt: skip


@pytest.fixture
def box() -> TriangleMesh:
    return meshed(trimesh.creation.box((0.020, 0.012, 0.008)))


@pytest.mark.parametrize("rms_m", [5e-5, 1e-4])
def test_a_scan_has_the_requested_rms_error(box, rms_m):
    rng = np.random.default_rng(0)
    found = outside.simulate_scan(box, rms_m, 2e-3, rng)
    off_m = distances_m(found.sample(600, rng), box)
    assert np.sqrt(np.mean(off_m**2)) == pytest.approx(rms_m, rel=0.15)
    assert off_m.max() < 4.5 * rms_m


def test_scan_errors_are_correlated_over_the_correlation_length(box):
    """The correlation on the top face is exp(-1/2) at one correlation length and about 0 at four."""
    covariances = np.zeros(3)
    for seed in range(6):
        found = outside.simulate_scan(box, 1e-4, 2e-3, np.random.default_rng(seed))
        top = found.vertices_m[
            (found.vertices_m[:, 2] > 0.0035) & (np.abs(found.vertices_m[:, :2]) < [0.009, 0.005]).all(1)
        ]
        height, apart = (top[:, 2] - 0.004) / 1e-4, np.linalg.norm(top[:, None, :2] - top[None, :, :2], axis=-1)
        products = height[:, None] * height
        covariances += [products[np.abs(apart - at) < 2e-4].mean() / 6 for at in (0, 2e-3, 8e-3)]
    assert covariances[0] == pytest.approx(1, abs=0.35)
    assert covariances[1] / covariances[0] == pytest.approx(np.exp(-0.5), abs=0.2)
    assert abs(covariances[2] / covariances[0]) < 0.35


def test_decimation_nearly_reaches_the_permitted_error():
    ball = meshed(trimesh.creation.icosphere(4, 0.010))
    found = outside.decimate(ball, 1e-4, np.random.default_rng(0))
    assert len(found.faces) < len(ball.faces) / 4
    off_m = distances_m(ball.sample(500, np.random.default_rng(1)), found)
    assert 0.6e-4 < np.sqrt(np.mean(off_m**2)) < 1.1e-4


def test_unseen_noise_has_the_documented_rates():
    rng = np.random.default_rng(0)
    clean = np.full((30, *GEOMETRY.shape), 2e-3, np.float32)
    clean[:, 10:40, 10:50] = 5e-4
    noisy = outside.UnseenNoise().corrupt(clean, np.full(30, 1e-3), GEOMETRY, rng)
    contact, inside = noisy < np.float32(1e-3), clean < 1e-3
    assert contact[inside].mean() == pytest.approx(0.95, abs=0.01)
    assert contact[~inside].mean() == pytest.approx(0.001, abs=0.0005)
    drift = np.where(contact & inside, noisy - clean, np.nan)
    assert np.nanmax(np.abs(drift)) < 3e-4
    assert np.nanmean(np.abs(drift[:, 20, 20:22])) > 1e-6
    assert np.nanmedian(np.abs(np.diff(drift, axis=2))) < 5e-6, "smooth"
    assert 2e-5 < np.sqrt(np.nanmean(drift**2)) < 8e-5


@pytest.fixture(scope="module")
def parts():
    pytest.importorskip("manifold3d")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        return importlib.import_module("generated_parts")


def test_generated_parts_are_solids_of_the_size_of_machine_parts(parts):
    for family in parts.EVERY:
        for number in (0, 1, 2, 3, 1210, 1582):
            mesh = parts.make_mesh(f"{family}-{number:05d}")
            assert mesh.volume > 50  # mm^3
            assert 8 < mesh.extents.max() < 100


def test_a_name_determines_the_shape(parts):
    one, again, other = (parts.make_mesh(name) for name in ("cam-00002", "cam-00002", "cam-00003"))
    assert np.array_equal(one.vertices, again.vertices)
    assert one.volume != pytest.approx(other.volume)


def test_some_parts_are_mirror_images_or_have_a_hole_more(parts):
    like, mirrored, drilled = (parts.make_mesh(f"cam-{n:05d}") for n in (1, 8, 9))
    assert mirrored.volume == pytest.approx(like.volume, rel=1e-5)
    assert mirrored.centroid == pytest.approx(like.centroid * [-1, 1, 1], abs=1e-3)
    assert 0.5 * like.volume < drilled.volume < like.volume
