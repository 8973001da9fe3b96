from __future__ import annotations

import dataclasses
import json
from datetime import datetime

import numpy as np
import pytest
from pydantic import ValidationError

from tactile_loc import __version__
from tactile_loc.core.poses.metric import PoseMetric
from tactile_loc.core.runtime.errors import ConfigError, OutputError
from tactile_loc.io.config import RunConfig
from tactile_loc.io.streams.records import read_versions, write_record
from tactile_loc.locate.probability.conformal import PoseSet
from tactile_loc.locate.result.doubts import list_doubts
from tactile_loc.locate.result.result_json import SCHEMA_VERSION, ResultRecord, make_record
from tactile_loc.slots.registry import SLOTS


@pytest.fixture(scope="module")
def record(localizer, localization):
    return make_record(localizer, localization, {"model": 1.5})


def with_truth(localization, T):
    return dataclasses.replace(localization, touch=dataclasses.replace(localization.touch, T_sensor_object=T))


def test_the_file_holds_the_record(record, tmp_path):
    path = write_record(tmp_path / "deep" / "result.json", record)
    assert ResultRecord.model_validate_json(path.read_text()) == record
    assert json.loads(path.read_text())["schema_version"] == SCHEMA_VERSION


def test_the_schema_refuses_unknown_keys(record):
    with pytest.raises(ValidationError):
        ResultRecord.model_validate({**record.model_dump(), "mood": "good"})


def test_the_record_holds_the_hypotheses_of_the_localisation(record, localization):
    assert [h.rank for h in record.hypotheses] == list(range(1, len(localization.hypotheses) + 1))
    for written, found in zip(record.hypotheses, localization.hypotheses, strict=True):
        assert np.array_equal(written.T_sensor_object, found.T_sensor_object)
        assert np.array_equal(written.T_sensor_object_grid, found.T_sensor_object_grid)
        assert written.probability == found.probability
        assert (written.contact_iou, written.converged) == (found.refined.contact_iou, found.refined.converged)
    assert record.grid_poses == len(localization.posterior.grid)


def test_the_entropy_is_normalised_by_that_of_a_uniform_posterior(record):
    assert record.normalised_entropy == pytest.approx(record.entropy_nats / np.log(record.grid_poses))


def test_the_record_holds_the_seconds_of_all_stages(record):
    assert record.seconds["model"] == 1.5
    assert {"encode", "match", "refine"} <= record.seconds.keys()


def test_errors_equal_the_distances_to_the_truth(record, localizer, localization):
    metric, T_true = PoseMetric(localizer.object), localization.touch.T_sensor_object
    expected = [
        metric.symmetric_distance(np.array(h.T_sensor_object)[None], T_true[None])[0] for h in record.hypotheses
    ]
    assert [h.error_m for h in record.hypotheses] == pytest.approx(expected)
    assert record.errors.best_m == pytest.approx(expected[0])
    assert record.errors.best_listed_m == pytest.approx(min(expected))
    grid = localization.posterior.grid.T_sensor_object
    closest = metric.symmetric_distance(grid, np.broadcast_to(T_true, grid.shape)).min()
    assert record.errors.closest_in_grid_m == pytest.approx(closest, abs=1e-6)


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (PoseSet(0.95, 0.9, 84, 1, 1e-3), ("95 % set", "1 pose", "1.00 mm", "84")),
        (PoseSet(0.9, 0.9, 84, 7, 1e-3, 0.3, True, False, "Too often."), ("90 % set", "7 poses or elsewhere", "Too")),
    ],
)
def test_a_set_for_a_coverage_is_written_and_put_into_words(localizer, localization, found, said):
    written = make_record(localizer, dataclasses.replace(localization, pose_set=found)).pose_set
    assert written.model_dump() == dataclasses.asdict(found)
    text = f"{written.title}: {written.size}. {written.meaning}"
    assert all(words in text for words in said)


