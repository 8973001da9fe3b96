import dataclasses
import pickle
import time

import numpy as np
import pytest
import trimesh
from locate_helpers import list_poses, measure_errors_mm
from message_helpers import missing, naming

from tactile_loc.core.geometry.rigid import invert, make_transform, make_translation, rotation_about, transform_points
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.poses.tolerance import measure_shape_distances
from tactile_loc.core.runtime.errors import ConfigError, GridError, TouchError
from tactile_loc.core.sensing.touch import ContactShape, Touch
from tactile_loc.evaluation.metrics import compute_nees
from tactile_loc.io.meshes.mesh_files import load_object
from tactile_loc.locate.localizer import Localizer
from tactile_loc.locate.result.localization import Localization
from tactile_loc.locate.result.located_frame import LocatedFrame
from tactile_loc.locate.result.verdict import Verdict
from tactile_loc.locate.several_touches import localize_together
from tactile_loc.locate.sources import scoring
from tactile_loc.locate.sources.scoring import FEWEST_MATCHERS
from tactile_loc.slots.component import Capabilities
from tactile_loc.store.store import StageStore

SMALL = {"shape_px": 60, "sensor": {"name": "gelslim", "image_size_px": [100, 100], "gel": "rigid"}}
AMPLE = {"name": "face", "min_contact_percent": 2.0}  # enough contact to locate the object
FINE = {**SMALL, "grid": {**AMPLE, "spacing_mm": 3.0}}
MINI = {"name": "gelsight-mini", "image_size_px": [100, 75]}
COARSE = {**SMALL, "grid": {**AMPLE, "spacing_mm": 7.0}}


@pytest.fixture(scope="module")
def pin(store: StageStore) -> Localizer:
    return Localizer.create("pin", store=store, **FINE)


@pytest.fixture(scope="module")
def coarse(store: StageStore) -> Localizer:
    return Localizer.create("pin", store=store, **COARSE)


@pytest.fixture(scope="module")
def touches(pin: Localizer) -> list[Touch]:
    return pin.simulate(12, seed=1)


def errors_mm(localizer: Localizer, touch: Touch, found: Localization) -> np.ndarray:
    return measure_errors_mm(localizer, list_poses(found), touch)


def test_the_hypotheses_contain_the_true_pose_and_a_certain_result_is_right(pin, touches):
    found = [(pin.localize(t), t) for t in touches]
    nearest = [errors_mm(pin, t, f).min() for f, t in found]
    assert np.median(nearest) < 0.3, "the error exceeds a tenth of the grid's spacing"
    assert np.mean(np.array(nearest) < 1.0) >= 0.8
    best = [errors_mm(pin, t, f)[0] for f, t in found if f.normalised_entropy < 0.1]
    assert len(best) >= 3
    assert np.median(best) < 0.3
    assert max(best) < 1.5


def test_lighter_presses_are_located(pin):
    for press_m in (0.001, 0.00113):
        touches = pin.simulate(10, seed=1, press_depth_m=press_m)
        nearest = [errors_mm(pin, t, pin.localize(t)).min() for t in touches]
        assert np.median(nearest) < 0.6


def test_a_sphere_has_one_pose(store, tmp_path):
    trimesh.creation.icosphere(4, 0.008).export(tmp_path / "ball.stl")
    ball = Localizer.create(tmp_path / "ball.stl", units="m", store=store, **{**SMALL, "temperature": 0.03})
    (touch,) = ball.simulate(1, seed=3)
    found = ball.localize(touch)
    assert len(found.hypotheses) == 1
    assert found.verdict is Verdict.CERTAIN
    assert errors_mm(ball, touch, found)[0] < 0.05


def test_a_result_is_sorted_and_complete(pin, touches):
    found = pin.localize(touches[0], top=4)
    assert found.touch is touches[0]
    assert found.posterior.probabilities.sum() + found.posterior.elsewhere == pytest.approx(1.0)
    p = [h.probability for h in found.hypotheses]
    assert 1 <= len(p) <= 4
    assert p == sorted(p, reverse=True)
    assert 0 < sum(p) <= 1 + 1e-9
    assert found.best is found.hypotheses[0]
    assert 0 <= found.normalised_entropy <= 1
    assert set(found.seconds) == {"encode", "match", "fuse", "modes", "refine", "choose"}
    assert all(s >= 0 for s in found.seconds.values())
    for h in found.hypotheses:
        assert np.array_equal(h.T_sensor_object_grid, pin.model.grid.T_sensor_object[h.grid_index])
        assert h.grid_poses >= 1


