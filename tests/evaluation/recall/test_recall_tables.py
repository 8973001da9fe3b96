"""The tables, the JSON document, the figure and BOP's files of an evaluation agree with its results."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest
from report_helpers import make_recall_runs

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.evaluation.recall import tables
from tactile_loc.evaluation.recall.bop import COLUMNS, OURS, format_results, make_scenes, make_truth, write_bop
from tactile_loc.evaluation.recall.evaluation import VERDICTS
from tactile_loc.evaluation.recall.figure import draw_recall
from tactile_loc.evaluation.recall.summary import RecallRun, RecallSummary

ABOUT = {"examples": 12, "noises": ["none", "strong"], "seeds": [5], "images": False}


@pytest.fixture
def runs() -> list[RecallRun]:
    return make_recall_runs()


def test_groups_join_seeds_and_then_all_objects(runs):
    groups = tables.group_runs([*runs, runs[0]])  # as a second seed
    labels = [(group.object, group.noise, group.touches, len(group.outcomes)) for group in groups]
    assert labels[:2] == [("pin", "none", 1, 24), ("pin", "none", 3, 24)]
    assert labels[-4:] == [("all", "none", 1, 36), ("all", "none", 3, 36), ("all", "strong", 1, 24),
                           ("all", "strong", 3, 24)]  # fmt: skip


def test_one_object_has_no_row_of_all_objects(runs):
    assert {group.object for group in tables.group_runs(runs[:2])} == {"pin"}


def test_tables_show_the_summary(runs):
    groups = tables.group_runs(runs)
    s = RecallSummary.of(groups[0].outcomes)
    row = dict(zip(*tables.tabulate_recall(groups)[:2], strict=True))
    assert row["< 1 mm"] == f"{100 * s.within[1]:.0f} % ({100 * s.listed_within[1]:.0f} %)"
    assert row["AUC"] == f"{100 * s.auc:.0f} % ({100 * s.listed_auc:.0f} %)"
    row = dict(zip(*tables.tabulate_verdicts(groups)[:2], strict=True))
    assert [int(row[verdict]) for verdict in VERDICTS] == list(s.verdicts.values())
    assert row["certain: right"].startswith(f"{100 * (s.certain_right or 0):.0f} %")


def test_the_csv_has_a_row_for_each_group(runs):
    rows = list(csv.DictReader(io.StringIO(tables.format_csv(runs))))
    groups = tables.group_runs(runs)
    assert [(row["object"], row["noise"], int(row["touches"])) for row in rows] == [
        (g.object, g.noise, g.touches) for g in groups
    ]
    assert float(rows[0]["within_1_mm"]) == pytest.approx(RecallSummary.of(groups[0].outcomes).within[1], rel=1e-5)


def test_the_document_has_every_example_and_is_read_back(runs):
    document = json.loads(json.dumps(tables.record_runs(runs, ABOUT), allow_nan=False))
    each = document["runs"][0]["results"][0][tables.EACH]
    assert each["errors_m"]["surface"][1] is None
    assert each["problem"][1] == "the file is damaged"
    assert document["runs"][0]["refused"] == 12
    for read, group in zip(tables.read_groups(document), tables.group_runs(runs), strict=True):
        assert read.label == group.label
        assert RecallSummary.of(read.outcomes) == RecallSummary.of(group.outcomes)


def test_problems_are_counted_not_dropped(runs):
    assert tables.list_problems(runs) == [("the file is damaged", 2 * len(runs))]
    assert "the file is damaged" in tables.format_markdown(runs, "title")


def test_bop_rows_are_poses_in_millimetres_with_scores(runs):
    T = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.01, -0.02, 0.03])
    runs[2].evaluation.T_sensor_object[4, 1, 0] = T
    rows = list(csv.DictReader(io.StringIO(format_results(make_scenes(runs), OURS, 3))))
    assert tuple(rows[0]) == COLUMNS
    (row, *others) = [row for row in rows if (row["scene_id"], row["im_id"]) == ("3", "4")]
    assert len(others) == 3  # the other listed poses
    assert row["obj_id"] == "2"
    assert np.allclose(np.array(row["R"].split(), float).reshape(3, 3), T[:3, :3])
    assert np.allclose(np.array(row["t"].split(), float), [10, -20, 30])
    assert float(row["score"]) == pytest.approx(runs[2].evaluation.probabilities[4, 1, 0], rel=1e-5)
    assert float(row["time"]) == pytest.approx(runs[2].evaluation.seconds[4, 1], rel=1e-4)
    assert not [row for row in rows if row["im_id"] == "1"]  # an example without a pose


def test_bop_truth_has_each_example_whose_first_touch_can_be_read(runs):
    truth = make_truth(make_scenes(runs)[0], 7)
    assert sorted(map(int, truth)) == [n for n in range(12) if n != 1]
    (pose,) = truth["0"]
    assert (pose["cam_R_m2c"], pose["cam_t_m2c"], pose["obj_id"]) == (np.eye(3).ravel().tolist(), [0, 0, 0], 7)


def test_bop_files_are_one_for_each_number_of_touches(runs, tmp_path):
    written = write_bop(tmp_path, make_scenes(runs))
    assert [path.name for path in written] == [
        "ids.json", "tactile-loc-1-touches_evaluation-test.csv", "tactile-loc-3-touches_evaluation-test.csv"
    ]  # fmt: skip
    ids = json.loads(written[0].read_text())
    assert ids["objects"] == {"pin": 1, "hook": 2}
    assert (tmp_path / "bop" / "test" / "000004" / "scene_gt.json").is_file()


def test_the_figure_has_two_curves_for_each_number_of_touches_and_noise(runs):
    recall, reliability = draw_recall(runs, "title").axes
    assert len([line for line in recall.lines if len(line.get_xdata()) > 2]) == 2 * 4
    assert [text.get_text() for text in recall.figure.legends[0].texts][:2] == [
        "1 touch, no noise",
        "3 touches, no noise",
    ]
    heights = [line.get_ydata() for line in recall.lines if len(line.get_xdata()) > 2]
    assert all((np.diff(y) >= 0).all() for y in heights)
    assert reliability.get_xlim() == (0, 100)
