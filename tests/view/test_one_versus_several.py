"""The picture of one touch alone beside all touches states both verdicts and the errors, and labels every sensor."""

import dataclasses

import numpy as np
import pytest
from message_helpers import missing
from PIL import Image

from tactile_loc import localize_together
from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.view import one_versus_several
from tactile_loc.view.one_versus_several import describe_side, draw_one_versus_several, find_font, save_picture
from tactile_loc.view.palette import DARK, LIGHT, Palette


@pytest.fixture(scope="module")
def pair(localizer):
    """The results of the first of two touches, and of both."""
    touches = localizer.simulate_together(2, seed=3)
    observations = [(localizer, touch) for touch in touches]
    return localize_together(observations[:1]), localize_together(observations)


@pytest.fixture
def written(monkeypatch):
    """The texts that a picture shows, with their places."""
    texts = []
    plain = one_versus_several._Side.write

    def keep(side, at, text, *others, **look):
        texts.append((text, side.left + at[0], at[1]))
        plain(side, at, text, *others, **look)

    monkeypatch.setattr(one_versus_several._Side, "write", keep)
    return texts


def forget_truth(found):
    return dataclasses.replace(found, touch=dataclasses.replace(found.touch, T_sensor_object=None))


def count_orange(picture):
    """Return the number of pixels (left half, right half) below the contact shapes with the true pose's colour."""
    below = np.asarray(picture, float)[one_versus_several.SCENE_TOP :]
    near = np.abs(below - 255 * Palette.rgb(LIGHT.truth)).max(axis=-1) < 40
    return [half.sum() for half in np.split(near, 2, axis=1)]


def test_both_sides_state_verdict_and_error(pair, written):
    picture = draw_one_versus_several(*pair, "a pin")
    shown = [text for text, _, _ in written]
    assert "a pin" in shown
    for found, of in zip(pair, ("the first touch alone", "2 touches together"), strict=True):
        head, text = describe_side(found, of)
        assert {head, text} <= set(shown)
        assert not missing(head, of, str(found.verdict))
        assert not missing(text, found.count_explanations(), " off")
    assert shown.count("touch 2") == 2  # a contact shape and a sensor
    assert all(0 < x < picture.width and 0 < y < picture.height for _, x, y in written)


def test_the_true_pose_is_drawn_on_both_sides_only_if_it_is_known(pair):
    assert min(count_orange(draw_one_versus_several(*pair, "a pin"))) > 100
    unknown = [forget_truth(found) for found in pair]
    assert max(count_orange(draw_one_versus_several(*unknown, "a pin"))) == 0
    assert not any("off" in describe_side(found, "")[1] for found in unknown)


def test_long_texts_are_made_smaller(pair):
    plain, long = (np.asarray(draw_one_versus_several(*pair, text)) for text in ("a pin", "a pin " * 40))
    paper = np.array([255, 255, 255])
    heading = long[:60]
    assert (heading != paper).any()
    assert (heading[:, :5] == paper).all()
    assert (heading[:, -5:] == paper).all()
    assert np.array_equal(plain[70:], long[70:])


def test_dark_pictures_have_dark_paper_and_the_same_colours(pair):
    dark = np.asarray(draw_one_versus_several(*pair, "a pin", DARK))
    assert np.array_equal(dark[0, 0], 255 * Palette.rgb(DARK.paper))
    assert min(count_orange(dark)) > 100


def test_a_picture_is_written_whole_or_not_at_all(tmp_path):
    picture = Image.new("RGB", (5, 3), "#123456")
    with Image.open(save_picture(tmp_path / "some" / "picture.png", picture)) as read:
        assert read.size == (5, 3)
        assert read.getpixel((4, 2)) == (0x12, 0x34, 0x56)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        save_picture(tmp_path / "file" / "picture.png", picture)


def test_bold_letters_are_wider():
    assert find_font(20, "Bold").getlength("certain") > find_font(20).getlength("certain")


def test_equal_explanations_are_within_a_small_difference_of_the_best(pair):
    (alone, _) = pair
    best = max(h.imprint_iou for h in alone.hypotheses)
    assert all((h in alone.equal_explanations) == (h.imprint_iou >= best - 0.02) for h in alone.hypotheses)
