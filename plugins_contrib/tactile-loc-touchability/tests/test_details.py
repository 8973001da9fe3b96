"""The details of a study: the best touches, the answer in words, the page and the file."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest
from tactile_loc import LocalWorkers, write_page
from tactile_loc.plugin import Progress

from tactile_loc_touchability.details import Findings, find_details, give_answer
from tactile_loc_touchability.files import write_document
from tactile_loc_touchability.page import UNREACHED, draw_maps, make_touchability_page, subdivide
from tactile_loc_touchability.study import SensorSetup, StudyOptions, run_studies
from tactile_loc_touchability.together import CONFIRMED, BestTouches, average_nearby


@pytest.fixture(scope="module")
def found(localizer, folder) -> Findings:
    workers = LocalWorkers(1, 1, folder / "workers.log")
    options = StudyOptions(touches=20, sets=1, noise="none")
    studies = run_studies([SensorSetup(localizer, 6e-4)], options, folder / "out", workers, Progress())
    return find_details(studies, folder / "out", workers, Progress())


def test_the_best_touches_are_one_two_and_three_presses(found):
    assert [len(one.presses) for one in found.best] == [1, 2, 3]
    assert all(len(set(one.presses)) == len(one.presses) for one in found.best)
    assert all(one.shares["sets"] == CONFIRMED for one in found.best)


def test_the_file_and_the_page_have_the_answer(found, tmp_path):
    answer = give_answer(found)
    document, path = write_document([found.study], found, answer, tmp_path)
    written = json.loads(path.read_text())
    assert written["answer"] == answer == document["answer"]
    assert len(written["touches"][0]) == 20
    assert {"place_m", "verdict", "error_m"} <= set(written["touches"][0][0])
    page = write_page(make_touchability_page([found.study], found, answer), tmp_path / "report.html")
    assert answer in page.read_text()


def test_each_map_has_a_value_for_each_triangle(found):
    names, data = draw_maps(found)
    faces = len(base64.b64decode(data["mesh"]["faces"])) // 12
    assert len(names) == len(data["maps"]) == 3 + len(found.pairs)
    for one in data["maps"]:
        values = np.frombuffer(base64.b64decode(one["values"]), "<f4")
        assert len(values) == faces
        assert ((values == UNREACHED) | ((values >= 0) & (values <= one["high"]))).all()


def test_large_triangles_are_divided(plain):
    finer = subdivide(plain.mesh, 2e-3)
    assert finer.face_areas.sum() == pytest.approx(plain.mesh.face_areas.sum())
    assert np.linalg.norm(np.diff(finer.triangles_m, axis=1), axis=-1).max() <= 2e-3 + 1e-9


def test_results_nearby_are_averaged(study_of):
    study = study_of["plain"]
    left = (study.presses.places_m[:, 0] < 0).astype(float)
    places = np.array([[-0.014, 0, 0.004], [0.014, 0, 0.004]])
    low, high = average_nearby(study, left, places, np.tile([0.0, 0, 1], (2, 1)))
    assert low > 0.95
    assert high < 0.05


def share(touches: int, certain: float) -> dict:
    return {"touches": touches, "sets": 10, "certain": certain, "right": certain, "wrong": 0.0, "nothing": 0.0}


def make_rows(certain: float) -> list[dict]:
    sure = {"verdict": "certain", "error_m": 1e-4, "rivals": [], "right": 1.0}
    return [sure if k < 10 * certain else {**sure, "verdict": "ambiguous"} for k in range(10)]


@pytest.mark.parametrize(
    ("shares", "best", "said"),
    [
        ({1: 0.9}, (), "one touch at a random place usually determines the pose"),
        ({1: 0.1, 2: 0.5, 3: 0.9}, (), "3 touches at random places usually determine the pose"),
        ({1: 0.0, 2: 0.1}, (share(1, 0.2), share(2, 1.0)), "2 touches at the best places determined the pose in 100 %"),
        ({1: 0.0, 2: 0.1}, (share(2, 0.1),), "up to three touches seldom determine the pose"),
        ({1: 0.0, 2: 0.5}, (), "up to three touches determine the pose in at most 50 % of the cases"),
    ],
)
def test_the_answer_names_the_number_of_touches_that_usually_is_enough(study_of, shares, best, said):
    rows = {n: make_rows(certain) for n, certain in shares.items()}
    study = replace(study_of["plain"], rows=rows.pop(1), together=rows)
    touches = [BestTouches(tuple(range(one["touches"])), one) for one in best]
    assert said in give_answer(Findings(study, touches, (), ()))