def test_a_symmetric_equivalent_of_the_truth_has_no_error(localizer, localization):
    T = localization.best.T_sensor_object
    half_turn = localizer.object.symmetry.list_elements()[1]
    assert with_truth(localization, T @ half_turn).measure_errors_m(localizer.object)[0] == pytest.approx(0, abs=1e-9)
    shifted = T.copy()
    shifted[0, 3] += 0.003
    assert with_truth(localization, shifted).measure_errors_m(localizer.object)[0] == pytest.approx(0.003)


def test_a_record_without_a_true_pose_has_no_errors(localizer, localization):
    unknown = with_truth(localization, None)
    assert unknown.measure_errors_m(localizer.object) is None
    record = make_record(localizer, unknown)
    assert record.errors is None
    assert record.touch.T_sensor_object is None
    assert {h.error_m for h in record.hypotheses} == {None}


def test_settings_are_complete_and_are_read_back(record):
    again = RunConfig.from_dict(record.configuration)
    assert again.resolve() == record.configuration
    assert record.configuration["grid"]["options"]["spacing_mm"] == 8
    assert record.configuration["grid"]["options"]["face"] == "auto"
    assert record.distributions == dict.fromkeys(SLOTS, "tactile-loc")


def test_settings_that_a_component_refuses_give_an_error():
    with pytest.raises(ConfigError, match="spacing_mm"):
        RunConfig.from_dict({"grid": {"name": "face", "spacing_mm": -1}}).resolve()


def test_the_record_holds_versions_and_the_time(record):
    assert read_versions() == record.versions
    assert record.versions["tactile-loc"] == __version__
    assert record.versions["numpy"] == np.__version__
    assert any(name.startswith("open3d") for name in record.versions)
    assert datetime.fromisoformat(record.created).utcoffset().total_seconds() == 0


def test_the_record_describes_the_object(record, localizer):
    assert record.object.symmetry == "z2"
    assert record.object.size_m == pytest.approx(localizer.object.mesh.extents_m)


@pytest.mark.parametrize(("iou", "doubted"), [(0.49, True), (0.5, False)])
def test_a_touch_that_the_pose_hardly_explains_causes_a_doubt(record, iou, doubted):
    said = list_doubts(explained_by(record, iou))
    assert len(said) == doubted
    assert all("49 %" in sentence and record.touch.name in sentence for sentence in said)


def test_an_unrefined_pose_causes_no_doubt(record):
    grid_pose = record.hypotheses[0].T_sensor_object_grid
    assert list_doubts(explained_by(record, 0.1, T_sensor_object=grid_pose)) == []


def test_touches_that_the_first_pose_explains_not_at_all_are_named(record):
    said = list_doubts(explain_several(record, (0.9, 0.0, 0.8, 0.04)))
    assert len(said) == 1
    assert "touch-1, touch-3" in said[0]
    assert all(name not in said[0] for name in ("touch-0", "touch-2"))


def test_touches_that_are_named_already_or_explained_a_little_cause_no_second_doubt(record):
    assert list_doubts(explain_several(record, (0.9, 0.06, 0.8))) == []
    (said,) = list_doubts(explain_several(record, (0.9, 0.0, 0.8), outliers=(1,)))
    assert "2 of 3 touches agree" in said


def explain_several(record, ious, outliers=()):
    touches = [
        record.touch.model_copy(update={"name": f"touch-{k}", "outlier": k in outliers, "best_imprint_iou": 0.9})
        for k in range(len(ious))
    ]
    best = record.hypotheses[0].model_copy(update={"imprint_ious": list(ious), "imprint_iou": float(np.mean(ious))})
    return record.model_copy(
        update={
            "touch": touches[0],
            "other_touches": touches[1:],
            "hypotheses": [best],
            "contradictory": bool(outliers),
        }
    )


def explained_by(record, iou, **changes):
    best = record.hypotheses[0].model_copy(update={"imprint_iou": iou, **changes})
    return record.model_copy(update={"hypotheses": [best]})


def test_an_unwritable_path_is_refused(record, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError):
        write_record(tmp_path / "file" / "result.json", record)
