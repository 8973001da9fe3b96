import numpy as np
import pytest

from tactile_loc import Localizer, load_object
from tactile_loc.core.places.places import CAMERA
from tactile_loc.locate.sources.listed_grid import build_bank, build_model
from tactile_loc.plugin import Matcher, Progress, Scene, registry
from tactile_loc.plugin.helpers import find_anchor, rotate_patches
from tactile_loc.plugins.encoders.pixel import PixelEncoder
from tactile_loc.plugins.grids.face import FaceGrid
from tactile_loc.plugins.matchers.dense import DenseMatcher
from tactile_loc.plugins.renderers.heightmap import HeightmapRenderer
from tactile_loc.simulate.touch_simulation import simulate_touches


def brute_force(queries: np.ndarray, bank: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    q, b = queries.astype(float), bank.astype(float)
    w = np.ones_like(q) if weights is None else weights.astype(float)
    return np.stack([-0.5 * ((one - b) ** 2 @ known) for one, known in zip(q, w, strict=True)])


@pytest.fixture(scope="module")
def random_bank() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.normal(size=(9, 24)).astype(np.float32), rng.normal(size=(500, 24)).astype(np.float32)


@pytest.fixture(scope="module")
def place_bank(store) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A touch of the whole pin rotated by every third degree, the bank of the pin's places, and the known pixels."""
    localizer = Localizer.create("pin", store=store, grid="whole", sensor="gelsight-mini")
    (touch,) = localizer.simulate(1, seed=3, noise="strong")
    search, press_m = localizer.source.place_search, touch.press_depth_m
    depths_m, seen = rotate_patches(touch, *find_anchor(touch), search.yaws_rad)
    queries, weights = localizer.encoder.encode_seen(depths_m, seen, press_m, CAMERA)
    assert 0.2 < weights.mean() < 0.8
    return queries, localizer.encoder.encode(search.places.depths(press_m, slice(None)), press_m, CAMERA), weights


@pytest.fixture(scope="module")
def real_bank(store, pinhole) -> tuple[np.ndarray, np.ndarray]:
    """Queries of simulated touches, and the bank of the demo pin."""
    scene, sampler = Scene(load_object("pin"), pinhole, HeightmapRenderer()), FaceGrid(FaceGrid.Options(spacing_mm=4.0))
    bank = build_bank(build_model(scene, sampler, store, Progress()), scene, PixelEncoder(), 0.002, store, Progress())
    touches = simulate_touches(sampler, scene, 100, np.random.default_rng(1))
    depths = np.stack([t.contact_shape.depth_m for t in touches])
    return PixelEncoder().encode(depths, 0.002, pinhole), bank


def matcher_of(bank: np.ndarray, **options) -> Matcher:
    pytest.importorskip("faiss")
    matcher = registry().create("matcher", "faiss", options)
    matcher.index(bank)
    return matcher


def dense_of(bank: np.ndarray) -> DenseMatcher:
    matcher = DenseMatcher()
    matcher.index(bank)
    return matcher


@pytest.fixture(params=["real_bank", "place_bank"])
def case(request) -> tuple[np.ndarray, ...]:
    """Queries and a bank without weights, and the same with weights."""
    return request.getfixturevalue(request.param)


def test_faiss_flat_equals_dense_for_the_best_rows(case):
    """The scores agree to 1e-5 of the best rows' scores, the precision of float32 sums."""
    queries, bank, *weights = case
    exact, found = (one.scores(queries, *weights) for one in (dense_of(bank), matcher_of(bank, top_k=50)))
    assert (np.isfinite(found).sum(axis=1) == 50).all()
    for row, scores in zip(exact, found, strict=True):
        kept = np.isfinite(scores)
        np.testing.assert_allclose(scores[kept], row[kept], atol=1e-5 * np.abs(row[kept]).max())
        assert row[kept].min() >= row[~kept].max() - 1e-7, "a better row was left out"


@pytest.mark.parametrize("kind", ["hnsw", "ivf"])
def test_approximate_search_finds_most_of_the_best_rows(case, kind):
    queries, bank, *weights = case
    exact = dense_of(bank).scores(queries, *weights)
    found = matcher_of(bank, kind=kind, effort=32, top_k=200).scores(queries, *weights)
    kept = np.isfinite(found)
    np.testing.assert_allclose(found[kept], exact[kept], atol=1e-6)
    best = np.argsort(-exact, axis=1)[:, :20]
    assert np.take_along_axis(kept, best, axis=1).mean() >= 0.95
    assert 0 < kept.sum() < kept.size


def test_a_bank_far_from_the_origin_costs_weighted_faiss_no_accuracy(random_bank):
    queries, bank = (rows + np.float32(100) for rows in random_bank)
    weights = np.random.default_rng(2).uniform(size=queries.shape).astype(np.float32)
    found = matcher_of(bank).scores(queries, weights)
    np.testing.assert_allclose(found, brute_force(queries, bank, weights), rtol=1e-4)


def test_weighted_and_plain_queries_may_alternate(random_bank):
    queries, bank = random_bank
    matcher, half = matcher_of(bank), np.full_like(queries, 0.5)
    for rows in (bank, bank[:100]):
        matcher.index(rows)
        for _ in range(2):
            np.testing.assert_allclose(matcher.scores(queries), brute_force(queries, rows), atol=1e-4)
            np.testing.assert_allclose(matcher.scores(queries, half), 0.5 * brute_force(queries, rows), atol=1e-4)


def test_a_small_bank_is_indexed_without_output(random_bank, capfd):
    queries, bank = random_bank
    matcher_of(bank[:200], kind="ivf").scores(queries)
    assert capfd.readouterr() == ("", "")