def test_a_frame_without_contact_is_a_result(pin):
    for touches in (None, [], [None, None]):
        found = pin.locate(touches, time_s=12.5)
        assert found.verdict is Verdict.NO_CONTACT
        assert found.T_sensor_object is found.T_base_object is None
        assert found.time_s == 12.5
        assert str(found).splitlines() == [f"no contact at 12.500 s: {found.says}"]


def test_a_frame_that_no_pose_explains_is_a_result(pin, touches, monkeypatch):
    def fail(*_, **__):
        raise GridError("no pose fits")

    monkeypatch.setattr(pin, "localize", fail)
    found = pin.find_most_probable_pose(touches[:1])
    assert found.verdict is Verdict.NOT_FOUND
    assert found.says == "no pose fits"


def test_a_located_frame_has_the_pose_in_the_base_frame_and_one_line(pin, touches):
    T = make_translation([0.3, 0.0, 0.1])
    given = dataclasses.replace(touches[1], T_base_sensor=T)
    whole, before = pin.localize(given), time.time()
    found = pin.locate([None, given])
    assert before <= found.time_s <= time.time()
    assert np.array_equal(found.T_base_object, whole.T_base_object)
    assert np.array_equal(found.base_covariance, whole.best.base_covariance)
    assert len(found.probabilities) == len(whole.hypotheses)
    (line,) = str(found).splitlines()
    assert not missing(line, str(found.verdict), f"{found.time_s:.3f} s", "base frame")
    assert len(str(dataclasses.replace(found, T_base_object=None, says="x\ny")).splitlines()) == 1


def test_a_touch_is_found_in_depths_if_there_is_contact(pin, touches):
    given = Localizer.create("pin", store=pin.store, **COARSE, touch={"unit": "mm", "kind": "indentation"})
    shape, T = touches[1].contact_shape, make_translation([0.3, 0.0, 0.1])
    indentation_mm = 1e3 * (shape.press_depth_m - shape.depth_m)
    touch = given.find_touch(indentation_mm, T, "left")
    assert touch.name == "left"
    assert np.array_equal(touch.T_base_sensor, T)
    np.testing.assert_allclose(1e3 * (touch.press_depth_m - touch.contact_shape.depth_m), indentation_mm, atol=1e-4)
    assert given.find_touch(np.zeros_like(indentation_mm)) is None
    with pytest.raises(TouchError):
        given.find_touch(indentation_mm[:5])


def test_touches_of_several_sensors_are_located_by_either_localizer(store):
    slim = Localizer.create("pin", store=store, **COARSE)
    mini = slim.for_sensor(MINI)
    assert mini is slim.for_sensor(MINI) is mini.for_sensor(MINI)
    assert mini.for_sensor(SMALL["sensor"]) is slim
    placed = [
        dataclasses.replace(one, T_base_sensor=invert(one.T_sensor_object))
        for one in (slim.simulate(1, seed=4)[0], mini.simulate(1, seed=5)[0])
    ]
    expected = localize_together([(slim, placed[0]), (mini, placed[1])]).best.T_sensor_object
    for localizer in (slim, mini, pickle.loads(pickle.dumps(slim))):
        assert np.array_equal(localizer.localize(placed).best.T_sensor_object, expected)
    alone = Localizer.create("pin", store=store, **COARSE)
    with pytest.raises(TouchError, match=naming("gelslim", "for_sensor")):
        alone.localize(placed)


