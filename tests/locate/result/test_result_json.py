"""The document of a result: its values, its keys, and the doubts about a result."""

import dataclasses
import json
from datetime import datetime

import numpy as np
import pytest
from message_helpers import missing, naming

from tactile_loc import RunConfig, Verdict, __version__
from tactile_loc.core.runtime.errors import ConfigError, ResultError
from tactile_loc.io.json_keys import read_keys
from tactile_loc.io.streams.records import read_document, read_versions
from tactile_loc.locate.probability.conformal import PoseSet
from tactile_loc.locate.result.doubts import list_doubts, name_likely_cause
from tactile_loc.locate.result.hypothesis import Agreement
from tactile_loc.locate.result.result_json import (
    ERRORS,
    FREEDOM,
    HYPOTHESIS,
    OBJECT,
    POSE_SET,
    RESULT,
    SCHEMA_VERSION,
    TOUCH,
    read_result,
)
from tactile_loc.plugin.helpers import transform_points
from tactile_loc.slots.registry import SLOTS


@pytest.fixture(scope="module")
def document(localization):
    return dataclasses.replace(localization, seconds={"model": 1.5, **localization.seconds}).to_json()


def with_truth(localization, T):
    return dataclasses.replace(localization, touch=dataclasses.replace(localization.touch, T_sensor_object=T))


def test_the_document_has_the_listed_keys_and_types(document):
    assert document["schema_version"] == SCHEMA_VERSION
    parts = ((RESULT, document), (OBJECT, document["object"]), (TOUCH, document["touch"]), (ERRORS, document["errors"]))
    for keys, part in (*parts, (FREEDOM, document["freedom"]), *((HYPOTHESIS, h) for h in document["hypotheses"])):
        assert read_keys(keys, json.loads(json.dumps(part))) == part


def test_the_document_holds_the_hypotheses_of_the_localisation(document, localization):
    assert [h["rank"] for h in document["hypotheses"]] == list(range(1, len(localization.hypotheses) + 1))
    for written, found in zip(document["hypotheses"], localization.hypotheses, strict=True):
        assert np.array_equal(written["T_sensor_object"], found.T_sensor_object)
        assert np.array_equal(written["T_sensor_object_grid"], found.T_sensor_object_grid)
        assert written["probability"] == found.probability
        assert (written["contact_iou"], written["converged"]) == (found.refined.contact_iou, found.refined.converged)
    assert document["grid_poses"] == len(localization.posterior.grid)
    assert document["probability_within"] == localization.outcome.right
    assert (document["elsewhere"], document["poor_touches"]) == (localization.posterior.elsewhere, [])
    assert document["normalised_entropy"] == pytest.approx(document["entropy_nats"] / np.log(document["grid_poses"]))
    assert document["seconds"]["model"] == 1.5
    assert {"encode", "match", "refine"} <= document["seconds"].keys()


def test_errors_are_pose_errors(document, localizer, localization):
    T_true, corners_m = localization.touch.T_sensor_object, localizer.object.mesh.vertices_m
    same = transform_points(T_true @ localizer.object.symmetry.list_elements(), corners_m)

    def measure(T):
        return np.linalg.norm(transform_points(np.array(T), corners_m) - same, axis=-1).max(axis=1).min()

    expected = [measure(h["T_sensor_object"]) for h in document["hypotheses"]]
    assert [h["error_m"] for h in document["hypotheses"]] == pytest.approx(expected)
    grid = localization.posterior.grid
    closest = measure(grid.T_sensor_object[grid.nearest(T_true[None])[1][0]])
    best = {"best_m": expected[0], "best_listed_m": min(expected), "closest_in_grid_m": closest}
    assert document["errors"] == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (PoseSet(0.95, 0.9, 84, 1, 1e-3), ("95 % set", "1 pose", "1.00 mm", "84")),
        (PoseSet(0.9, 0.9, 84, 7, 1e-3, 0.3, True, False, "Too often."), ("90 % set", "7 poses or elsewhere", "Too")),
    ],
)
def test_a_set_for_a_coverage_is_written_and_put_into_words(localization, found, said):
    written = dataclasses.replace(localization, pose_set=found).to_json()["pose_set"]
    assert read_keys(POSE_SET, written) == dataclasses.asdict(found)
    text = f"{found.title}: {found.size}. {found.meaning}"
    assert all(words in text for words in said)


