"""Search of a whole object, with touches from another renderer."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from locate_helpers import draw_examples, locate_together, measure_errors_mm
from message_helpers import naming

from tactile_loc import (
    Localizer,
    PosePosterior,
    RobotTouches,
    StageStore,
    Touch,
    Verdict,
    localize_together,
    make_noise,
)
from tactile_loc.core.poses.priors import GaussianPrior, SeenFrom
from tactile_loc.core.runtime.progress import StageTimes
from tactile_loc.io.config import RunConfig, SlotConfig
from tactile_loc.locate.sources import whole_object as search_module
from tactile_loc.locate.sources.place_search import PlaceSearch, find_highest
from tactile_loc.locate.sources.whole_object import search_together
from tactile_loc.plugin import ConfigError, View, registry
from tactile_loc.plugin.helpers import find_anchor, invert, make_transform, make_translation, rotation_about

WHOLE = {"grid": {"name": "whole"}, "sensor": {"name": "gelsight-mini", "gel": "rigid"}}


@pytest.fixture(scope="module")
def localizer(store) -> Localizer:
    return Localizer.create("pin", store=store, **WHOLE)


@pytest.fixture(scope="module")
def search(localizer) -> PlaceSearch:
    return localizer.source.place_search


@pytest.fixture(scope="module")
def examples(localizer) -> list[list[Touch]]:
    return draw_examples(localizer, 21, 8)


def test_the_whole_object_is_searched_by_default():
    config = RunConfig()
    assert config.grid.name == "whole"
    assert config.encoder.options == {"signal": "depth", "cells": 16}
    assert config.refiner.name == "joint"
    assert RunConfig(grid="face").encoder.options == {}
    assert RunConfig(grid="face").refiner.name == "joint"
    assert RunConfig(refiner="icp").refiner.name == "icp"
    assert RunConfig(grid={"name": "hopf"}).encoder.name == "pixel"
    assert RunConfig(encoder={"name": "pixel", "cells": 9}).encoder.options == {"cells": 9}


@pytest.mark.slow
def test_the_search_finds_the_true_pose(localizer, search, examples):
    touches = [touch for example in examples for touch in example]
    nearest = [measure_errors_mm(localizer, search.score(t, StageTimes())[0].T_sensor_object, t).min() for t in touches]
    assert np.mean(np.array(nearest) < 1.0) > 0.8


def test_three_touches_from_any_side_locate_the_object(localizer, examples):
    best = [locate_together(localizer, some).best.T_sensor_object[None] for some in examples]
    errors = [measure_errors_mm(localizer, T, some[0])[0] for T, some in zip(best, examples, strict=True)]
    assert np.median(errors) < 0.1
    assert np.mean(np.array(errors) < 0.5) >= 0.75


def test_found_poses_explain_the_touch_and_are_listed_once_and_found_again(localizer, search, examples):
    touch = examples[0][0]
    grid, ious = search.score(touch, StageTimes())
    exact = View(touch, localizer.scene.match_touch(touch)).imprint_ious(grid.T_sensor_object)
    assert np.abs(exact - ious).max() < 0.2  # the search renders coarsely
    assert ious.max() > 0.9
    apart_m = grid.neighbour_spacing()
    assert apart_m.min() >= 0.5e-3 - 1e-9
    again, _ = search.score(touch, StageTimes())
    assert np.array_equal(again.T_sensor_object, grid.T_sensor_object)


def test_places_are_built_once(tmp_path, monkeypatch):
    from tactile_loc.plugins.grids.whole import WholeGrid

    few = {**WHOLE, "grid": {"name": "whole", "directions": 100}}
    first = Localizer.create("pin", store=StageStore(tmp_path), **few)
    found = first.places
    monkeypatch.setattr(WholeGrid, "places", None)  # the sampler is not used again
    again = Localizer.create("pin", store=StageStore(tmp_path), **{**few, "sensor": "gelslim"})
    assert np.array_equal(found.patches, again.places.patches)
    assert again.source.place_search.key.digest == first.source.place_search.key.digest


def together(localizer: Localizer, some: list[Touch]) -> Sequence[PosePosterior]:
    return localizer.source.search(localizer.make_views(some), [localizer.source] * len(some), StageTimes())


def test_several_touches_are_compared_at_the_same_poses(localizer, examples):
    some = examples[0][:2]
    first, second = together(localizer, some)
    T = np.linalg.inv(np.asarray(some[1].T_base_sensor)) @ np.asarray(some[0].T_base_sensor)
    assert 1 < len(first.grid) <= localizer.config.search.registered_together
    assert T @ first.grid.T_sensor_object == pytest.approx(second.grid.T_sensor_object)
    assert locate_together(localizer, some).posterior.touches == 2


@pytest.mark.slow
def test_poses_that_start_beside_the_true_pose_are_found_if_they_are_moved_first(localizer, examples, store):
    pairs = [[some[k], some[(k + 1) % 3]] for some in examples for k in range(3)]
    found = []
    for count in (1, 200):
        few = {"registered_together": 1, "moved_together": count, "wide_below_iou": 0.0}
        search = Localizer.create("pin", store=store, search=few, **WHOLE).source.place_search
        nearest = [measure_errors_mm(localizer, search_pair(localizer, search, pair), pair[0]).min() for pair in pairs]
        found.append(np.mean(np.array(nearest) < 1.0))
    assert found[1] > found[0] + 0.1


def misplace(touches: list[Touch], number: int) -> list[Touch]:
    """Return touches of which one has a wrong sensor pose, so that no pose explains all of them."""
    wrong = make_transform(rotation_about([0, 0, 1], np.radians(10)), [5e-3, 0, 0])
    moved = dataclasses.replace(touches[number], T_base_sensor=np.asarray(touches[number].T_base_sensor) @ wrong)
    return [*touches[:number], moved, *touches[number + 1 :]]


def test_batches_find_what_registering_all_poses_at_once_finds(localizer, examples, store):
    at_once = {"moved_together": 400, "registered_together": 400, "registered_widely": 400}
    full = Localizer.create("pin", store=store, search=at_once, **WHOLE).source.place_search
    for some in examples[:2]:
        views = localizer.make_views(misplace(some, 2))
        batches, everything = (
            search_together(views, [one] * 3, StageTimes()) for one in (localizer.source.place_search, full)
        )
        assert len(batches[0]) < len(everything[0])
        assert batches[1].mean(axis=1).max() > everything[1].mean(axis=1).max() - 0.03


def test_no_further_batch_follows_one_without_a_better_pose(localizer, examples, monkeypatch):
    some = misplace(examples[0], 2)
    views, given = localizer.make_views(some), []
    register = search_module._register

    def note(views, search, poses, kept=None):
        found = register(views, search, poses, kept)
        given.append((len(poses), found[1].mean(axis=1).max()))
        return found

    monkeypatch.setattr(search_module, "_register", note)
    search_together(views, [localizer.source.place_search] * 3, StageTimes())
    counts, best = zip(*given, strict=True)
    assert set(counts) == {localizer.config.search.moved_together}
    assert len(counts) < localizer.config.search.registered_widely / localizer.config.search.moved_together
    assert best[-1] <= max(best[:-1])
    assert all(later > max(best[:number]) for number, later in enumerate(best[1:-1], 1))


@pytest.mark.parametrize("wrong", [0, 2])
def test_trials_that_end_early_change_no_result(localizer, examples, monkeypatch, wrong):
    found = []
    for unpromising in (0.0, search_module.UNPROMISING):
        monkeypatch.setattr(search_module, "UNPROMISING", unpromising)
        some = [misplace(one, wrong) for one in examples[:2]]
        found.append([locate_together(localizer, touches) for touches in some])
    for slow, fast in zip(*found, strict=True):
        assert fast.agreement.outliers == slow.agreement.outliers
        np.testing.assert_array_equal(fast.best.T_sensor_object, slow.best.T_sensor_object)
    named = [one.agreement.outliers == (wrong,) for one in found[1]]
    assert all(named)


def search_pair(localizer: Localizer, search: PlaceSearch, pair: list[Touch]) -> np.ndarray:
    views = localizer.make_views(pair)
    return search_together(views, [search] * 2, StageTimes())[0]


def test_a_pose_far_from_many_nearer_ones_is_registered_to_several_touches(localizer, search, examples):
    some = examples[0]
    views = localizer.make_views(some)
    steps_m = 1.6e-3 * np.arange(-3, 4)  # poses as far apart as the search keeps them
    shifts_m = np.stack(np.meshgrid(steps_m, steps_m, steps_m), axis=-1).reshape(-1, 3)
    beside = np.stack([make_translation(shift_m) for shift_m in shifts_m]) @ np.asarray(some[0].T_sensor_object)
    far = make_translation([0.0, 0.02, 0.0]) @ np.asarray(some[0].T_sensor_object)
    poses, moved = np.concatenate([beside, far[None]]), search.options.moved_together
    assert search_module.estimate_surface_distances(views, poses).argmax() == len(poses) - 1
    ranks = []
    for spread in (moved // 2, 0):
        kept = search_module._keep_nearest(views, search, poses, spread, len(poses))
        assert len(kept) == len(poses)
        ranks.append(int(np.abs(kept - far).max(axis=(1, 2)).argmin()))
    assert ranks[0] < moved / 2
    assert ranks[1] > moved


@pytest.mark.slow
def test_two_touches_that_two_poses_explain_are_ambiguous(store):
    """The hook turned by half a turn explains both touches perfectly, and starts nearer to them than the true pose."""
    localizer = Localizer.create("hook", store=store, sensor={"name": "gelsight-mini", "image_size_px": [160, 120]})
    source = RobotTouches(localizer.object, localizer.scene.geometry, registry().create("renderer", "zbuffer", {}))
    touches, _ = source.draw_example(2, np.random.default_rng([77, 274]))
    found = locate_together(localizer, touches)
    assert found.verdict is Verdict.AMBIGUOUS
    explaining = np.stack([h.T_sensor_object for h in found.equal_explanations])
    errors_mm = measure_errors_mm(localizer, explaining, touches[0])
    assert errors_mm.min() < 0.1
    assert errors_mm.max() > 10


def test_touches_that_no_pose_explains_together_are_never_certain(localizer, examples):
    placed = [touch.T_base_sensor for touch in examples[0]]
    moved = [dataclasses.replace(examples[k][k], T_base_sensor=T) for k, T in enumerate(placed)]
    agreeing, wrong = locate_together(localizer, examples[0]), locate_together(localizer, moved)
    assert wrong.outcome.right < min(0.5, agreeing.outcome.right)
    assert wrong.verdict not in (Verdict.CERTAIN, Verdict.AMBIGUOUS)


def test_the_deepest_point_is_the_anchor(examples):
    touch = examples[0][0]
    (x, y, z), R_sensor_gel = find_anchor(touch)
    assert (R_sensor_gel == np.eye(3)).all()
    assert z == touch.geometry.standoff_m
    points = touch.geometry.backproject(touch.contact_shape.depth_m + touch.geometry.standoff_m)
    deepest = points[np.unravel_index(touch.contact_shape.depth_m.argmin(), touch.contact_shape.depth_m.shape)]
    assert (x, y) == pytest.approx(deepest[:2], abs=1e-4)


@pytest.mark.parametrize("count", [1, 40, 5000, 100_000])
def test_the_highest_scores_are_found_in_any_order_without_those_of_minus_infinity(count):
    rng = np.random.default_rng(count)
    for scores in (rng.normal(size=(40, 1000)), np.sort(rng.normal(size=40_000)).reshape(40, 1000), np.zeros((8, 100))):
        found = scores[find_highest(scores.astype(np.float32), count)]
        assert sorted(found) == pytest.approx(np.sort(scores, axis=None)[-count:], abs=1e-6)
    excluded = np.full((10, 100), -np.inf, np.float32)
    excluded[3, 5] = -1.0
    assert [part.tolist() for part in find_highest(excluded, count)] == [[3], [5]]


def test_mixing_searched_and_listed_touches_is_refused(localizer, examples, store):
    listed = Localizer.create("pin", store=store, sensor="gelsight-mini", grid={"name": "face", "spacing_mm": 8})
    with pytest.raises(ConfigError, match="whole"):
        localize_together([(localizer, examples[0][0]), (listed, examples[0][1])])


@pytest.mark.slow
def test_a_trainable_encoder_trains_once_and_keeps_its_banks(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    from tactile_loc.plugins.encoders.moco import training

    monkeypatch.setattr(training, "VALIDATION_TOUCHES", 32)
    learned = {"name": "moco", "epochs": 1, "queries": 64, "batch": 32, "channels": 4}
    settings = {"grid": {"name": "whole", "directions": 100}, "sensor": "gelsight-mini", "temperature": 0.02}
    store = StageStore(tmp_path)
    first = Localizer.create("pin", store=store, encoder=learned, **settings)
    touch = first.simulate(1)[0]
    found = first.posterior(touch)
    assert [key.stage for key in store.built].count("encoder") == 1
    built = list(store.built)
    again = Localizer.create("pin", store=store, encoder=learned, **settings)
    np.testing.assert_array_equal(again.posterior(touch).log_p, found.log_p)
    assert store.built == built
    other = Localizer.create("pin", store=store, encoder={**learned, "seed": 1}, **settings)
    assert other.source.trained != again.source.trained


@pytest.mark.parametrize("options", [{}, {"kind": "ivf"}, {"kind": "hnsw"}], ids=str)
def test_faiss_finds_the_rotated_places_that_dense_finds(localizer, search, examples, options):
    pytest.importorskip("faiss")
    other = Localizer(with_faiss(localizer.config, **options), localizer.object, localizer.store).source.place_search
    assert other is not None
    for touch in examples[0]:
        exact, found = (one.alike(touch, 1000) for one in (search, other))
        missed = len(exact[1]) - len(common(exact[0], found[0]))
        assert missed <= (2 if not options else 30)  # of 1000; places with equal scores may be exchanged
        assert found[1].max() == pytest.approx(exact[1].max(), abs=1e-5)


def test_a_top_k_matcher_proposes_only_the_poses_that_it_scores(localizer, examples):
    pytest.importorskip("faiss")
    few = Localizer(with_faiss(localizer.config, top_k=3), localizer.object, localizer.store).source.place_search
    assert few is not None
    poses, scores = few.alike(examples[0][0], 1000)
    assert len(poses) == len(scores) == 3 * len(few.yaws_rad)
    assert np.isfinite(scores).all()
    grid, ious = few.score(examples[0][0], StageTimes())
    assert len(grid) == len(ious) > 0


def with_faiss(config: RunConfig, **options: object) -> RunConfig:
    return config.model_copy(update={"matcher": SlotConfig(name="faiss", options=options)})


def common(first: np.ndarray, second: np.ndarray) -> set:
    """Return the poses that are in both lists."""
    one, other = ({tuple(T.ravel().round(9)) for T in poses} for poses in (first, second))
    return one & other


@pytest.fixture(scope="module")
def noisy(localizer) -> list[Touch]:
    return [touch for (touch,) in draw_examples(localizer, 31, 32, 1, make_noise("mild"))]


def near(touch: Touch, rng: np.random.Generator) -> GaussianPrior:
    """Return a prior that knows a pose to about 2 mm and 4 degrees."""
    truth = np.asarray(touch.T_sensor_object)
    turn = make_transform(rotation_about(rng.normal(size=3), np.radians(4)), np.zeros(3))
    middle = make_translation(truth[:3, 3])
    return GaussianPrior(
        make_translation(2e-3 * rng.normal(size=3)) @ middle @ turn @ invert(middle) @ truth, 3e-3, 0.1
    )


@pytest.mark.slow
def test_a_prior_guides_the_search(localizer, search, noisy):
    rng, found = np.random.default_rng(4), {"alone": [], "guided": []}
    for touch in noisy:
        for name, prior in (("alone", None), ("guided", near(touch, rng))):
            poses = search.score(touch, StageTimes(), prior)[0].T_sensor_object
            found[name].append(measure_errors_mm(localizer, poses, touch).min())
    assert np.mean(found["guided"]) < 0.75 * np.mean(found["alone"])


def test_a_prior_of_several_touches_applies_in_the_frame_of_the_first_sensor(localizer, search, examples):
    touches = examples[2]
    views = localizer.make_views(touches)
    prior = near(touches[0], np.random.default_rng(5))
    for view in views:
        _, (poses, _) = search.propose(view.touch, 200, SeenFrom(prior, invert(view.T_sensor_first)))
        likely = prior(invert(view.T_sensor_first) @ poses)
        assert (np.diff(likely) <= 1e-9).all()  # the most probable pose comes first
        others = prior(invert(view.T_sensor_first) @ search.propose(view.touch, 200)[0][0])
        assert np.median(likely) > np.median(others)
    found, _ = search_together(views, [search] * 3, StageTimes(), prior)
    assert measure_errors_mm(localizer, found, touches[0]).min() < 1.0


def test_an_all_excluding_prior_is_ignored_and_an_invalid_prior_is_refused(search, examples):
    touch = examples[0][0]
    (alone,) = search.propose(touch, 100, lambda poses: np.full(len(poses), -np.inf))
    assert len(alone[0]) == 100
    with pytest.raises(ConfigError, match=naming("()", 30000, "(N,)")):
        search.score(touch, StageTimes(), lambda poses: 0.0)
