"""The document of a result: its values, its keys, and the doubts about a result."""

from __future__ import annotations

import dataclasses
import json
from datetime import datetime

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc import __version__
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.errors import ConfigError, ResultError
from tactile_loc.io.config import RunConfig
from tactile_loc.io.json_keys import read_keys
from tactile_loc.io.streams.records import read_document, read_versions
from tactile_loc.locate.probability.conformal import PoseSet
from tactile_loc.locate.result.doubts import list_doubts
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
    assert document["normalised_entropy"] == pytest.approx(document["entropy_nats"] / np.log(document["grid_poses"]))
    assert document["seconds"]["model"] == 1.5
    assert {"encode", "match", "refine"} <= document["seconds"].keys()


def test_errors_equal_the_distances_to_the_truth(document, localizer, localization):
    metric, T_true = PoseMetric(localizer.object), localization.touch.T_sensor_object
    poses = [np.array(h["T_sensor_object"]) for h in document["hypotheses"]]
    expected = [metric.symmetric_distance(T[None], T_true[None])[0] for T in poses]
    assert [h["error_m"] for h in document["hypotheses"]] == pytest.approx(expected)
    grid = localization.posterior.grid.T_sensor_object
    closest = metric.symmetric_distance(grid, np.broadcast_to(T_true, grid.shape)).min()
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
    assert any(name.startswith("open3d") for name in document["versions"])
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
        ({"schema_version": 2}, "version 2"),
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


@pytest.mark.parametrize(("iou", "doubted"), [(0.49, True), (0.5, False)])
def test_a_touch_that_a_refined_pose_hardly_explains_causes_a_doubt(localization, iou, doubted):
    best = dataclasses.replace(localization.best, imprint_iou=iou)
    said = list_doubts(dataclasses.replace(localization, hypotheses=(best,)))
    assert len(said) == doubted
    assert all("49 %" in sentence and localization.touch.name in sentence for sentence in said)
    refined = dataclasses.replace(localization.best.refined, T_sensor_object=localization.best.T_sensor_object_grid)
    unrefined = dataclasses.replace(best, imprint_iou=0.1, refined=refined)
    assert list_doubts(dataclasses.replace(localization, hypotheses=(unrefined,))) == []


def test_touches_that_the_first_pose_explains_not_at_all_are_named_once(localization):
    (said,) = list_doubts(explain_several(localization, (0.9, 0.0, 0.8, 0.04)))
    assert "touch-1, touch-3" in said
    assert all(name not in said for name in ("touch-0", "touch-2"))
    assert list_doubts(explain_several(localization, (0.9, 0.06, 0.8))) == []
    (said,) = list_doubts(explain_several(localization, (0.9, 0.0, 0.8), outliers=(1,)))
    assert "2 of 3 touches agree" in said


def explain_several(localization, ious, outliers=()):
    touch, *others = (dataclasses.replace(localization.touch, name=f"touch-{k}") for k in range(len(ious)))
    best = dataclasses.replace(localization.best, imprint_ious=ious, imprint_iou=float(np.mean(ious)))
    agreement = Agreement((0.9,) * len(ious), outliers, bool(outliers))
    return dataclasses.replace(localization, touch=touch, others=tuple(others), hypotheses=(best,), agreement=agreement)
