"""The files of BOP agree with the rows of a benchmark."""

import csv
import json

import numpy as np
import pytest

from tactile_loc_benchmark.bop_files import COLUMNS, write_bop


@pytest.fixture(scope="module")
def root(finished, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bop")
    return write_bop(folder, finished.results.rows, "small")


def test_there_is_a_file_for_each_method_and_number_of_touches(root):
    names = {f"{method}-{n}-touches_small-test.csv" for method in ("oracle", "guess") for n in (1, 2)}
    assert {path.name for path in root.glob("*.csv")} == names
    ids = json.loads((root / "ids.json").read_text())
    assert {one["file"] for one in ids["results"]} == names
    assert [(one["source"], one["object"]) for one in ids["scenes"]] == [
        ("sketch", "brick"),
        ("shy", "brick"),
        ("archive", "brick"),
    ]


def test_the_rows_are_the_listed_poses_and_the_truth_is_that_of_the_examples(root, finished):
    rows = list(csv.DictReader((root / "oracle-1-touches_small-test.csv").open()))
    assert tuple(rows[0]) == COLUMNS
    assert [(row["scene_id"], row["im_id"]) for row in rows[:6]] == [("1", str(k // 2)) for k in range(6)]
    truth = json.loads((root / "test" / "000001" / "scene_gt.json").read_text())
    for row in rows[0:6:2]:
        (true,) = truth[row["im_id"]]
        assert np.allclose(np.array(row["R"].split(), float), true["cam_R_m2c"], atol=1e-7)
        assert np.allclose(np.array(row["t"].split(), float), true["cam_t_m2c"], atol=1e-4)
    first = finished.results.rows[0]
    assert float(rows[0]["time"]) == pytest.approx(first["seconds"], abs=1e-6)
    assert [float(row["score"]) for row in rows[:2]] == pytest.approx(first["scores"], rel=1e-5)
    T = np.array(first["true_T_base_object"])
    assert np.allclose(truth["0"][0]["cam_t_m2c"], 1e3 * T[:3, 3])


def test_an_example_without_a_pose_has_no_row_and_no_truth(root):
    rows = list(csv.DictReader((root / "guess-1-touches_small-test.csv").open()))
    assert [row["im_id"] for row in rows if row["scene_id"] == "3"] == ["0"]
    assert list(json.loads((root / "test" / "000003" / "scene_gt.json").read_text())) == ["0"]


def test_labels_that_differ_only_in_signs_get_files_of_their_own(run_small, tmp_path):
    labels = ["guess 1", "guess_1"]
    found = run_small(method=[{"name": "guess", "label": label} for label in labels], touches=[1])
    write_bop(tmp_path, found.results.rows)
    results = json.loads((tmp_path / "bop" / "ids.json").read_text())["results"]
    assert [one["method"] for one in results] == labels
    assert len({one["file"] for one in results}) == 2
