"""Pages of identifications, next touches, mounts and folders of touches."""

import re
from pathlib import Path

import numpy as np
import pytest
from message_helpers import missing
from PIL import Image
from report_helpers import Elements

from tactile_loc import Approach, Identification, KnownObject, NextTouch, PoseModes, RatedApproach, Verdict
from tactile_loc.io.mount_files import HandEyeRecord, HandEyeTouchRecord
from tactile_loc.locate.touch_files import LocatedFile
from tactile_loc.planning.next_touch_files import write_next_touch
from tactile_loc.reports.page import Page, render
from tactile_loc.reports.tasks import (
    make_folder_page,
    make_hand_eye_page,
    make_identification_page,
    make_next_touch_page,
)

EYE = np.eye(4).tolist()


@pytest.fixture
def picture(tmp_path) -> Path:
    path = tmp_path / "picture.png"
    Image.new("RGB", (40, 30), (200, 30, 60)).save(path)
    return path


def read(page: Page) -> Elements:
    """Return the elements of a page, after checks that hold for every page without plots."""
    html = render(page)
    assert len(html) < 1e6  # without plotly
    found = Elements(html)
    assert all(str(a["src"]).startswith("data:image/png") for a in found.named("img"))
    assert "<script>alert" not in html
    return found


def list_cells(page: Page) -> list[str]:
    """Return the texts of a page's table cells."""
    return re.findall(r"<td[^>]*>([^<]*)</td>", render(page))


def make_identification(localization, names: list[str]) -> Page:
    objects = [KnownObject(name, p, 0.5, localization) for name, p in zip(names, (0.39, 0.31), strict=True)]
    return make_identification_page(Identification(tuple(objects), 0.3), [localization.touch])


def test_an_identification_has_its_verdict_as_title(localization):
    page = make_identification(localization, ["hook", "head"])
    assert page.title.startswith("ambiguous: hook 39 %, head 31 %")
    found = read(page)
    iou = f"{100 * localization.best.imprint_iou:.0f}"
    assert {"hook", "head", "none of these", "39.0", iou} <= set(list_cells(page))
    assert len(found.named("img")) == 1


def test_a_folder_counts_its_verdicts(localization):
    found = [
        LocatedFile(Path("a.npz"), localization.best, verdict=Verdict.CERTAIN),
        LocatedFile(Path("b.npz"), localization.best, verdict=Verdict.CERTAIN),
        LocatedFile(Path("c.npz"), problem="c.npz is no touch"),
    ]
    page = make_folder_page(found, {"a.npz": localization.touch}, "pin on gelslim, from touches")
    assert page.title == "3 touches: 2 certain, 1 refused"
    shown = read(page)
    assert not missing(shown.text, "a.npz", "b.npz", "c.npz is no touch", "2 touches are not drawn")


def test_a_next_touch_shows_the_best_approach(localizer, picture):
    geometry, T = localizer.sensor.geometry, np.stack([np.eye(4)] * 2)
    modes = PoseModes((localizer.object,) * 2, T, np.array([0.5, 0.5]), geometry, 1e-3)
    rated = tuple(
        RatedApproach(Approach(np.eye(4), name=f"approach {k}"), 0.9, 0.8, 0.3, 0.8, np.array([0.01, np.nan]), 1.0)
        for k in (1, 2)
    )
    found = NextTouch(modes, rated, ((Approach(np.eye(4), name="far"), "is too far"),), localizer.scene)
    vars(found)["alike"] = ((0, 1),)  # otherwise it is found by drawing
    page = make_next_touch_page(found, picture)
    assert page.title == "next touch of pin: approach 1"
    shown = read(page)
    assert not missing(shown.text, "0.69 nats", "far is too far", "poses 1, 2")
    assert {"approach 1", "approach 2", "0.90", "0.30", "80"} <= set(list_cells(page))
    assert len(shown.named("img")) == 1
    assert write_next_touch(found)["ranked"][1]["travel_m"] == [0.01, None]


def test_a_mount_shows_its_residuals_and_deviations(picture):
    touches = [
        HandEyeTouchRecord(name="t0", residual_m=2e-4, residual_rad=0.01, imprint_iou=0.9),
        HandEyeTouchRecord(name="t1", residual_m=9e-3, residual_rad=0.2, imprint_iou=0.4, left_out="it is 9 mm off"),
    ]
    covariance = np.diag([1e-8] * 3 + [np.radians(0.5) ** 2] * 3).tolist()
    record = HandEyeRecord(T_flange_sensor=EYE, covariance=covariance, object="pin", sensor="digit", touch=touches)
    page = make_hand_eye_page(record, picture)
    assert not missing(read(page).text, "1 of 2", "0.10, 0.10, 0.10 mm", "0.50, 0.50, 0.50")
    assert {"t0", "0.20", "0.57", "t1", "9.00", "it is 9 mm off"} <= set(list_cells(page))
