"""Shares and places in words."""

import pytest

from tactile_loc_touchability.words import write_place, write_share


@pytest.mark.parametrize(
    ("share", "words"), [(0, "0 %"), (0.075, "7.5 %"), (0.0004, "0.0 %"), (0.83, "83 %"), (1, "100 %")]
)
def test_a_share_of_a_sample_has_no_more_digits_than_it_is_worth(share, words):
    assert write_share(share) == words


def test_a_place_is_in_millimetres():
    assert write_place([0.0012, -0.01, 0.0]) == "(1.2, -10.0, 0.0)"