def test_a_touch_at_a_grid_pose_is_matched_to_it(pin):
    for index in (10, pin.model.size // 2, pin.model.size - 5):
        T = pin.model.grid.T_sensor_object[index]
        touch = Touch(pin.scene.contact_shape(T, 0.002), pin.scene.geometry)
        posterior = pin.posterior(touch)
        assert posterior.probabilities[index] >= 0.3 * posterior.probabilities.max()


def test_a_region_prior_keeps_the_poses_in_the_region_and_an_excluding_one_is_refused(pin, touches):
    metric, touch = pin.model.grid.metric, touches[0]
    wrong = pin.model.grid.T_sensor_object[int(pin.posterior(touch).log_p.argmin())]

    def near_wrong(T):
        return np.where(metric.symmetric_distance(T, np.broadcast_to(wrong, T.shape)) < 0.008, 0.0, -np.inf)

    found = pin.localize(touch, prior=near_wrong)
    excluded = near_wrong(found.posterior.grid.T_sensor_object) == -np.inf
    assert 0 < (~excluded).sum() < 500
    assert not found.posterior.probabilities[excluded].any()
    assert found.posterior.probabilities.sum() + found.posterior.elsewhere == pytest.approx(1.0)
    for h in found.hypotheses:
        assert not excluded[h.grid_index]
    with pytest.raises(GridError, match="prior"):
        pin.localize(touch, prior=lambda T: np.full(len(T), -np.inf))


@pytest.mark.slow
def test_the_same_seed_gives_the_same_result(coarse, tmp_path):
    other = Localizer.create("pin", store=StageStore(tmp_path / "own"), **COARSE)
    for a, b in zip(coarse.simulate(2, seed=3), other.simulate(2, seed=3), strict=True):
        assert np.array_equal(a.T_sensor_object, b.T_sensor_object)
        first, second = coarse.localize(a), other.localize(b)
        np.testing.assert_array_equal(first.posterior.log_p, second.posterior.log_p)
        for h, k in zip(first.hypotheses, second.hypotheses, strict=True):
            assert h.grid_index == k.grid_index
            np.testing.assert_array_equal(h.T_sensor_object, k.T_sensor_object)
    assert not np.allclose(coarse.simulate(1, seed=3)[0].T_sensor_object, coarse.simulate(1, seed=4)[0].T_sensor_object)


@pytest.fixture(scope="module")
def pin_files(tmp_path_factory):
    """The demo pin in metres, in millimetres, and in metres in another frame."""
    folder = tmp_path_factory.mktemp("pins")
    mesh = load_object("pin").mesh
    X = make_transform(rotation_about([1, 2, 0.5], 1.1), [0.03, -0.02, 0.01])
    moved = transform_points(X, mesh.vertices_m)
    for name, vertices in (("m", mesh.vertices_m), ("mm", mesh.vertices_m * 1e3), ("moved", moved)):
        trimesh.Trimesh(vertices, mesh.faces, process=False).export(folder / f"{name}.off", digits=12)
    return folder, X


def test_metres_and_millimetres_give_the_same_poses(pin_files, store):
    folder, _ = pin_files
    metres, milli = (
        Localizer.create(folder / f"{unit}.off", units=unit, symmetry="z2", store=store, **COARSE)
        for unit in ("m", "mm")
    )
    np.testing.assert_allclose(metres.model.grid.T_sensor_object, milli.model.grid.T_sensor_object, atol=1e-8)
    (touch,) = metres.simulate(1, seed=6)
    assert touch.contact_shape.contact.mean() > 0.1, (
        "the contact is narrow, so rounding decides the rotation of the pin"
    )
    a, b = metres.localize(touch), milli.localize(touch)
    np.testing.assert_allclose(a.posterior.probabilities, b.posterior.probabilities, atol=1e-3)
    assert a.best.grid_index == b.best.grid_index
    np.testing.assert_allclose(a.best.T_sensor_object, b.best.T_sensor_object, atol=1e-4)


@pytest.mark.slow
def test_the_frame_of_the_mesh_does_not_matter(pin_files, store):
    """A mesh of the part in another frame gives the same pose of the part."""
    folder, X = pin_files
    here, there = (
        Localizer.create(folder / f"{name}.off", units="m", symmetry="none", store=store, temperature=0.01, **FINE)
        for name in ("m", "moved")
    )
    metric, touches = PoseMetric(load_object("pin")), here.simulate(12, seed=1)
    for localizer, frame in ((here, np.eye(4)), (there, X)):
        gaps_mm = []
        for touch in touches:
            found = np.stack([h.T_sensor_object @ frame for h in localizer.localize(touch).hypotheses])
            true = np.broadcast_to(touch.T_sensor_object, found.shape)
            gaps_mm.append(1e3 * metric.symmetric_distance(found, true).min())
        assert np.median(gaps_mm) < 0.1


def test_banks_are_kept_by_press_depth_and_the_touch_is_cut_at_that_of_its_bank(coarse):
    """A press between the depths of two banks is compared at the lighter depth."""
    assert coarse.listed.matcher(0.001) is coarse.listed.matcher(0.00109), "banks have steps of 0.1 mm"
    assert coarse.listed.matcher(0.001) is coarse.listed.matcher(0.001 - 1e-12), "a rounding error changed the bank"
    assert coarse.listed.matcher(0.001) is not coarse.listed.matcher(0.00112)
    (touch,) = coarse.simulate(1, seed=6, press_depth_m=0.00114)
    lighter = Touch(touch.contact_shape.press_to(0.0011), touch.geometry)
    np.testing.assert_array_equal(coarse.posterior(touch).log_p, coarse.posterior(lighter).log_p)


def test_a_press_just_below_a_step_has_the_same_result(coarse):
    """Pixels without contact lie at the press depth exactly; the bank must not count them as contact."""
    exact = coarse.simulate(1, seed=6, press_depth_m=0.0005)[0]
    below_m = 0.0005 * (1 - 9e-8)
    shape = ContactShape(np.minimum(exact.contact_shape.depth_m, np.float32(below_m)), below_m)
    assert np.float32(below_m) < np.float32(0.0005)
    touch = Touch(shape, exact.geometry)
    np.testing.assert_allclose(coarse.posterior(touch).log_p, coarse.posterior(exact).log_p, atol=1e-2)


def test_an_encoder_with_one_bank_gets_the_press_depth_of_the_touch(coarse, store):
    localizer = Localizer.create("pin", store=store, temperature=1e-3, **COARSE)
    told: list[float] = []

    class Fixed(type(localizer.encoder)):
        capabilities = Capabilities(follows_press_depth=False)

        def encode(self, depth_m, press_depth_m, geometry):
            told.append(press_depth_m)
            return super().encode(depth_m, press_depth_m, geometry)

    localizer.encoder = Fixed(localizer.encoder.options)
    (touch,) = localizer.simulate(1, seed=7, press_depth_m=0.001)
    localizer.posterior(touch)
    assert localizer.listed.matcher(0.001) is localizer.listed.matcher(0.002), "the encoder has more than one bank"
    assert told[-1] == pytest.approx(0.001)
    assert set(told[:-1]) <= {0.002}


def test_a_touch_with_half_the_pixels_has_the_same_result(pin, touches):
    """The touch carries its geometry, so half the pixels describe the same touch."""
    touch = touches[3]
    half = Touch(touch.contact_shape.subsample(2), touch.geometry.subsample(2), T_sensor_object=touch.T_sensor_object)
    a, b = pin.posterior(touch), pin.posterior(half)
    assert b.probabilities[a.top(1)[0]] > 0.5 * b.probabilities.max()


def test_a_touch_of_another_sensor_is_refused(pin, touches):
    geometry = dataclasses.replace(touches[0].geometry, fx=0.9 * touches[0].geometry.fx)
    touch = Touch(touches[0].contact_shape, geometry, "touch-0000")
    with pytest.raises(TouchError, match=naming("touch-0000", "gelslim")):
        pin.find_most_probable_pose(touch)


def test_invalid_touches_priors_and_numbers_are_refused(coarse, tmp_path):
    with pytest.raises(TouchError, match=naming("'touch.npz'", "Localizer.read_touch")):
        coarse.localize("touch.npz")
    (touch,) = coarse.simulate(1, seed=10)
    with pytest.raises(ConfigError, match=r"'prior\.toml'"):
        coarse.localize(touch, "prior.toml")
    with pytest.raises(ConfigError, match=naming(0, "top")):
        coarse.localize(touch, top=0)
    for count, seed in ((-1, 0), (1, -1)):
        with pytest.raises(ConfigError, match=naming(count, seed)):
            coarse.simulate(count, seed)


def test_the_store_may_be_a_folder(tmp_path):
    assert Localizer.create("pin", store=tmp_path / "a").store.root == tmp_path / "a"
    assert Localizer.create("pin", store=str(tmp_path / "b")).store.root == tmp_path / "b"


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"sensor": 3}, ("Localizer.create", "sensor", 3)),
        ({"top": -1}, ("Localizer.create", "top", "-1")),
        ({"refinr": "icp"}, ("Localizer.create", "'refinr'", "'refiner'")),
        ({"grid": {"name": "face", "spacing": 3}}, ("grid 'face'", "'spacing'", "'spacing_mm'")),
        ({"grid": {"name": "face", "spacing_mm": np.inf}}, ("spacing_mm", "inf")),
        ({"refiner": {"name": "icp", "wide_mm": np.inf}}, ("wide_mm", "inf")),
        ({"temperature": np.inf}, ("temperature", "inf")),
    ],
)
def test_bad_settings_are_refused(settings, said):
    with pytest.raises(ConfigError, match=naming(*said)):
        Localizer.create("pin", **settings)


