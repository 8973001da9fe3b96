"""The picture of one touch alone beside all touches states both verdicts and the errors, and labels every sensor."""

import dataclasses

import matplotlib.pyplot as plt
import pytest

from tactile_loc import localize_together
from tactile_loc.view.one_versus_several import draw_one_versus_several

pytestmark = pytest.mark.usefixtures("arranged_pictures")


@pytest.fixture(scope="module")
def pair(localizer):
    """The results of the first of two touches, and of both."""
    touches = localizer.simulate_together(2, seed=3)
    observations = [(localizer, touch) for touch in touches]
    return localize_together(observations[:1]), localize_together(observations)


def test_both_sides_state_verdict_and_error(pair):
    figure = draw_one_versus_several(*pair, "a pin")
    shown = [text.get_text() for text in figure.findobj(plt.Text)]
    assert "a pin" in shown
    for found in pair:
        assert any(text.endswith(f": {found.verdict}") for text in shown)
        assert any(text.startswith(found.count_explanations()) and text.endswith(" off") for text in shown)
    assert shown.count("touch 2") == 2  # a contact shape and a sensor


def test_no_true_pose_is_drawn_if_it_is_unknown(pair):
    unknown = [
        dataclasses.replace(found, touch=dataclasses.replace(found.touch, T_sensor_object=None)) for found in pair
    ]
    figure = draw_one_versus_several(*unknown, "a pin")
    shown = [text.get_text() for text in figure.findobj(plt.Text)]
    assert not any("true" in text or text.endswith(" off") for text in shown)


def test_equal_explanations_are_within_a_small_difference_of_the_best(pair):
    (alone, _) = pair
    best = max(h.imprint_iou for h in alone.hypotheses)
    assert all((h in alone.equal_explanations) == (h.imprint_iou >= best - 0.02) for h in alone.hypotheses)
