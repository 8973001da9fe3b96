"""A saved localisation is read back whole, and everything that works from a localisation works from the copy."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import Localization, PoseModes, localize_together
from tactile_loc.core.runtime.errors import ResultError
from tactile_loc.locate.result.result_arrays import write_arrays
from tactile_loc.plugin.helpers import invert, make_translation
from tactile_loc.reports import find_result
from tactile_loc.reports.report import make_page
from tactile_loc.store.files import write_json


@pytest.fixture(scope="module")
def several(localizer) -> Localization:
    """Three touches with sensor poses; the third contradicts the others and is left out."""
    touches = localizer.simulate(3, seed=4)
    T = make_translation([0.4, 0.1, 0.0])
    placed = [
        dataclasses.replace(t, T_base_sensor=T @ invert(t.T_sensor_object), T_base_sensor_std_m=5e-4) for t in touches
    ]
    found = localize_together([(localizer, touch) for touch in placed[:2]])
    return dataclasses.replace(found, left_out=(placed[2],))


@pytest.fixture(scope="module", params=["one", "several"])
def pair(request, localization, several, tmp_path_factory) -> tuple[Localization, Localization]:
    found = localization if request.param == "one" else several
    folder = tmp_path_factory.mktemp("saved") / "deep"
    assert found.save(folder) == [folder / "result.json", folder / "result.npz"]
    return found, Localization.load(folder)


def test_hypotheses_are_read_back_exactly(pair):
    found, again = pair
    assert len(again.hypotheses) == len(found.hypotheses)
    for a, b in zip(again.hypotheses, found.hypotheses, strict=True):
        for name in ("T_sensor_object", "T_sensor_object_grid", "covariance", "imprint_ious", "quaternion_xyzw"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        for name in ("probability", "imprint_iou", "contact_iou", "converged", "iterations", "grid_poses"):
            assert getattr(a, name) == getattr(b, name)
        assert (a.T_base_object is None) == (b.T_base_object is None)
        if b.T_base_object is not None:
            np.testing.assert_allclose(a.T_base_object, b.T_base_object, atol=1e-12)
            np.testing.assert_allclose(a.base_covariance, b.base_covariance, rtol=1e-9, atol=1e-18)
        if found.posterior.probabilities[b.grid_index] == 0:
            continue  # such a pose is not stored
        T, before = (
            one.posterior.grid.T_sensor_object[[index]] for one, index in ((again, a.grid_index), (found, b.grid_index))
        )
        assert found.posterior.grid.metric.symmetric_distance(T, before)[0] < 1e-6


def test_the_posterior_and_the_verdict_are_read_back(pair):
    found, again = pair
    p = found.posterior.probabilities
    np.testing.assert_allclose(again.posterior.probabilities, np.sort(p[p > 0])[::-1], rtol=1e-5)
    assert again.posterior.elsewhere == found.posterior.elsewhere
    assert again.posterior.touches == found.posterior.touches
    assert (again.posterior.log_train is None) == (found.posterior.log_train is None)
    assert again.posterior.entropy == pytest.approx(found.posterior.entropy, rel=1e-5)
    assert again.verdict == found.verdict
    assert again.summary() == found.summary()
    assert again.agreement == found.agreement or vars(again.agreement) == vars(found.agreement)
    assert again.tolerance == found.tolerance
    assert again.outcome.right == again.probability_within() == found.probability_within()
    assert again.outcome.missed == found.outcome.missed
    assert again.poor_touches == found.poor_touches
    assert str(again.freedom) == str(found.freedom)


def test_only_a_result_with_all_its_hypotheses_states_probabilities_within_other_tolerances(pair):
    found, again = pair
    assert 0 < found.probability_within("0.01mm") < found.probability_within("10mm") < 1
    with pytest.raises(ResultError, match=naming("0.01mm")):
        again.probability_within("0.01mm")


def test_the_touches_are_read_back(pair):
    found, again = pair
    assert len(again.touches) == len(found.touches)
    assert len(again.left_out) == len(found.left_out)
    for a, b in zip((*again.touches, *again.left_out), (*found.touches, *found.left_out), strict=True):
        np.testing.assert_array_equal(a.contact_shape.depth_m, b.contact_shape.depth_m)
        assert a.name == b.name
        assert (a.press_depth_m, a.indentation_m) == (b.press_depth_m, b.indentation_m)
        assert a.geometry.describe() == b.geometry.describe()
        assert (a.T_base_sensor_std_m, a.T_base_sensor_std_rad) == (b.T_base_sensor_std_m, b.T_base_sensor_std_rad)
        np.testing.assert_array_equal(a.T_sensor_object, b.T_sensor_object)
        assert (a.T_base_sensor is None) == (b.T_base_sensor is None)


def test_a_copy_has_the_same_document_and_is_saved_again(pair, tmp_path):
    found, again = pair
    again.save(tmp_path)
    documents = [one.to_json() for one in (again, Localization.load(tmp_path))]
    for document in documents:
        for hypothesis in document["hypotheses"]:  # these are rounded, because the file has their sensor's pose, too
            for name in ("T_base_object", "base_quaternion_xyzw", "base_covariance"):
                del hypothesis[name]
    assert documents[0] == documents[1]
    poses = [h["T_sensor_object"] for h in documents[0]["hypotheses"]]
    assert poses == [h.T_sensor_object.tolist() for h in found.hypotheses]


def test_a_file_states_the_assessment_from_all_poses(localization, tmp_path):
    """The file keeps fewer poses, and no unlisted hypotheses, but says what the whole result said."""
    said = {"next_step": "touch the head", "grid_poses": 10**6, "poor_touches": (0,), "error_quantile_m": 2e-3}
    stated = dataclasses.replace(localization.assessment, **said)
    dataclasses.replace(localization, assessed=stated).save(tmp_path)
    again = Localization.load(tmp_path)
    assert (again.poor_touches, again.outcome.right) == ((0,), stated.outcome.right)
    for name in ("verdict", "next_step", "grid_poses", "entropy_nats", "errors", "poor_touches", "error_quantile_m"):
        assert getattr(again.assessment, name) == getattr(stated, name)
    assert again.assessment.kept_probability == pytest.approx(stated.kept_probability)
    assert "1000000" in again.describe_search()
    assert vars(again.made_with) == vars(dataclasses.replace(localization.made_with, created=again.made_with.created))


def test_reports_pictures_and_the_next_touch_work_from_the_files(pair, tmp_path):
    from tactile_loc.view.pictures import draw_result

    found, again = pair
    again.save(tmp_path)
    assert make_page(find_result(tmp_path)).title
    modes, other = PoseModes.of(again), PoseModes.of(found)
    np.testing.assert_allclose(modes.T_base_object, other.T_base_object, atol=1e-7)
    np.testing.assert_allclose(modes.probabilities, other.probabilities)
    assert draw_result(again, again.make_views()[0].scene, "again").axes


def test_the_files_of_run_are_read(run_folder):
    document = json.loads((run_folder / "result.json").read_text())
    for path in (run_folder, run_folder / "result.json"):
        found = Localization.load(path)
        assert found.best.probability == document["hypotheses"][0]["probability"]
        assert found.config is not None
        assert found.config.resolve() == document["configuration"]


@pytest.mark.slow
def test_the_set_of_a_coverage_is_read_back(localizer, tmp_path):
    found = localizer.localize(localizer.simulate(1, seed=0)[0], coverage=0.8)
    found.save(tmp_path)
    again = Localization.load(tmp_path)
    assert again.pose_set.coverage == 0.8
    assert dataclasses.asdict(again.pose_set) == dataclasses.asdict(found.pose_set)
    assert len(again.hypotheses) == again.pose_set.poses


def test_a_localisation_without_a_configuration_is_not_saved(localization, tmp_path):
    with pytest.raises(ResultError):
        dataclasses.replace(localization, config=None).save(tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["result.json", "result.npz"])
def test_a_missing_file_is_named(run_folder: Path, tmp_path: Path, name: str):
    for other in {"result.json", "result.npz"} - {name}:
        (tmp_path / other).write_bytes((run_folder / other).read_bytes())
    with pytest.raises(ResultError, match=name):
        Localization.load(tmp_path)


@pytest.mark.parametrize("damage", ["touches", "pose", "grid pose", "no hypothesis", "verdict"])
def test_a_damaged_result_gives_an_error(run_folder: Path, tmp_path: Path, damage: str):
    """Both files belong together, but one has another number of touches, or a pose that is no pose."""
    document = json.loads((run_folder / "result.json").read_text())
    with np.load(run_folder / "result.npz") as file:
        arrays = {name: file[name] for name in file.files if name not in ("schema_version", "result_sha256")}
    rows = [[1.0, 0.0], [0.0, 1.0]]
    changed = {
        "touches": {"other_touches": [document["touch"]]},
        "pose": {"touch": {**document["touch"], "T_sensor_object": rows}},
        "grid pose": {"hypotheses": [{**h, "T_sensor_object_grid": rows} for h in document["hypotheses"]]},
        "no hypothesis": {"hypotheses": []},
        "verdict": {"verdict": "sure"},
    }
    wrong = {**document, **changed[damage]}
    write_json(tmp_path / "result.json", wrong)
    write_arrays(tmp_path / "result.npz", arrays, wrong)
    with pytest.raises(ResultError, match="damaged"):
        Localization.load(tmp_path)
