"""A job: a method locates examples without the truth, and its answers are measured."""

import numpy as np
import pytest
from message_helpers import naming

from tactile_loc_benchmark.interfaces import AnswerError, ScoredPoses


def rows_of(found, method):
    return [row for row in found.results.rows if (row["source"], row["method"]) == ("sketch", method)]


def test_right_and_wrong_poses_are_measured(finished):
    for row in rows_of(finished, "oracle"):
        assert row["problem"] == ""
        assert row["mssd_mm"] < 1e-3
        assert row["shape_mm"] < 1e-3
        assert (row["verdict"], row["probability"], row["covered"]) == ("certain", 0.75, True)
        np.testing.assert_allclose(row["T_base_object"][0], row["true_T_base_object"], atol=1e-8)
        assert row["diameter_m"] == pytest.approx(np.linalg.norm([0.030, 0.020, 0.012]))
    for row in rows_of(finished, "guess"):
        assert row["mssd_mm"] > 1
        assert "probability" not in row


def test_each_example_has_a_row_for_each_number_of_touches(finished):
    rows = rows_of(finished, "oracle")
    assert [(row["example"], row["touches"]) for row in rows] == [(e, n) for e in range(3) for n in (1, 2)]
    archived = [row for row in finished.results.rows if (row["source"], row["method"]) == ("archive", "guess")]
    assert [(row["example"], row["touches"]) for row in archived] == [(0, 1), (1, 1)]
    assert [bool(row["problem"]) for row in archived] == [False, True]


def test_a_method_without_a_pose_gives_rows_and_no_error(run_small):
    found = run_small(method=[{"name": "guess", "fault": "no pose"}])
    assert not found.failed
    assert {row["problem"] for row in found.results.rows} == {"nothing fits"}


@pytest.mark.parametrize(("fault", "says"), [("nothing", "NoneType"), ("mirror", "rigid")])
def test_an_answer_that_is_none_gives_one_clear_error(run_small, tmp_path, fault, says):
    found = run_small(tmp_path, method=[{"name": "guess", "fault": fault}])
    (cell,) = found.failed
    assert says in cell.error
    assert "return" in cell.error or "raise" in cell.error
    assert found.results.rows == []
    assert not (tmp_path / "errors").exists(), "a mistake of the method needs no traceback of ours"


@pytest.mark.parametrize(
    ("T", "scores", "p"),
    [
        (np.eye(4), [1.0], None),
        (np.eye(4)[None], [1.0, 2.0], None),
        (np.zeros((0, 4, 4)), [], None),
        (np.eye(4)[None], [np.nan], None),
        (np.eye(4)[None], [1.0], [-0.1]),
        (np.eye(4)[None], [1.0], [0.5, 0.5]),
        (1.1 * np.eye(4)[None], [1.0], None),
        (None, [1.0], None),
        (np.eye(4)[None], ["good"], None),
        (np.eye(4)[None], None, None),
    ],
)
def test_impossible_answers_are_refused_but_lists_are_not(T, scores, p):
    with pytest.raises(AnswerError, match=naming("a method returned")):
        ScoredPoses(T, scores, p)
    answer = ScoredPoses([np.eye(4).tolist()], [1], [1])
    assert answer.T_base_object.shape == (1, 4, 4), "answers may be lists"
    assert answer.scores.dtype == answer.probabilities.dtype == np.float64