def test_only_the_most_recent_matchers_stay_in_memory(coarse, monkeypatch):
    monkeypatch.setattr(coarse.listed.banks._matchers, "most_bytes", 0)
    kept = coarse.listed.matcher(0.002)
    for step in range(1, FEWEST_MATCHERS + 3):
        coarse.listed.matcher(step * 1e-4)
        assert coarse.listed.matcher(0.002) is kept
    assert len(coarse.listed.banks._matchers) == FEWEST_MATCHERS


@pytest.mark.slow
def test_a_press_that_is_not_in_memory_gives_the_same_poses(store, monkeypatch):
    monkeypatch.setattr(scoring, "KEPT_BYTES", 0)
    monkeypatch.setattr(scoring, "FEWEST_MATCHERS", 1)
    localizer = Localizer.create("pin", store=store, sensor={"name": "gelsight-mini", "gel": "rigid"})
    (touch,), (other,) = localizer.simulate(1, 3, 8e-4), localizer.simulate(1, 3, 5e-4)
    first, _, again = (localizer.source.place_search.alike(some, 200) for some in (touch, other, touch))
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
    assert len(localizer.source.place_search._banks._matchers) == 1


def test_a_refined_pose_has_a_covariance(pin, touches):
    """For each refiner, the true pose of half of the touches lies within a few standard deviations."""
    found = [pin.localize(touch) for touch in touches[:6]]
    for one in found:
        for h in one.hypotheses:
            covariance = h.refined.covariance
            if h.imprint_iou > 0:
                np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
                assert (np.linalg.eigvalsh(covariance) > 0).all()
    metric = PoseMetric(pin.object)
    squared = [
        compute_nees(metric, one.best.T_sensor_object, one.best.refined.covariance, touch.T_sensor_object)
        for one, touch in zip(found, touches, strict=False)
    ]
    assert np.median(squared) < 40


