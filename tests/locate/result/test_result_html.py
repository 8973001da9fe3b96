"""The HTML that notebooks display: the verdict, the pictures of each touch and hypothesis, and what is left out."""

import base64
import dataclasses
import html
import re
from io import BytesIO

import numpy as np
from PIL import Image

from tactile_loc import Touch, localize_together
from tactile_loc.io.shape_pictures import NO_CONTACT, OUTLINE, read_colour
from tactile_loc.locate.result.result_html import MOST_ROWS, MOST_TOUCHES, SIDE_PX


def read_pictures(page: str) -> list[np.ndarray]:
    codes = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    return [np.asarray(Image.open(BytesIO(base64.b64decode(code)))) for code in codes]


def test_a_notebook_displays_the_summary_and_the_hypotheses(localization):
    page = localization._repr_html_()
    words = html.unescape(re.sub(r"<[^>]+>", "", page))
    assert all(line in words for line in localization.summary().splitlines())
    assert page.count("<tr>") == 2 + min(MOST_ROWS, len(localization.hypotheses))
    total = len(localization.hypotheses)
    assert f"{total - MOST_ROWS} of {total} poses" in page


def test_each_picture_has_the_observed_outline(localization):
    first, *others = read_pictures(localization._repr_html_())
    outlines = [(picture == read_colour(OUTLINE)).all(axis=2) for picture in (first, *others)]
    assert max(first.shape) in range(SIDE_PX // 2, 2 * SIDE_PX)
    assert outlines[0].any()
    assert all(np.array_equal(outline, outlines[0]) for outline in outlines)


def test_the_best_pose_predicts_the_observed_contact(localization):
    observed, best, *_ = read_pictures(localization._repr_html_())
    assert np.abs(observed.astype(int) - best).mean() < 5


def test_a_mask_is_predicted_at_the_press_of_the_pose(localization):
    """The assumed press of the mask is a third of the true one, so a prediction at this press would be smaller."""
    touch = localization.touch
    press_m = touch.press_depth_m / 3
    mask = Touch.from_mask(
        touch.contact_shape.contact, sensor=touch.geometry, press_depth_m=press_m, press_std_m=touch.press_depth_m / 3
    )
    page = dataclasses.replace(localization, touch=mask)._repr_html_()
    observed, best = ((picture != read_colour(NO_CONTACT)).any(axis=2) for picture in read_pictures(page)[:2])
    assert (observed & best).sum() > 0.9 * (observed | best).sum()


def test_every_touch_has_a_column_of_pictures(localizer):
    touches = [
        dataclasses.replace(touch, T_base_sensor=np.linalg.inv(touch.T_sensor_object))
        for touch in localizer.simulate(MOST_TOUCHES + 1, seed=2)
    ]
    found = localize_together([(localizer, touch) for touch in touches], top=2)
    page = found._repr_html_()
    assert len(read_pictures(page)) == MOST_TOUCHES * (1 + len(found.hypotheses))
    assert f"1 of {MOST_TOUCHES + 1} touches" in page
    assert "base frame" in page


def test_names_cannot_contain_html(localization):
    touch = dataclasses.replace(localization.touch, name="<b>bold</b>")
    assert "<b>" not in dataclasses.replace(localization, touch=touch)._repr_html_()


def test_a_result_made_by_hand_has_no_pictures(localization):
    page = dataclasses.replace(localization, config=None)._repr_html_()
    assert read_pictures(page) == []
    assert str(localization.verdict) in page
