"""The page of a run agrees with result.json."""

import dataclasses
import json

import numpy as np
import pytest
from message_helpers import missing
from report_helpers import Elements, floats, html_of, numbers_in, page_in

from tactile_loc.core.geometry.rigid import rotation_about
from tactile_loc.locate.result.localization import Localization
from tactile_loc.reports.page import render
from tactile_loc.reports.run import make_result_page


@pytest.fixture(scope="module")
def result(run_folder) -> dict:
    return json.loads((run_folder / "result.json").read_text())


@pytest.fixture(scope="module")
def page(run_folder) -> Elements:
    return Elements(html_of(run_folder))


@pytest.fixture(scope="module")
def data(run_folder) -> dict:
    return page_in(run_folder).data


def test_the_page_lists_the_candidates_of_the_result(result, page):
    rows = page.rows[1 : 1 + len(result["hypotheses"])]
    assert page.rows[0][0] == "rank"
    for row, h in zip(rows, result["hypotheses"], strict=True):
        T = np.array(h["T_sensor_object"])
        shown = [float(cell.removeprefix("< ")) for cell in row[:7]]
        assert shown[:3] == pytest.approx([h["rank"], 100 * h["probability"], 100 * h["imprint_iou"]], abs=0.51)
        below = row[1].startswith("< ")
        assert below == (h["probability"] < 0.0005)
        assert shown[1] == pytest.approx(100 * h["probability"], abs=0.1 if below else 0.051)
        assert shown[3:6] == pytest.approx(1e3 * T[:3, 3], abs=0.0051)
        R = rotation_about(numbers_in(row[7]), np.radians(shown[6]))
        assert np.abs(R - T[:3, :3]).max() < 0.005
        assert float(row[8]) == pytest.approx(1e3 * h["error_m"], abs=0.0051)


def test_the_head_shows_names_pose_entropy_error_and_verdict(run_folder, result, page):
    assert not missing(page.text, "pin", "gelslim")
    assert f"{result['normalised_entropy']:.2f}" in page.text
    x, y, z = (1e3 * row[3] for row in result["hypotheses"][0]["T_sensor_object"][:3])
    assert f"{x:.2f}, {y:.2f}, {z:.2f} mm" in page.text
    assert not missing(page.text, result["grid_poses"])
    assert "error" in page.text
    assert not missing(page.text, result["verdict"], Localization.load(run_folder).explain())


def test_every_candidate_shows_its_shape_and_its_difference(result, page):
    cards = [a for a in page.named("div") if a.get("class") == "card"]
    assert len(cards) == len(result["hypotheses"])
    pictures = page.named("image")
    assert len(pictures) == 1 + 2 * len(cards)
    assert all(str(a["href"]).startswith("data:image/png;base64,") for a in pictures)


def test_scripts_draw_the_poses_of_the_result(result, data):
    for candidate, h in zip(data["candidates"], result["hypotheses"], strict=True):
        T = np.array(h["T_sensor_object"])[:3]
        T[:, 3] *= 1e3
        assert candidate["T"] == pytest.approx(T.ravel(), abs=1e-5)
        assert candidate["probability"] == h["probability"]
        assert candidate["error_mm"] == pytest.approx(1e3 * h["error_m"])
    truth = np.array(result["touch"]["T_sensor_object"])[:3]
    assert data["truth"][3::4] == pytest.approx(1e3 * truth[:, 3], abs=1e-5)
    assert dict(data["times"]) == {k: pytest.approx(1e3 * s) for k, s in result["seconds"].items() if k != "model"}


def test_the_peak_on_the_surface_is_under_the_best_pose(result, data):
    """The touch is clean and on a coarse grid: most of the probability is around the truth."""
    marks = data["surface"]["marks"]
    assert any("1" in text.split(", ") for text in marks["text"])
    vertices = floats(data["surface"]["mesh"]["vertices_mm"]).reshape(-1, 3)
    density = floats(data["surface"]["log_density"])
    first = next(i for i, text in enumerate(marks["text"]) if "1" in text.split(", "))
    near = np.linalg.norm(vertices - [marks[k][first] for k in "xyz"], axis=1) < 6
    assert density[near].max() > density.max() - 1


def test_the_bounds_hold_the_object_at_every_candidate(result, data):
    vertices = floats(data["mesh"]["vertices_mm"]).reshape(-1, 3)
    for candidate in data["candidates"]:
        T = np.array(candidate["T"]).reshape(3, 4)
        points = vertices @ T[:, :3].T + T[:, 3]
        for k, (low, high) in enumerate(data["bounds"]):
            assert low < points[:, k].min()
            assert points[:, k].max() < high


def test_a_result_without_a_true_pose_shows_no_error(run_folder):
    found = Localization.load(run_folder)
    touch = dataclasses.replace(found.touch, T_sensor_object=None)
    assessed = dataclasses.replace(found.assessment, errors=None)
    page = make_result_page(dataclasses.replace(found, touch=touch, assessed=assessed))
    assert page.data["truth"] is None
    assert page.data["creases"] == []
    assert all(candidate["error_mm"] is None for candidate in page.data["candidates"])
    text = Elements(render(page)).text
    assert "error" not in text.replace("press_error", "")  # an option of the refiner
    assert "true" not in text.replace("true pose is elsewhere", "")  # as the search states


def test_a_touch_from_an_image_shows_the_image(run_folder):
    loaded = Localization.load(run_folder)
    touch = dataclasses.replace(loaded.touch, image=np.full((30, 40, 3), 200, np.uint8))
    seen = dataclasses.replace(loaded, touch=touch)
    plain, found = (Elements(render(make_result_page(one))) for one in (loaded, seen))
    assert len(found.named("image")) == len(plain.named("image")) + 1
    assert found.text != plain.text, "the image has no caption"