def test_a_symmetric_equivalent_of_the_truth_has_no_error(localizer, localization):
    T = localization.best.T_sensor_object
    half_turn = localizer.object.symmetry.list_elements()[1]
    assert with_truth(localization, T @ half_turn).measure_errors_m(localizer.object)[0] == pytest.approx(0, abs=1e-9)
    shifted = T.copy()
    shifted[0, 3] += 0.003
    assert with_truth(localization, shifted).measure_errors_m(localizer.object)[0] == pytest.approx(0.003)


def test_a_document_without_a_true_pose_has_no_errors(localizer, localization):
    unknown = with_truth(localization, None)
    assert unknown.measure_errors_m(localizer.object) is None
    document = unknown.to_json()
    assert document["errors"] is document["touch"]["T_sensor_object"] is None
    assert {h["error_m"] for h in document["hypotheses"]} == {None}


def test_settings_are_complete_and_are_read_back(document):
    assert RunConfig.from_dict(document["configuration"]).resolve() == document["configuration"]
    assert document["configuration"]["grid"]["options"]["spacing_mm"] == 8
    assert document["configuration"]["grid"]["options"]["face"] == "auto"
    assert document["distributions"] == dict.fromkeys(SLOTS, "tactile-loc")


def test_settings_that_a_component_refuses_give_an_error():
    with pytest.raises(ConfigError, match="spacing_mm"):
        RunConfig.from_dict({"grid": {"name": "face", "spacing_mm": -1}}).resolve()


def test_the_document_holds_versions_the_time_and_the_object(document, localizer):
    assert read_versions() == document["versions"]
    assert document["versions"]["tactile-loc"] == __version__
    assert document["versions"]["numpy"] == np.__version__
    assert {"numba", "scipy", "trimesh"} <= document["versions"].keys()
    assert datetime.fromisoformat(document["created"]).utcoffset().total_seconds() == 0
    assert document["object"]["symmetry"] == "z2"
    assert document["object"]["size_m"] == pytest.approx(localizer.object.mesh.extents_m)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"hypotheses": None}, "hypotheses"),
        ({"normalised_entropy": "much"}, "normalised_entropy"),
        ({"unknown": 1}, "unknown"),
        ({"schema_version": 7}, "version 7"),
        ({"schema_version": 4}, "version 4"),
    ],
)
def test_a_damaged_or_older_document_gives_a_one_sentence_error(document, tmp_path, change, named):
    (tmp_path / "result.json").write_text(json.dumps({**document, **change}))
    with pytest.raises(ResultError, match=naming("result.json", named)):
        read_result(tmp_path / "result.json")


@pytest.mark.parametrize(("text", "kind"), [("{", "JSON"), ("[1]", "list")])
def test_a_file_without_a_document_gives_a_one_sentence_error(tmp_path, text, kind):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(ResultError, match=naming("result.json", kind)):
        read_document(tmp_path / "result.json")


def doubt(localization, *, poor=(), ious=(0.8,), press_m=0.0, **changes):
    """The doubts about a result of touches 0, 1, ..., some of which the first pose explains poorly."""
    touch, *others = (dataclasses.replace(localization.touch, name=f"touch-{k}") for k in range(len(ious)))
    best = dataclasses.replace(localization.best, imprint_ious=ious, imprint_iou=float(np.mean(ious)))
    assessed = dataclasses.replace(localization.assessment, poor_touches=poor)
    evidence = dataclasses.replace(localization.evidence, press_m=np.zeros(len(ious)) + press_m)
    found = {"touch": touch, "others": tuple(others), "hypotheses": (best,), "assessed": assessed, "evidence": evidence}
    return list_doubts(dataclasses.replace(localization, **(found | changes)))


def agree(*best_ious, outliers=(), contradictory=False):
    return {"agreement": Agreement(best_ious, outliers, contradictory)}


