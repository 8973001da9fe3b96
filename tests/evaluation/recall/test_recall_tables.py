"""The tables, the JSON document and BOP's files of an evaluation agree with its results."""

import csv
import io
import json

import numpy as np
import pytest
from report_helpers import make_recall_runs

from tactile_loc.core.geometry.rigid import make_transform, rotation_about
from tactile_loc.evaluation.recall import tables
from tactile_loc.evaluation.recall.bop import COLUMNS, OURS, format_results, make_scenes, make_truth, write_bop
from tactile_loc.evaluation.table import EvaluatedRun, ExampleTable, join_runs

ABOUT = {"examples": 12, "noises": ["none", "strong"], "seeds": [5]}


@pytest.fixture
def runs() -> list[EvaluatedRun]:
    return make_recall_runs()


@pytest.fixture
def table(runs) -> ExampleTable:
    return join_runs(runs)


def test_groups_join_seeds_and_then_all_objects(runs):
    groups = tables.group_answers(join_runs([*runs, runs[0]]))  # as a second seed
    labels = [(name, noise, touches, len(some)) for (name, _, noise, touches), some in groups.items()]
    assert labels[:2] == [("pin", "none", 1, 24), ("pin", "none", 3, 24)]
    noises = (("none", 36), ("strong", 24))
    assert labels[-4:] == [("all", noise, touches, count) for noise, count in noises for touches in (1, 3)]
    assert {name for name, *_ in tables.group_answers(join_runs(runs[:2]))} == {"pin"}


def test_the_csv_has_a_row_for_each_group(runs, table, tmp_path):
    tables.collect_answers(runs, ABOUT, "title").write(tmp_path)
    rows = list(csv.DictReader((tmp_path / "recall.csv").read_text().splitlines()))
    found = tables.summarise_answers(table)
    assert [[row[name] for name in tables.GROUP] for row in rows] == [
        [str(one[name]) for name in tables.GROUP] for one in found
    ]
    assert float(rows[0]["within_1_mm"]) == pytest.approx(found[0]["within"][1], rel=1e-5)


def test_the_document_has_every_example_and_is_read_back(runs, table):
    document = json.loads(json.dumps(tables.collect_answers(runs, ABOUT, "").document, allow_nan=False))
    assert document["examples"]["first mssd_m"][2] is None
    assert document["examples"]["problem"][2] == "the file is damaged"
    assert document["runs"][0]["refused"] == 12
    assert tables.summarise_answers(ExampleTable.read(document["examples"])) == tables.summarise_answers(table)


def test_problems_are_counted_not_dropped(runs, table):
    assert tables.list_problems(table) == [("the file is damaged", 2 * len(runs))]
    assert "the file is damaged" in tables.collect_answers(runs, ABOUT, "title").format_markdown()


def test_bop_rows_are_poses_in_millimetres_with_scores(runs, table):
    T = make_transform(rotation_about([0, 0, 1], np.pi / 2), [0.01, -0.02, 0.03])
    number = 2 * 24 + 2 * 4 + 1  # of the third run, the fifth example from three touches
    table["T_sensor_object"][number, 0] = T
    rows = list(csv.DictReader(io.StringIO(format_results(make_scenes(table), OURS, 3))))
    assert tuple(rows[0]) == COLUMNS
    (row, *others) = [row for row in rows if (row["scene_id"], row["im_id"]) == ("3", "4")]
    assert len(others) == 3  # the other listed poses
    assert row["obj_id"] == "2"
    assert np.allclose(np.array(row["R"].split(), float).reshape(3, 3), T[:3, :3])
    assert np.allclose(np.array(row["t"].split(), float), [10, -20, 30])
    assert float(row["score"]) == pytest.approx(table["probability"][number], rel=1e-5)
    assert float(row["time"]) == pytest.approx(table["seconds"][number], rel=1e-4)
    assert not [row for row in rows if row["im_id"] == "1"]  # an example without a pose


def test_bop_truth_has_each_example_whose_first_touch_can_be_read(table):
    truth = make_truth(make_scenes(table)[0], 7)
    assert sorted(map(int, truth)) == [n for n in range(12) if n != 1]
    (pose,) = truth["0"]
    assert (pose["cam_R_m2c"], pose["cam_t_m2c"], pose["obj_id"]) == (np.eye(3).ravel().tolist(), [0, 0, 0], 7)


def test_bop_files_are_one_for_each_number_of_touches(table, tmp_path):
    written = write_bop(tmp_path, make_scenes(table))
    tables = [f"tactile-loc-{touches}-touches_evaluation-test.csv" for touches in (1, 3)]
    assert [path.name for path in written] == ["ids.json", *tables]
    ids = json.loads(written[0].read_text())
    assert ids["objects"] == {"pin": 1, "hook": 2}
    assert (tmp_path / "bop" / "test" / "000004" / "scene_gt.json").is_file()
