"""Studies of a part whose ends differ, and of a block that is the same on many sides."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tactile_loc import Localizer, LocalWorkers, PoseJudge
from tactile_loc.plugin import Progress

from tactile_loc_touchability.locating import NOTHING, measure_set
from tactile_loc_touchability.study import RIGHT_M, SensorSetup, Study, StudyOptions, run_studies, share_rows

FEW = StudyOptions(touches=20, sets=2, noise="none")
PRESS_M = 6e-4


def run(localizer: Localizer, folder: Path, options: StudyOptions = FEW) -> Study:
    workers = LocalWorkers(1, 1, folder / "workers.log")
    return run_studies([SensorSetup(localizer, PRESS_M)], options, folder / "out", workers, Progress())[0]


@pytest.fixture(scope="module")
def study(localizer: Localizer, folder: Path) -> Study:
    return run(localizer, folder)


def test_each_press_has_a_row_and_sets_have_theirs(study):
    assert len(study.rows) == len(study.presses) == 20
    assert {n: len(rows) for n, rows in study.together.items()} == {2: 2, 3: 2}


def test_rivals_are_motions_to_wrong_poses(study):
    obj = study.localizer.object
    motions = [np.reshape(one["motion"], (4, 4)) for row in study.rows for one in row["rivals"]]
    assert motions
    for T in motions:
        assert PoseJudge(obj).measure_errors(T[None], np.eye(4))[0, 0] > 0.99 * RIGHT_M


def test_finished_jobs_are_not_done_again(study, localizer, folder):
    kept = {path: path.stat().st_mtime_ns for path in (folder / "out" / "rows").iterdir()}
    again = run(localizer, folder)
    assert again.rows == study.rows
    assert {path: path.stat().st_mtime_ns for path in (folder / "out" / "rows").iterdir()} == kept


def test_another_seed_gives_other_jobs(localizer, folder, study):
    other = run(localizer, folder, replace(FEW, seed=1, sets=0))
    assert not np.allclose(other.presses.places_m, study.presses.places_m)


def test_a_press_that_shows_nothing_has_no_pose(localizer):
    row = measure_set(localizer, [])
    assert (row["verdict"], row["error_m"], row["rivals"]) == (NOTHING, None, [])


def test_shares_count_certain_right_and_wrong_rows():
    rows = [
        {"verdict": "certain", "error_m": 0.5 * RIGHT_M},
        {"verdict": "certain", "error_m": 2 * RIGHT_M},
        {"verdict": "ambiguous", "error_m": 0.1 * RIGHT_M},
        {"verdict": NOTHING, "error_m": None},
    ]
    shares = share_rows(1, rows)
    found = [shares[name] for name in ("certain", "right", "wrong", "nothing")]
    assert found == [0.5, 0.5, 0.25, 0.25]