def test_the_most_probable_pose_has_a_probability_a_verdict_and_a_covariance(pin, touches):
    located = dataclasses.replace(touches[1], T_base_sensor=make_translation([0.3, 0.0, 0.1]))
    found, whole = pin.find_most_probable_pose(located), pin.localize(located, top=1)
    assert found.probability == whole.best.probability
    assert found.verdict == whole.verdict
    assert found.imprint_iou == pytest.approx(pin.scene.imprint_ious(found.T_sensor_object[None], located)[0])
    assert (np.linalg.eigvalsh(found.covariance) > 0).all()
    np.testing.assert_allclose(found.T_base_object[:3, 3] - found.T_sensor_object[:3, 3], [0.3, 0.0, 0.1], atol=1e-12)


@pytest.mark.parametrize("noise", ["none", "mild"])
def test_the_verdict_does_not_depend_on_how_a_touch_is_located_or_how_many_poses_are_listed(pin, noise):
    given, few = pin.simulate(8, seed=3, noise=noise), Localizer.create("pin", store=pin.store, **FINE, top=3)
    for touch in given:
        whole, found = pin.localize(touch), pin.find_most_probable_pose(touch)
        assert found.verdict is whole.verdict is LocatedFrame.of(whole).verdict
        assert found.probability == whole.best.probability
        assert pin.localize(touch, top=3).outcome == whole.outcome
        assert few.localize(touch).outcome == whole.outcome


def test_the_most_probable_pose_of_a_refiner_without_covariances_has_one(pin, touches, store):
    other = Localizer.create("pin", store=store, **COARSE, refiner="icp")
    found = other.find_most_probable_pose(touches[1])
    assert found.covariance.shape == (6, 6)
    assert found.imprint_iou == pytest.approx(other.scene.imprint_ious(found.T_sensor_object[None], touches[1])[0])


@pytest.mark.slow
def test_a_touch_of_a_turned_face_determines_its_shape_but_not_its_pose(store):
    """Nearly equal shapes at several yaws explain the touch, and the first one is not the peak of the grid's mode."""
    localizer = Localizer.create("pin", store=store, sensor="gelsight-mini", grid={"name": "face", "face": "+z"})
    touch = localizer.simulate(3, seed=11)[2]
    found = localizer.localize(touch)
    truth = np.asarray(touch.T_sensor_object)
    off_m = measure_shape_distances(localizer.object.mesh, found.best.T_sensor_object[None], truth)
    assert off_m[0] < 3e-4
    assert (found.verdict, found.probability_within() < 0.5) == (Verdict.AMBIGUOUS, True)
    assert found.freedom.turn_rad.any()
    assert found.probability_within("shape:1mm") > 0.9