@pytest.mark.parametrize(
    ("ious", "poor", "changes", "cause"),
    [
        ((0.41,), (0,), {}, ("object", "sensor", "unit", "press")),
        ((0.41,), (0,), {"press_m": 4e-4}, ("press", "deeper")),
        ((0.41,), (0,), {"press_m": -4e-4}, ("press", "lighter")),
        ((0.9, 0.41), (1,), agree(0.9, 0.9), ("moved", "T_base_sensor", "mirrored")),
        ((0.9, 0.41), (1,), agree(0.9, 0.45), ("touch-1 fit no pose", "mesh", "unit", "sensor")),
        ((0.9, 0.41), (1,), agree(0.9, 0.9) | {"press_m": (4e-4, 0.0)}, ("moved",)),  # one touch shows no press
        ((0.9, 0.41), (1,), agree(0.9, 0.9) | {"press_m": 4e-4}, ("press", "deeper")),
    ],
)
def test_touches_that_the_first_pose_explains_poorly_are_named_with_the_likely_cause(
    localization, ious, poor, changes, cause
):
    (said,) = doubt(localization, ious=ious, poor=poor, **changes)
    assert not missing(said, f"touch-{poor[0]}", "41 %", *cause)
    assert "90 %" not in said


def test_a_press_is_named_only_if_all_touches_show_it_clearly(localization):
    (small,) = doubt(localization, poor=(0,), press_m=1e-5)
    mixed = dataclasses.replace(localization.evidence, press_m=np.array([4e-4, -4e-4]))
    assert "mm more" not in small
    assert name_likely_cause(dataclasses.replace(localization, evidence=mixed)) == name_likely_cause(localization)


def test_a_press_that_several_touches_show_is_a_doubt_unless_the_verdict_is_certain(localization):
    assert localization.verdict is not Verdict.CERTAIN
    (said,) = doubt(localization, ious=(0.8, 0.8), press_m=4e-4)
    assert not missing(said, "press", "deeper")
    certain = dataclasses.replace(localization.assessment, verdict=Verdict.CERTAIN)
    assert doubt(localization, ious=(0.8, 0.8), press_m=4e-4, assessed=certain) == []


def test_touches_that_fit_no_pose_are_a_doubt_if_the_pose_was_not_found(localization):
    lost = {"assessed": dataclasses.replace(localization.assessment, verdict=Verdict.NOT_FOUND)}
    (said,) = doubt(localization, ious=(0.8, 0.3), **agree(0.8, 0.4), **lost)
    assert not missing(said, "touch-1 fit no pose", "mesh", "unit", "sensor")
    assert doubt(localization, ious=(0.8, 0.3), **agree(0.8, 0.9), **lost) == []


def test_outliers_name_a_motion_or_another_part(localization):
    (said,) = doubt(localization, ious=(0.9, 0.9, 0.1), **agree(0.9, 0.9, 0.9, outliers=(2,), contradictory=True))
    assert not missing(said, "2 of 3 touches agree", "touch-2", "moved", "T_base_sensor", "another part")


def test_a_prior_that_contradicts_the_touches_is_named(localization):
    alone = dataclasses.replace(localization, hypotheses=(dataclasses.replace(localization.best, imprint_iou=0.95),))
    near, far = (
        dataclasses.replace(alone, hypotheses=(dataclasses.replace(alone.best, imprint_iou=iou),)) for iou in (0.9, 0.6)
    )
    assert not near.compare_without_prior(alone).unexpected
    found = far.compare_without_prior(alone)
    assert found.unexpected
    assert "prior" in list_doubts(found)[0]
    assert found.verdict is not Verdict.CERTAIN
    poor, cause = doubt(localization, poor=(0,), press_m=4e-4, unexpected=True)
    assert "prior" in cause
    assert "press" not in poor + cause


def test_touches_that_contradict_the_others_are_named(localization):
    (said,) = doubt(localization, ious=(0.9, 0.0, 0.8), **agree(0.9, 0.7, 0.9, outliers=(1,), contradictory=True))
    assert not missing(said, "2 of 3", "touch-1 0 %", "70 %", "T_base_sensor")
    (said,) = doubt(localization, ious=(0.9, 0.0), **agree(0.9, 0.7, contradictory=True))
    assert not missing(said, "touch-0", "touch-1", "T_base_sensor")
    left = (dataclasses.replace(localization.touch, name="touch-9"),)
    (said,) = doubt(localization, left_out=left)
    assert "touch-9" in said
